"""What objects, doors and stairs are worth, and how well kinds are told.

    python benchmarks/furnished.py midi-furnished --data o-f --scenes 60
    python benchmarks/furnished.py midi-furnished --plans floorplans.jsonl.gz --scenes 24

A row for the data set as it is and as a robot sees it, mildly and strongly degraded; each with all
that is observed, and with the planes alone. Real floor plans with labelled rooms have a row for
flats and one for schools and offices: planes and labels are real, doors and objects there are none,
so that kinds are told by shape and neighbours alone. Rooms and units are found if they have exactly
their planes, and overlapping if they share more than half of all planes of the two; kinds are right
or wrong where the room or unit is found. `told` has kinds of the true rooms of all graphs, however
large: how many are right, and of how many. Writes benchmarks/results/furnished_NAME.json.
"""

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.cli.provenance import provenance_of_script
from sg3d_jax.data.furnished import UNIT_KINDS
from sg3d_jax.data.registry import import_file
from sg3d_jax.infer.complete import complete
from sg3d_jax.infer.kinds import chances_of_kinds
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
    """Returns the precision and recall of a concept, exact and by half, and right kinds."""
    pairs = [
        (nodes_by_planes(one, concept), nodes_by_planes(other, concept))
        for one, other in zip(made, truth, strict=True)
    ]
    hits = [(one[key], other[key]) for one, other in pairs for key in one.keys() & other.keys()]
    known = [one == other for one, other in hits if other]
    overlapping = sum(
        any(2 * len(mine & key) > len(mine | key) for mine in one)
        for one, other in pairs
        for key in other
    )
    all_made, all_true = (max(sum(map(len, side)), 1) for side in zip(*pairs, strict=True))
    return {
        "precision": round(len(hits) / all_made, 3),
        "recall": round(len(hits) / all_true, 3),
        "overlapping_precision": round(overlapping / all_made, 3),
        "overlapping_recall": round(overlapping / all_true, 3),
        "kind": round(float(np.mean(known)), 3) if known else 0.0,
    }


def told(trained: Trained, truth: list[SceneGraph]) -> dict[str, Any]:
    """Returns how many kinds are told right of true rooms and units, and how many there are."""
    right, number = Counter(), Counter()
    for graph in truth:
        nodes, concepts = graph.nodes, ontology_of(graph).concepts
        given = int(nodes.observed.sum())
        chances = chances_of_kinds(trained.model, trained.params, graph, given)
        assert chances is not None, "these weights tell no kinds"
        likeliest = 1 + chances.argmax(axis=1)
        for label, kind, best in zip(
            nodes.label[given:], nodes.kind[given:].astype(int), likeliest, strict=True
        ):
            if kind:
                name = f"{concepts[label].name}: {concepts[label].kinds[kind - 1]}"
                number[name] += 1
                right[name] += int(best == kind)
    return {name: [right[name], number[name]] for name in sorted(number)}


def real_floors(path: Path) -> dict[str, list[SceneGraph]]:
    """Reads the test floors of a file of plans whose rooms are labelled, in a mixed order."""
    graphs, about = import_file("p-f-kinds", path)
    tests = [graph for graph, part in zip(graphs, about["parts"], strict=True) if part == "test"]
    mixed = [tests[index] for index in np.random.default_rng(0).permutation(len(tests))]
    kind = 1.0 + UNIT_KINDS.index("flat")
    is_flat = [kind in nodes_by_planes(graph, "unit").values() for graph in mixed]
    return {
        name: [graph for graph, flat in zip(mixed, is_flat, strict=True) if flat == wanted]
        for name, wanted in (("flats", True), ("workplaces", False))
    }


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
    parser.add_argument("--most-nodes", type=int, help="leave larger graphs out of completing")
    parser.add_argument("--candidates", type=int, help="graphs drawn a scene, at most")
    parser.add_argument("--views", nargs="+", default=VIEWS, help="what a robot sees of it")
    arguments = parser.parse_args()
    trained = load_weights(arguments.weights)
    name, views, floors = arguments.data, arguments.views, {}
    if arguments.plans:
        floors = real_floors(arguments.plans)
        name, views = "plans", [*floors]
    about = provenance_of_script()
    rows = {}
    for view in views:
        truth = floors.get(view) or load_split(DataConfig(f"{name}@{view}"), "test")
        most = arguments.most_nodes or max(len(graph.nodes.label) for graph in truth)
        fitting = [graph for graph in truth if len(graph.nodes.label) <= most]
        rows[view] = measured(trained, fitting[: arguments.scenes], arguments.candidates)
        rows[view]["told"] = told(trained, truth)
        print(f"{name}@{view:14} {json.dumps(rows[view])}", flush=True)
        path = RESULTS / f"furnished_{name}.json"
        path.write_text(json.dumps(about | {"rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
