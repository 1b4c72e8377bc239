"""Which scenes weights do worst on, and what is wrong there.

    python benchmarks/worst.py midi-general --data s-f@strong p-f.npz@strong g-f@strong --plans to

Completes the first test scenes of every set as `sg3d complete` does, and lists those with the
largest FGW: their planes, exact rooms and walls, and `metrics.structure.failures`. With --plans
draws each from above into a folder, the truth dashed. Writes benchmarks/results/worst.json.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from robot import RESULTS, completed, plane_sets

from sg3d_jax.cli.provenance import provenance_of_script
from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.metrics.structure import failures
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import ROOM, WALL
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.weights import load_weights
from sg3d_jax.viz.plan import save_plan


def described(made: SceneGraph, truth: SceneGraph) -> dict[str, Any]:
    """Returns what is right and what is wrong with a graph."""
    row: dict[str, Any] = {"planes": int(truth.nodes.observed.sum())}
    for name, concept in (("rooms", ROOM), ("walls", WALL)):
        true, drawn = plane_sets(truth, concept), plane_sets(made, concept)
        row[name] = f"{len(set(true) & set(drawn))} of {len(true)}, {len(drawn)} drawn"
    return row | {"failures": dict(failures(made, truth).most_common())}


def main() -> None:
    """Measures, draws and writes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights")
    parser.add_argument("--data", nargs="+", required=True, help="sets by name or files")
    parser.add_argument("--scenes", type=int, default=24, help="of each set")
    parser.add_argument("--count", type=int, default=20, help="of scenes that are listed")
    parser.add_argument("--plans", type=Path, help="a folder for their pictures")
    arguments = parser.parse_args()
    trained, found = load_weights(arguments.weights), []
    for data in arguments.data:
        truth = load_split(DataConfig(data), "test")[: arguments.scenes]
        made = completed(trained, truth)
        values = fgw_pairs(made, truth).value.tolist()
        numbered = enumerate(zip(values, made, truth, strict=True))
        found += [(value, Path(data).name, i, *graphs) for i, (value, *graphs) in numbered]
        print(f"{data}: {len(truth)} scenes, FGW {sum(values) / len(values):.4f}", flush=True)
    found.sort(key=lambda one: -one[0])
    rows = []
    for value, data, index, made, truth in found[: arguments.count]:
        about = {"data": data, "index": index, "fgw": round(value, 4)}
        rows.append(about | described(made, truth))
        print(*rows[-1].values(), sep="  ", flush=True)
        if arguments.plans is not None:
            arguments.plans.mkdir(exist_ok=True)
            save_plan(made, arguments.plans / f"{data}_{index}.png", truth=truth)
    about = provenance_of_script()
    text = json.dumps({**about, "scenes": len(found), "rows": rows}, indent=2)
    (RESULTS / "worst.json").write_text(f"{text}\n")


if __name__ == "__main__":
    main()
