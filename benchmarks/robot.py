"""How weights fare on what robots see: effect by effect, walls of any thickness, recordings.

    python benchmarks/robot.py midi-general fd4-s-f --data s-f --scenes 40
    python benchmarks/robot.py midi-general midi-p-f --data p-f.npz --scenes 40
    python benchmarks/robot.py midi-general fd4-s-f
    python benchmarks/robot.py midi-general --recordings s_graphs_logs.jsonl.gz

With data, a row for the set as it is, and as a robot sees it (`data.robot.VIEWS`). Without, five
rooms whose six walls are 0.09 to 0.40 m thick: the shares of walls and rooms that have exactly
their planes. Recordings are graphs, a line each, with planes and the rooms that S-Graphs found: the
shares of these that are found exactly, and with an IoU of planes of at least .5. Writes to
benchmarks/results/robot_NAME.json, NAME being that of the data, "walls" or "recordings": what it
holds of other weights stays.
"""

import argparse
import gzip
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sg3d_jax.cli.provenance import provenance_of_script
from sg3d_jax.data.robot import VIEWS
from sg3d_jax.infer.complete import complete
from sg3d_jax.io.planes import planes
from sg3d_jax.metrics.report import score
from sg3d_jax.scene.graph import SceneGraph, make_graph, observed_of, parts_first
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PLANE, ROOM, WALL
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.weights import Trained, load_weights

EFFECTS = ("", *(f"@{name}" for name in VIEWS if not name.endswith("bare")))
THICKNESSES = (0.09, 0.15, 0.20, 0.30, 0.40)  # metres
FLOORS_OF_FIVE = 10
RESULTS = Path(__file__).parent / "results"


def completed(trained: Trained, scenes: Sequence[SceneGraph]) -> list[SceneGraph]:
    """Completes each scene as `sg3d complete` does."""
    made = complete(trained.model, trained.params, [observed_of(scene) for scene in scenes])
    return [samples[0].graph for samples in made]


def measured(trained: Trained, data: str, scenes: int) -> dict[str, Any]:
    """Scores weights on the first scenes of a test split."""
    truth = load_split(DataConfig(data), "test")[:scenes]
    report = score(completed(trained, truth), truth)
    levels = {
        f"{level}_{kind}": round(report[kind][level], 3)
        for level in ("wall", "room")
        for kind in ("precision", "recall")
    }
    exact = round(report["exact_structure"], 3)
    return {"graphs": len(truth), "fgw": round(report["fgw"], 4), "exact": exact, **levels}


def plane_sets(graph: SceneGraph, concept: int) -> list[frozenset[int]]:
    """Returns the planes of each node of a concept."""
    label, members = graph.nodes.label, {}
    for part, whole in parts_first(graph).tolist():
        if label[part] == PLANE and label[whole] == concept:
            members.setdefault(whole, set()).add(part)
    return [frozenset(of_node) for of_node in members.values()]


def five_rooms(gap: float, rng: np.random.Generator) -> tuple[SceneGraph, list, list]:
    """Returns planes of five rooms whose walls are `gap` thick, and the planes of walls and rooms.

    Three rooms in a row, and two beside them, one of which has a wall with two of the three.
    """
    x, y = np.cumsum([0, *rng.uniform(2.5, 5, 3)]), np.cumsum([0, *rng.uniform(2.5, 5, 2)])
    spans = [(0, 1, 0), (1, 2, 0), (2, 3, 0), (0, 1, 1), (1, 3, 1)]
    low = np.array([[x[a], y[row]] for a, _, row in spans]) + gap / 2
    high = np.array([[x[b], y[row + 1]] for _, b, row in spans]) - gap / 2
    normal = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    middle, half = (low + high) / 2, (high - low) / 2
    centroid = (middle[:, None] - normal * half[:, None]).reshape(-1, 2)
    width = np.repeat(2 * half[:, ::-1], 2, axis=1).ravel()
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    pad = [(0, 0), (0, 1)]
    scene = planes(np.pad(centroid @ turn, pad), np.pad(np.tile(normal, (5, 1)) @ turn, pad), width)
    beside, above = (1, 0), (3, 2)
    pairs = [(0, 1, beside), (1, 2, beside), (3, 4, beside), (0, 3, above), (1, 4, above)]
    pairs.append((2, 4, above))
    walls = [frozenset((4 * a + side, 4 * b + other)) for a, b, (side, other) in pairs]
    return scene, walls, [frozenset(range(4 * room, 4 * room + 4)) for room in range(5)]


