"""Every method that can be trained, by name: ours, and those that a user registers.

A method is a configuration of numbers and how a model is made of it. Training, weights, scores and
the command line ask here, whatever the model.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from sg3d_jax.baselines import edge_classifier
from sg3d_jax.baselines.edge_classifier import ECL, ECLConfig, ECSquare, ECSquareConfig
from sg3d_jax.baselines.edge_features import Scales, count_scales
from sg3d_jax.baselines.midi_oracle import (
    MiDiOracle,
    MiDiOracleConfig,
    check_one_shot,
    one_shot_cut,
)
from sg3d_jax.fill.fd4 import FD4, FD4Config
from sg3d_jax.fill.midi import MiDi, MiDiConfig
from sg3d_jax.fill.protocol import Fill, Params, Statistics
from sg3d_jax.flagg import step
from sg3d_jax.flagg.step import FlaggConfig, make_flagg
from sg3d_jax.infer.lanes import Model
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.train.statistics import statistics_of

Measured = Statistics | Scales  # what a model knows of its training set


class Method(NamedTuple):
    """A method that is trained.

    Attributes:
      config: the frozen dataclass of its model's numbers.
      make: (config, how it grows or None, statistics, ontology) -> model.
      measure: (how it grows or None, stacks of training graphs) -> statistics.
      statistics: their type.
      grows: whether its models grow; they then have a `FlaggConfig`.
      steps: the field of the configuration that says how many diffusion steps a sample of the
        topology takes; None for methods that do not diffuse.
      home: the data set whose configuration is taken for sets that have none of their own; None
        where every run has its own file.
      trained_at_home: whether one training serves all data sets.
      top: the label of the highest concept that it can be trained and scored on; None for any.
      target: (true host graph) -> what of it is to be completed; refuses what it cannot be.
    """

    config: type
    make: Callable[[Any, FlaggConfig | None, Any, Ontology], Model]
    measure: Callable[[FlaggConfig | None, Sequence[SceneGraph]], Measured]
    statistics: type[Measured]
    grows: bool
    steps: str | None = None
    home: str | None = None
    trained_at_home: bool = False
    top: int | None = None
    target: Callable[[SceneGraph], SceneGraph] = lambda graph: graph


def _measure_cuts(flagg: FlaggConfig | None, stacks: Sequence[SceneGraph]) -> Statistics:
    return statistics_of(functools.partial(step.cut_graph, flagg or FlaggConfig()), stacks)


def _measure_one_shot(flagg: FlaggConfig | None, stacks: Sequence[SceneGraph]) -> Statistics:
    check_one_shot(stacks)
    return statistics_of(lambda key, graph: one_shot_cut(graph), stacks, cuts_a_graph=1)


def _growing(
    config: type,
    make_fill: Callable[[Any, Statistics, Ontology], Fill],
    steps: str | None,
    home: str | None,
) -> Method:
    """Returns the method that grows by a Fill model."""

    def make(config: Any, flagg: Any, statistics: Any, ontology: Ontology) -> Model:
        return make_flagg(flagg, make_fill(config, statistics, ontology))

    return Method(config, make, _measure_cuts, Statistics, grows=True, steps=steps, home=home)


def _classifying(config: type, make: Callable[[Any, Scales], Model], home: str) -> Method:
    """Returns the method of an edge classifier, which knows the paper's concepts alone."""
    return Method(
        config=config,
        make=lambda config, flagg, scales, ontology: make(config, scales),
        measure=lambda flagg, stacks: count_scales(stacks),
        statistics=Scales,
        grows=False,
        home=home,
        trained_at_home=True,
        top=edge_classifier.TOP,
        target=edge_classifier.target,
    )


METHODS: Final[dict[str, Method]] = {
    "ec-square": _classifying(ECSquareConfig, ECSquare, "s-f-square"),
    "ec-l": _classifying(ECLConfig, ECL, "s-f"),
    "midi-or": Method(
        config=MiDiOracleConfig,
        make=lambda config, flagg, statistics, ontology: MiDiOracle(config, statistics, ontology),
        measure=_measure_one_shot,
        statistics=Statistics,
        grows=False,
        steps="sampling_steps",
        home="s-f",
    ),
    "fd4": _growing(FD4Config, FD4, "topology_steps", "s-f"),
    "midi": _growing(MiDiConfig, MiDi, "sampling_steps", "s-f"),
}


def register_fill(
    name: str,
    config: type,
    make_fill: Callable[[Any, Statistics, Ontology], Fill],
    steps: str | None = None,
) -> None:
    """Makes a Fill model of your own a method that can be trained, stored and completed with.

    Call it where the model is defined; whoever loads its weights must have run that file.

    Args:
      name: of the method, such as "nearest".
      config: a frozen dataclass of numbers, all with defaults.
      make_fill: (config, statistics, ontology) -> the Fill model, see `fill.protocol.Fill`.
      steps: the field of the configuration that says how many diffusion steps a sample takes.

    Raises:
      ValueError: another method has this name.
    """
    known = METHODS.get(name)
    if known is not None and known.config.__qualname__ != config.__qualname__:
        raise ValueError(f"a method {name!r} is there already, expected another name")
    METHODS[name] = _growing(config, make_fill, steps, home=None)


def method_of(config: Any) -> str:
    """Returns the name of the method that a configuration of a model is of.

    Raises:
      ValueError: no method has such a configuration.
    """
    for name, method in METHODS.items():
        if method.config is type(config):
            return name
    raise ValueError(
        f"{type(config).__name__} is the configuration of no method: register_fill makes it one"
    )


def measure(config: Any, flagg: FlaggConfig | None, stacks: Sequence[SceneGraph]) -> Measured:
    """Counts what a model must know of its training set.

    Args:
      config: of the model.
      flagg: how it grows; None for a model that does not.
      stacks: of padded graphs with proximity edges.
    """
    return METHODS[method_of(config)].measure(flagg, stacks)


def build_model(
    config: Any, flagg: FlaggConfig | None, statistics: Measured, ontology: Ontology
) -> Model:
    """Builds a model; two that are built alike are equal and compile once.

    Args:
      config: of the model.
      flagg: how it grows; None for a model that does not.
      statistics: what `measure` counted.
      ontology: the concepts.
    """
    return METHODS[method_of(config)].make(config, flagg, statistics, ontology)


def params_of(config: Any, branches: dict[str, Any]) -> Params:
    """Returns the parameters that a weights file holds as nested dictionaries.

    Args:
      config: of the model.
      branches: a module without any parameters left no branch.
    """
    if not METHODS[method_of(config)].grows:
        return branches
    absent = step.Params._field_defaults
    modules = step.Params._fields
    return step.Params(*(branches.get(module, absent.get(module, {})) for module in modules))


def sampling_steps(config: Any) -> int | None:
    """Returns the diffusion steps of a sample of the topology; None where nothing is diffused."""
    field = METHODS[method_of(config)].steps
    return None if field is None else getattr(config, field)


def with_sampling_steps(config: Any, steps: int) -> Any:
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
