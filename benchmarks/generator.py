"""Draws graphs of the synthetic sets; prints graphs a second and how the statistics agree.

Run: python benchmarks/generator.py [NAME ...]
Writes benchmarks/results/generator.json; sets that are not named keep their results.
"""

import argparse
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.data import registry
from sg3d_jax.metrics.describe import describe

NUM_GRAPHS: Final = 2000
RESULTS: Final = Path(__file__).parent / "results" / "generator.json"

COLUMNS: Final = (
    "nodes",
    "edges",
    "hierarchy_edges",
    "proximity_edges",
    "degree",
    "hierarchy_degree",
    "plane",
    "room",
    "wall",
    "floor",
)


class Reference(NamedTuple):
    """Graphs drawn with the authors' generator (snt-arg/situational_graphs_datasets)."""

    graphs: int
    means: Mapping[str, float]  # by column
    seconds: float | None = None  # a graph, on one core


def _means(*values: float) -> dict[str, float]:
    return dict(zip(COLUMNS[: len(values)], values, strict=True))


REFERENCE: Final = {
    "s-f-square": Reference(
        400, _means(23.81, 108.5, 27.2, 81.2, 8.13, 2.16, 14.72, 3.68, 4.41), 0.17
    ),
    "s-f": Reference(400, _means(29.87, 145.2, 35.0, 110.2, 9.34, 2.28, 18.84, 3.88, 6.16), 0.17),
    "s-c": Reference(
        200, _means(109.53, 519.9, 129.7, 390.1, 9.50, 2.34, 67.28, 14.46, 21.20, 3.59), 1.1
    ),
}
NO_REFERENCE: Final = Reference(0, {})
NAMES: Final = tuple(name for name, spec in registry.DATASETS.items() if spec.config)


def measure(name: str) -> dict[str, Any]:
    """Returns the speed on one core and, for each column, our mean beside the reference."""
    start = time.process_time()
    graphs = registry.make(name, NUM_GRAPHS)
    seconds = (time.process_time() - start) / NUM_GRAPHS
    summary = describe(graphs)
    by_column = {**summary, **summary["concepts"]}
    reference, paper = REFERENCE.get(name, NO_REFERENCE), registry.get(name).paper
    result = {
        "graphs": NUM_GRAPHS,
        "milliseconds_a_graph": 1000 * seconds,
        "graphs_a_second": 1 / seconds,
        "columns": {column: compare(by_column[column], column, reference) for column in COLUMNS},
        "paper": paper._asdict() if paper else None,
        "planes_a_room": summary["children"]["plane-room"],
        "ranges": summary["ranges"],
    }
    if reference.seconds:
        result["times_faster_than_original"] = reference.seconds / seconds
    return result


def compare(ours: Mapping[str, float], column: str, reference: Reference) -> dict[str, float]:
    """Returns our mean and, where there is a reference, it and the z-score between them."""
    if column not in reference.means:
        return {"ours": ours["mean"]}
    error = ours["sd"] * np.sqrt(1 / NUM_GRAPHS + 1 / reference.graphs)
    z_score = (ours["mean"] - reference.means[column]) / error
    return {"ours": ours["mean"], "reference": reference.means[column], "z": float(z_score)}


def show(name: str, result: Mapping[str, Any]) -> None:
    """Prints the table of one set."""
    print(f"\n{name}: {result['graphs']} graphs, {result['graphs_a_second']:.0f} a second")
    if "times_faster_than_original" in result:
        print(f"{result['times_faster_than_original']:.0f} times faster than the original")
    print(f"{'mean of':<18}{'ours':>10}{'original':>10}{'z':>7}")
    for column, row in result["columns"].items():
        beside = f"{row['reference']:>10.2f}{row['z']:>7.1f}" if "z" in row else ""
        print(f"{column:<18}{row['ours']:>10.2f}{beside}")
    print("planes a room:", {k: round(v, 3) for k, v in result["planes_a_room"].items()})


def main() -> None:
    """Measures the sets that the command line names, prints the tables and writes the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(NAMES))
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    output = arguments.output
    results = json.loads(output.read_text()) if output.exists() else {}
    for name in arguments.names:
        results[name] = measure(name)
        show(name, results[name])
    output.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
