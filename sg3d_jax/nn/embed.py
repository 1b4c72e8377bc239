"""Inputs of the networks: invariant geometry, what is already explained, and time.

Everything here is unchanged by translation, by rotation about the vertical (gravity is known) and
by reflection in a vertical plane: offsets are measured along and across the normals of the planes
themselves, and the side across is dropped.

Source: paper, Sec. "Related work" (invariance must be carried over to scene graphs); design.
Differs: the authors' D4 snapshot feeds absolute normals, which breaks the invariance.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt

from sg3d_jax.scene.graph import Nodes, SceneGraph, ontology_of
from sg3d_jax.scene.ontology import NUM_RELATIONS
from sg3d_jax.scene.padding import part_of_adjacency

SCALES = (0.1, 1.0)  # metres: the gap between two faces of a wall, and a step


class Surface(NamedTuple):
    """What geometry needs of a node; normal and width are zero for all but planes."""

    position: Array  # float[..., 3], metres
    normal: Array  # float[..., 3], unit
    width: Array  # float[...], metres


def surface_of(nodes: Nodes) -> Surface:
    """Returns the geometric fields of the nodes."""
    return Surface(nodes.position, nodes.normal, nodes.width)


def take(surface: Surface, index: Array) -> Surface:
    """Gathers surfaces by node index along the first axis."""
    return Surface(*(jnp.take(field, index, axis=0) for field in surface))


def safe_norm(vector: Float[Array, "... D"]) -> Float[Array, "..."]:
    """Returns the Euclidean norm over the last axis, with a finite gradient at zero."""
    return jnp.sqrt(jnp.sum(vector**2, axis=-1) + 1e-12)


def _seen_from(surface: Surface, offset: Float[Array, "... 3"]) -> tuple[Array, Array, Array]:
    """Returns an offset along the normal, across it (unsigned) and beyond the edge, metres."""
    normal = surface.normal
    along = jnp.sum(normal * offset, axis=-1)
    across = jnp.abs(normal[..., 0] * offset[..., 1] - normal[..., 1] * offset[..., 0])
    return along, across, across - surface.width / 2


def multiscale(lengths: Float[Array, "... F"]) -> Float[Array, "... 3*F"]:
    """Shows each length at three resolutions: of centimetres, of metres, and of buildings."""
    fine = [jnp.tanh(lengths / scale) for scale in SCALES]
    return jnp.concatenate([lengths / 5.0, *fine], axis=-1)


def relative_geometry(receiver: Surface, sender: Surface) -> Float[Array, "... 37"]:
    """Returns the invariant description of one surface as seen from another.

    Args:
      receiver: the surface that looks, batch shape `...`.
      sender: the surface that is looked at, the same batch shape. Points are surfaces with zero
        normal and width.

    Returns:
      Twelve lengths at three scales, and the cosine between the normals.
    """
    offset = sender.position - receiver.position
    along, across, beyond = _seen_from(receiver, offset)
    back_along, back_across, back_beyond = _seen_from(sender, -offset)
    lengths = [
        safe_norm(offset[..., :2]),
        offset[..., 2],
        along,
        across,
        beyond,
        back_along,
        back_across,
        back_beyond,
        jnp.abs(along) - sender.width / 2,  # zero where two walls meet at a corner
        jnp.abs(back_along) - receiver.width / 2,
        receiver.width - sender.width,
        receiver.width + sender.width,
    ]
    cosine = jnp.sum(receiver.normal * sender.normal, axis=-1, keepdims=True)
    return jnp.concatenate([multiscale(jnp.stack(lengths, axis=-1)), cosine], axis=-1)


def relative_to_points(points: Float[Array, "M 3"], surfaces: Surface) -> Float[Array, "M N 15"]:
    """Returns where points lie as seen from surfaces: five lengths at three scales."""
    offset = points[:, None, :] - surfaces.position[None, :, :]
    seen = Surface(*(field[None] for field in surfaces))
    along, across, beyond = _seen_from(seen, offset)
    lengths = [safe_norm(offset[..., :2]), offset[..., 2], along, across, beyond]
    return multiscale(jnp.stack(lengths, axis=-1))


def node_features(graph: SceneGraph) -> Float[Array, "N F"]:
    """Returns the inputs of every node: concept, width, and how many neighbours of each concept.

    The counts say what is already explained: a plane without a room, a room without a floor. Where
    something observed has kinds, its kind, too; that of what is grown is never an input.
    """
    nodes = graph.nodes
    concept = _one_hot_concept(graph)
    neighbours = part_of_adjacency(graph).astype(jnp.float32) @ concept
    width = multiscale(nodes.width[:, None])
    planes_apart = jnp.minimum(neighbours, 3.0)
    kind = _one_hot_kind(graph)
    features = jnp.concatenate([concept, width, planes_apart, neighbours / 10.0, kind], axis=-1)
    return features * nodes.mask[:, None]


def edge_features(graph: SceneGraph) -> Float[Array, "E F"]:
    """Returns the inputs of every directed edge: relation, geometry, common neighbours by concept.

    Common neighbours say which pairs of planes already share a wall or a room.
    """
    nodes, edges = graph.nodes, graph.edges
    surface = surface_of(nodes)
    geometry = relative_geometry(take(surface, graph.receivers), take(surface, graph.senders))
    common = jnp.minimum(common_neighbours(graph), 2).astype(jnp.float32)
    relation = jax.nn.one_hot(edges.relation, NUM_RELATIONS)
    features = jnp.concatenate([relation, geometry, common], axis=-1)
    return features * edges.mask[:, None]


def common_neighbours(graph: SceneGraph) -> Int[Array, "E C"]:
    """Returns how many part-of neighbours of each concept the two ends of every edge share.

    Neighbours are bits of words: E x N / 32 words are read in place of E x N numbers.
    """
    neighbours = _packed(part_of_adjacency(graph))
    members = _packed((_one_hot_concept(graph) > 0).T)
    shared = neighbours[graph.senders] & neighbours[graph.receivers]
    counts = [jnp.sum(jax.lax.population_count(shared & row[None]), axis=-1) for row in members]
    return jnp.stack(counts, axis=-1).astype(jnp.int32)


def _packed(rows: Bool[Array, "R N"]) -> UInt[Array, "R words"]:
    """Packs truth values into words of 32 bits."""
    rows = jnp.pad(rows, [(0, 0), (0, -rows.shape[1] % 32)])
    bits = rows.reshape(rows.shape[0], -1, 32).astype(jnp.uint32)
    places = jnp.arange(32, dtype=jnp.uint32)[None, None]
    return jnp.sum(bits << places, axis=-1, dtype=jnp.uint32)


def graph_features(graph: SceneGraph) -> Float[Array, " F"]:
    """Returns the number of nodes of each concept, and how many of them have no part-of edge."""
    concept = _one_hot_concept(graph)
    alone = ~jnp.any(part_of_adjacency(graph), axis=-1)
    counts = jnp.concatenate([jnp.sum(concept, 0), jnp.sum(concept * alone[:, None], 0)])
    return jnp.concatenate([jnp.minimum(counts, 3.0), counts / 10.0])


def _one_hot_concept(graph: SceneGraph) -> Float[Array, "N C"]:
    concepts = jax.nn.one_hot(graph.nodes.label, ontology_of(graph).num_concepts)
    return concepts * graph.nodes.mask[:, None]


def _one_hot_kind(graph: SceneGraph) -> Float[Array, "N K"]:
    """Returns the kinds of observed nodes, as many columns as their concepts have kinds in all."""
    ontology, nodes = ontology_of(graph), graph.nodes
    most = ontology.num_kinds * ontology.is_observed
    first = np.cumsum(most) - most
    column = jnp.asarray(first)[nodes.label] + nodes.kind.astype(jnp.int32) - 1
    known = nodes.observed & (nodes.kind > 0)
    return jax.nn.one_hot(column, int(most.sum())) * known[:, None]


def sinusoids(value: Float[Array, "..."], num_features: int = 16) -> Float[Array, "... F"]:
    """Embeds a number in sines and cosines of frequencies 1 to 1/1000.

    Source: FLAGG's 16-dimensional time embedding.
    """
    half = num_features // 2
    angle = value[..., None] * jnp.exp(-jnp.log(1000.0) * jnp.arange(half) / half)
    return jnp.concatenate([jnp.sin(angle), jnp.cos(angle)], axis=-1)
