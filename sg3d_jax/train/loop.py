"""A run: data, steps, validation by sampling, checkpoints, logs.

A run is a pure function of its configuration: data, parameters, the order of the buckets and every
draw follow from its seeds and the step, so a resumed run continues bit for bit.
"""

import json
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import chex
import jax
import numpy as np
from jaxtyping import Array, Key

from sg3d_jax.fill.protocol import Params
from sg3d_jax.infer.complete import complete, share_halted
from sg3d_jax.infer.lanes import Model, root_key
from sg3d_jax.io.files import read_documents, replacing
from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.metrics.structure import exact_structure
from sg3d_jax.scene.graph import PackedGraph, SceneGraph, ontology_of
from sg3d_jax.train import checkpoint
from sg3d_jax.train.card import Card, card_of
from sg3d_jax.train.config import Config, check, to_json
from sg3d_jax.train.dataset import load_split, stack_by_size, training_graphs
from sg3d_jax.train.log import display, writers
from sg3d_jax.train.methods import METHODS, Measured, build_model, measure
from sg3d_jax.train.statistics import shares_of
from sg3d_jax.train.step import TrainCall, TrainState, init_state, make_train_call
from sg3d_jax.train.weights import load_weights, save_weights


class Run(NamedTuple):
    """What stays the same throughout a run."""

    config: Config  # of the run
    model: Model  # built from it and the statistics
    statistics: Measured  # of the training set
    stacks: list[PackedGraph]  # training graphs by size
    validation: list[SceneGraph]  # host graphs
    card: Card  # of the weights to come


def prepare(config: Config, graphs: Sequence[SceneGraph] | None = None) -> Run:
    """Makes or reads the data and builds the model.

    Args:
      config: the run.
      graphs: that are trained on, where they are made already; None for those of the configuration.
    """
    graphs = training_graphs(config.data, config.method) if graphs is None else graphs
    _check_concepts(config, graphs)
    stacks = stack_by_size(graphs, config.capacities)
    statistics = measure(config.model, config.flagg, stacks)
    validation = load_split(config.data, "validation")[: config.validation_graphs]
    model = build_model(config.model, config.flagg, statistics, config.ontology)
    return Run(config, model, statistics, stacks, validation, card_of(graphs))


def _check_concepts(config: Config, graphs: Sequence[SceneGraph]) -> None:
    """Refuses graphs of other concepts than those that are to be learnt."""
    for index, graph in enumerate(graphs):
        if ontology_of(graph) != config.ontology:
            held, wanted = (", ".join(o.names) for o in (ontology_of(graph), config.ontology))
            raise ValueError(
                f"{config.data.name}: graph {index} has the concepts {held}, expected {wanted}, as "
                "the ontology of the configuration says"
            )


def bucket_of_call(config: Config, shares: np.ndarray, call: int) -> int:
    """Draws the bucket of one compiled call by `shares_of`, from seed and call."""
    return int(np.random.default_rng([config.seed, call]).choice(len(shares), p=shares))


def validate(run: Run, params: Params) -> dict[str, float]:
    """Completes the validation scenes and scores them: means of FGW, GW, W, exact structures."""
    seed = run.config.validation_seed  # a model that has not learnt to halt is not waited for
    completions = complete(run.model, params, run.validation, seed, outgrow=False)
    made = [samples[0].graph for samples in completions]
    truth = [METHODS[run.config.method].target(graph) for graph in run.validation]
    scores = fgw_pairs(made, truth)
    exact = [exact_structure(*pair) for pair in zip(made, truth, strict=True)]
    halted = share_halted([samples[0] for samples in completions])
    fgw = float(np.mean(scores.value))
    return {
        "fgw": fgw if np.isfinite(fgw) else np.inf,  # the worst, not the best
        "gw": float(np.mean(scores.gw)),
        "w": float(np.mean(scores.w)),
        "exact_structure": float(np.mean(exact)),
        **({} if halted is None else {"halted": halted}),
    }


