"""The proximity graph of the observed planes: the input of every model.

Source: paper, Eq. for E_P in Sec. "Initializing the plane graph"; k = 10 and the union of both
directions as in the authors' data (they query k + 1 neighbours of a KD-tree and drop the plane
itself).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sg3d_jax.scene.concepts import PLANE, PROXIMITY
from sg3d_jax.scene.graph import Edges, SceneGraph

NEIGHBOURS = 10


def nearest_neighbours(
    position: Float[Array, "N 3"], mask: Bool[Array, " N"], k: int = NEIGHBOURS
) -> Bool[Array, "N N"]:
    """Returns the symmetric adjacency of the k-nearest-neighbour graph.

    Args:
      position: centroids, metres.
      mask: which rows take part; the others get no edge.
      k: neighbours a node; a graph of at most k + 1 nodes is complete.

    Returns:
      True at (i, j) if j is among the k nearest of i, or i among those of j. Ties go to the lower
      index.
    """
    num_nodes = position.shape[0]
    offset = position[:, None] - position[None, :]
    squared = jnp.sum(offset**2, axis=-1)
    pairs = mask[:, None] & mask[None, :] & ~jnp.eye(num_nodes, dtype=bool)
    squared = jnp.where(pairs, squared, jnp.inf)
    _, nearest = jax.lax.top_k(-squared, min(k, num_nodes))
    rows = jnp.arange(num_nodes)[:, None]
    directed = jnp.zeros((num_nodes, num_nodes), bool).at[rows, nearest].set(True) & pairs
    return directed | directed.T


def connect_planes(graph: SceneGraph, k: int = NEIGHBOURS) -> SceneGraph:
    """Replaces the edges of a padded graph by the proximity edges of its planes.

    Args:
      graph: padded, `N` nodes and `E` edges of capacity. Padding stays padding.
      k: neighbours a plane.

    Returns:
      The same nodes with both directions of every proximity edge in the first edge slots. Edges
      that do not fit in `E` are lost: `n_edge[0]` then exceeds `E`, which host callers check.

    Source: paper, Sec. "Initializing the plane graph".
    """
    nodes = graph.nodes
    adjacency = nearest_neighbours(nodes.position, nodes.mask & (nodes.label == PLANE), k)
    capacity = graph.senders.shape[0]
    senders, receivers = jnp.nonzero(adjacency, size=capacity, fill_value=0)
    count = jnp.sum(adjacency, dtype=jnp.int32)
    mask = jnp.arange(capacity) < count
    return graph._replace(
        edges=Edges(relation=jnp.full(capacity, PROXIMITY, jnp.int32), mask=mask),
        senders=senders.astype(jnp.int32),
        receivers=receivers.astype(jnp.int32),
        n_edge=jnp.stack([count, capacity - count]),
    )
