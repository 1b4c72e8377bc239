"""Trains a configuration for so many minutes, on whatever device there is.

The learning rate follows the clock, not a number of steps: a machine that is lent for ten minutes
is used to the last of them, however fast it is. Graphs are made in as many processes, and buckets
compiled in as many threads, as there are cores. Of several devices each takes a batch of every
step, and the rate grows by the square root of their number (docs/scaling.md).

    python benchmarks/train_minutes.py configs/midi_general.py --minutes 8 -o weights.npz
"""

import argparse
import dataclasses
import json
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import jax
import numpy as np
import optax

from sg3d_jax.infer.lanes import root_key
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import numbered_parts, slots_of, training_set
from sg3d_jax.train.loop import bucket_of_call, compile_calls, prepare, start_from_weights
from sg3d_jax.train.presets import find_config
from sg3d_jax.train.processes import on_all_devices
from sg3d_jax.train.statistics import shares_of
from sg3d_jax.train.step import init_state, make_optimiser, make_train_call, mesh_of
from sg3d_jax.train.weights import save_weights

MOMENTS = 1000  # of the time, as the schedule of the learning rate counts it,
WARMUP = 20  # and those in which it rises


def made_side_by_side(data: DataConfig) -> list[SceneGraph]:
    """Makes the training graphs of all data sets, those of each view in a process of its own."""
    os.environ["JAX_PLATFORMS"] = "cpu"  # of the processes: they must not take the device
    jobs = []
    for part, before in numbered_parts(data):
        views = range(part.views) if "@" in part.name else [0]
        first = before * part.views
        jobs += [(dataclasses.replace(part, views=1), first + number) for number in views]
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        sets = list(pool.map(training_set, *zip(*jobs, strict=True)))
    for (part, number), graphs in zip(jobs, sets, strict=True):
        nodes = sum(len(graph.nodes.label) for graph in graphs)
        print(f"  {part.name} {number}: {len(graphs)} graphs, {nodes} nodes")
    return [graph for graphs in sets for graph in graphs]


def main() -> None:
    """Trains and writes weights."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("config", help="METHOD-DATASET or a Python file that defines CONFIG")
    parser.add_argument("--minutes", type=float, required=True, help="of this run, all in all")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the weights, npz")
    parser.add_argument("--batch", type=int, help="graphs a step; as configured by default")
    parser.add_argument("--batch-nodes", type=int, help="but at most so many slots of nodes")
    parser.add_argument("--accumulate", type=int, help="batches a step; one a device by default")
    parser.add_argument("--views", type=int, help="of each graph of a set that a robot sees")
    parser.add_argument("--num-graphs", type=int, help="of each set")
    parser.add_argument("--initial", help="weights to start from")
    parser.add_argument("--data", help="other data sets than those configured")
    arguments = parser.parse_args()
    began = time.monotonic()
    said = lambda text: print(f"{time.monotonic() - began:6.1f} s  {text}", flush=True)
    given = {name: value for name, value in vars(arguments).items() if value is not None}
    config = find_config(given["config"])
    data = {name: given[name] for name in ("views", "num_graphs") if name in given}
    data |= {"name": given["data"]} if "data" in given else {}
    given.setdefault("accumulate", len(jax.devices()))
    names = "batch", "batch_nodes", "accumulate", "initial"
    fields = {name: given[name] for name in names if name in given}
    data = dataclasses.replace(config.data, **data)
    config = dataclasses.replace(config, data=data, **fields, steps_per_call=50)
    said(f"{jax.devices()}")
    graphs = made_side_by_side(config.data)
    fitting = [graph for graph in graphs if slots_of(graph) <= config.capacities[-1]]
    said(f"{len(graphs)} graphs, {len(graphs) - len(fitting)} of them too large and left out")
    run = prepare(config, fitting)
    shares = shares_of(run.stacks)
    said(f"stacks of {[s.nodes.mask.shape for s in run.stacks]}, shares {shares.round(3).tolist()}")
    optimiser = optax.inject_hyperparams(lambda rate: make_optimiser(config, rate))(rate=0.0)
    peak = config.optimiser.learning_rate * config.accumulate**0.5
    schedule = optax.warmup_cosine_decay_schedule(0.0, peak, WARMUP, MOMENTS)
    one = jax.tree.map(lambda leaf: leaf[0], run.stacks[0])
    state = start_from_weights(config, init_state(config, run.model, one, optimiser))
    given = jax.tree.map(jax.numpy.copy, state), root_key(config.seed + 1), run.stacks
    state, key, stacks = on_all_devices(given, mesh_of(config))
    calls = compile_calls(make_train_call(config, run.model, optimiser), state, key, stacks)
    said("compiled")
    first, log = time.monotonic(), []
    seconds = max(60 * arguments.minutes - (first - began), 1e-3)
    while (progress := (time.monotonic() - first) / seconds) < 1:
        rate = jax.numpy.asarray(schedule(progress * MOMENTS), jax.numpy.float32)
        given = state.optimiser._replace(hyperparams={"rate": rate})
        bucket = bucket_of_call(config, shares, len(log))
        start = time.monotonic()
        state, metrics = calls[bucket](state._replace(optimiser=given), key, stacks[bucket])
        metrics = {name: float(value) for name, value in metrics.items()}
        per_step = (time.monotonic() - start) / config.steps_per_call
        log.append({"bucket": bucket, "seconds_per_step": per_step, "rate": float(rate), **metrics})
        if len(log) % 20 == 0:
            recent = {name: np.mean([entry[name] for entry in log[-20:]]) for name in metrics}
            shown = "  ".join(f"{name} {value:.4f}" for name, value in recent.items())
            said(f"step {int(state.step)}  {per_step * 1e3:.1f} ms  {shown}")
    config = dataclasses.replace(config, steps=int(state.step))
    history = (
        f"{config.steps} steps in {arguments.minutes:g} minutes on {jax.devices()[0].device_kind}"
    )
    card = dataclasses.replace(run.card, history=history)
    save_weights(arguments.output, config, run.statistics, state.average, card)
    arguments.output.with_suffix(".log.jsonl").write_text("\n".join(map(json.dumps, log)) + "\n")
    said(f"{arguments.output}: {config.steps} steps")


if __name__ == "__main__":
    main()
