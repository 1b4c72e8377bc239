"""Every model that can be trained, by the name of its method, behind the same functions.

A method is one entry of `METHODS`. Training, validation, weights, scores and the command line call
the functions below, whatever the model.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from jaxtyping import Array, Float, Key

from sg3d_jax.baselines import edge_classifier, midi_oracle
from sg3d_jax.baselines.edge_classifier import (
    ECLConfig,
    ECSquareConfig,
    EdgeClassifier,
    make_edge_classifier,
)
from sg3d_jax.baselines.edge_features import Scales, count_scales
from sg3d_jax.baselines.midi_oracle import MiDiOracle, MiDiOracleConfig, make_midi_oracle
from sg3d_jax.fill.fd4 import FD4Config, make_fd4
from sg3d_jax.fill.midi import MiDiConfig, make_midi
from sg3d_jax.fill.protocol import Fill, Statistics
from sg3d_jax.flagg import sample, step
from sg3d_jax.flagg.removal import check_one_shot, one_shot_cut
from sg3d_jax.flagg.grow import Completion
from sg3d_jax.flagg.step import Flagg, FlaggConfig, make_flagg
from sg3d_jax.infer.candidates import medoids
from sg3d_jax.scene.ontology import CITY, FLOOR
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train.statistics import statistics_of

ModelConfig = FD4Config | MiDiOracleConfig | MiDiConfig | ECSquareConfig | ECLConfig
Model = Flagg | MiDiOracle | EdgeClassifier
Measured = Statistics | Scales  # what a model knows of its training set
Params = Any  # nested dictionaries of arrays; of Flagg, those of its three modules


class Kind(NamedTuple):
    """What is done with the models of one type.

    Attributes:
      statistics: the type of what they know of their training set.
      measure: (how to grow, stacks of training graphs) -> statistics.
      params: (nested dictionaries, as a weights file holds them) -> parameters.
      init, loss, complete: the functions below of the same names.
      target: (true host graph) -> what of it is to be completed.
      top: the highest concept of graphs that they can be trained and scored on.
    """

    statistics: Callable[..., Measured]
    measure: Callable[[Any, Sequence[SceneGraph]], Measured]
    params: Callable[[dict[str, Any]], Params]
    init: Callable[..., Params]
    loss: Callable[..., Any]
    complete: Callable[..., list[list[Completion]]]
    target: Callable[[SceneGraph], SceneGraph]
    top: int


class MethodSpec(NamedTuple):
    """A method that is trained.

    Attributes:
      config: the dataclass of its model's numbers.
      make: (config, how to grow or None, statistics) -> model.
      kind: what is done with it.
      steps: the field of the configuration that says how many diffusion steps a sample of the
        topology takes; None for methods that do not diffuse.
      home: the data set whose configuration is taken for sets that have none of their own.
    """

    config: Callable[..., Any]
    make: Callable[[Any, Any, Any], Any]
    kind: Kind
    steps: str | None
    home: str


def _measure_cuts(flagg: FlaggConfig, stacks: Sequence[SceneGraph]) -> Statistics:
    return statistics_of(functools.partial(step.cut_graph, flagg), stacks)


def _measure_one_shot(flagg: None, stacks: Sequence[SceneGraph]) -> Statistics:
    check_one_shot(stacks)
    return statistics_of(lambda key, graph: one_shot_cut(graph), stacks, cuts_a_graph=1)


def _params_of_modules(branches: dict[str, Any]) -> step.Params:
    """Returns the parameters of Flagg; a module without any left no branch in a file."""
    return step.Params(*(branches.get(module, {}) for module in step.Params._fields))


def _around(make_fill: Callable[[Any, Any], Fill]) -> Callable[[Any, Any, Any], Flagg]:
    """Returns how to make a growing model of a Fill model."""
    return lambda config, flagg, statistics: make_flagg(flagg, make_fill(config, statistics))


def _alone(make: Callable[[Any, Any], Any]) -> Callable[[Any, Any, Any], Any]:
    """Returns how to make a model that does not grow."""
    return lambda config, flagg, statistics: make(config, statistics)


GROWING: Final = Kind(
    statistics=Statistics,
    measure=_measure_cuts,
    params=_params_of_modules,
    init=step.init,
    loss=step.loss,
    complete=sample.complete,
    target=lambda graph: graph,
    top=CITY,
)
ONE_SHOT: Final = Kind(
    statistics=Statistics,
    measure=_measure_one_shot,
    params=lambda branches: branches,
    init=lambda model, key, graph: model.init(key, graph),
    loss=lambda model, params, key, graph: model.loss(params, key, graph),
    complete=midi_oracle.complete,
    target=lambda graph: graph,
    top=CITY,
)
CLASSIFYING: Final = ONE_SHOT._replace(
    statistics=Scales,
    measure=lambda flagg, stacks: count_scales(stacks),
    complete=edge_classifier.complete,
    target=edge_classifier.target,
    top=FLOOR,
)

METHODS: Final[Mapping[str, MethodSpec]] = MappingProxyType(
    {
        "ec-square": MethodSpec(
            ECSquareConfig, _alone(make_edge_classifier), CLASSIFYING, None, "s-f-square"
        ),
        "ec-l": MethodSpec(ECLConfig, _alone(make_edge_classifier), CLASSIFYING, None, "s-f"),
        "midi-or": MethodSpec(
            MiDiOracleConfig, _alone(make_midi_oracle), ONE_SHOT, "sampling_steps", "s-f"
        ),
        "fd4": MethodSpec(FD4Config, _around(make_fd4), GROWING, "topology_steps", "s-f"),
        "midi": MethodSpec(MiDiConfig, _around(make_midi), GROWING, "sampling_steps", "s-f"),
    }
)
_METHOD_OF: Final = {spec.config: name for name, spec in METHODS.items()}
_KIND_OF: Final[Mapping[type, Kind]] = MappingProxyType(
    {Flagg: GROWING, MiDiOracle: ONE_SHOT, EdgeClassifier: CLASSIFYING}
)


def method_of(config: ModelConfig) -> str:
    """Returns the name of the method that a configuration of a model is of."""
    return _METHOD_OF[type(config)]


def measure(
    config: ModelConfig, flagg: FlaggConfig | None, stacks: Sequence[SceneGraph]
) -> Measured:
    """Counts what a model must know of its training set.

    Args:
      config: of the model.
      flagg: how it grows; None for a model that does not.
      stacks: of padded graphs with proximity edges.
    """
    return METHODS[method_of(config)].kind.measure(flagg, stacks)


def build_model(config: ModelConfig, flagg: FlaggConfig | None, statistics: Measured) -> Model:
    """Builds the functions of a model.

    Args:
      config: of the model.
      flagg: how it grows; None for a model that does not.
      statistics: what `measure` counted.
    """
    return METHODS[method_of(config)].make(config, flagg, statistics)


def init(model: Model, key: Key[Array, ""], graph: SceneGraph) -> Params:
    """Draws initial parameters; `graph` is any complete padded graph with proximity edges."""
    return _KIND_OF[type(model)].init(model, key, graph)


def loss(
    model: Model, params: Params, key: Key[Array, ""], graph: SceneGraph
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Returns the loss of a training step on one graph, and its terms.

    Args:
      model: of any method.
      params: its parameters.
      key: of all that is drawn.
      graph: complete, padded, with proximity edges.
    """
    return _KIND_OF[type(model)].loss(model, params, key, graph)


