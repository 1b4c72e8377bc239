"""The Fused Gromov-Wasserstein distance between generated scene graphs and the true ones.

It is exact in that nothing is relaxed: no entropy, and plans that meet their marginals. The problem
is not convex, though, and what `frank_wolfe` finds is a stationary point, which may lie above the
minimum (how far is told there).

Source: paper, Sec. "Metrics". What is minimised is in `fgw_problem`, how in `frank_wolfe`.
"""

import itertools
from collections.abc import Iterable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float

from sg3d_jax.metrics.fgw_problem import (
    ALPHA,
    PAPER_SCALE,
    Loss,
    Problem,
    Scalar,
    Scale,
    centred,
    check_choices,
    check_pair,
    one_hot,
    pose,
)
from sg3d_jax.metrics.frank_wolfe import TOLERANCE, Search, from_product, minimise
from sg3d_jax.scene.graph import Edges, Nodes, SceneGraph, make_graph, ontology_of
from sg3d_jax.scene.ontology import PART_OF, Ontology
from sg3d_jax.scene.padding import Capacity, bucket, centre_of_observed, unpad_all

HostOrDevice = jax.Array | np.ndarray
Pair = tuple[SceneGraph, SceneGraph]

PAIRS_PER_CALL = 64
NOTHING = make_graph([], np.zeros((0, 3)))


class FGW(NamedTuple):
    """The distance, its two terms at its plan, and how it was found."""

    value: HostOrDevice  # float[], (1 - alpha) w + alpha gw
    gw: HostOrDevice  # float[], structure: difference of hop distances, as a share of the largest
    w: HostOrDevice  # float[], features: distance of position and label, in observed spreads
    plan: HostOrDevice | None  # float[N, N], mass from generated (rows) to true nodes (columns)
    converged: HostOrDevice  # bool[], the solver met its tolerance
    iterations: HostOrDevice  # int32[]
    matched: HostOrDevice | None = None  # float[C, C], nodes of each generated label (rows) that
    # the plan puts on nodes of each true label; `fgw_pairs` has it in place of the plan


def fgw(
    generated: SceneGraph,
    truth: SceneGraph,
    alpha: Scalar = ALPHA,
    scale: Scale = PAPER_SCALE,
    loss: Loss = "absolute",
) -> FGW:
    """Returns the FGW distance of two padded graphs over the same observed nodes.

    It is that of a stationary point, and so an upper bound of the minimum: see
    `frank_wolfe.minimise`. `jit`, `vmap` and `grad` apply.

    Args:
      generated: padded; its proximity edges are ignored.
      truth: padded to the same capacity, of the same concepts. What is observed in it sets the
        origin and the unit of positions. If both are host graphs, they are moved there in float64,
        so that they may stand anywhere; on the device they must stand near the origin already.
      alpha: weight of the structure, from 0 to 1.
      scale: what counts as distance 1 in metres and in hops; the paper's by default.
      loss: how two hop distances differ: "absolute" as in the paper, or "squared".

    Returns:
      `FGW` with its plan. `value` can be differentiated with respect to positions: the plan is a
      constant (envelope theorem). `fgw_loss` is the smooth variant for training.

    Raises:
      ValueError: the graphs have different ontologies or capacities, `alpha` is outside 0 to 1, or
        there is no such loss.

    Source: paper, Sec. "Metrics", Eq. for d_FGW.
    """
    check_choices(alpha, loss)
    check_pair(generated, truth)
    return _fgw(*centred(generated, truth), alpha, scale, loss)


@partial(jax.jit, static_argnames="loss")
def _fgw(generated: SceneGraph, truth: SceneGraph, alpha: Scalar, scale: Scale, loss: Loss) -> FGW:
    """Returns the FGW distance of two graphs near the origin."""
    problem = pose(generated, truth, scale)
    fixed = jax.lax.stop_gradient(problem)
    found = minimise(fixed, jax.lax.stop_gradient(alpha), loss, from_product(fixed, loss))
    return score_of(problem, found, alpha)


def score_of(problem: Problem, found: Search, alpha: Scalar) -> FGW:
    """Returns the score of a pair at the plan that a search has found."""
    w = jnp.sum(problem.features * found.plan)
    gw = jnp.sum(found.structure * found.plan)
    return FGW(
        value=(1 - alpha) * w + alpha * gw,
        gw=gw,
        w=w,
        plan=found.plan,
        converged=found.gap <= TOLERANCE,
        iterations=found.iterations,
    )


