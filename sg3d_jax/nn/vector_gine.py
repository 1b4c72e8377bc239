"""GINE whose nodes hold vectors, too: where the grown nodes of a graph stand, told by its edges.

A grown node starts in the middle of its parts. In every layer scalars pass along the edges as in a
GINE, and with them vectors, weighted by the scalars: the normals at the two ends of an edge, the
way from one to the other, and its parts along these normals and upwards. What adds them up moves
the node. So a scene that is shifted, turned about the vertical or mirrored has its centroids
shifted, turned or mirrored, and a room between two pairs of facing planes can be put in the middle
exactly, however much of the planes is hidden.

Source: Schütt, Unke and Gastegger, "Equivariant message passing for the prediction of tensorial
properties and molecular spectra" (PaiNN), ICML 2021.
Differs: scalars are those of a GINE; vectors are a mean over neighbours, not a sum; directions are
in metres, not of unit length, and nodes have normals; positions move from layer to layer.
"""

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Float

from sg3d_jax.nn.apply import Dense, stacked
from sg3d_jax.nn.embed import edge_features, node_features, safe_norm
from sg3d_jax.nn.gine import GINELayer
from sg3d_jax.scene.graph import Edges, SceneGraph, ontology_of
from sg3d_jax.scene.ontology import PART_OF
from sg3d_jax.scene.padding import part_of_adjacency

UP = (0.0, 0.0, 1.0)
EDGE_SLOTS = 6  # a node: a plane has a room and some walls, directed both ways


def part_of_alone(graph: SceneGraph) -> SceneGraph:
    """Returns a padded graph with its part-of edges alone, in `EDGE_SLOTS` slots a node."""
    chosen = graph.edges.mask & (graph.edges.relation == PART_OF)
    slots = min(EDGE_SLOTS * graph.nodes.mask.shape[0], len(chosen))
    (place,) = jnp.nonzero(chosen, size=slots, fill_value=0)
    return graph._replace(
        edges=Edges(graph.edges.relation[place], jnp.arange(slots) < jnp.sum(chosen)),
        senders=graph.senders[place],
        receivers=graph.receivers[place],
    )


def amid_parts(graph: SceneGraph) -> SceneGraph:
    """Returns a padded graph whose grown nodes stand in the middle of their parts, bottom-up.

    Those that have no parts stay where they are, and so does what is observed.
    """
    nodes, ontology = graph.nodes, ontology_of(graph)
    is_part = jnp.asarray(ontology.may_be_part)[nodes.label[None, :], nodes.label[:, None]]
    parts = (part_of_adjacency(graph) & is_part).astype(nodes.position.dtype)
    count = jnp.sum(parts, axis=1)[:, None]
    moves = (count > 0) & (nodes.mask & ~nodes.observed)[:, None]
    position = nodes.position
    for _ in range(ontology.num_concepts - 1):  # one layer more each time
        position = jnp.where(moves, parts @ position / jnp.maximum(count, 1.0), position)
    return graph._replace(nodes=nodes._replace(position=position))


def directions(graph: SceneGraph) -> Float[Array, "E 6 3"]:
    """Returns the vectors that an edge knows, metres: each is turned as the scene is.

    The normals of its ends, the way from receiver to sender, and the parts of that along the
    normals and upwards.
    """
    nodes = graph.nodes
    way = nodes.position[graph.senders] - nodes.position[graph.receivers]
    normals = nodes.normal[graph.senders], nodes.normal[graph.receivers]
    axes = jnp.stack([*normals, jnp.broadcast_to(jnp.array(UP), way.shape)], axis=1)
    along = jnp.sum(axes * way[:, None], axis=-1, keepdims=True) * axes
    return jnp.concatenate([axes[:, :2], way[:, None], along], axis=1)


class VectorLayer(nn.Module):
    """A layer: scalars, then vectors, then positions."""

    width: int
    channels: int

    @nn.compact
    def __call__(
        self,
        state: tuple[Float[Array, "N D"], Float[Array, "N V 3"], Float[Array, "N 3"]],
        graph: SceneGraph,
    ) -> tuple[tuple[Float[Array, "N D"], Float[Array, "N V 3"], Float[Array, "N 3"]], None]:
        """Returns the new scalars and vectors of the nodes, and where they stand."""
        nodes, vectors, position = state
        graph = graph._replace(nodes=graph.nodes._replace(position=position))
        count, (sender, receiver) = position.shape[0], (graph.senders, graph.receivers)
        edge = Dense(self.width, name="edges")(edge_features(graph))
        lengths = safe_norm(vectors)
        nodes = nodes + Dense(self.width, name="lengths")(jnp.tanh(lengths))
        nodes, _ = GINELayer(self.width, name="scalars")(nodes, edge, graph)

        known = directions(graph)
        state_of_edge = nn.LayerNorm(name="norm")(nodes[sender] + nodes[receiver] + edge)
        number = known.shape[1] + 1
        gates = Dense(number * self.channels, name="gates")(nn.relu(state_of_edge))
        gates = gates.reshape(-1, number, self.channels) * graph.edges.mask[:, None, None]
        message = jnp.sum(gates[:, 1:, :, None] * known[:, :, None, :], axis=1)
        message += gates[:, 0, :, None] * vectors[sender]
        degree = jax.ops.segment_sum(graph.edges.mask.astype(jnp.float32), receiver, count)
        total = jax.ops.segment_sum(message, receiver, count)
        vectors = vectors + total / jnp.maximum(degree, 1.0)[:, None, None]

        grown = graph.nodes.mask & ~graph.nodes.observed
        zeros = nn.initializers.zeros
        weights = Dense(self.channels, kernel_init=zeros, name="moves")(nodes)
        weights *= grown[:, None]
        return (nodes, vectors, position + jnp.einsum("nv,nvc->nc", weights, vectors)), None


class VectorGINE(nn.Module):
    """Where the nodes of a graph stand; see the module."""

    width: int
    channels: int
    layers: int

    @nn.compact
    def __call__(self, graph: SceneGraph) -> Float[Array, "N 3"]:
        """Returns the positions of one padded graph, metres; what is observed stays."""
        graph = amid_parts(part_of_alone(graph))
        mask = graph.nodes.mask[:, None].astype(jnp.float32)
        nodes = Dense(self.width, name="nodes")(node_features(graph)) * mask
        vectors = jnp.zeros((nodes.shape[0], self.channels, 3), nodes.dtype)
        state = nodes, vectors, graph.nodes.position
        layers = stacked(VectorLayer, self.layers)(self.width, self.channels, name="layers")
        (_, _, position), _ = layers(state, graph)
        return position
