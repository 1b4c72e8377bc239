"""The removal process: a complete graph is cut at a random step of its insertion sequence.

Source: paper, Sec. "FLAGG for graph extension": nodes are removed in blocks until only the observed
ones are left; the modules learn to undo one removal.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, Key

from sg3d_jax.flagg.blocks import draw_schedule, insert_posterior
from sg3d_jax.flagg.ordering import Ordering, insertion_rank, is_upper
from sg3d_jax.scene.graph import SceneGraph, ontology_of
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
    any_cuts: float = 0.0,
    upper: str = "",
) -> Cut:
    """Draws an order, a schedule and a step of a complete graph, and cuts it there.

    What is left at a step lacks the last nodes of the order alone. A share of the cuts removes any
    nodes instead, so that a model also learns to mend a graph: a room that is missing below a floor
    that is there, a hole in the middle of a city.

    Args:
      graph: padded and complete.
      key: a new key gives a new trajectory and a new step, uniform over its T + 1 graphs.
      coins: block sizes; the block capacity `M` is the largest.
      ordering: "H" or "HP".
      layers: the concepts in the order of insertion; empty for bottom-up.
      any_cuts: the share of the cuts that remove any nodes (`draw_missing`); what comes next is
        then the first of them in the order.
      upper: a concept below which nothing is removed, and something is of what is not; empty for
        cuts of all that is grown.

    Returns:
      The cut. Its block indexes old nodes by their slots in `graph`.

    Differs: FLAGG unrolls every step of a trajectory into one batch; we draw one step a graph, the
    same objective in expectation. Cuts of any kind are ours.
    """
    key_order, key_schedule, key_step = jax.random.split(key, 3)
    num_nodes = graph.nodes.mask.shape[0]
    rank = insertion_rank(graph, key_order, ordering, layers)
    missing = graph.nodes.mask
    if any_cuts:
        key_any, key_missing = jax.random.split(jax.random.fold_in(key, 1))
        any_cut = jax.random.uniform(key_any) < any_cuts
        missing &= ~any_cut | draw_missing(graph, key_missing)
    if upper:
        missing &= jnp.asarray(is_upper(ontology_of(graph), upper, layers))[graph.nodes.label]
    if any_cuts or upper:
        rank = rank_of_missing(rank, missing, graph)
    num_missing = jnp.sum((rank >= 0) & graph.nodes.mask, dtype=jnp.int32)
    schedule = draw_schedule(key_schedule, num_missing, coins, num_nodes)
    num_cuts = jnp.maximum(schedule.num_steps, 1) if upper else schedule.num_steps + 1
    step = jax.random.randint(key_step, (), 0, num_cuts)
    if any_cuts:
        step = jnp.where(any_cut, 0, step)
    complete = step == schedule.num_steps
    num_inserted = jnp.where(complete, num_missing, schedule.start[step])
    size = jnp.where(complete, 0, schedule.size[step])
    return Cut(
        survivors=keep_nodes(graph, rank < num_inserted),
        block=extract_block(graph, rank, num_inserted, size, max(coins)),
        insert_probs=insert_posterior(num_missing - num_inserted, coins, num_nodes),
        complete=complete,
        has_block=~complete,
        inserted=jnp.any(grown_nodes(graph) & (rank < num_inserted)),
    )


def grown_nodes(graph: SceneGraph) -> Bool[Array, " N"]:
    """Returns which real nodes are not observed."""
    return graph.nodes.mask & ~graph.nodes.observed


def draw_missing(graph: SceneGraph, key: Key[Array, ""]) -> Bool[Array, " N"]:
    """Draws which nodes of a complete graph are missing: of each concept a share of its own.

    Half of the time they are those nearest to one node, a hole; else any.
    """
    key_share, key_node, key_hole = jax.random.split(key, 3)
    nodes, grown = graph.nodes, grown_nodes(graph)
    by_chance = jax.random.uniform(key_node, nodes.mask.shape)
    centre = nodes.position[jnp.argmax(jnp.where(grown, by_chance, -1.0))]
    distance = jnp.sum((nodes.position - centre[None]) ** 2, axis=-1)
    kin = (nodes.label[:, None] == nodes.label[None, :]) & grown[None, :]
    nearer = jnp.sum(kin & (distance[None, :] < distance[:, None]), axis=-1)
    by_distance = (nearer + 0.5) / jnp.maximum(jnp.sum(kin, axis=-1), 1)
    score = jnp.where(jax.random.bernoulli(key_hole), by_distance, by_chance)
    share = jax.random.uniform(key_share, (ontology_of(graph).num_concepts,))
    return grown & (score < share[nodes.label])


def rank_of_missing(
    rank: Int[Array, " N"], missing: Bool[Array, " N"], graph: SceneGraph
) -> Int[Array, " N"]:
    """Returns the places of the missing nodes among each other; -1 for what is there."""
    missing = missing & grown_nodes(graph)
    place = jnp.sum(missing[None, :] & (rank[None, :] < rank[:, None]), axis=-1, dtype=jnp.int32)
    return jnp.where(missing, place, jnp.where(graph.nodes.mask, -1, rank.shape[0]))


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
    size, capacity = jnp.sum(cut.block.mask, dtype=jnp.int32), cut.block.mask.shape[0]

    def draw(key: Key[Array, ""]) -> Block:
        fresh = insertion_rank(graph, key, "H", layers)
        rank = rank_of_missing(fresh, ~survivors, graph)
        return extract_block(graph, rank, jnp.zeros((), jnp.int32), size, capacity)

    return jax.vmap(draw)(jax.random.split(key, number))


def keep_nodes(graph: SceneGraph, keep: Bool[Array, " N"]) -> SceneGraph:
    """Masks out the other nodes and every edge that touches them."""
    kept_edges = graph.edges.mask & keep[graph.senders] & keep[graph.receivers]
    return masked(graph, keep & graph.nodes.mask, kept_edges)


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
