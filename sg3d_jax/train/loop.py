"""A run: data, steps, validation by sampling, checkpoints, logs.

A run is a pure function of its configuration: data, parameters, the order of the buckets and every
draw follow from its seeds and the step, so a resumed run continues bit for bit. A run whose steps
are raised goes on from where it is, by the schedule of the new length: the learning rate, which had
fallen towards zero, rises to what it is at that step of a run so long. It is not, then, what a run
of that length would have been from its start.

Devices and processes change nothing: batches are spread over them (`train/step.py`), and of several
processes the first alone reads, validates and writes, while the others take the steps with it.
"""

import contextlib
import time
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from sg3d_jax.distributed import is_first
from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.step import with_upper
from sg3d_jax.infer.complete import complete, share_halted
from sg3d_jax.infer.lanes import Model, root_key
from sg3d_jax.io.files import sync
from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.metrics.structure import exact_structure
from sg3d_jax.scene.graph import PackedGraph, SceneGraph, ontology_of
from sg3d_jax.train import checkpoint
from sg3d_jax.train.card import Card, card_of
from sg3d_jax.train.config import Config, check
from sg3d_jax.train.dataset import load_split, stack_by_size, training_graphs
from sg3d_jax.train.digest import digest_of
from sg3d_jax.train.directory import changes_of_origin, check_same_run, held, origin_of, write_run
from sg3d_jax.train.log import display, say_remark, writers
from sg3d_jax.train.methods import METHODS, Measured, build_model, measure
from sg3d_jax.train.processes import from_first, on_all_devices, together
from sg3d_jax.train.rounds import made_side_by_side, rounds, workers
from sg3d_jax.train.statistics import shares_of
from sg3d_jax.train.step import TrainCall, TrainState, init_state, make_train_call, mesh_of
from sg3d_jax.train.transfer import transferred
from sg3d_jax.train.weights import load_weights, save_weights

CHECKPOINTS: Final = "checkpoints"  # the folder in the run directory, and
WEIGHTS: Final = "weights.npz"  # the file there
SPARE_EDGES: Final = 0.125  # share of the edge slots, for graphs that are drawn anew


class Run(NamedTuple):
    """What stays the same throughout a run."""

    config: Config  # of the run
    model: Model  # built from it and the statistics
    statistics: Measured  # of the training set
    stacks: list[PackedGraph]  # training graphs by size
    validation: list[SceneGraph]  # host graphs
    card: Card  # of the weights to come
    digests: dict[str, str]  # of the training and validation graphs


class Called(NamedTuple):
    """What a compiled call of several steps has come to."""

    state: TrainState  # until the next call, which takes its memory
    step: int  # of it
    metrics: dict[str, float]  # means over the steps
    seconds: float  # a step


class Finished(NamedTuple):
    """What a run has come to."""

    weights: Path  # the file
    step: int  # of the best validation FGW, whose averaged parameters they are
    fgw: float  # it


def prepare(config: Config) -> Run:
    """Makes or reads the data and builds the model."""
    graphs = _graphs_of(config)
    stacks, statistics, model = build(config, graphs)
    validation = load_split(config.data, "validation")[: config.validation_graphs]
    digests = {"training": digest_of(graphs), "validation": digest_of(validation)}
    return Run(config, model, statistics, stacks, validation, card_of(graphs), digests)


def build(
    config: Config, graphs: Sequence[SceneGraph], statistics: Measured | None = None
) -> tuple[list[PackedGraph], Measured, Model]:
    """Stacks the graphs that are trained on by size, and builds the model.

    Args:
      config: the run.
      graphs: host graphs.
      statistics: what the model is to know of its training set; None for those of the graphs.
    """
    _check_concepts(config, graphs)
    spare = 0.0 if config.fresh_every is None else SPARE_EDGES
    stacks = stack_by_size(graphs, config.capacities, spare)
    if statistics is None:
        statistics = measure(config.model, config.flagg, stacks)
    return stacks, statistics, build_model(config.model, config.flagg, statistics, config.ontology)


def _graphs_of(config: Config) -> list[SceneGraph]:
    """Makes or reads the training graphs; those that are drawn anew later, on all cores."""
    if config.fresh_every is None:
        return training_graphs(config.data, config.method)
    with workers() as make:
        return made_side_by_side(make, config.data, config.method)


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
    completions = complete(run.model, params, run.validation, seed, candidates=1, outgrow=False)
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