def matched_labels(
    plan: Float[Array, "N N"], generated: SceneGraph, truth: SceneGraph
) -> Float[Array, "C C"]:
    """Returns how many nodes of each generated label a plan puts on nodes of each true label.

    What it puts on dummies is not counted, so a row sums to at most the nodes of its label.
    """
    masks = generated.nodes.mask, truth.nodes.mask
    left, right = (
        jnp.where(mask[:, None], one_hot(graph), 0.0)
        for mask, graph in zip(masks, (generated, truth), strict=True)
    )
    num_nodes = jnp.maximum(*(jnp.sum(mask, dtype=plan.dtype) for mask in masks))
    return num_nodes * left.T @ plan @ right


def fgw_pairs(
    generated: Iterable[SceneGraph],
    truth: Iterable[SceneGraph],
    alpha: Scalar = ALPHA,
    scale: Scale = PAPER_SCALE,
    loss: Loss = "absolute",
) -> FGW:
    """Returns the FGW distances of many pairs of graphs.

    Pairs of one size bucket share a compilation, are solved a fixed number at a time, and are dealt
    to all devices of the CPU: with the option `jax_num_cpu_devices` at the number of cores, to all
    cores. That is so beside an accelerator, too (see `solvers`).

    Args:
      generated: host graphs of any size and anywhere, or padded ones.
      truth: likewise, over the same observed nodes in the same order.
      alpha: weight of the structure, from 0 to 1.
      scale: what counts as distance 1.
      loss: how two hop distances differ: "absolute" or "squared".

    Returns:
      `FGW` of numpy arrays with one entry a pair, in the order given; `matched` sums up the plan,
      which is None.

    Raises:
      ValueError: the lists differ in length, are empty or none, graphs have different ontologies,
        one exceeds the largest capacity, `alpha` is outside 0 to 1, or there is no such loss.
    """
    check_choices(alpha, loss)
    generated, truth = unpad_all(generated), unpad_all(truth)
    if len(generated) != len(truth) or not truth:
        raise ValueError(f"{len(generated)} generated graphs cannot be paired with {len(truth)}")
    if len({ontology_of(graph) for graph in (*generated, *truth)}) > 1:
        raise ValueError("the graphs to compare have different ontologies, expected one")
    pairs = list(zip(generated, truth, strict=True))
    capacities = [_capacity(pair) for pair in pairs]
    order = sorted(range(len(pairs)), key=lambda index: capacities[index])
    chunks = [
        _fgw_chunk([pairs[index] for index in members], capacity, alpha, scale, loss)
        for capacity, group in itertools.groupby(order, lambda index: capacities[index])
        for members in _in_chunks(list(group))
    ]
    place = np.argsort(order)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[place], *chunks)


def solvers() -> list[jax.Device]:
    """Returns the devices that solve pairs: those of the CPU, if JAX has it.

    An assignment is thousands of small steps, each of which waits for the one before: a core takes
    them in its stride, and an accelerator, which is free for growing or training meanwhile, would
    have to be told of every one.
    """
    try:
        return jax.local_devices(backend="cpu")
    except RuntimeError:  # JAX_PLATFORMS leaves it out
        return jax.local_devices()


def _in_chunks(members: list[int]) -> list[list[int]]:
    """Cuts a list into pieces that one call can take."""
    starts = range(0, len(members), PAIRS_PER_CALL)
    return [members[start : start + PAIRS_PER_CALL] for start in starts]


def _capacity(pair: Pair) -> Capacity:
    """Returns the bucket that holds the nodes and part-of edges of both graphs of a pair."""
    return bucket(
        max(len(graph.nodes.label) for graph in pair),
        max(int(np.count_nonzero(_is_part_of(graph))) for graph in pair),
    )


def _is_part_of(graph: SceneGraph) -> np.ndarray:
    return np.asarray(graph.edges.mask) & (np.asarray(graph.edges.relation) == PART_OF)


