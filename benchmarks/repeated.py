"""What walls that stand for the same planes cost: scores with them, and with each counted once.

    python benchmarks/repeated.py midi-general --data s-f=40 s-f@clean=40 s-c=24

Where the paper's generator merges rooms on both sides of a wall, its graphs keep two walls over the
same two planes. Completes the first test scenes of every set as `sg3d complete` does. Writes
benchmarks/results/repeated.json.
"""

import argparse
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from robot import RESULTS, completed

from sg3d_jax.cli.provenance import provenance_of_script
from sg3d_jax.metrics.calibration import identities
from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.metrics.structure import exact_structure
from sg3d_jax.scene.graph import SceneGraph, subgraph
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.weights import load_weights


def repeats_another(graph: SceneGraph) -> np.ndarray:
    """Returns bool[n], the nodes of the same concept and over the same planes as one before."""
    return np.array([number > 0 for *_, number in identities(graph)])


def num_repeats(graphs: Sequence[SceneGraph]) -> int:
    """Returns how many nodes of graphs repeat another."""
    return sum(int(repeats_another(graph).sum()) for graph in graphs)


def once(graph: SceneGraph) -> SceneGraph:
    """Returns a graph without the nodes that repeat another."""
    return subgraph(graph, ~repeats_another(graph))


def scores(made: Sequence[SceneGraph], truth: Sequence[SceneGraph]) -> dict[str, float]:
    """Returns the mean FGW and the share of exact structures."""
    exact = [exact_structure(*pair) for pair in zip(made, truth, strict=True)]
    fgw = float(np.mean(fgw_pairs(made, truth).value))
    return {"fgw": round(fgw, 4), "exact": round(float(np.mean(exact)), 3)}


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights")
    parser.add_argument("--data", nargs="+", required=True, help="NAME=SCENES, each a set")
    arguments = parser.parse_args()
    trained, rows = load_weights(arguments.weights), {}
    for data, number in (named.split("=") for named in arguments.data):
        truth = load_split(DataConfig(data), "test")[: int(number)]
        made = completed(trained, truth)
        both = [[once(graph) for graph in graphs] for graphs in (made, truth)]
        repeats = {"made": num_repeats(made), "true": num_repeats(truth)}
        row: dict[str, Any] = {"scenes": len(truth), "repeats": repeats}
        rows[data] = row | {"as they are": scores(made, truth), "once": scores(*both)}
        print(data, rows[data], flush=True)
    about = provenance_of_script()
    (RESULTS / "repeated.json").write_text(json.dumps({**about, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
