"""Graph isomorphism network with edge features: Insert, Halt and the encoder of the old graph."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Float

from sg3d_jax.nn.apply import Dense, stacked
from sg3d_jax.nn.embed import edge_features, graph_features, node_features
from sg3d_jax.scene.graph import SceneGraph


class Encoding(NamedTuple):
    """What a GINE makes of a graph."""

    nodes: Array  # float[N, width], zero at padding
    edges: Array  # float[E, width], meaningless at padding


class GINELayer(nn.Module):
    """One layer of a GINE."""

    width: int

    @nn.compact
    def __call__(
        self, nodes: Float[Array, "N D"], edge: Float[Array, "E D"], graph: SceneGraph
    ) -> tuple[Float[Array, "N D"], None]:
        """Returns the new node states, given W e_ij."""
        mask = graph.nodes.mask[:, None].astype(jnp.float32)
        edge_mask = graph.edges.mask[:, None].astype(jnp.float32)
        message = nn.relu(jnp.take(nodes, graph.senders, axis=0) + edge) * edge_mask
        total = jax.ops.segment_sum(message, graph.receivers, nodes.shape[0])
        hidden = nn.LayerNorm(name="norm")(nodes + total)
        hidden = nn.relu(Dense(2 * self.width, name="hidden")(hidden))
        return (nodes + Dense(self.width, name="out")(hidden)) * mask, None


class GINE(nn.Module):
    """h_i <- h_i + MLP(norm(h_i + sum_j relu(h_j + W e_ij))), on the edges of a padded graph.

    Source: Hu et al. 2020 (GINE); paper, Sec. "FLAGG for graph extension".
    Differs: residual, with a layer norm before the MLP, which sums over a dozen neighbours need.
    """

    width: int
    layers: int

    @nn.compact
    def __call__(self, graph: SceneGraph) -> Encoding:
        """Encodes one padded graph; masked nodes and edges do not matter."""
        mask = graph.nodes.mask[:, None].astype(jnp.float32)
        nodes = Dense(self.width, name="nodes")(node_features(graph)) * mask
        edges = nn.relu(Dense(self.width, name="edges")(edge_features(graph)))
        messages = Dense(self.layers * self.width, name="messages")(edges)
        messages = messages.reshape(-1, self.layers, self.width)
        layers = stacked(GINELayer, self.layers, in_axes=(1, nn.broadcast))
        nodes, _ = layers(self.width, name="layers")(nodes, messages, graph)
        return Encoding(nodes, edges)


class GraphHead(nn.Module):
    """A GINE with mean and max readout and an MLP: logits of a whole graph.

    Source: FLAGG's insertion and halting networks (pool, concatenate graph features, two layers).
    Differs: the maximum beside the mean, so that one unexplained plane is seen in a large graph.
    """

    width: int
    layers: int
    num_logits: int

    @nn.compact
    def __call__(self, graph: SceneGraph) -> Float[Array, " K"]:
        """Returns the logits of one padded graph."""
        nodes = GINE(self.width, self.layers, name="gine")(graph).nodes
        mask = graph.nodes.mask[:, None]
        mean = jnp.sum(nodes * mask, axis=0) / jnp.maximum(jnp.sum(mask), 1)
        most = jnp.max(jnp.where(mask, nodes, -1e9), axis=0)
        pooled = jnp.concatenate([mean, most, graph_features(graph)])
        hidden = nn.relu(Dense(self.width, name="hidden")(pooled))
        return Dense(self.num_logits, name="logits")(hidden)


class NodeHead(nn.Module):
    """A GINE and an MLP: logits of every node.

    Source: ours.
    """

    width: int
    layers: int
    num_logits: int

    @nn.compact
    def __call__(self, graph: SceneGraph) -> Float[Array, "N K"]:
        """Returns the logits of the nodes of one padded graph."""
        nodes = GINE(self.width, self.layers, name="gine")(graph).nodes
        hidden = nn.relu(Dense(self.width, name="hidden")(nodes))
        return Dense(self.num_logits, name="logits")(hidden)
