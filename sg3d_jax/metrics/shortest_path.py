"""Hop distances between the nodes of a padded graph."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.padding import part_of_adjacency


def hop_distances(adjacency: Bool[Array, "N N"], mask: Bool[Array, " N"]) -> Int[Array, "N N"]:
    """Returns the number of edges on the shortest path between every two nodes.

    Args:
      adjacency: symmetric; False at padding.
      mask: True for real nodes.

    Returns:
      Hops; 0 on the diagonal and at padding. Two real nodes without a path between them are one hop
      further apart than the farthest connected pair.

    Source: paper, Sec. "Metrics" (SP in the Gromov-Wasserstein term).
    Differs: the paper leaves the distance of unconnected nodes open; ours is that of its dummies.
    """
    links = adjacency.astype(jnp.float32)
    start = jnp.eye(mask.shape[0], dtype=bool)

    # One breadth-first layer a turn, from every node at once: as many turns as the longest path.
    def spread(state: tuple) -> tuple:
        reached, _, hops, turn = state
        wider = reached | (reached.astype(jnp.float32) @ links > 0)
        hops = jnp.where(wider & ~reached, turn, hops)
        return wider, jnp.any(wider != reached), hops, turn + 1

    initial = start, jnp.array(True), jnp.zeros(start.shape, jnp.int32), jnp.array(1, jnp.int32)
    reached, _, hops, _ = jax.lax.while_loop(lambda state: state[1], spread, initial)
    unconnected = mask[:, None] & mask[None, :] & ~reached
    return jnp.where(unconnected, 1 + jnp.max(hops, initial=0), hops)


def part_of_hops(graph: SceneGraph) -> Int[Array, "N N"]:
    """Returns `hop_distances` over the part-of edges of a padded graph; proximity is ignored."""
    return hop_distances(part_of_adjacency(graph), graph.nodes.mask)
