"""What growing and training cost as graphs grow: seconds a block, and memory.

    python benchmarks/growth.py [WEIGHTS]

Scenes of about 30, 110, 220, 320 and 640 nodes, of S-F, S-C and the `large` set. Each size runs in
a process of its own, whose peak resident memory is reported whole and above that of the imported
package. Growing is one scene, planes to complete graph, compiled already. Training is one step on
that graph alone, with the continuations of the weights' configuration. Writes
benchmarks/results/growth.json and growth.png.
"""

import argparse
import dataclasses
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

RESULTS: Final = Path(__file__).parent / "results"
WEIGHTS: Final = "fd4-s-c"
SIZES: Final = {30: "s-f", 110: "s-c", 220: "s-c", 320: "large", 640: "large"}
DRAWN: Final = 120  # graphs of a set among which the nearest in size is taken


def peak() -> float:
    """Returns the largest resident memory of this process so far, GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def measure(weights: str, size: int) -> dict[str, Any]:
    """Grows a scene, and trains on it."""
    import jax

    from sg3d_jax.data import registry
    from sg3d_jax.infer.complete import complete
    from sg3d_jax.train.dataset import stack_by_size
    from sg3d_jax.train.step import init_state, make_train_call
    from sg3d_jax.train.weights import load_weights

    jax.config.update("jax_enable_compilation_cache", False)  # compiling takes memory, reading less
    trained = load_weights(weights)
    drawn = registry.make(SIZES[size], DRAWN, seed=1)
    graph = min(drawn, key=lambda graph: abs(len(graph.nodes.label) - size))
    before = peak()
    [[grown]] = complete(trained.model, trained.params, [graph], candidates=1)
    seconds = _shortest(lambda: complete(trained.model, trained.params, [graph], candidates=1), 3)
    grown_peak = peak()

    config = dataclasses.replace(trained.config, batch=1, steps_per_call=1)
    capacity = -(-len(graph.nodes.label) // 32) * 32
    (stack,) = stack_by_size([graph], [capacity])
    state = init_state(config, trained.model, jax.tree.map(lambda leaf: leaf[0], stack))
    call, key = make_train_call(config, trained.model), jax.random.key(0)
    fresh = lambda: jax.tree.map(lambda leaf: leaf.copy(), state)  # a call takes its memory
    jax.block_until_ready(call(fresh(), key, stack))
    step = _shortest(lambda: jax.block_until_ready(call(fresh(), key, stack)), 5)
    return {
        "data": SIZES[size],
        "nodes": len(graph.nodes.label),
        "planes": int(graph.nodes.observed.sum()),
        "grown_nodes": len(grown.graph.nodes.label),
        "halt_reason": grown.halt_reason,
        "seconds_a_scene": round(seconds, 3),
        "milliseconds_a_block": round(1e3 * seconds / grown.steps, 3),
        "growing_gib": round(grown_peak, 3),
        "growing_gib_above_imports": round(grown_peak - before, 3),
        "training_milliseconds_a_step": round(1e3 * step, 2),
        "training_gib": round(peak(), 3),
    }


def _shortest(run: Callable[[], Any], times: int) -> float:
    """Returns how long the shortest of several calls takes, seconds."""
    seconds = []
    for _ in range(times):
        began = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Plots the cost of a block and of a training step, and memory, against the size."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.2), layout="constrained")
    cost, memory = figure.subplots(1, 2)
    nodes = [row["nodes"] for row in rows]
    for name, label in (
        ("milliseconds_a_block", "growing, a block"),
        ("training_milliseconds_a_step", "training, a graph"),
    ):
        values = [row[name] for row in rows]
        (line,) = cost.loglog(nodes, values, "o-", label=label)
        linear = [values[0] * n / nodes[0] for n in nodes]
        cost.loglog(nodes, linear, ":", color=line.get_color(), label="linear in the graph")
    cost.set(xlabel="nodes", ylabel="milliseconds", title="Cost")
    cost.set_xticks(nodes, [str(number) for number in nodes])
    cost.minorticks_off()
    for name, label in (("growing_gib", "growing"), ("training_gib", "growing, then training")):
        memory.plot(nodes, [row[name] for row in rows], "o-", label=label)
    memory.set(xlabel="nodes", ylabel="GiB", title="Peak memory of the process", ylim=(0, None))
    for axes in (cost, memory):
        axes.legend(frameon=False, fontsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measures every size in its own process, and writes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights", nargs="?", default=WEIGHTS)
    parser.add_argument("size", nargs="?", type=int, help="measure this one here, and only print")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS, help="a folder")
    arguments = parser.parse_args()
    weights = arguments.weights
    if arguments.size is not None:
        print(json.dumps(measure(weights, arguments.size)))
        return
    rows = []
    for size in SIZES:
        command = [sys.executable, __file__, weights, str(size)]
        run = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        rows.append(json.loads(run.stdout.splitlines()[-1]))
        print(rows[-1], flush=True)
    content = {"weights": Path(weights).stem, "cores": os.cpu_count(), "rows": rows}
    (arguments.output / "growth.json").write_text(json.dumps(content, indent=2) + "\n")
    draw(rows, arguments.output / "growth.png")


if __name__ == "__main__":
    main()
