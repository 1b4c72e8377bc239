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

from sg3d_jax.fill.fd4 import FD4Config, make_fd4
from sg3d_jax.fill.protocol import Fill, Statistics
from sg3d_jax.flagg import sample, step
from sg3d_jax.flagg.sample import Completion
from sg3d_jax.flagg.step import Flagg, FlaggConfig, make_flagg
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train.statistics import statistics_of

ModelConfig = FD4Config
Model = Flagg
ONE_SHOT: Final = "ONE_SHOT"  # the halt reason of graphs that did not grow in steps
Params = Any  # nested dictionaries of arrays; of Flagg, those of its three modules


class Kind(NamedTuple):
    """What is done with the models of one type; see the functions of the same names.

    Attributes:
      statistics: the type of what they know of their training set.
      measure: (how to grow, stacks of training graphs) -> statistics.
      params: (nested dictionaries) -> parameters, as a weights file holds them.
      init, loss, complete, target: as the functions below.
    """

    statistics: Callable[..., Any]
    measure: Callable[[Any, Sequence[SceneGraph]], Any]
    params: Callable[[dict[str, Any]], Params]
    init: Callable[..., Params]
    loss: Callable[..., Any]
    complete: Callable[..., list[list[Completion]]]
    target: Callable[[Any, SceneGraph], SceneGraph]


class MethodSpec(NamedTuple):
    """A method that is trained.

    Attributes:
      config: the dataclass of its model's numbers.
      make: (config, how to grow or None, statistics) -> model.
      kind: what is done with it.
      steps: the field of the configuration that says how many diffusion steps a sample of the
        topology takes; None for methods that do not diffuse.
    """

    config: Callable[..., Any]
    make: Callable[[Any, Any, Any], Any]
    kind: Kind
    steps: str | None


def _measure_cuts(flagg: FlaggConfig, stacks: Sequence[SceneGraph]) -> Statistics:
    return statistics_of(functools.partial(step.cut_graph, flagg), stacks)


def _params_of_modules(branches: dict[str, Any]) -> step.Params:
    """Returns the parameters of Flagg; a module without any left no branch in a file."""
    return step.Params(*(branches.get(module, {}) for module in step.Params._fields))


def _around(make_fill: Callable[[Any, Any], Fill]) -> Callable[[Any, Any, Any], Flagg]:
    """Returns how to make a growing model of a Fill model."""
    return lambda config, flagg, statistics: make_flagg(flagg, make_fill(config, statistics))


GROWING: Final = Kind(
    statistics=Statistics,
    measure=_measure_cuts,
    params=_params_of_modules,
    init=step.init,
    loss=step.loss,
    complete=sample.complete,
    target=lambda model, graph: graph,
)

METHODS: Final[Mapping[str, MethodSpec]] = MappingProxyType(
    {
        "fd4": MethodSpec(FD4Config, _around(make_fd4), GROWING, "topology_steps"),
    }
)
_METHOD_OF: Final = {spec.config: name for name, spec in METHODS.items()}
_KIND_OF: Final[Mapping[type, Kind]] = MappingProxyType({Flagg: GROWING})


def method_of(config: ModelConfig) -> str:
    """Returns the name of the method that a configuration of a model is of."""
    return _METHOD_OF[type(config)]


def measure(
    config: ModelConfig, flagg: FlaggConfig | None, stacks: Sequence[SceneGraph]
) -> Statistics:
    """Counts what a model must know of its training set.

    Args:
      config: of the model.
      flagg: how it grows; None for a model that does not.
      stacks: of padded graphs with proximity edges.
    """
    return METHODS[method_of(config)].kind.measure(flagg, stacks)


def build_model(config: ModelConfig, flagg: FlaggConfig | None, statistics: Statistics) -> Model:
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
    model: Model, params: Params, scenes: Sequence[SceneGraph], seed: int = 0, samples: int = 1
) -> list[list[Completion]]:
    """Completes scene graphs from the planes of host graphs, in compiled batches.

    Args:
      model: of any method.
      params: its parameters.
      scenes: host graphs; everything but their planes is ignored.
      seed: with the position of a scene in `scenes` and the number of the sample, fixes it.
      samples: graphs a scene.

    Returns:
      For every scene, in order, its samples.
    """
    return _KIND_OF[type(model)].complete(model, params, scenes, seed, samples)


def target(model: Model, graph: SceneGraph) -> SceneGraph:
    """Returns what of a true host graph a completed one is scored against."""
    return _KIND_OF[type(model)].target(model, graph)


def share_halted(completions: Sequence[Completion]) -> float | None:
    """Returns the share of graphs that a growing model found complete; None for other models."""
    reasons = [completion.halt_reason for completion in completions]
    return None if ONE_SHOT in reasons else reasons.count("HALTED") / len(reasons)


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
    if not 1 <= steps <= config.diffusion_steps:
        raise ValueError(f"diffusion steps must be in 1..{config.diffusion_steps}, got {steps}")
    return dataclasses.replace(config, **{field: steps})
