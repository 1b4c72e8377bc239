"""The configuration of a run: every number that its result depends on."""

import dataclasses
import json
from typing import Any

from sg3d_jax.fill.fd4 import FD4Config
from sg3d_jax.flagg.corrupt import CorruptionConfig
from sg3d_jax.flagg.step import FlaggConfig


@dataclasses.dataclass(frozen=True)
class DataConfig:
    """Which graphs are trained on."""

    name: str = "s-f-square"  # a data set by name, or the path of an npz file
    num_graphs: int | None = None  # None: as many as the paper has
    seed: int = 0  # of the generator
    split_seed: int = 0


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
    flagg: FlaggConfig = FlaggConfig()
    fill: FD4Config = FD4Config()
    optimiser: OptimiserConfig = OptimiserConfig()
    seed: int = 0  # of the parameters and of every draw in training
    steps: int = 20_000
    batch: int = 32  # graphs a step
    steps_per_call: int = 50  # scanned in one compiled call
    capacities: tuple[int, ...] = (24, 48, 96)  # node buckets of the training set
    validate_every: int = 2_500
    validation_graphs: int = 64
    validation_seed: int = 0


def to_dict(config: Config) -> dict[str, Any]:
    """Returns the configuration as nested plain types."""
    return dataclasses.asdict(config)


def to_json(config: Config) -> str:
    """Returns the configuration as JSON text."""
    return json.dumps(to_dict(config), indent=2)


def from_dict(values: dict[str, Any]) -> Config:
    """Rebuilds a configuration from `to_dict`, or from its JSON.

    Raises:
      TypeError: a field is unknown.
    """
    flagg = dict(values["flagg"])
    flagg["corruption"] = CorruptionConfig(**flagg["corruption"])
    flagg["coins"], flagg["layers"] = tuple(flagg["coins"]), tuple(flagg["layers"])
    rest = {key: value for key, value in values.items() if not isinstance(value, dict)}
    rest["capacities"] = tuple(rest["capacities"])
    return Config(
        data=DataConfig(**values["data"]),
        flagg=FlaggConfig(**flagg),
        fill=FD4Config(**values["fill"]),
        optimiser=OptimiserConfig(**values["optimiser"]),
        **rest,
    )
