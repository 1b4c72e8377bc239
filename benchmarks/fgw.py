"""Scores the same pairs with our FGW and with POT: the same values, and how fast.

*Agreement* compares the optima of both losses with those of `ot.optim.cg` (absolute) and
`ot.gromov.fused_gromov_wasserstein` (squared), and ours with the best of ten random starts.
*Speed* compares seconds from host graphs to scores with the absolute loss, the same start and an
exact line search; ours without its compilation, which is reported apart. POT is given the threshold
form of the loss, the fastest that numpy has, and on two cores one process each. Seconds are wall
time, the shortest of a few runs; `load` says how busy the machine was otherwise.

Run: python benchmarks/fgw.py
Writes benchmarks/results/fgw.json; given a number of cores, prints the speed on so many instead.
"""

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import ot
from scipy.sparse.csgraph import shortest_path

from sg3d_jax.data import registry
from sg3d_jax.metrics.fgw import fgw, fgw_pairs
from sg3d_jax.metrics.fgw_problem import ALPHA, pose
from sg3d_jax.metrics.frank_wolfe import from_assignment, minimise
from sg3d_jax.scene.graph import SceneGraph, make_graph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF
from sg3d_jax.scene.padding import bucket, pad, stack

RESULTS: Final = Path(__file__).parent / "results" / "fgw.json"
PAIRS: Final = 256
Costs = tuple[np.ndarray, np.ndarray, np.ndarray, float]
Pair = tuple[SceneGraph, SceneGraph]

# By mean number of nodes: data set, graphs to draw, and the sizes that are kept of these.
SETS: Final = {
    "24": ("s-f-square", PAIRS, range(1000)),
    "30": ("s-f", PAIRS, range(1000)),
    "110": ("s-c", PAIRS, range(1000)),
    "223": ("large", 5 * PAIRS, range(180, 270)),
}


def graphs_of(size: str) -> list[SceneGraph]:
    """Returns the true graphs of a row."""
    name, count, kept = SETS[size]
    drawn = registry.make(name, count, seed=1)
    return [graph for graph in drawn if len(graph.nodes.label) in kept][:PAIRS]


def blurred(
    rng: np.random.Generator, graph: SceneGraph, metres: float = 0.3, share: float = 0.05
) -> SceneGraph:
    """Errs as a model does: noise, a share of wrong labels and lost edges, often a node less."""
    label, position = graph.nodes.label.copy(), graph.nodes.position.copy()
    new = np.flatnonzero(~graph.nodes.observed)
    position[new] += rng.normal(scale=metres, size=(len(new), 3))
    wrong = new[rng.random(len(new)) < share]
    label[wrong] = rng.choice(np.flatnonzero(~ontology_of(graph).is_observed), len(wrong))
    pairs = undirected_edges(graph, PART_OF)
    size = len(label) - int(rng.integers(2))
    kept = (pairs < size).all(axis=1) & (rng.random(len(pairs)) > share)
    return make_graph(label[:size], position[:size], part_of=pairs[kept])


def costs(generated: SceneGraph, truth: SceneGraph) -> Costs:
    """Returns feature distances and both hop matrices, dummies included, and the longest path."""
    observed = truth.nodes.position[truth.nodes.observed]
    spread = np.sqrt(observed[:, :2].var(axis=0).mean())
    size = max(len(graph.nodes.label) for graph in (generated, truth))
    features = np.zeros((2, size, 3 + ontology_of(truth).num_concepts))
    hops, longest = np.zeros((2, size, size)), 1.0
    for row, matrix, graph in zip(features, hops, (generated, truth), strict=True):
        count = len(graph.nodes.label)
        row[:count, :3] = (graph.nodes.position - observed.mean(axis=0)) / spread
        row[np.arange(count), 3 + graph.nodes.label] = 1.0
        links = np.zeros((count, count))
        links[tuple(undirected_edges(graph, PART_OF).T)] = 1.0
        path = shortest_path(links, directed=False, unweighted=True)
        path[np.isinf(path)] = 1 + path[np.isfinite(path)].max()
        longest = max(longest, path.max())
        matrix[:] = 1 + path.max()
        matrix[:count, :count] = path
        np.fill_diagonal(matrix, 0.0)
    distance = np.linalg.norm(features[0][:, None] - features[1][None], axis=-1)
    return distance, hops[0], hops[1], longest