def train(config: Config, directory: str | Path, accept_changes: bool = False) -> Finished:
    """Trains, or goes on training, in a run directory.

    Of several processes (`distributed.initialise`) each calls this, with the same arguments.

    Args:
      config: the run. A directory that already holds a run must hold this one, of as many steps or
        fewer.
      directory: gets config.json, origins.jsonl, log.jsonl, checkpoints/ and, at the end,
        weights.npz.
      accept_changes: go on with other data or code, or on another device, than the run began with.

    Returns:
      The weights: the averaged parameters of the best validation FGW.

    Raises:
      ValueError: the configuration is no run, the directory holds a run of another one, or of other
        data or code, or another process trains in it, or the weights to start from do not fit.
      FloatingPointError: the loss is not finite; the last good checkpoint stays.
      OSError: something cannot be written.
    """
    directory = Path(directory)
    check(config)
    if not is_first():
        return _take_part(config, directory)
    with contextlib.ExitStack() as stack:
        with together():
            stack.enter_context(held(directory))
            steps = check_same_run(directory, config)
            run = prepare(config)
            here = origin_of(run.digests)
            _check_origin(directory, here, accept_changes)
            template = _initial_state(run)
            start = start_from_weights(config, template)
            checkpoints = checkpoint.open_checkpoints(directory / CHECKPOINTS)
            kept = checkpoint.steps(checkpoints)
            step = kept[-1].step if kept else 0
            _remark_how_it_goes_on(directory, checkpoints, step, steps, config.steps)
            _remark_idle_devices(directory, config)
            write_run(directory, config, here, step)
        step = from_first(step)
        state = checkpoint.restore(checkpoints, template, step) if step else start
        _run(run, state, checkpoints, directory)
        best = from_first(min(checkpoint.steps(checkpoints), key=lambda one: one.fgw))
        params = checkpoint.restore(checkpoints, template, best.step).average
        save_weights(directory / WEIGHTS, config, run.statistics, params, run.card)
        return Finished(directory / WEIGHTS, *best)


def _take_part(config: Config, directory: Path) -> Finished:
    """Does in every other process what the first, which has the run directory, cannot do alone."""
    with together():
        run = prepare(config)
        template = _initial_state(run)
        start = start_from_weights(config, template)
    checkpoints = checkpoint.Checkpoints(directory / CHECKPOINTS)
    step = from_first(0)
    state = checkpoint.restore(checkpoints, template, step) if step else start
    with contextlib.closing(calls(run, state, directory)) as made:
        for called in made:
            if _is_due(config, called.step):
                with together():
                    pass  # the first process validates
                with together():
                    checkpoint.write_state(checkpoints, called.state)
    best = from_first(checkpoint.Kept(0, 0.0))
    checkpoint.restore(checkpoints, template, best.step)
    return Finished(directory / WEIGHTS, *best)


def _initial_state(run: Run) -> TrainState:
    """Returns the state that a run begins with, unless it starts from weights."""
    return init_state(run.config, run.model, jax.tree.map(lambda leaf: leaf[0], run.stacks[0]))


def _check_origin(directory: Path, here: dict[str, str], accept_changes: bool) -> None:
    """Refuses to go on with other data or code than a run began with, unless that is asked for."""
    changes = changes_of_origin(directory, here)
    if changes is None:
        say_remark(f"{directory}: does not say what data and code it began with; taken to be these")
        return
    listed = "; ".join(changes)
    if changes and not accept_changes:
        raise ValueError(
            f"{directory}: the run began with other data or code, {listed}; expected the same, or "
            "--accept-changes for weights that are of neither alone"
        )
    if changes:
        say_remark(f"{directory}: goes on although changed, {listed}")


def _remark_how_it_goes_on(
    directory: Path,
    checkpoints: checkpoint.Checkpoints,
    step: int,
    steps_before: int | None,
    steps: int,
) -> None:
    """Says what is unusual in how a run goes on."""
    if checkpoints.damaged:
        names = ", ".join(checkpoints.damaged)
        say_remark(f"{directory}: set aside damaged checkpoints: {names}; goes on from step {step}")
    if steps_before is not None and steps_before < steps:
        say_remark(
            f"{directory}: had {steps_before} steps, now {steps}; from step {step} on the learning "
            f"rate is that of a run of {steps}"
        )


def _remark_idle_devices(directory: Path, config: Config) -> None:
    """Says which accelerators have nothing to do; the devices of a CPU share its cores."""
    used, there = mesh_of(config).size, jax.device_count()
    if used < there and jax.default_backend() != "cpu":
        say_remark(
            f"{directory}: trains on {used} of {there} devices, because accumulate is "
            f"{config.accumulate}; --accumulate {there} has a batch for each"
        )


