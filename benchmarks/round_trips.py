"""Takes 500 scene graphs through every format and back: the same graphs, and how fast.

Run: python benchmarks/round_trips.py
Prints a row a format and writes benchmarks/results/round_trips.json.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np

from sg3d_jax.data import registry
from sg3d_jax.io.formats import FORMATS, read_graphs, write_graphs
from sg3d_jax.scene.graph import SceneGraph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY

RESULTS: Final = Path(__file__).parent / "results" / "round_trips.json"
FLOORS, CITIES = 450, 50
ONE_A_FILE: Final = ("graphml",)


def is_same(one: SceneGraph, other: SceneGraph) -> bool:
    """Returns whether all fields are equal, bit for bit, and so are the edges and the concepts."""
    fields = zip(one.nodes, other.nodes, strict=True)
    same = ontology_of(one) == ontology_of(other)
    same &= all(left.tobytes() == right.tobytes() for left, right in fields)
    return same and all(
        np.array_equal(undirected_edges(one, relation), undirected_edges(other, relation))
        for relation in (PART_OF, PROXIMITY)
    )


def round_trip(graphs: list[SceneGraph], to: str, folder: Path) -> dict[str, float]:
    """Writes and reads graphs; returns how many come back the same, and rates."""
    suffix = f".{to}" if to in ("graphml", "npz") else ".jsonl"
    files = [graphs] if to not in ONE_A_FILE else [[graph] for graph in graphs]
    paths = [folder / f"{to}{index}{suffix}" for index in range(len(files))]
    began = time.perf_counter()
    for path, content in zip(paths, files, strict=True):
        write_graphs(path, content, to)
    written = time.perf_counter()
    back = [graph for path in paths for graph in read_graphs(path)]
    read = time.perf_counter()
    return {
        "graphs": len(graphs),
        "same": sum(map(is_same, back, graphs)),
        "written_per_second": round(len(graphs) / (written - began)),
        "read_per_second": round(len(graphs) / (read - written)),
        "bytes_per_graph": round(sum(path.stat().st_size for path in paths) / len(graphs)),
    }


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    graphs = registry.make("s-f", FLOORS) + registry.make("s-c", CITIES)
    results = {}
    for to in FORMATS:
        with tempfile.TemporaryDirectory() as folder:
            results[to] = round_trip(graphs, to, Path(folder))
        print(to, results[to], flush=True)
    arguments.output.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
