"""The removal process: a complete graph is cut at a random step of its insertion sequence.

Source: paper, Sec. "FLAGG for graph extension": nodes are removed in blocks until only the planes
are left; the modules learn to undo one removal.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from sg3d_jax.flagg.blocks import draw_schedule, insert_posterior
from sg3d_jax.flagg.ordering import Ordering, insertion_rank
from sg3d_jax.scene.ontology import CONCEPTS, PLANE
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.padding import Block, part_of_adjacency


class Cut(NamedTuple):
    """One graph of a removal trajectory and the targets of Insert, Fill and Halt on it."""

    survivors: SceneGraph  # G_t: the padded graph with everything not yet inserted masked out
    block: Block  # what Fill is to insert next; all False when the graph is complete
    insert_probs: Array  # float[K], exact posterior of the next block size; zero when complete
    complete: Array  # bool[], Halt's target
    has_block: Array  # bool[], False when complete
    inserted: Array  # bool[], False for the plane graph, which Halt never sees


def draw_cut(
    graph: SceneGraph,
    key: Key[Array, ""],
    coins: tuple[int, ...],
    ordering: Ordering = "H",
    layers: tuple[str, ...] = CONCEPTS,
) -> Cut:
    """Draws an order, a schedule and a step of a complete graph, and cuts it there.

    Args:
      graph: padded and complete.
      key: a new key gives a new trajectory and a new step, uniform over its T + 1 graphs.
      coins: block sizes; the block capacity `M` is the largest.
      ordering: "H" or "HP".
      layers: the concepts in the order of insertion.

    Returns:
      The cut. Its block indexes old nodes by their slots in `graph`.

    Differs: FLAGG unrolls every step of a trajectory into one batch; we draw one step a graph, the
    same objective in expectation.
    """
    key_order, key_schedule, key_step = jax.random.split(key, 3)
    num_nodes = graph.nodes.mask.shape[0]
    rank = insertion_rank(graph, key_order, ordering, layers)
    num_missing = jnp.sum((rank >= 0) & graph.nodes.mask, dtype=jnp.int32)
    schedule = draw_schedule(key_schedule, num_missing, coins, num_nodes)
    step = jax.random.randint(key_step, (), 0, schedule.num_steps + 1)
    complete = step == schedule.num_steps
    num_inserted = jnp.where(complete, num_missing, schedule.start[step])
    size = jnp.where(complete, 0, schedule.size[step])
    return Cut(
        survivors=_keep(graph, rank < num_inserted),
        block=_block(graph, rank, num_inserted, size, max(coins)),
        insert_probs=insert_posterior(num_missing - num_inserted, coins, num_nodes),
        complete=complete,
        has_block=~complete,
        inserted=step > 0,
    )


def draw_continuations(
    graph: SceneGraph,
    cut: Cut,
    key: Key[Array, ""],
    number: int,
    layers: tuple[str, ...] = CONCEPTS,
) -> Block:
    """Draws several blocks that may come next after the survivors of a cut, in the order H.

    What follows a state of H is a uniform draw among the nodes of the layer that are missing (and
    of those above once it is complete). Several such draws are samples of the same conditional
    distribution, and one encoding of the survivors serves them all.

    Args:
      graph: the complete padded graph.
      cut: of it, in the order H.
      key: a new key gives new blocks.
      number: L, how many.
      layers: the concepts in the order of insertion.

    Returns:
      Blocks as large as the cut's own, with a leading axis `L`, independent given the cut.
    """
    survivors = cut.survivors.nodes.mask
    num_inserted = jnp.sum(survivors & (graph.nodes.label != PLANE), dtype=jnp.int32)
    size, capacity = jnp.sum(cut.block.mask, dtype=jnp.int32), cut.block.mask.shape[0]

    def draw(key: Key[Array, ""]) -> Block:
        fresh = insertion_rank(graph, key, "H", layers)
        missing = graph.nodes.mask & ~survivors
        earlier = missing[None, :] & (fresh[None, :] < fresh[:, None])
        place = num_inserted + jnp.sum(earlier, axis=-1, dtype=jnp.int32)
        rank = jnp.where(missing, place, jnp.where(survivors, -1, survivors.shape[0]))
        return _block(graph, rank, num_inserted, size, capacity)

    return jax.vmap(draw)(jax.random.split(key, number))


def one_shot_cut(graph: SceneGraph) -> Cut:
    """Cuts a complete graph down to its planes: all other nodes are one block, in their order.

    Args:
      graph: padded and complete, `N` nodes of capacity.

    Returns:
      The cut; its block has room for `one_shot_capacity(N)` nodes. See `check_one_shot`.

    Source: FLAGG's one-shot schedule, T = 1.
    """
    nodes = graph.nodes
    high = nodes.mask & (nodes.label != PLANE)
    num_nodes, num_high = nodes.mask.shape[0], jnp.sum(high, dtype=jnp.int32)
    rank = jnp.where(high, jnp.cumsum(high, dtype=jnp.int32) - 1, -1)
    rank = jnp.where(nodes.mask, rank, num_nodes)
    return Cut(
        survivors=_keep(graph, rank < 0),
        block=_block(graph, rank, jnp.asarray(0), num_high, one_shot_capacity(num_nodes)),
        insert_probs=jnp.ones(1),
        complete=num_high == 0,
        has_block=num_high > 0,
        inserted=jnp.asarray(False),
    )


def one_shot_capacity(num_nodes: int) -> int:
    """Returns the room for new nodes in a graph of N slots: half of it, the rest is planes."""
    return num_nodes // 2


def check_one_shot(stacks: Sequence[SceneGraph]) -> None:
    """Refuses stacks of padded graphs that have no room for their high-level nodes in one block.

    Raises:
      ValueError: one sentence with the numbers, and what to change.
    """
    for graphs in stacks:
        nodes, room = graphs.nodes, one_shot_capacity(graphs.nodes.mask.shape[-1])
        most = int(jnp.max(jnp.sum(nodes.mask & (nodes.label != PLANE), axis=-1)))
        if most > room:
            raise ValueError(
                f"a graph in the bucket of {nodes.mask.shape[-1]} nodes has {most} that are not "
                f"planes, expected at most {room}: leave this bucket out of capacities"
            )


def _keep(graph: SceneGraph, keep: Array) -> SceneGraph:
    """Masks out the other nodes and every edge that touches them."""
    kept_edges = graph.edges.mask & keep[graph.senders] & keep[graph.receivers]
    num_nodes, num_edges = jnp.sum(keep, dtype=jnp.int32), jnp.sum(kept_edges, dtype=jnp.int32)
    return graph._replace(
        nodes=graph.nodes._replace(mask=keep),
        edges=graph.edges._replace(mask=kept_edges),
        n_node=jnp.stack([num_nodes, keep.shape[0] - num_nodes]),
        n_edge=jnp.stack([num_edges, kept_edges.shape[0] - num_edges]),
    )


def _block(graph: SceneGraph, rank: Array, first: Array, size: Array, capacity: int) -> Block:
    """Extracts the nodes of rank first..first + size with their edges to themselves and before."""
    adjacency = part_of_adjacency(graph)
    places = jnp.arange(capacity)
    mask = places < size
    chosen = jnp.argmax(rank[None, :] == (first + places)[:, None], axis=-1)
    to_old = adjacency[chosen] & (rank < first)[None, :] & mask[:, None]
    to_new = adjacency[chosen][:, chosen] & mask[:, None] & mask[None, :]
    return Block(
        label=jnp.where(mask, graph.nodes.label[chosen], 0),
        position=jnp.where(mask[:, None], graph.nodes.position[chosen], 0.0),
        edges=jnp.concatenate([to_new, to_old], axis=-1),
        mask=mask,
    )