def pot_fgw(distance: np.ndarray, left: np.ndarray, right: np.ndarray, longest: float) -> float:
    """Solves one pair by `ot.optim.cg`."""
    size = len(distance)
    mass = np.full(size, 1 / size)
    levels = np.arange(min(left.max(), right.max()))[:, None, None]
    left_layers = (left > levels).astype(float).reshape(-1, size)
    right_layers = (right > levels).astype(float).reshape(-1, size)

    def structure(plan: np.ndarray) -> np.ndarray:
        layers = (left_layers @ plan).reshape(-1, size, size).transpose(1, 0, 2)
        shared = layers.reshape(size, -1) @ right_layers
        total = (left @ plan.sum(axis=1))[:, None] + (right @ plan.sum(axis=0))[None]
        return (total - 2 * shared) / longest

    def energy(plan: np.ndarray) -> float:
        return float(np.sum(plan * structure(plan)))

    def line_search(
        _: Any, plan: np.ndarray, move: np.ndarray, gradient: Any, value: float, df: Any, **__: Any
    ) -> tuple[float, int, float, np.ndarray]:
        change = structure(move)
        slope, curvature = np.sum(gradient * move), ALPHA * np.sum(change * move)
        step = min(1.0, -slope / (2 * curvature)) if curvature > 0 else 1.0
        return step, 1, value + step * slope + step**2 * curvature, df + 2 * step * change

    plan = ot.optim.cg(
        mass,
        mass,
        (1 - ALPHA) * distance,
        ALPHA,
        energy,
        lambda plan: 2 * structure(plan),
        np.outer(mass, mass),
        line_search=line_search,
    )
    return float((1 - ALPHA) * np.sum(distance * plan) + ALPHA * energy(plan))


def pot_squared(distance: np.ndarray, left: np.ndarray, right: np.ndarray, longest: float) -> float:
    """Solves one pair with the squared loss by POT's own solver."""
    mass = np.full(len(distance), 1 / len(distance))
    hops = left / longest, right / longest
    _, log = ot.gromov.fused_gromov_wasserstein(distance, *hops, mass, mass, alpha=ALPHA, log=True)
    return float(log["fgw_dist"])


def score_with_pot(pair: Pair) -> float:
    """Scores a pair of host graphs, as `fgw_pairs` does."""
    return pot_fgw(*costs(*pair))


