"""Trains a configuration for so many minutes, on whatever device there is.

The learning rate follows the clock, not a number of steps: a machine that is lent for ten minutes
is used to the last of them, however fast it is. Graphs are made in as many processes, and buckets
compiled in as many threads, as there are cores; with --fresh-every they are drawn anew meanwhile.
Of several devices each takes a batch of every step, and the rate grows by the square root of their
number (docs/scaling.md). Every minute what has been learnt is written, in case the machine is taken
back. Who goes on from weights of the same concepts keeps what those know of their training set.
With --only kinds or --only placement nothing is learnt but these, of graphs that are complete; a
slot then costs a fifteenth or a third. With --only upper nothing is but the parameters of the upper
layers, those from the concept `flagg.upper` on, on cuts of their own; of graphs that have one node
of it at most there are half as many as of others (those that --fresh-every draws later come as they
are). All else stays as it was.

    python benchmarks/train_minutes.py configs/midi_general.py --minutes 8 -o weights.npz
"""

import argparse
import dataclasses
import json
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import jax
import numpy as np
import optax

from sg3d_jax.flagg.corrupt import CorruptionConfig, corrupt
from sg3d_jax.flagg.kinds import Kinds, kind_loss
from sg3d_jax.flagg.step import Flagg, Params
from sg3d_jax.infer.lanes import Model, root_key
from sg3d_jax.scene.graph import SceneGraph, ontology_of
from sg3d_jax.train.card import card_of
from sg3d_jax.train.config import Config
from sg3d_jax.train.dataset import slots_of
from sg3d_jax.train.loop import bucket_of_call, build, compile_calls, start_from_weights
from sg3d_jax.train.methods import Measured
from sg3d_jax.train.presets import find_config
from sg3d_jax.train.processes import on_all_devices
from sg3d_jax.train.rounds import made_side_by_side, rounds, workers
from sg3d_jax.train.statistics import shares_of
from sg3d_jax.train.step import init_state, make_optimiser, make_train_call, mesh_of
from sg3d_jax.train.weights import load_weights, save_weights

MOMENTS = 1000  # of the time, as the schedule of the learning rate counts it,
WARMUP = 20  # and those in which it rises
STEPS_A_CALL = 20
REPORT = 40  # calls
MINUTE = 60.0  # between two times that weights are written
# What may be learnt alone, and what is said of a model that lacks it.
LACKS = {
    "kinds": "kinds",
    "upper": "upper layers (flagg.upper)",
    "placement": "placement (flagg.placement)",
}
ENDLESS = STEPS_A_CALL * 10**7  # steps; the clock ends a run


@dataclasses.dataclass(frozen=True)
class Alone:
    """One loss of a model, as something to train: `make_train_call` asks for a loss."""

    loss: Callable[[Params, Any, SceneGraph], Any]


