"""What the edge classifiers see of planes and pairs of planes, in the ground plane.

Source: the authors' code and settings (snt-arg/situational_graphs_reasoning).
Differs: the limits that bring features to about [0, 1] are counted on the training set, one length
for all that a pair has, instead of typed in for each set.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sg3d_jax.nn.edge_attention import Links
from sg3d_jax.nn.embed import safe_norm
from sg3d_jax.scene.graph import Nodes, SceneGraph
from sg3d_jax.scene.ontology import PROXIMITY


class Scales(NamedTuple):
    """Limits of the training set, metres: plain numbers, so that models hash."""

    width_min: float  # of the planes
    width_max: float  # of the planes
    distance_max: float  # between the centroids of planes that are near


def count_scales(stacks: Sequence[SceneGraph]) -> Scales:
    """Counts the limits of a training set.

    Args:
      stacks: padded graphs with proximity edges, stacked along a first axis; one stack a size.
    """

    def of_graph(graph: SceneGraph) -> tuple[Array, Array, Array]:
        nodes, links = graph.nodes, near_planes(graph)
        offset = nodes.position[links.senders] - nodes.position[links.receivers]
        return (
            jnp.min(jnp.where(nodes.observed, nodes.width, jnp.inf)),
            jnp.max(jnp.where(nodes.observed, nodes.width, 0.0)),
            jnp.max(jnp.where(links.mask, safe_norm(offset), 0.0)),
        )

    counted = [jax.jit(jax.vmap(of_graph))(graphs) for graphs in stacks]
    least, most, farthest = (np.concatenate(limits) for limits in zip(*counted, strict=True))
    return Scales(float(least.min()), float(most.max()), float(farthest.max()))


def near_planes(graph: SceneGraph) -> Links:
    """Returns the proximity edges of a padded graph, all others masked."""
    near = graph.edges.mask & (graph.edges.relation == PROXIMITY)
    return Links(graph.senders, graph.receivers, near)


def absolute_features(
    graph: SceneGraph, scales: Scales
) -> tuple[Float[Array, "N 3"], Float[Array, "E 3"]]:
    """Returns the features of EC-square: of planes width and normal, of edges gap and offset.

    They change when the building turns.

    Source: EC-square.
    Differs: the width is that of the plane itself, where the original trained on that of the plane
    beside it in its room.
    """
    nodes, limit = graph.nodes, scales.distance_max
    span = jnp.maximum(scales.width_max - scales.width_min, 1e-3)
    width = (nodes.width - scales.width_min) / span
    offset = nodes.position[graph.senders] - nodes.position[graph.receivers]
    gap = segment_distance(nodes, graph.senders, graph.receivers) / limit
    return (
        jnp.concatenate([width[:, None], (nodes.normal[:, :2] + 1) / 2], axis=-1),
        jnp.concatenate([gap[:, None], (offset[:, :2] + limit) / (2 * limit)], axis=-1),
    )


def relative_features(
    graph: SceneGraph, scales: Scales
) -> tuple[Float[Array, "N 1"], Float[Array, "E 3"]]:
    """Returns the features of EC-L: of planes the width, of edges a distance and two angles.

    The angles are between the sender's normal and the way to the receiver, and between the normals.
    Nothing changes when the building turns, moves or is mirrored.

    Source: EC-L.
    """
    nodes, senders, receivers = graph.nodes, graph.senders, graph.receivers
    offset = (nodes.position[receivers] - nodes.position[senders])[:, :2]
    normal, other = nodes.normal[senders, :2], nodes.normal[receivers, :2]
    features = [
        safe_norm(offset) / scales.distance_max,
        _angle(normal, offset) / (2 * jnp.pi) + 0.25,
        _angle(normal, other) / (2 * jnp.pi),
    ]
    return nodes.width[:, None] / scales.width_max, jnp.stack(features, axis=-1)


def segment_distance(nodes: Nodes, one: Array, other: Array) -> Float[Array, " E"]:
    """Returns the least distance of planes seen from above; zero if they cross.

    Args:
      nodes: planes as segments: centroid, width, along the normal turned by 90 degrees.
      one: int[E], node indices.
      other: int[E].
    """
    along = jnp.stack([-nodes.normal[:, 1], nodes.normal[:, 0]], axis=-1)
    reach, centre = along * nodes.width[:, None] / 2, nodes.position[:, :2]
    ends = jnp.stack([centre - reach, centre + reach], axis=1)
    to_other = _distance_to_segment(ends[one], ends[other])
    to_one = _distance_to_segment(ends[other], ends[one])
    apart = jnp.min(jnp.concatenate([to_other, to_one], axis=-1), axis=-1)
    across = _split_by(ends[one], ends[other]) & _split_by(ends[other], ends[one])
    return jnp.where(across, 0.0, apart)


def _distance_to_segment(
    points: Float[Array, "E P 2"], ends: Float[Array, "E 2 2"]
) -> Float[Array, "E P"]:
    start, along = ends[:, None, 0], (ends[:, 1] - ends[:, 0])[:, None]
    length = jnp.maximum(jnp.sum(along**2, axis=-1), 1e-12)
    share = jnp.clip(jnp.sum((points - start) * along, axis=-1) / length, 0.0, 1.0)
    return safe_norm(points - start - share[..., None] * along)


def _split_by(points: Float[Array, "E 2 2"], ends: Float[Array, "E 2 2"]) -> Array:
    """Returns whether two points lie on different sides of the line through a segment."""
    along = (ends[:, 1] - ends[:, 0])[:, None]
    side = _cross(along, points - ends[:, None, 0])
    return side[:, 0] * side[:, 1] < 0


def _angle(one: Float[Array, "E 2"], other: Float[Array, "E 2"]) -> Float[Array, " E"]:
    """Returns the unsigned angle between two vectors, radians; zero if one has no length."""
    return jnp.arctan2(jnp.abs(_cross(one, other)), jnp.sum(one * other, axis=-1))


def _cross(one: Float[Array, "... 2"], other: Float[Array, "... 2"]) -> Float[Array, "..."]:
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
