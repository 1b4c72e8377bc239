"""Graph transformer on the rectangle block x (block + old graph), conditioned on the old graph.

Only the M new nodes and their M x (M + N) pairs have a state that changes from layer to layer. The
old graph is encoded once: a vector a node, and gates on its edges. Through the gates a row of the
rectangle is propagated along the old graph, so that "this plane belongs to the new room" reaches
the planes that the geometry ties to it; two planes of one room agree although neither knows the
other's place.

Source: DiGress and FLAGG (edge FiLM, old nodes as frozen tokens); paper, Sec. "Adapting D4".
Differs: attention logits come from the pair state, which already holds both ends; messages are
weighted pair states, so no tensor is wider than the pair state; gated propagation along the old
graph and the geometry of the linked planes are ours.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Bool, Float, Int

from sg3d_jax.nn.apply import Dense, stacked
from sg3d_jax.nn.contact import connect_contacts
from sg3d_jax.nn.embed import Surface, relative_to_points, sinusoids, surface_of
from sg3d_jax.nn.gine import GINE
from sg3d_jax.nn.kin import connect_kin
from sg3d_jax.scene.graph import SceneGraph

FEW_NODES = 96  # of which a dense matrix costs less than a list of edges, as measured on a CPU


class Gates(NamedTuple):
    """H gates on each edge of the old graph, along which rows are propagated.

    Few rows are scattered along the edges, at a cost of O(M E), so that growing stays linear in the
    graph. Many rows, those of a one-shot model, are multiplied by a dense matrix: O(M N^2) with a
    constant some twenty times smaller. So are rows of few nodes, `FEW_NODES` at most.
    """

    values: Array  # float[E, H], zero at padding
    senders: Array  # int32[E]
    receivers: Array  # int32[E]
    dense: Array | None  # float[H, N, N], receiver x sender; None for few rows of many nodes


class Conditioning(NamedTuple):
    """The old graph as the denoisers see it; computed once a growth step."""

    nodes: Array  # float[N, width], zero at padding
    gates: Gates  # on its edges
    surface: Surface  # of the N old nodes
    mask: Array  # bool[N]


def propagate(gates: Gates, rows: Float[Array, "M N H"]) -> Float[Array, "M N H"]:
    """Sends each row along the edges: at a node, the gated sum over its neighbours."""
    if gates.dense is not None:
        return jnp.einsum("hij,mjh->mih", gates.dense, rows)
    sent = jnp.take(rows, gates.senders, axis=1) * gates.values[None]
    return jnp.zeros_like(rows).at[:, gates.receivers].add(sent)


class OldGraphEncoder(nn.Module):
    """GINE over the conditioning graph, with H gates on each of its edges."""

    width: int
    layers: int
    gates: int
    kin: int = 0  # nearest nodes of its own concept that a node hears of
    many_rows: bool = False  # of the blocks to come; see Gates
    contacts: int = 0  # observed nodes that one hears of because their extents come close

    @nn.compact
    def __call__(self, graph: SceneGraph) -> Conditioning:
        """Encodes one padded graph."""
        if self.contacts:
            graph = connect_contacts(graph, self.contacts)
        if self.kin:
            graph = connect_kin(graph, self.kin)
        encoding = GINE(self.width, self.layers, name="gine")(graph)
        sender = Dense(self.width, name="sender")(encoding.nodes)
        receiver = Dense(self.width, use_bias=False, name="receiver")(encoding.nodes)
        pair = Dense(self.width, use_bias=False, name="pair")(encoding.edges)
        pair += jnp.take(sender, graph.senders, 0) + jnp.take(receiver, graph.receivers, 0)
        values = Dense(self.gates, name="gates")(nn.relu(pair)) * graph.edges.mask[:, None]
        dense, num_nodes = None, graph.nodes.mask.shape[0]
        if self.many_rows or num_nodes <= FEW_NODES:
            dense = jnp.zeros((num_nodes, num_nodes, self.gates))
            dense = jnp.moveaxis(dense.at[graph.receivers, graph.senders].add(values), -1, 0)
        return Conditioning(
            nodes=encoding.nodes,
            gates=Gates(values, graph.senders, graph.receivers, dense),
            surface=surface_of(graph.nodes),
            mask=graph.nodes.mask,
        )


def linked_centre(
    linked: Float[Array, "M N"], conditioning: Conditioning
) -> tuple[Float[Array, "M 3"], Float[Array, "M 1"]]:
    """Returns the mean position of the linked old nodes, and how many there are.

    A node without links stands at the mean of the old graph.
    """
    linked = linked * conditioning.mask[None, :]
    count = jnp.sum(linked, axis=-1, keepdims=True)
    everyone = jnp.broadcast_to(conditioning.mask[None, :].astype(jnp.float32), linked.shape)
    weight = jnp.where(count > 0, linked, everyone)
    total = jnp.maximum(jnp.sum(weight, axis=-1, keepdims=True), 1.0)
    return (weight @ conditioning.surface.position) / total, count


def block_symmetric(pairs: Float[Array, "M tokens D"]) -> Float[Array, "M tokens D"]:
    """Averages the square block x block with its transpose; the rest is unchanged."""
    num_block = pairs.shape[0]
    square = pairs[:, :num_block]
    square = (square + jnp.swapaxes(square, 0, 1)) / 2
    return jnp.concatenate([square, pairs[:, num_block:]], axis=1)


class RectangleLayer(nn.Module):
    """One layer: propagate along the old graph, gather into the new nodes, update the pairs."""

    node_width: int
    pair_width: int
    heads: int
    gates: int

    @nn.compact
    def __call__(
        self,
        state: tuple[Float[Array, "M D"], Float[Array, "M tokens P"]],
        conditioning: Conditioning,
        token_mask: Bool[Array, " tokens"],
    ) -> tuple[tuple[Float[Array, "M D"], Float[Array, "M tokens P"]], None]:
        """Returns the new states of the block nodes and of the pairs."""
        block, pairs = state
        num_block = block.shape[0]
        normed = nn.LayerNorm(name="pair_norm")(pairs)
        projected = Dense(self.gates + self.heads + self.pair_width, name="project")(normed)
        claim, logits, hidden = jnp.split(projected, [self.gates, self.gates + self.heads], axis=-1)
        claim = claim * (token_mask[:num_block, None] & token_mask[None, :])[..., None]
        spread = propagate(conditioning.gates, claim[:, num_block:])
        spread = jnp.pad(spread, ((0, 0), (num_block, 0), (0, 0)))
        rivals = jnp.sum(claim, axis=0, keepdims=True) - claim
        context = jnp.concatenate([spread, rivals], axis=-1)

        logits = jnp.where(token_mask[None, :, None], logits, -1e9)
        weights = jax.nn.softmax(logits, axis=1)
        gathered = jnp.einsum("mth,mtp->mhp", weights, normed).reshape(num_block, -1)
        block = block + Dense(self.node_width, name="gathered")(gathered)
        expanded = Dense(2 * self.node_width, name="expand")(nn.LayerNorm(name="norm")(block))
        block = block + Dense(self.node_width, name="contract")(nn.relu(expanded))

        scale, shift = jnp.split(Dense(2 * self.pair_width, name="film")(block), 2, axis=-1)
        hidden += Dense(self.pair_width, use_bias=False, name="context")(context)
        hidden = nn.relu(hidden * (1 + scale[:, None]) + shift[:, None])
        return (block, pairs + Dense(self.pair_width, name="pair_out")(hidden)), None


class RectangleTransformer(nn.Module):
    """Predicts the clean labels and edges of a block from noisy ones."""

    node_width: int
    pair_width: int
    layers: int
    heads: int
    gates: int
    num_concepts: int

    @nn.compact
    def __call__(
        self,
        conditioning: Conditioning,
        block_mask: Bool[Array, " M"],
        label: Int[Array, " M"],
        edges: Int[Array, "M tokens"],
        time: Float[Array, ""],
    ) -> tuple[Float[Array, "M C"], Float[Array, "M tokens 2"]]:
        """Returns logits of the clean labels and of {no edge, edge}, symmetric inside the block.

        Args:
          conditioning: the encoded old graph.
          block_mask: real new nodes.
          label: noisy labels.
          edges: noisy edges, 0 or 1, symmetric inside the block.
          time: diffusion time, 0..S.
        """
        num_block = block_mask.shape[0]
        token_mask = jnp.concatenate([block_mask, conditioning.mask])
        is_edge = (edges * token_mask[None, :]).astype(jnp.float32)
        centre, count = linked_centre(is_edge[:, num_block:], conditioning)
        concept = jax.nn.one_hot(label, self.num_concepts)
        clock = jnp.broadcast_to(sinusoids(time)[None], (num_block, 16))
        size = jnp.broadcast_to(jnp.sum(block_mask) / num_block, (num_block, 1))
        inputs = jnp.concatenate([concept, clock, size, count / 5.0], axis=-1)
        block = Dense(self.node_width, name="block")(inputs)

        old = Dense(self.pair_width, name="old")(conditioning.nodes)
        own = Dense(self.pair_width, use_bias=False, name="own")(block)
        geometry = relative_to_points(centre, conditioning.surface)
        geometry = Dense(self.pair_width, name="geometry")(geometry)
        old_part = geometry + old[None] + own[:, None]
        new_part = own[:, None] + own[None, :]
        pairs = jnp.concatenate([new_part, old_part], axis=1)
        link = self.param("link", nn.initializers.normal(1.0), (self.pair_width,))
        pairs += is_edge[..., None] * link[None, None]

        sizes = self.node_width, self.pair_width, self.heads, self.gates
        layers = stacked(RectangleLayer, self.layers)(*sizes, name="layers")
        (block, pairs), _ = layers((block, pairs), conditioning, token_mask)

        logits_label = Dense(self.num_concepts, name="label")(nn.LayerNorm(name="out")(block))
        logits_edge = Dense(2, name="edge")(nn.relu(nn.LayerNorm(name="pair_out")(pairs)))
        return logits_label, block_symmetric(logits_edge)


class DistanceLayer(nn.Module):
    """One layer: messages along the edges into the new nodes, and back into the pairs."""

    width: int

    @nn.compact
    def __call__(
        self,
        state: tuple[Float[Array, "M D"], Float[Array, "M tokens D"]],
        old: Float[Array, "N D"],
        linked: Float[Array, "M tokens 1"],
    ) -> tuple[tuple[Float[Array, "M D"], Float[Array, "M tokens D"]], None]:
        """Returns the new states of the block nodes and of the pairs."""
        block, pairs = state
        tokens = jnp.concatenate([block, old], axis=0)
        message = nn.relu(nn.LayerNorm(name="norm")(pairs + tokens[None])) * linked
        total = Dense(self.width, name="message")(jnp.sum(message, axis=1))
        hidden = nn.relu(nn.LayerNorm(name="block_norm")(block + total))
        block = block + Dense(self.width, name="block")(hidden)
        mixed = nn.relu(message + Dense(self.width, name="mix")(block)[:, None])
        return (block, pairs + Dense(self.width, name="pairs")(mixed)), None


class DistanceNetwork(nn.Module):
    """Edge-regression GINE on the generated edges: predicts clean distances from noisy ones.

    Messages run from the linked tokens to the new nodes and back, along the edges alone.

    Source: paper, Eq. (distance_transition); the network is not specified there.
    """

    width: int
    layers: int
    num_concepts: int

    @nn.compact
    def __call__(
        self,
        conditioning: Conditioning,
        label: Int[Array, " M"],
        edges: Bool[Array, "M tokens"],
        distance: Float[Array, "M tokens"],
        time: Float[Array, ""],
    ) -> Float[Array, "M tokens"]:
        """Returns standardised clean distances, symmetric inside the block.

        Args:
          conditioning: the encoded old graph.
          label: labels of the block.
          edges: the generated edges; other pairs do not matter.
          distance: noisy standardised distances.
          time: diffusion time, 0..S.
        """
        num_block = label.shape[0]
        linked = edges[..., None].astype(jnp.float32)
        centre, count = linked_centre(linked[:, num_block:, 0], conditioning)
        concept = jax.nn.one_hot(label, self.num_concepts)
        clock = jnp.broadcast_to(sinusoids(time)[None], (num_block, 16))
        block = jnp.concatenate([concept, clock, count / 5.0], axis=-1)
        block = Dense(self.width, name="block")(block)
        old = Dense(self.width, name="old")(conditioning.nodes)
        to_old = relative_to_points(centre, conditioning.surface)
        points = Surface(centre, jnp.zeros_like(centre), jnp.zeros(num_block))
        geometry = jnp.concatenate([relative_to_points(centre, points), to_old], axis=1)
        inputs = jnp.concatenate([geometry, (distance * edges)[..., None]], axis=-1)
        pairs = Dense(self.width, name="pairs")(inputs)
        layers = stacked(DistanceLayer, self.layers)(self.width, name="layers")
        (_, pairs), _ = layers((block, pairs), old, linked)
        predicted = Dense(1, name="distance")(nn.relu(pairs))
        return block_symmetric(predicted)[..., 0]
