"""The proximity graph of the observed planes, the input of every model; and that of their kin.

Source: paper, Eq. for E_P in Sec. "Initializing the plane graph"; k = 10 and the union of both
directions as in the authors' data (they query k + 1 neighbours of a KD-tree and drop the plane
itself).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sg3d_jax.scene.concepts import PART_OF, PLANE, PROXIMITY, ROOM
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
    nearest, found = _k_nearest(position, mask[:, None] & mask[None, :], k)
    rows = jnp.arange(num_nodes)[:, None]
    directed = jnp.zeros((num_nodes, num_nodes), bool).at[rows, nearest].set(found)
    return directed | directed.T


def _k_nearest(
    position: Float[Array, "N 3"], pairs: Bool[Array, "N N"], k: int
) -> tuple[Int[Array, "N K"], Bool[Array, "N K"]]:
    """Returns the nearest others of each node among its pairs, and which of them there are."""
    num_nodes = position.shape[0]
    offset = position[:, None] - position[None, :]
    squared = jnp.sum(offset**2, axis=-1)
    pairs = pairs & ~jnp.eye(num_nodes, dtype=bool)
    nearness, nearest = jax.lax.top_k(jnp.where(pairs, -squared, -jnp.inf), min(k, num_nodes))
    return nearest, jnp.isfinite(nearness)


def connect_planes(graph: SceneGraph, k: int = NEIGHBOURS) -> SceneGraph:
    """Gives a padded graph the proximity edges of its planes, in place of any it had.

    Args:
      graph: padded, `N` nodes and `E` edges of capacity. Padding stays padding.
      k: neighbours a plane.

    Returns:
      The same nodes; in the first edge slots both directions of every proximity edge, then the
      part-of edges of `graph`. Edges that do not fit in `E` are lost: `n_edge[0]` then exceeds `E`,
      which callers on the host check.

    Source: paper, Sec. "Initializing the plane graph".
    """
    nodes, edges = graph.nodes, graph.edges
    adjacency = nearest_neighbours(nodes.position, nodes.mask & (nodes.label == PLANE), k)
    capacity = edges.mask.shape[0]
    senders, receivers = jnp.nonzero(adjacency, size=capacity, fill_value=0)
    is_near = jnp.arange(capacity) < jnp.sum(adjacency)
    is_part = edges.mask & (edges.relation == PART_OF)
    mask = jnp.concatenate([is_near, is_part])
    chosen = jnp.argsort(~mask)[:capacity]  # stable: real edges first, in their order

    def pick(near: Array, part: Array) -> Array:
        return jnp.where(mask[chosen], jnp.concatenate([near, part])[chosen], 0).astype(jnp.int32)

    count = jnp.sum(adjacency, dtype=jnp.int32) + jnp.sum(is_part, dtype=jnp.int32)
    return graph._replace(
        edges=Edges(pick(jnp.full_like(senders, PROXIMITY), edges.relation), mask[chosen]),
        senders=pick(senders, graph.senders),
        receivers=pick(receivers, graph.receivers),
        n_edge=jnp.stack([count, capacity - count]),
    )


def connect_kin(graph: SceneGraph, k: int) -> SceneGraph:
    """Appends edges to rooms, floors and buildings from the nearest nodes of their own concept.

    What the next layer groups then hears of each other directly, and not by way of a dozen planes
    and walls: whether two rooms lie on one floor is a question to these two.

    Args:
      graph: padded, `N` nodes and `E` edges of capacity.
      k: nearest nodes of its concept that each node hears of.

    Returns:
      The graph with `(N // 3) k` more edge slots, whose directed proximity edges end at the first
      `N // 3` nodes above the walls; no scene of the benchmark that fills its bucket has more.
      Real edges are no longer in the first slots.
    """
    nodes = graph.nodes
    num_kin = nodes.mask.shape[0] // 3
    high = nodes.mask & (nodes.label >= ROOM)
    (slot,) = jnp.nonzero(high, size=num_kin, fill_value=0)
    real = jnp.arange(num_kin) < jnp.sum(high)
    label = nodes.label[slot]
    pairs = real[:, None] & real[None, :] & (label[:, None] == label[None, :])
    nearest, found = _k_nearest(nodes.position[slot], pairs, k)
    mask = found.ravel()
    receivers = jnp.where(mask, jnp.repeat(slot, nearest.shape[1]), 0).astype(jnp.int32)
    senders = jnp.where(mask, slot[nearest].ravel(), 0).astype(jnp.int32)
    relation = jnp.full_like(senders, PROXIMITY)
    count, unused = jnp.sum(mask, dtype=jnp.int32), jnp.sum(~mask, dtype=jnp.int32)
    return graph._replace(
        edges=Edges(
            jnp.concatenate([graph.edges.relation, relation]),
            jnp.concatenate([graph.edges.mask, mask]),
        ),
        senders=jnp.concatenate([graph.senders, senders]),
        receivers=jnp.concatenate([graph.receivers, receivers]),
        n_edge=graph.n_edge + jnp.stack([count, unused]),
    )