def start_from_weights(config: Config, state: TrainState) -> TrainState:
    """Returns the initial state, with the parameters of the weights that the run starts from.

    Weights of other concepts are carried over (`transferred`). Upper layers that they have no
    parameters of begin with those of Fill (`FlaggConfig.upper`), a placement as any new one does.

    Raises:
      ValueError: they are of another method or of other sizes.
    """
    if config.initial is None:
        return state
    trained = load_weights(config.initial)

    try:
        if trained.config.method != config.method:
            raise AssertionError
        params = trained.params
        if config.flagg is not None:
            params = with_upper(params, config.flagg)
        if trained.config.ontology != config.ontology:
            concepts = trained.config.ontology, config.ontology
            params = transferred(params, concepts[0], state.params, concepts[1])
        if config.flagg is not None and not (config.flagg.placement and params.placement):
            params = params._replace(placement=state.params.placement)
        chex.assert_trees_all_equal_shapes_and_dtypes(params, state.params)
    except (AssertionError, ValueError) as error:
        raise ValueError(
            f"initial: {config.initial} are weights of {trained.config.method} with other layers, "
            f"expected those of {config.method} with the widths, layers and coins of this run"
        ) from error
    return state._replace(params=params, average=params)


def compile_calls(
    train_call: Any, state: TrainState, key: Key[Array, ""], stacks: Sequence[PackedGraph]
) -> list[TrainCall]:
    """Compiles the training call of every bucket, side by side on as many cores as there are."""
    pool = ThreadPoolExecutor()
    try:
        coming = [pool.submit(train_call.lower(state, key, one).compile) for one in stacks]
        return [one.result() for one in coming]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # Ctrl-C waits for no compiler


def calls(run: Run, state: TrainState, directory: Path) -> Generator[Called]:
    """Trains from a state to the end, and yields what every compiled call has come to.

    Args:
      run: the same in every process.
      state: likewise.
      directory: of the run.

    Raises:
      FloatingPointError: the loss is not finite.
    """
    config, mesh, shares = run.config, mesh_of(run.config), shares_of(run.stacks)
    key, stacks = on_all_devices((root_key(config.seed + 1), run.stacks), mesh)
    step = int(state.step)
    state = on_all_devices(jax.tree.map(jnp.copy, state), mesh)  # calls take its memory
    train_calls = compile_calls(make_train_call(config, run.model), state, key, stacks)
    with contextlib.closing(rounds(config, run.stacks, step)) as coming:
        for graphs, until in coming:
            stacks = on_all_devices(graphs, mesh)
            while step < until:
                first, began = step, time.monotonic()
                bucket = bucket_of_call(config, shares, first // config.steps_per_call)
                state, metrics = train_calls[bucket](state, key, stacks[bucket])
                step = int(state.step)
                values = {name: float(value) for name, value in metrics.items()}
                _check_finite(values, directory, first, step)
                yield Called(state, step, values, (time.monotonic() - began) / (step - first))


def _check_finite(values: dict[str, float], directory: Path, first: int, step: int) -> None:
    """Ends a run whose loss or gradients are not finite."""
    if not np.isfinite(values["loss"] + values["gradient_norm"]):
        raise FloatingPointError(
            f"{directory}: the loss is {values['loss']} with gradients of norm "
            f"{values['gradient_norm']} between steps {first} and {step}; the last good "
            "checkpoint is untouched, try a lower learning rate"
        )


def _is_due(config: Config, step: int) -> bool:
    """Returns whether a run is validated and saved after a step."""
    return step % config.validate_every == 0 or step >= config.steps


def _run(run: Run, state: TrainState, checkpoints: checkpoint.Checkpoints, directory: Path) -> None:
    """Trains from a state to the end, recording, validating and saving on the way."""
    config, step = run.config, int(state.step)
    recording = writers(directory, step)
    made = contextlib.closing(calls(run, state, directory))
    with recording as record, display(config.steps, step) as shown, made as coming:
        for called in coming:
            step, seconds = called.step, called.seconds
            for write in record:
                write("train", step, {**called.metrics, "seconds_per_step": seconds})
            shown.advance(step, f"loss {called.metrics['loss']:.4f}  {seconds:.3f} s/step")
            if _is_due(config, step):
                with together():
                    reached = jax.tree.map(np.asarray, called.state)
                    scores = validate(run, reached.average)
                    for write in record:
                        write("validation", step, scores)
                    sync(directory / "log.jsonl")  # a checkpoint is behind all records of its steps
                with together():
                    checkpoint.save(checkpoints, reached, scores["fgw"])
                shown.advance(step, "  ".join(f"{k} {v:.4f}" for k, v in scores.items()))