def seconds(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Returns the shortest of a few runs, and the result."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    return min(times), result


def agreement(size: str, count: int) -> dict[str, float]:
    """Compares optima on pairs that err as a model does, and on pairs that err far more."""
    rng = np.random.default_rng(2)
    truth = graphs_of(size)[:count]
    errors = [(0.3, 0.05), (1.5, 0.2)]
    generated = [blurred(rng, graph, *errors[index % 2]) for index, graph in enumerate(truth)]
    pairs = list(zip(generated, truth, strict=True))
    ours = fgw_pairs(generated, truth).value
    squared = fgw_pairs(generated, truth, loss="squared").value
    of_cg = np.array([score_with_pot(pair) for pair in pairs])
    of_pot = np.array([pot_squared(*costs(*pair)) for pair in pairs])
    best = np.array([best_of_random_starts(pair) for pair in pairs])
    return {
        "pairs": count,
        "mean_fgw": float(ours.mean()),
        "largest_difference_absolute": float(np.abs(ours - of_cg).max()),
        "largest_difference_squared": float(np.abs(squared - of_pot).max()),
        "mean_excess_over_best_of_ten_starts": float(np.mean(ours / best) - 1),
        "largest_excess_over_best_of_ten_starts": float(np.max(ours / best) - 1),
    }


def best_of_random_starts(pair: Pair) -> float:
    """Returns the lowest FGW of ten searches from random assignments."""
    capacity = bucket(
        *(
            max(len(field) for field in sizes)
            for sizes in zip(*((graph.nodes.label, graph.senders) for graph in pair), strict=True)
        )
    )
    orders = np.random.default_rng(3).random((10, capacity.nodes), np.float32)
    return float(_best_of_starts(*(pad(graph, capacity) for graph in pair), orders))


@jax.jit
def _best_of_starts(generated: SceneGraph, truth: SceneGraph, orders: jax.Array) -> jax.Array:
    problem = pose(generated, truth)
    inside = jnp.arange(orders.shape[1]) < problem.size

    def value(order: jax.Array) -> jax.Array:
        columns = jnp.argsort(jnp.where(inside, order, jnp.inf))
        found = minimise(problem, ALPHA, "absolute", from_assignment(problem, columns, "absolute"))
        energy = (1 - ALPHA) * problem.features + ALPHA * found.structure
        return jnp.sum(energy * found.plan)

    return jnp.min(jax.lax.map(value, orders))


def speed(size: str, cores: int) -> dict[str, float]:
    """Times both on the same pairs."""
    rng = np.random.default_rng(0)
    truth = graphs_of(size)
    generated = [blurred(rng, graph) for graph in truth]
    pairs = list(zip(generated, truth, strict=True))
    load = os.getloadavg()[0]
    first, _ = seconds(lambda: fgw_pairs(generated, truth), repeats=1)
    ours, scores = seconds(lambda: fgw_pairs(generated, truth), repeats=5)
    if cores == 1:
        pot, values = seconds(lambda: [score_with_pot(pair) for pair in pairs], repeats=2)
    else:
        with multiprocessing.get_context("spawn").Pool(cores) as pool:
            pool.map(score_with_pot, pairs[: 4 * cores])  # every worker has imported everything
            pot, values = seconds(lambda: pool.map(score_with_pot, pairs, chunksize=8), repeats=2)
    return {
        "pairs": len(truth),
        "mean_nodes": float(np.mean([len(graph.nodes.label) for graph in truth])),
        "load": load,
        "mean_fgw": float(scores.value.mean()),
        "largest_difference": float(np.abs(scores.value - values).max()),
        "pairs_per_second": len(truth) / ours,
        "pairs_per_second_pot": len(truth) / pot,
        "ratio": pot / ours,
        "compilation_seconds": first - ours,
    }


def memory(size: str) -> dict[str, float]:
    """Returns what the largest pair of a row takes, in megabytes: arrays and workspace."""
    largest = max(graphs_of(size), key=lambda graph: len(graph.nodes.label))
    pair = blurred(np.random.default_rng(0), largest), largest
    capacity = bucket(len(largest.nodes.label))
    sides = [jax.tree.map(lambda leaf: leaf[0], stack([graph], capacity)) for graph in pair]
    use: Any = jax.jit(fgw).lower(*sides).compile().memory_analysis()
    tracemalloc.start()
    score_with_pot(pair)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    total = use.argument_size_in_bytes + use.temp_size_in_bytes + use.output_size_in_bytes
    return {
        "nodes": len(largest.nodes.label),
        "capacity": capacity.nodes,
        "megabytes": total / 1e6,
        "megabytes_pot": peak / 1e6,
    }


def speed_on(cores: int) -> dict[str, dict[str, float]]:
    """Times in a process of its own, which sees that many cores and no more."""
    run = [sys.executable, __file__, str(cores)]
    available = sorted(os.sched_getaffinity(0))[-cores:]
    output = subprocess.run(
        run,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},  # two processes of two threads would collide
        preexec_fn=lambda: os.sched_setaffinity(0, available),
    ).stdout
    return json.loads(output)


def main() -> None:
    """Compares on graphs of about 24, 30, 110 and 223 nodes and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cores", nargs="?", type=int, help="measure on so many, and only print")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    if cores := arguments.cores:
        jax.config.update("jax_num_cpu_devices", cores)
        jax.config.update("jax_enable_compilation_cache", False)  # compiling is timed, not reading
        print(json.dumps({size: speed(size, cores) for size in SETS}))
        return
    counts = {"24": 96, "30": 96, "110": 64}
    results = {
        "cores": {str(cores): speed_on(cores) for cores in (1, 2)},
        "memory": {size: memory(size) for size in SETS},
        "agreement": {size: agreement(size, count) for size, count in counts.items()},
    }
    print(json.dumps(results, indent=2))
    arguments.output.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
