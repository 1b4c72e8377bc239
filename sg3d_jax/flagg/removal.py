"""The removal process: a complete graph is cut at a random step of its insertion sequence.

Source: paper, Sec. "FLAGG for graph extension": nodes are removed in blocks until only the observed
ones are left; the modules learn to undo one removal.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Key

from sg3d_jax.flagg.blocks import draw_schedule, insert_posterior
from sg3d_jax.flagg.ordering import Ordering, insertion_rank
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.padding import Block, masked, part_of_adjacency


class Cut(NamedTuple):
    """One graph of a removal trajectory and the targets of Insert, Fill and Halt on it."""

    survivors: SceneGraph  # G_t: the padded graph with everything not yet inserted masked out
    block: Block  # what Fill is to insert next; all False when the graph is complete
    insert_probs: Array  # float[K], exact posterior of the next block size; zero when complete
    complete: Array  # bool[], Halt's target
    has_block: Array  # bool[], False when complete
    inserted: Array  # bool[], False for the observed graph, which Halt never sees


def draw_cut(
    graph: SceneGraph,
    key: Key[Array, ""],
    coins: tuple[int, ...],
    ordering: Ordering = "H",
    layers: tuple[str, ...] = (),
) -> Cut:
    """Draws an order, a schedule and a step of a complete graph, and cuts it there.

    Args:
      graph: padded and complete.
      key: a new key gives a new trajectory and a new step, uniform over its T + 1 graphs.
      coins: block sizes; the block capacity `M` is the largest.
      ordering: "H" or "HP".
      layers: the concepts in the order of insertion; empty for bottom-up.

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
        survivors=keep_nodes(graph, rank < num_inserted),
        block=extract_block(graph, rank, num_inserted, size, max(coins)),
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
    layers: tuple[str, ...] = (),
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
      layers: the concepts in the order of insertion; empty for bottom-up.

    Returns:
      Blocks as large as the cut's own, with a leading axis `L`, independent given the cut.
    """
    survivors = cut.survivors.nodes.mask
    num_inserted = jnp.sum(survivors & ~graph.nodes.observed, dtype=jnp.int32)
    size, capacity = jnp.sum(cut.block.mask, dtype=jnp.int32), cut.block.mask.shape[0]

    def draw(key: Key[Array, ""]) -> Block:
        fresh = insertion_rank(graph, key, "H", layers)
        missing = graph.nodes.mask & ~survivors
        earlier = missing[None, :] & (fresh[None, :] < fresh[:, None])
        place = num_inserted + jnp.sum(earlier, axis=-1, dtype=jnp.int32)
        rank = jnp.where(missing, place, jnp.where(survivors, -1, survivors.shape[0]))
        return extract_block(graph, rank, num_inserted, size, capacity)

    return jax.vmap(draw)(jax.random.split(key, number))


def keep_nodes(graph: SceneGraph, keep: Bool[Array, " N"]) -> SceneGraph:
    """Masks out the other nodes and every edge that touches them."""
    kept_edges = graph.edges.mask & keep[graph.senders] & keep[graph.receivers]
    return masked(graph, keep, kept_edges)


def extract_block(
    graph: SceneGraph, rank: Array, first: Array, size: Array, capacity: int
) -> Block:
    """Extracts the nodes of rank first..first + size with their edges to themselves and before.

    Args:
      graph: padded and complete.
      rank: int[N], the place of each node in the order of insertion.
      first: int[], the least rank in the block.
      size: int[], how many nodes.
      capacity: M, the room for them.
    """
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