def train(config: Config, directory: str | Path) -> Path:
    """Trains, or goes on training, in a run directory.

    Args:
      config: the run. A directory that already holds a run must hold this one.
      directory: gets config.json, log.jsonl, checkpoints/ and, at the end, weights.npz.

    Returns:
      The path of the weights: the averaged parameters of the best validation FGW.

    Raises:
      ValueError: the configuration is no run, the directory holds a run of another one, or the
        weights to start from do not fit.
      FloatingPointError: the loss is not finite; the last good checkpoint stays.
    """
    directory = Path(directory)
    check(config)
    _check_same_run(directory / "config.json", config)
    run = prepare(config)
    template = init_state(config, run.model, jax.tree.map(lambda leaf: leaf[0], run.stacks[0]))
    start = start_from_weights(config, template)
    directory.mkdir(parents=True, exist_ok=True)
    with replacing(directory / "config.json") as temporary:
        temporary.write_text(to_json(config) + "\n")
    checkpoints = checkpoint.open_checkpoints(directory / "checkpoints")
    try:
        kept = checkpoint.steps(checkpoints)
        state = checkpoint.restore(checkpoints, template, kept[-1][0]) if kept else start
        _run(run, state, checkpoints, directory)
        best = min(checkpoint.steps(checkpoints), key=lambda step_and_fgw: step_and_fgw[1])[0]
        params = checkpoint.restore(checkpoints, template, best).average
    finally:
        checkpoint.close(checkpoints)
    return save_weights(directory / "weights.npz", config, run.statistics, params, run.card)


def start_from_weights(config: Config, state: TrainState) -> TrainState:
    """Returns the initial state, with the parameters of the weights that the run starts from.

    Raises:
      ValueError: they are of another method or of other sizes.
    """
    if config.initial is None:
        return state
    trained = load_weights(config.initial)

    try:
        if trained.config.method != config.method:
            raise AssertionError
        chex.assert_trees_all_equal_shapes_and_dtypes(trained.params, state.params)
    except AssertionError as error:
        raise ValueError(
            f"initial: {config.initial} are weights of {trained.config.method} with other layers, "
            f"expected those of {config.method} with the widths, layers and coins of this run"
        ) from error
    return state._replace(params=trained.params, average=trained.params)


def compile_calls(
    train_call: Any, state: TrainState, key: Key[Array, ""], stacks: Sequence[PackedGraph]
) -> list[TrainCall]:
    """Compiles the training call of every bucket, side by side on as many cores as there are."""
    lowered = [train_call.lower(state, key, graphs) for graphs in stacks]
    with ThreadPoolExecutor() as pool:
        return list(pool.map(lambda one: one.compile(), lowered))


def _run(run: Run, state: TrainState, checkpoints: checkpoint.Checkpoints, directory: Path) -> None:
    """Trains from a state to the end, validating and saving on the way."""
    config = run.config
    record = writers(directory)
    key, shares = root_key(config.seed + 1), shares_of(run.stacks)
    train_calls = compile_calls(make_train_call(config, run.model), state, key, run.stacks)
    with display(config.steps, int(state.step)) as shown:
        while int(state.step) < config.steps:
            first, began = int(state.step), time.monotonic()
            bucket = bucket_of_call(config, shares, first // config.steps_per_call)
            state, metrics = train_calls[bucket](state, key, run.stacks[bucket])
            step, values = int(state.step), {name: float(value) for name, value in metrics.items()}
            if not np.isfinite(values["loss"] + values["gradient_norm"]):
                raise FloatingPointError(
                    f"{directory}: the loss is {values['loss']} with gradients of norm "
                    f"{values['gradient_norm']} between steps {first} and {step}; the last good "
                    "checkpoint is untouched, try a lower learning rate"
                )
            seconds = (time.monotonic() - began) / (step - first)
            for write in record:
                write("train", step, {**values, "seconds_per_step": seconds})
            shown.advance(step, f"loss {values['loss']:.4f}  {seconds:.3f} s/step")
            if step % config.validate_every == 0 or step >= config.steps:
                scores = validate(run, state.average)
                checkpoint.save(checkpoints, state, scores["fgw"])
                for write in record:
                    write("validation", step, scores)
                shown.advance(step, "  ".join(f"{k} {v:.4f}" for k, v in scores.items()))


def _check_same_run(path: Path, config: Config) -> None:
    """Refuses a run directory whose config.json is of another run."""
    if not path.exists():
        return
    ((_, there),) = read_documents(path)
    changed = _changes(there, json.loads(to_json(config)))
    if changed:
        listed = "; ".join(f"{name} {old} there, {new} here" for name, old, new in changed)
        raise ValueError(f"{path}: the run has another configuration: {listed}")


def _changes(there: dict[str, Any], here: dict[str, Any], prefix: str = "") -> list[tuple]:
    """Lists the fields in which two nested dictionaries differ."""
    found = []
    for name in sorted(there.keys() | here.keys()):
        old, new = there.get(name), here.get(name)
        if isinstance(old, dict) and isinstance(new, dict):
            found += _changes(old, new, f"{prefix}{name}.")
        elif old != new:
            found.append((f"{prefix}{name}", old, new))
    return found
