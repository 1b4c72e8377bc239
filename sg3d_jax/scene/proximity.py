"""The proximity graph of the observed nodes, the input of every model.

Source: paper, Eq. for E_P in Sec. "Initializing the plane graph"; k = 10 and the union of both
directions as in the authors' data (they query k + 1 neighbours of a KD-tree and drop the plane
itself).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sg3d_jax.scene.graph import Edges, Nodes, PackedGraph, ontology_of
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY, Ontology

NEIGHBOURS = 10
OTHERS = 3  # neighbours of other concepts


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
    return _either_way(*k_nearest(position, mask[:, None] & mask[None, :], k))


def observed_neighbours(
    nodes: Nodes, ontology: Ontology, k: int = NEIGHBOURS
) -> Bool[Array, "N N"]:
    """Returns the symmetric adjacency of the proximity graph of observed nodes.

    Where several concepts are observed, a node is joined to the k nearest of its own and to the
    `OTHERS` nearest of any other: furniture must not come between the walls.

    Args:
      nodes: padded.
      ontology: their concepts.
      k: neighbours a node.
    """
    observed = nodes.observed
    if ontology.is_observed.sum() == 1:
        return nearest_neighbours(nodes.position, observed, k)
    pairs = observed[:, None] & observed[None, :]
    alike = nodes.label[:, None] == nodes.label[None, :]
    own = _either_way(*k_nearest(nodes.position, pairs & alike, k))
    return own | _either_way(*k_nearest(nodes.position, pairs & ~alike, OTHERS))


def _either_way(nearest: Int[Array, "N K"], found: Bool[Array, "N K"]) -> Bool[Array, "N N"]:
    """Returns True at (i, j) if j is among what is nearest to i, or i to j."""
    num_nodes = nearest.shape[0]
    rows = jnp.arange(num_nodes)[:, None]
    directed = jnp.zeros((num_nodes, num_nodes), bool).at[rows, nearest].set(found)
    return directed | directed.T


def k_nearest(
    position: Float[Array, "N 3"], pairs: Bool[Array, "N N"], k: int
) -> tuple[Int[Array, "N K"], Bool[Array, "N K"]]:
    """Returns the nearest others of each node among its pairs, and which of them there are."""
    offset = position[:, None] - position[None, :]
    return k_least(jnp.sum(offset**2, axis=-1), pairs, k)


def k_least(
    distance: Float[Array, "N N"], pairs: Bool[Array, "N N"], k: int
) -> tuple[Int[Array, "N K"], Bool[Array, "N K"]]:
    """Returns the others at least distance from each node, likewise; of any kind of distance."""
    num_nodes = distance.shape[0]
    pairs = pairs & ~jnp.eye(num_nodes, dtype=bool)
    nearness, nearest = jax.lax.top_k(jnp.where(pairs, -distance, -jnp.inf), min(k, num_nodes))
    return nearest, jnp.isfinite(nearness)


def connect_observed(graph: PackedGraph, k: int = NEIGHBOURS) -> PackedGraph:
    """Gives a packed graph the proximity edges of its observed nodes, in place of any it had.

    Args:
      graph: packed, `N` nodes and `E` edges of capacity. Padding stays padding.
      k: neighbours a node.

    Returns:
      The same nodes; in the first edge slots both directions of every proximity edge, then the
      part-of edges of `graph`. Edges that do not fit in `E` are lost: `n_edge[0]` then exceeds `E`,
      which callers on the host check.

    Source: paper, Sec. "Initializing the plane graph".
    """
    nodes, edges = graph.nodes, graph.edges
    adjacency = observed_neighbours(nodes, ontology_of(graph), k)
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
