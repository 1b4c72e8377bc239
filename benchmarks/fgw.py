"""Scores the same pairs with our FGW and with POT's conditional gradient; prints pairs a second.

Both get the absolute loss, the same start and an exact line search, and are timed from host graphs
to scores; ours without its compilation, which is reported apart. POT is given the threshold form of
the loss, the fastest that numpy has.

Run: OMP_NUM_THREADS=1 python benchmarks/fgw.py
Writes benchmarks/results/fgw.json.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import ot
from scipy.sparse.csgraph import shortest_path

from sg3d_jax.data import registry
from sg3d_jax.metrics.fgw import ALPHA, fgw_pairs
from sg3d_jax.scene.concepts import BUILDING, CITY, FLOOR, NUM_CONCEPTS, PART_OF, PLANE
from sg3d_jax.scene.graph import SceneGraph, make_graph, undirected_edges

RESULTS: Final = Path(__file__).parent / "results" / "fgw.json"
Costs = tuple[np.ndarray, np.ndarray, np.ndarray, float]


def cities(count: int) -> list[SceneGraph]:
    """Draws cities of three or four one-floor buildings, about 110 nodes each."""
    floors = iter(registry.make("s-f", 4 * count, seed=1))
    return [city([next(floors) for _ in range(3 + index % 2)]) for index in range(count)]


def city(floors: list[SceneGraph]) -> SceneGraph:
    """Puts every floor into a building of its own, 30 m apart, and these into a city."""
    labels, positions, edges, start = [], [], [], 0
    for storey, floor in enumerate(floors):
        count = len(floor.nodes.label)
        labels += [*floor.nodes.label, BUILDING]
        shifted = floor.nodes.position + np.array([30.0 * storey, 0, 0])
        positions += [*shifted, shifted.mean(axis=0)]
        edges += [*(undirected_edges(floor, PART_OF) + start)]
        edges.append([start + int(np.argmax(floor.nodes.label == FLOOR)), start + count])
        start += count + 1
    buildings = np.flatnonzero(np.array(labels) == BUILDING)
    edges += [[building, start] for building in buildings]
    positions.append(np.mean([positions[building] for building in buildings], axis=0))
    return hierarchy([*labels, CITY], np.array(positions), np.array(edges))


def hierarchy(label: Any, position: np.ndarray, part_of: np.ndarray) -> SceneGraph:
    """Builds a host graph; neither normals nor widths enter the metric."""
    return make_graph(label, position, np.zeros_like(position), np.zeros(len(label)), part_of)


def blurred(rng: np.random.Generator, graph: SceneGraph) -> SceneGraph:
    """Errs as a model does: 0.3 m of noise, 5 % of labels and edges, half the time a node less."""
    label, position = graph.nodes.label.copy(), graph.nodes.position.copy()
    new = np.flatnonzero(label != PLANE)
    position[new] += rng.normal(scale=0.3, size=(len(new), 3))
    wrong = new[rng.random(len(new)) < 0.05]
    label[wrong] = rng.integers(1, NUM_CONCEPTS, len(wrong))
    pairs = undirected_edges(graph, PART_OF)
    size = len(label) - int(rng.integers(2))
    kept = (pairs < size).all(axis=1) & (rng.random(len(pairs)) > 0.05)
    return hierarchy(label[:size], position[:size], pairs[kept])


def costs(generated: SceneGraph, truth: SceneGraph) -> Costs:
    """Returns feature distances and both hop matrices, dummies included, and the longest path."""
    planes = truth.nodes.position[truth.nodes.label == PLANE]
    spread = np.sqrt(planes[:, :2].var(axis=0).mean())
    size = max(len(graph.nodes.label) for graph in (generated, truth))
    features = np.zeros((2, size, 3 + NUM_CONCEPTS))
    hops, longest = np.zeros((2, size, size)), 1.0
    for row, matrix, graph in zip(features, hops, (generated, truth), strict=True):
        count = len(graph.nodes.label)
        row[:count, :3] = (graph.nodes.position - planes.mean(axis=0)) / spread
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


def seconds(call: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    """Returns the shortest of a few runs, and the result."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    return min(times), result


def compare(truth: list[SceneGraph]) -> dict[str, float]:
    """Times both on the same pairs."""
    rng = np.random.default_rng(0)
    generated = [blurred(rng, graph) for graph in truth]
    first, _ = seconds(lambda: fgw_pairs(generated, truth), repeats=1)
    ours, scores = seconds(lambda: fgw_pairs(generated, truth))
    pot, values = seconds(
        lambda: [pot_fgw(*costs(*pair)) for pair in zip(generated, truth, strict=True)]
    )
    return {
        "pairs": len(truth),
        "mean_nodes": float(np.mean([len(graph.nodes.label) for graph in truth])),
        "mean_fgw": float(scores.value.mean()),
        "mean_fgw_pot": float(np.mean(values)),
        "largest_difference": float(np.abs(scores.value - values).max()),
        "pairs_per_second": len(truth) / ours,
        "pairs_per_second_pot": len(truth) / pot,
        "ratio": pot / ours,
        "compilation_seconds": first - ours,
    }


def main() -> None:
    """Compares on graphs of about 24, 30 and 110 nodes and writes the figures."""
    sets = {
        "24": registry.make("s-f-square", 256, seed=1),
        "30": registry.make("s-f", 256, seed=1),
        "110": cities(64),
    }
    results = {name: compare(truth) for name, truth in sets.items()}
    for name, row in results.items():
        print(name, {key: round(value, 4) for key, value in row.items()})
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
