"""Floors read and scenes made from them a second, and what the scenes are like.

    python benchmarks/import_rates.py floorplans.jsonl.gz
    python benchmarks/import_rates.py mds_V2_5.372k.csv

Prints a row a level and writes benchmarks/results/import_rates.json (or _msd.json).
"""

import argparse
import json
import os
import time
from pathlib import Path

from sg3d_jax.data import floorplan, msd
from sg3d_jax.data.levels import LEVELS
from sg3d_jax.metrics.describe import describe

RESULTS = Path(__file__).parent / "results"
COLUMNS = ("nodes", "edges", "degree", "hierarchy_edges")


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    path = parser.parse_args().file
    is_msd = path.suffix.lower() == ".csv"
    began = time.perf_counter()
    floors, left_out = (msd if is_msd else floorplan).read_floors(path)
    seconds = time.perf_counter() - began
    content = {
        "floors": len(floors),
        "left_out": len(left_out),
        "floors_per_second": round((len(floors) + len(left_out)) / seconds),
        "cores": os.cpu_count(),
        "levels": {},
    }
    if not is_msd:
        plans = floorplan.read_plans(path)
        content["rooms"] = sum(len(plan.rooms) for plan in plans)
        content["rooms_repaired"] = sum(
            int(floorplan.repaired_rooms(plan.rooms).sum()) for plan in plans
        )
    print({name: value for name, value in content.items() if name != "levels"}, flush=True)
    for level, scenes in LEVELS.items():
        began = time.perf_counter()
        graphs = scenes(floors, rotate=not is_msd).graphs
        seconds = time.perf_counter() - began
        about = describe(graphs)
        row = {"graphs": len(graphs), "graphs_per_second": round(len(graphs) / seconds)}
        row |= {name: round(about[name]["mean"], 2) for name in COLUMNS}
        row |= {name: round(of["mean"], 2) for name, of in about["concepts"].items()}
        row |= {"greatest_graph": int(about["nodes"]["max"])}
        content["levels"][level] = row
        print(level, row, flush=True)
    name = "import_rates_msd.json" if is_msd else "import_rates.json"
    (RESULTS / name).write_text(json.dumps(content, indent=2) + "\n")


if __name__ == "__main__":
    main()
