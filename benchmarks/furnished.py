"""What objects, doors and stairs are worth, and how well kinds are told.

    python benchmarks/furnished.py midi-furnished --data o-f --scenes 60
    python benchmarks/furnished.py midi-furnished --plans floorplans.jsonl.gz --scenes 60

A row for the data set as it is and as a robot sees it, mildly and strongly degraded; each with all
that is observed, and with the planes alone. Real floor plans with labelled rooms have a row: planes
and labels are real, doors and objects there are none. Rooms and units are found if they have
exactly their planes; kinds are right or wrong where the room or unit is found. Writes
benchmarks/results/furnished_NAME.json.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.cli.provenance import provenance
from sg3d_jax.data.floorplan import read_floors
from sg3d_jax.data.levels import floor_scenes
from sg3d_jax.data.room_labels import labelled
from sg3d_jax.infer.complete import complete
from sg3d_jax.metrics.calibration import observed_below
from sg3d_jax.metrics.report import score
from sg3d_jax.scene.graph import SceneGraph, observed_of, ontology_of
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.weights import Trained, load_weights

VIEWS: Final = ("clean", "bare", "mild", "mild_bare", "strong", "strong_bare")
RESULTS: Final = Path(__file__).parent / "results"

Found = dict[frozenset[int], int]  # planes and kind of each node of a concept


def nodes_by_planes(graph: SceneGraph, concept: str) -> Found:
    """Returns the kind of each node of a concept by the planes that are below it."""
    label, ontology = graph.nodes.label, ontology_of(graph)
    is_plane = label[graph.nodes.observed] == ontology.label_of("plane")
    below = observed_below(graph)[:, is_plane]
    return {
        frozenset(np.flatnonzero(below[node]).tolist()): int(graph.nodes.kind[node])
        for node in np.flatnonzero(label == ontology.label_of(concept)).tolist()
    }


def found(made: list[SceneGraph], truth: list[SceneGraph], concept: str) -> dict[str, float]:
    """Returns the precision and recall of a concept, and the share of right kinds."""
    pairs = [
        (nodes_by_planes(one, concept), nodes_by_planes(other, concept))
        for one, other in zip(made, truth, strict=True)
    ]
    hits = [(one[key], other[key]) for one, other in pairs for key in one.keys() & other.keys()]
    known = [one == other for one, other in hits if other]
    return {
        "precision": round(len(hits) / max(sum(len(one) for one, _ in pairs), 1), 3),
        "recall": round(len(hits) / max(sum(len(other) for _, other in pairs), 1), 3),
        "kind": round(float(np.mean(known)), 3) if known else 0.0,
    }


def real_floors(path: Path) -> list[SceneGraph]:
    """Reads the test floors of a file of plans whose rooms are labelled, in a mixed order."""
    made = floor_scenes(read_floors(path).floors)
    graphs = [labelled(*each) for each in zip(made.graphs, made.names, strict=True)]
    floors = [graph for graph, part in zip(graphs, made.parts, strict=True) if part == "test"]
    return [floors[index] for index in np.random.default_rng(0).permutation(len(floors))]


def measured(trained: Trained, truth: list[SceneGraph], candidates: int | None) -> dict[str, Any]:
    """Scores weights on furnished scenes."""
    observed = [observed_of(graph) for graph in truth]
    completions = complete(trained.model, trained.params, observed, candidates=candidates)
    made = [samples[0].graph for samples in completions]
    report = score(made, truth)
    row: dict[str, Any] = {"graphs": len(truth)}
    row |= {"fgw": round(report["fgw"], 4), "exact": round(report["exact_structure"], 3)}
    return row | {concept: found(made, truth, concept) for concept in ("room", "unit")}


def main() -> None:
    """Measures, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights", help="by name, or an npz file")
    parser.add_argument("--data", default="o-f", help="a furnished data set")
    parser.add_argument("--plans", type=Path, help="real floors instead, JSON Lines")
    parser.add_argument("--scenes", type=int, default=60, help="of its test split")
    parser.add_argument("--candidates", type=int, help="graphs drawn a scene, at most")
    parser.add_argument("--views", nargs="+", default=VIEWS, help="what a robot sees of it")
    arguments = parser.parse_args()
    trained = load_weights(arguments.weights)
    name, views = arguments.data, arguments.views
    if arguments.plans:
        name, views = "plans", ("real",)
    rows = {}
    for view in views:
        truth = (
            real_floors(arguments.plans)
            if arguments.plans
            else load_split(DataConfig(f"{name}@{view}"), "test")
        )
        rows[view] = measured(trained, truth[: arguments.scenes], arguments.candidates)
        print(f"{name}@{view:14} {json.dumps(rows[view])}", flush=True)
    given = [Path(text).name for text in sys.argv[1:]]  # no folders of this machine
    about = provenance() | {"command": " ".join(["python benchmarks/furnished.py", *given])}
    path = RESULTS / f"furnished_{name}.json"
    path.write_text(json.dumps(about | {"rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