def thick_walls(trained: Trained) -> dict[str, Any]:
    """Returns the shares of walls and rooms that are found, by thickness."""
    rows = {}
    for gap in THICKNESSES:
        rng = np.random.default_rng(0)
        scenes, walls, rooms = zip(
            *(five_rooms(gap, rng) for _ in range(FLOORS_OF_FIVE)), strict=True
        )
        made = completed(trained, scenes)
        found = {}
        for name, concept, truth in (("walls", WALL, walls), ("rooms", ROOM, rooms)):
            drawn = [plane_sets(graph, concept) for graph in made]
            hits = [
                one in of_graph for of_graph, all_ in zip(drawn, truth, strict=True) for one in all_
            ]
            found[name] = round(float(np.mean(hits)), 3)
        rows[f"{gap:.2f} m"] = found
    return rows


def recorded(path: Path) -> list[SceneGraph]:
    """Reads recordings: planes with measured extents, and the rooms that S-Graphs found."""
    graphs = []
    for line in gzip.decompress(path.read_bytes()).decode().splitlines():
        document = json.loads(line)
        nodes = document["nodes"]
        row = {node["id"]: index for index, node in enumerate(nodes)}
        graphs.append(
            make_graph(
                [PAPER_ONTOLOGY.label_of(node["label"]) for node in nodes],
                np.array([node["position"] for node in nodes], float),
                np.array([node["normal"] or [0, 0, 0] for node in nodes], float),
                np.array([node.get("width_limits") or node["width"] or 0 for node in nodes], float),
                [[row[one], row[other]] for one, other in document["edges"]],
            )
        )
    return graphs


def rooms_found(trained: Trained, recordings: Sequence[SceneGraph]) -> dict[str, Any]:
    """Returns the shares of rooms of recordings that are found."""
    exact, near = [], []
    for truth, made in zip(recordings, completed(trained, recordings), strict=True):
        drawn = plane_sets(made, ROOM)
        for room in plane_sets(truth, ROOM):
            exact.append(room in drawn)
            near.append(any(2 * len(room & one) >= len(room | one) for one in drawn))
    return {"rooms": len(exact), "exact": float(np.mean(exact)), "iou_half": float(np.mean(near))}


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights", nargs="+")
    parser.add_argument("--data", help="a data set by name or a file")
    parser.add_argument("--recordings", type=Path, help="graphs of S-Graphs, JSON Lines, gzipped")
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--views", nargs="+", help="of the data, such as mild; all by default")
    arguments = parser.parse_args()
    rows: dict[str, Any] = {}
    for name in arguments.weights:
        trained, rows[name] = load_weights(name), {}
        if arguments.recordings:
            rows[name]["recordings"] = rooms_found(trained, recorded(arguments.recordings))
        if arguments.data:
            chosen = [f"@{view}" for view in arguments.views or ()]
            for effect in ["", *chosen] if chosen else EFFECTS:
                row = measured(trained, f"{arguments.data}{effect}", arguments.scenes)
                print(name, effect or "as it is", row, flush=True)
                rows[name][effect or "as it is"] = row
        elif not arguments.recordings:
            rows[name]["thick walls"] = thick_walls(trained)
        print(name, {key: value for key, value in rows[name].items() if key not in EFFECTS})
    label = Path(arguments.data).stem if arguments.data else "walls"
    label = "recordings" if arguments.recordings else label
    about, path = provenance_of_script(), RESULTS / f"robot_{label}.json"
    results = json.loads(path.read_text()) if path.exists() else {}
    results |= {name: {**about, "rows": own} for name, own in rows.items()}
    path.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
