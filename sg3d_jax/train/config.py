"""The configuration of a run: every number that its result depends on."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from sg3d_jax.fill.fd4 import FD4Config
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, Ontology, ontology_from_dict
from sg3d_jax.train.methods import METHODS, method_of
from sg3d_jax.train.values import check_type, check_values, hints_of

T = TypeVar("T")
NoOption = Annotated[T, tyro.conf.Fixed, tyro.conf.Suppress]  # said in a file, not at the shell


@dataclasses.dataclass(frozen=True)
class DataConfig:
    """Which graphs are trained on.

    Several data sets are joined by plus signs, each with its own number of graphs behind a colon,
    if not as many as usual: "s-f+g-c:1000+p-f.npz@robot". One that is named twice counts twice. The
    first so many graphs of a set are for the same parts as in the whole of it.
    """

    name: str = "s-f-square"  # a data set by name, the path of an npz file, or several
    num_graphs: int | None = None  # of each set; None: as many as the paper has
    seed: int = 0  # of the generator
    split_seed: int = 0
    views: int = 1  # trained on of each graph of a set that a robot sees, such as s-f@robot
    title: str | None = None  # what several sets together are called; None: their names

    @property
    def names(self) -> tuple[str, ...]:
        """The data sets that are mixed, with their numbers of graphs."""
        return tuple(self.name.split("+"))

    @property
    def parts(self) -> tuple["DataConfig", ...]:
        """The data sets that are mixed, one by one."""
        return tuple(self._part(name) for name in self.names)

    def _part(self, text: str) -> "DataConfig":
        base, at, seen = text.partition("@")
        name, colon, count = base.rpartition(":")
        if not (colon and count.isascii() and count.isdigit()):
            return dataclasses.replace(self, name=text)
        return dataclasses.replace(self, name=name + at + seen, num_graphs=int(count))

    def anew(self, number: int) -> "DataConfig":
        """The same sets, with all that is drawn of them drawn anew; as dealt as before.

        Args:
          number: of the draw; 0 for the first.
        """
        return dataclasses.replace(self, seed=self.seed + (number << 32))  # beyond seeds of users

    @property
    def label(self) -> str:
        """The name of the data, also where they are a file such as runs/p-f.npz."""
        return self.title or "+".join(Path(name).stem for name in self.names)


@dataclasses.dataclass(frozen=True)
class OptimiserConfig:
    """AdamW with warm-up and cosine decay, clipping, and an average of the parameters."""

    learning_rate: float = 1e-3
    warmup_steps: int = 500
    weight_decay: float = 1e-4
    clip_norm: float = 1.0
    ema_decay: float = 0.999


@dataclasses.dataclass(frozen=True)
class Config:
    """One run. Together with the code it determines every parameter, bit for bit."""

    data: DataConfig = DataConfig()
    ontology: NoOption[Ontology] = PAPER_ONTOLOGY  # the concepts of the data
    model: Any = FD4Config()  # the numbers of the model: the configuration of a method
    flagg: FlaggConfig | None = FlaggConfig()  # how it grows; None for models that do not
    optimiser: OptimiserConfig = OptimiserConfig()
    initial: str | None = None  # weights to start from, by name or path; None for a random draw
    seed: int = 0  # of the parameters and of every draw in training
    steps: int = 20_000
    batch: int = 32  # graphs,
    batch_nodes: int = 8192  # but at most so many slots of nodes, so that large graphs fit
    accumulate: int = 1  # batches a step, one after another or each on a device of its own
    steps_per_call: int = 50  # scanned in one compiled call
    capacities: tuple[int, ...] = (24, 48, 96)  # node buckets of the training set
    fresh_every: int | None = None  # steps after which the training data are drawn anew, if ever
    validate_every: int = 2_500
    validation_graphs: int = 64
    validation_seed: int = 0

    @property
    def method(self) -> str:
        """The name of the method that is trained."""
        return method_of(self.model)


def to_dict(config: Config) -> dict[str, Any]:
    """Returns the configuration as nested plain types, led by the name of its method."""
    return {"method": config.method, **dataclasses.asdict(config)}


def to_json(config: Config) -> str:
    """Returns the configuration as JSON text."""
    return json.dumps(to_dict(config), indent=2)


def from_dict(values: Any) -> Config:
    """Rebuilds a configuration from `to_dict`, or from its JSON.

    Raises:
      ValueError: the method or a field is unknown, or a field has a value that none can have.
    """
    if not isinstance(values, dict):
        raise ValueError(f"the configuration is {values!r:.40}, expected an object")
    fields = dict(values)
    method = fields.pop("method", Config().method)
    if not isinstance(method, str) or method not in METHODS:
        raise ValueError(
            f"unknown method {method!r}, expected one of {', '.join(METHODS)}, or one of your own: "
            "run the file that registers it first (--code FILE)"
        )
    ontology = ontology_from_dict(fields.pop("ontology", None))
    default = Config(ontology=ontology, model=METHODS[method].config())
    config = _rebuild(default, fields)
    check_values(config)
    return config


def check(config: Config) -> None:
    """Refuses a configuration that no run can follow.

    Raises:
      ValueError: one sentence that names the field and what was expected.
    """
    check_values(config)
    for name in ("steps", "fresh_every", "validate_every"):
        value, unit = getattr(config, name), config.steps_per_call
        if value is not None and value % unit:
            raise ValueError(f"{name} is {value}, expected a multiple of steps_per_call, {unit}")
    check_growth(config)
    warmup, capacities = config.optimiser.warmup_steps, config.capacities
    if not 0 <= warmup < config.steps:
        raise ValueError(f"optimiser.warmup_steps is {warmup}, expected 0 to {config.steps - 1}")
    if not capacities or list(capacities) != sorted(set(capacities)):
        raise ValueError(f"capacities is {list(capacities)}, expected increasing node counts")


def check_growth(config: Config) -> None:
    """Refuses a configuration that says how a model grows that does not, or does not say how.

    Raises:
      ValueError: one sentence.
    """
    grows = METHODS[config.method].grows
    if grows != (config.flagg is not None):
        expected = "how it grows" if grows else "None, because it does not grow"
        raise ValueError(f"flagg of {config.method} is {config.flagg}, expected {expected}")


def _rebuild(default: Any, values: Any) -> Any:
    """Returns a dataclass with the given fields, and its dataclasses likewise; lists are tuples."""
    if not isinstance(values, dict):
        raise ValueError(f"{type(default).__name__} is {values!r:.40}, expected an object")
    fields = {field.name: getattr(default, field.name) for field in dataclasses.fields(default)}
    unknown = sorted(values.keys() - fields.keys())
    if unknown:
        raise ValueError(
            f"unknown field {unknown[0]!r} of {type(default).__name__}, expected one of "
            f"{', '.join(fields)}"
        )
    chosen = {
        name: _rebuild(fields[name], value)
        if dataclasses.is_dataclass(fields[name]) and value is not None
        else (tuple(value) if isinstance(value, list) else value)
        for name, value in values.items()
    }
    for name, value in chosen.items():
        check_type(f"{type(default).__name__}.{name}", value, hints_of(default)[name])
    return dataclasses.replace(default, **chosen)
