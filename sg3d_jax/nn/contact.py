"""Edges between observed nodes whose extents come close, which the encoder of the old graph adds.

The proximity graph goes by centroids: the two walls of a corridor's corner, twenty metres long, lie
ten metres apart there, behind a dozen planes of the offices beside it. By their ends they touch.

Source: ours.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sg3d_jax.nn.kin import with_heard
from sg3d_jax.scene.graph import Nodes, SceneGraph
from sg3d_jax.scene.ontology import PROXIMITY
from sg3d_jax.scene.proximity import k_least


def gaps(nodes: Nodes) -> Float[Array, "N N"]:
    """Returns the squared distances between the extents of nodes, metres.

    An extent is a segment at the height of the centroid, across the normal and as long as the width
    is; extents that cross count as their nearest ends.
    """
    normal, half = nodes.normal[:, :2], nodes.width / 2
    along = jnp.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    reach = half[:, None] * along
    ends = nodes.position[:, None, :2] + jnp.stack([reach, -reach], axis=1)
    offset = ends[:, :, None] - nodes.position[None, None, :, :2]
    place = jnp.einsum("ieja,ja->iej", offset, along)
    nearest = jnp.clip(place, -half[None, None], half[None, None])[..., None] * along[None, None]
    squared = jnp.min(jnp.sum((offset - nearest) ** 2, axis=-1), axis=1)
    height = nodes.position[:, 2]
    return jnp.minimum(squared, squared.T) + (height[:, None] - height[None, :]) ** 2


def connect_contacts(graph: SceneGraph, k: int) -> SceneGraph:
    """Appends edges from the observed nodes that come closest to an observed node.

    Args:
      graph: padded, `N` nodes.
      k: nodes that each one hears of, besides those that it has a proximity edge with.

    Returns:
      The graph with `N k` more edge slots, of directed proximity edges. It is no longer packed.
    """
    nodes, edges = graph.nodes, graph.edges
    num_nodes = nodes.mask.shape[0]
    near = edges.mask & (edges.relation == PROXIMITY)
    joined: Bool[Array, "N N"] = jnp.zeros((num_nodes, num_nodes), bool)
    joined = joined.at[graph.receivers, graph.senders].max(near)
    pairs = nodes.observed[:, None] & nodes.observed[None, :] & ~joined
    nearest, found = k_least(gaps(nodes), pairs, k)
    receivers = jnp.repeat(jnp.arange(num_nodes), nearest.shape[1])
    return with_heard(graph, nearest.ravel(), receivers, found.ravel())
