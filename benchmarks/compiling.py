"""What compiling costs: seconds of a growth bucket and of a training bucket, of wall and of CPU.

    python benchmarks/compiling.py [NAME ...] [-o RESULT.json]

Of each of the weights, by default fd4-s-f and midi-p-c, two programs: growing 4 lanes of 64 nodes,
and 10 training steps of 32 graphs in 48 slots. Each is traced and lowered, then compiled, with
nothing read from disk; seconds of CPU count all threads of the process, and are what two busy
machines may be compared by. Prints a row a program and writes benchmarks/results/compiling.json.
"""

import argparse
import dataclasses
import json
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp

from sg3d_jax.cli.provenance import provenance
from sg3d_jax.data import registry
from sg3d_jax.flagg.grow import DEFAULT_MAX_STEPS, grow_lanes
from sg3d_jax.infer.lanes import sample_keys
from sg3d_jax.scene.graph import SceneGraph, observed_of
from sg3d_jax.scene.padding import bucket, stack
from sg3d_jax.train.dataset import stack_by_size
from sg3d_jax.train.step import init_state, make_train_call
from sg3d_jax.train.weights import Trained, load_weights

RESULT: Final = Path(__file__).parent / "results" / "compiling.json"
WEIGHTS: Final = ("fd4-s-f", "midi-p-c")
DATA: Final = "s-f"
LANES, GROWTH_NODES = 4, 64
BATCH, TRAINING_NODES, STEPS_PER_CALL = 32, 48, 10


class Program(NamedTuple):
    """A compiled function and what it is called with."""

    function: Any
    arguments: tuple[Any, ...]


def growing(trained: Trained, graphs: list[SceneGraph]) -> Program:
    """Returns the growth of a batch of scenes."""
    given = stack([observed_of(graph) for graph in graphs[:LANES]], bucket(GROWTH_NODES))
    keys, steps = sample_keys(0, range(LANES), [0] * LANES), jnp.zeros(LANES, jnp.int32)
    arguments = trained.model, trained.params, keys, given, steps, DEFAULT_MAX_STEPS, False
    return Program(grow_lanes, arguments)


def training(trained: Trained, graphs: list[SceneGraph]) -> Program:
    """Returns the training steps of one call."""
    config = dataclasses.replace(trained.config, batch=BATCH, steps_per_call=STEPS_PER_CALL)
    (stacked,) = stack_by_size(graphs, [TRAINING_NODES])
    state = init_state(config, trained.model, jax.tree.map(lambda leaf: leaf[0], stacked))
    call = make_train_call(config, trained.model)
    return Program(call, (state, jax.random.key(0), stacked))


def measure(program: Program) -> dict[str, float]:
    """Traces, lowers and compiles a program; returns seconds."""
    began, began_cpu = time.perf_counter(), time.process_time()
    lowered = program.function.lower(*program.arguments)
    traced, traced_cpu = time.perf_counter(), time.process_time()
    lowered.compile()
    ended, ended_cpu = time.perf_counter(), time.process_time()
    seconds = {
        "tracing_cpu": traced_cpu - began_cpu,
        "tracing_wall": traced - began,
        "compiling_cpu": ended_cpu - traced_cpu,
        "compiling_wall": ended - traced,
    }
    return {name: round(value, 2) for name, value in seconds.items()}


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights", nargs="*", default=list(WEIGHTS))
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_compilation_cache", False)
    drawn = registry.make(DATA, 2 * BATCH)
    graphs = [graph for graph in drawn if len(graph.nodes.label) <= TRAINING_NODES]
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for name in arguments.weights:
        trained = load_weights(name)
        rows[name] = {}
        for what, make in {"growing": growing, "training": training}.items():
            rows[name][what] = measure(make(trained, graphs))
            print(name, what, rows[name][what], flush=True)
    about = provenance()
    content = {"commit": about["commit"], "machine": about["machine"], "seconds": rows}
    arguments.output.write_text(json.dumps(content, indent=2) + "\n")


if __name__ == "__main__":
    main()