def _fgw_chunk(
    pairs: Sequence[Pair], capacity: Capacity, alpha: Scalar, scale: Scale, loss: Loss
) -> FGW:
    """Scores at most `PAIRS_PER_CALL` pairs, dealt to the devices in turn."""
    mesh = Mesh(np.array(solvers()), ("pairs",))
    share = -(-PAIRS_PER_CALL // mesh.size)
    slots = np.arange(share * mesh.size).reshape(mesh.size, share).T.ravel()[: len(pairs)]
    filled = [(NOTHING, NOTHING)] * (share * mesh.size)
    for slot, pair in zip(slots, pairs, strict=True):
        filled[slot] = pair
    origins = np.stack([centre_of_observed(truth) for _, truth in filled])
    ontology = ontology_of(pairs[0][1])
    sides = (_stack(graphs, origins, capacity, ontology) for graphs in zip(*filled, strict=True))
    with jax.set_mesh(None):  # one that the caller has set is for its own arrays
        scores = _fgw_stacked(*sides, alpha, scale, loss=loss, mesh=mesh)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[slots], scores)


@partial(jax.jit, static_argnames=("loss", "mesh"))
def _fgw_stacked(
    generated: SceneGraph, truth: SceneGraph, alpha: Scalar, scale: Scale, loss: Loss, mesh: Mesh
) -> FGW:
    """Scores stacked pairs one after another: no pair waits for the slowest of its stack."""

    def score(generated: SceneGraph, truth: SceneGraph) -> FGW:
        found = _fgw(generated, truth, alpha, scale, loss)
        matched = matched_labels(found.plan, generated, truth)
        return found._replace(plan=None, matched=matched)

    def score_unless_empty(pair: Pair) -> FGW:
        nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        occupied = jnp.any(pair[0].nodes.mask | pair[1].nodes.mask)
        return jax.lax.cond(occupied, score, lambda *_: nothing._replace(converged=True), *pair)

    def score_share(generated: SceneGraph, truth: SceneGraph) -> FGW:
        return jax.lax.map(score_unless_empty, (generated, truth))

    first = jax.tree.map(lambda leaf: leaf[0], (generated, truth))
    shapes = jax.eval_shape(score, *first)
    spec = PartitionSpec("pairs")
    return jax.shard_map(
        score_share, mesh=mesh, in_specs=(spec, spec), out_specs=spec, check_vma=False
    )(generated, truth)


def _stack(
    graphs: Sequence[SceneGraph], origins: np.ndarray, capacity: Capacity, ontology: Ontology
) -> SceneGraph:
    """Pads and stacks what the metric reads of host graphs: no normals, widths or proximity.

    One pass over all graphs: `padding.stack`, a graph and a field at a time, would take longer than
    the scores.
    """
    num_nodes = np.array([len(graph.nodes.label) for graph in graphs])
    part_of = [_is_part_of(graph) for graph in graphs]
    num_edges = np.array([np.count_nonzero(chosen) for chosen in part_of])
    node_mask = np.arange(capacity.nodes)[None] < num_nodes[:, None]
    edge_mask = np.arange(capacity.edges)[None] < num_edges[:, None]

    def padded(mask: np.ndarray, values: np.ndarray, dtype: type) -> np.ndarray:
        array = np.zeros((*mask.shape, *values.shape[1:]), dtype)
        array[mask] = values
        return array

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(graph.nodes, name) for graph in graphs])

    def ends(name: str) -> np.ndarray:
        chosen = [np.asarray(getattr(g, name))[c] for g, c in zip(graphs, part_of, strict=True)]
        return padded(edge_mask, np.concatenate(chosen), np.int32)

    position = joined("position") - np.repeat(origins, num_nodes, axis=0)
    return SceneGraph(
        nodes=Nodes(
            label=padded(node_mask, joined("label"), np.int32),
            position=padded(node_mask, position, np.float32),
            normal=np.zeros((*node_mask.shape, 3), np.float32),
            width=np.zeros(node_mask.shape, np.float32),
            kind=np.zeros(node_mask.shape, np.float32),
            observed=padded(node_mask, joined("observed"), bool),
            mask=node_mask,
        ),
        edges=Edges(relation=np.full(edge_mask.shape, PART_OF, np.int32), mask=edge_mask),
        senders=ends("senders"),
        receivers=ends("receivers"),
        n_node=np.stack([num_nodes, capacity.nodes - num_nodes], axis=1).astype(np.int32),
        n_edge=np.stack([num_edges, capacity.edges - num_edges], axis=1).astype(np.int32),
        globals=ontology,
    )
