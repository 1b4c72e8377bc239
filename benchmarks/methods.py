"""Seconds a scene of every method, in one run: what a user waits for once all is compiled.

    python benchmarks/methods.py s-f --scenes 100

Each method completes the same test scenes twice; the second time is the one reported. Prints a row
for each method and writes benchmarks/results/methods_DATA.json.
"""

import argparse
import json
import os
import time
from pathlib import Path

import jax

from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.evaluation import load_contender

METHODS = ("rand", "ec-square", "ec-l", "midi-or", "fd4", "midi")
RESULTS = Path(__file__).parent / "results"


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data")
    parser.add_argument("--scenes", type=int, default=100)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_compilation_cache", False)  # compiling is timed, not reading
    rows = {}
    for name in METHODS:
        method = load_contender(f"{name}-{arguments.data}")
        scenes = load_split(method.data, "test")[: arguments.scenes]
        seconds = []
        for _ in range(2):
            began = time.perf_counter()
            method.complete(scenes, 0)
            seconds.append(time.perf_counter() - began)
        rows[name] = {
            "seconds_a_scene": round(seconds[1] / len(scenes), 5),
            "seconds_of_compilation": round(seconds[0] - seconds[1], 1),
        }
        print(name, rows[name], flush=True)
    content = {"data": arguments.data, "scenes": len(scenes), "cores": os.cpu_count()}
    path = RESULTS / f"methods_{arguments.data}.json"
    path.write_text(json.dumps({**content, "methods": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
