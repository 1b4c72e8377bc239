"""Names such as fd4-s-f: a method on a data set, and the configuration that trains it."""

import dataclasses
import runpy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from sg3d_jax.baselines import rand
from sg3d_jax.baselines.rand import RandModel
from sg3d_jax.data.registry import DATASETS
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train.config import Config, DataConfig
from sg3d_jax.train.methods import METHODS

# Methods that are fitted in an instant: sized as the text of the paper says, and as its published
# pictures and scores are.
BASELINES: Final[Mapping[str, Callable[[Sequence[SceneGraph], str], RandModel]]] = MappingProxyType(
    {"rand": lambda graphs, name: rand.fit(graphs), "rand-sized": rand.fit_sized}
)
PACKAGE: Final = Path(__file__).parents[1]


class Named(NamedTuple):
    """What a name stands for."""

    method: str  # such as fd4
    data: str  # a data set by name


def parse(name: str) -> Named | None:
    """Returns method and data set of a name; None if it is no name of this kind."""
    pairs = (Named(method, name[len(method) + 1 :]) for method in (*BASELINES, *METHODS))
    return next((pair for pair in pairs if name == "-".join(pair) and pair.data in DATASETS), None)


def find_config(name_or_path: str) -> Config:
    """Returns the configuration of a run.

    Args:
      name_or_path: a Python file that defines CONFIG; or METHOD-DATASET, which is the configuration
        of that name if there is one, such as midi-general, else that of the method's home with
        another data set.

    Raises:
      ValueError: there is no such file or name, or there is nothing to train.
    """
    path = Path(name_or_path)
    if path.suffix:
        return _read(path)
    own = _folder() / f"{name_or_path.replace('-', '_')}.py"
    if own.is_file():
        return _read(own)
    named = parse(name_or_path)
    if named is None:
        raise ValueError(
            f"{name_or_path}: neither a configuration file nor METHOD-DATASET, expected one of "
            f"{', '.join(METHODS)} with a data set, such as fd4-s-f"
        )
    if named.method not in METHODS:
        raise ValueError(
            f"{named.method} has nothing to train, it is fitted by `sg3d evaluate {name_or_path}`"
        )
    home = METHODS[named.method].home
    if home is None:
        raise ValueError(f"{name_or_path}: {named.method} has no configuration, expected its file")
    config = _read(_folder() / f"{named.method}-{home}.py".replace("-", "_"))
    return dataclasses.replace(config, data=DataConfig(name=named.data))


def _folder() -> Path:
    """Returns where configurations are: in an installed package, or beside it in a clone."""
    installed = PACKAGE / "configs"
    return installed if installed.is_dir() else PACKAGE.parent / "configs"


def _read(path: Path) -> Config:
    """Runs a configuration file and returns its CONFIG."""
    if not path.is_file():
        raise ValueError(f"{path}: no such configuration file; configs/ holds some")
    config = runpy.run_path(str(path)).get("CONFIG")
    if not isinstance(config, Config):
        raise ValueError(f"{path}: expected a variable CONFIG of type sg3d_jax.train.config.Config")
    return config