def complete(
    model: Model,
    params: Params,
    scenes: Sequence[SceneGraph],
    seed: int = 0,
    samples: int = 1,
    candidates: int = 1,
) -> list[list[Completion]]:
    """Completes scene graphs from the planes of host graphs, in compiled batches.

    Args:
      model: of any method.
      params: its parameters.
      scenes: host graphs; everything but their planes is ignored, save that MiDi+Or counts the
        nodes that they have above the planes.
      seed: with the position of a scene in `scenes` and the number of the sample, fixes it.
      samples: graphs a scene.
      candidates: graphs that are drawn for each of them; their medoid under FGW is kept.

    Returns:
      For every scene, in order, its samples.
    """
    drawn = _KIND_OF[type(model)].complete(model, params, scenes, seed, samples * candidates)
    if candidates == 1:
        return drawn
    starts = range(0, samples * candidates, candidates)
    groups = [of_scene[start : start + candidates] for of_scene in drawn for start in starts]
    chosen = medoids([[one.graph for one in group] for group in groups])
    kept = iter([group[index] for group, index in zip(groups, chosen, strict=True)])
    return [[next(kept) for _ in starts] for _ in drawn]


def target(model: Model, graph: SceneGraph) -> SceneGraph:
    """Returns what of a true host graph a completed one is scored against."""
    return _KIND_OF[type(model)].target(graph)


def share_halted(completions: Sequence[Completion]) -> float | None:
    """Returns the share of graphs that a growing model found complete; None for other models."""
    reasons = [completion.halt_reason for completion in completions]
    return None if "ONE_SHOT" in reasons else reasons.count("HALTED") / len(reasons)


def sampling_steps(config: ModelConfig) -> int | None:
    """Returns the diffusion steps of a sample of the topology; None where nothing is diffused."""
    field = METHODS[method_of(config)].steps
    return None if field is None else getattr(config, field)


def with_sampling_steps(config: ModelConfig, steps: int) -> ModelConfig:
    """Returns the configuration with another number of diffusion steps of a sample.

    Raises:
      ValueError: not in 1..S of the trained schedule, or a method that does not diffuse.
    """
    name = method_of(config)
    field = METHODS[name].steps
    if field is None:
        raise ValueError(f"{name} has no diffusion steps, got {steps}")
    most = getattr(config, "diffusion_steps", 0)
    if not 1 <= steps <= most:
        raise ValueError(f"diffusion steps must be in 1..{most}, got {steps}")
    return dataclasses.replace(config, **{field: steps})
