"""Draws 2,000 graphs of each synthetic set; prints graphs a second and how the statistics agree.

Run: python benchmarks/generator.py
Writes benchmarks/results/generator.json.
"""

import json
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.data import registry
from sg3d_jax.data.describe import describe

NUM_GRAPHS: Final = 2000
ORIGINAL_SECONDS: Final = 0.17  # a graph of S-F, by the authors' generator on one core
RESULTS: Final = Path(__file__).parent / "results" / "generator.json"

# Means over 400 graphs a set drawn with the authors' generator
# (snt-arg/situational_graphs_datasets).
REFERENCE_GRAPHS: Final = 400
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
)
REFERENCE: Final = {
    "s-f-square": (23.81, 108.5, 27.2, 81.2, 8.13, 2.16, 14.72, 3.68, 4.41),
    "s-f": (29.87, 145.2, 35.0, 110.2, 9.34, 2.28, 18.84, 3.88, 6.16),
}


def measure(name: str, num_graphs: int) -> dict[str, Any]:
    """Returns the speed and, for each column, ours, the reference and the z-score between them."""
    start = time.perf_counter()
    graphs = registry.make(name, num_graphs)
    seconds = (time.perf_counter() - start) / num_graphs
    summary = describe(graphs)
    by_column = {**summary, **summary["concepts"]}
    columns = {}
    for column, reference in zip(COLUMNS, REFERENCE[name], strict=True):
        ours, deviation = by_column[column]["mean"], by_column[column]["sd"]
        error = deviation * np.sqrt(1 / num_graphs + 1 / REFERENCE_GRAPHS)
        z_score = (ours - reference) / error
        columns[column] = {"ours": ours, "reference": reference, "z": float(z_score)}
    paper = registry.get(name).paper._asdict()
    return {
        "graphs": num_graphs,
        "milliseconds_a_graph": 1000 * seconds,
        "graphs_a_second": 1 / seconds,
        "times_faster_than_original": ORIGINAL_SECONDS / seconds,
        "columns": columns,
        "paper": paper,
        "planes_a_room": summary["children"]["plane-room"],
        "ranges": summary["ranges"],
    }


def main() -> None:
    """Measures both sets, prints the tables and writes the results."""
    results = {name: measure(name, NUM_GRAPHS) for name in REFERENCE}
    for name, result in results.items():
        print(
            f"\n{name}: {result['graphs']} graphs, {result['graphs_a_second']:.0f} a second, "
            f"{result['times_faster_than_original']:.0f} times faster than the original"
        )
        print(f"{'mean of':<18}{'ours':>10}{'original':>10}{'z':>7}")
        for column, row in result["columns"].items():
            print(f"{column:<18}{row['ours']:>10.2f}{row['reference']:>10.2f}{row['z']:>7.1f}")
        print("planes a room:", {k: round(v, 3) for k, v in result["planes_a_room"].items()})
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