@dataclasses.dataclass(frozen=True)
class KindsAlone:
    """The kinds of what a model grows, likewise."""

    kinds: Kinds
    corruption: CorruptionConfig

    def loss(self, params: Params, key: Any, graph: SceneGraph) -> Any:
        """Returns the loss of the kinds of a complete graph, perturbed as in all training."""
        seen = corrupt(graph, key, self.corruption)
        loss = kind_loss(self.kinds.logits(params.kinds, seen), seen, graph)
        return loss, {"kind": loss}


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
    parser.add_argument("--fresh-every", type=int, help="steps after which data are drawn anew")
    parser.add_argument("--draw", type=int, default=0, help="of the data; 0: that of `sg3d train`")
    parser.add_argument("--rate", type=float, help="the highest learning rate")
    parser.add_argument("--capacities", type=int, nargs="+", help="of the buckets, nodes")
    parser.add_argument("--initial", help="weights to start from")
    parser.add_argument("--data", help="other data sets than those configured")
    parser.add_argument("--only", choices=(*LACKS,), help="parameters that may change")
    arguments = parser.parse_args()
    began = time.monotonic()
    said = lambda text: print(f"{time.monotonic() - began:6.1f} s  {text}", flush=True)
    given = {name: value for name, value in vars(arguments).items() if value is not None}
    config = configured(given)
    drawing = dataclasses.replace(config, data=config.data.anew(arguments.draw))
    said(f"{jax.devices()}")
    with workers() as make:
        graphs = made_side_by_side(make, drawing.data, config.method)
    fitting = [graph for graph in graphs if slots_of(graph) <= config.capacities[-1]]
    said(f"{len(graphs)} graphs, {len(graphs) - len(fitting)} of them too large and left out")
    if arguments.only == "upper" and config.flagg is not None and config.flagg.upper:
        fitting = mostly_several(fitting, config.flagg.upper)
        said(f"{len(fitting)} graphs, two of three with several of {config.flagg.upper}")
    first_stacks, statistics, model = build(config, fitting, known_to_initial(config))
    shares = shares_of(first_stacks)
    sizes = [stack.nodes.mask.shape for stack in first_stacks]
    said(f"stacks of {sizes}, shares {shares.round(3).tolist()}")
    optimiser = optax.inject_hyperparams(lambda rate: make_optimiser(config, rate))(rate=0.0)
    peak = given.get("rate", config.optimiser.learning_rate) * config.accumulate**0.5
    schedule = optax.warmup_cosine_decay_schedule(0.0, peak, WARMUP, MOMENTS)
    one = jax.tree.map(lambda leaf: leaf[0], first_stacks[0])
    state = start_from_weights(config, init_state(config, model, one, optimiser))
    before = jax.tree.map(np.asarray, state.params)
    mesh, state = mesh_of(config), jax.tree.map(jax.numpy.copy, state)
    state, key, stacks = on_all_devices((state, root_key(config.seed + 1), first_stacks), mesh)
    learner = model if arguments.only is None else alone(model, arguments.only)
    calls = compile_calls(make_train_call(config, learner, optimiser), state, key, stacks)
    said("compiled")
    first, log, until = time.monotonic(), [], 0
    written, card = first, card_of(fitting)

    def write() -> None:
        so_far = dataclasses.replace(config, steps=int(state.step))
        taken = (time.monotonic() - began) / 60
        history = f"{so_far.steps} steps in {taken:.1f} minutes on {jax.devices()[0].device_kind}"
        its_card = dataclasses.replace(card, history=history)
        params, only = state.average, arguments.only
        if only is not None:
            params = before._replace(**{only: getattr(params, only)})
        save_weights(arguments.output, so_far, statistics, params, its_card)
        lines = "\n".join(map(json.dumps, log)) + "\n"
        arguments.output.with_suffix(".log.jsonl").write_text(lines)
        said(f"{arguments.output}: {so_far.steps} steps")

    seconds = max(60 * arguments.minutes - (first - began), 1e-3)
    with closing(rounds(drawing, first_stacks, 0)) as coming:
        while (progress := (time.monotonic() - first) / seconds) < 1:
            if len(log) * STEPS_A_CALL >= until:
                graphs, until = next(coming)
                stacks = on_all_devices(graphs, mesh)
                said(f"step {len(log) * STEPS_A_CALL}  graphs until step {until} are there")
            rate = float(jax.numpy.asarray(schedule(progress * MOMENTS)))
            given = state.optimiser._replace(hyperparams={"rate": jax.numpy.float32(rate)})
            bucket = bucket_of_call(config, shares, len(log))
            start = time.monotonic()
            state, metrics = calls[bucket](state._replace(optimiser=given), key, stacks[bucket])
            metrics = {name: float(value) for name, value in metrics.items()}
            per_step = (time.monotonic() - start) / STEPS_A_CALL
            about = {"bucket": bucket, "seconds_per_step": per_step, "rate": rate}
            log.append(about | metrics)
            if len(log) % REPORT == 0:
                recent = {
                    name: np.mean([entry[name] for entry in log[-REPORT:]]) for name in metrics
                }
                shown = "  ".join(f"{name} {value:.4f}" for name, value in recent.items())
                said(f"step {int(state.step)}  {per_step * 1e3:.1f} ms  {shown}")
            if time.monotonic() - written > MINUTE:
                write()
                written = time.monotonic()
    write()


def configured(given: dict[str, Any]) -> Config:
    """Returns the configuration with what is given at the shell in place of its own."""
    given = {"accumulate": len(jax.devices())} | given
    config = find_config(given["config"])
    data = {name: given[name] for name in ("views", "num_graphs") if name in given}
    data |= {"name": given["data"]} if "data" in given else {}
    names = "batch", "batch_nodes", "accumulate", "initial", "fresh_every"
    fields = {name: given[name] for name in names if name in given}
    fields |= {"capacities": tuple(given["capacities"])} if "capacities" in given else {}
    data = dataclasses.replace(config.data, **data)
    endless = {"steps": ENDLESS, "steps_per_call": STEPS_A_CALL}
    return dataclasses.replace(config, data=data, **fields, **endless)


def mostly_several(graphs: list[SceneGraph], concept: str) -> list[SceneGraph]:
    """Leaves out graphs with one node of a concept at most: to half as many as have several."""

    def has_several(graph: SceneGraph) -> bool:
        return np.sum(graph.nodes.label == ontology_of(graph).label_of(concept)) > 1

    several = [graph for graph in graphs if has_several(graph)]
    others = [graph for graph in graphs if not has_several(graph)]
    every = max(2 * len(others) // max(len(several), 1), 1)
    return several + others[::every]


def alone(model: Model, only: str) -> Any:
    """Returns the kinds, the upper layers or the placement of a model as what is trained."""
    if only == "kinds" and isinstance(model, Flagg) and model.kinds is not None:
        return KindsAlone(model.kinds, model.config.corruption)
    if only == "upper" and isinstance(model, Flagg) and model.config.upper:
        return Alone(model.upper_loss)
    if only == "placement" and isinstance(model, Flagg) and model.placement:
        return Alone(model.placement_loss)
    raise SystemExit(f"--only {only}: what this configuration grows has no {LACKS[only]}")


def known_to_initial(config: Config) -> Measured | None:
    """Returns what the weights to start from know of their training set, if of these concepts."""
    if config.initial is None:
        return None
    initial = load_weights(config.initial)
    return initial.statistics if initial.config.ontology == config.ontology else None


if __name__ == "__main__":
    main()
