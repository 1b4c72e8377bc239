"""Weights in one npz file: parameters by path, statistics, and the configuration as JSON.

The file describes itself: numpy alone can read it, and no pickle is involved.
"""

import dataclasses
import functools
from collections.abc import Iterator
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sg3d_jax.fill.protocol import Params
from sg3d_jax.infer.lanes import Model
from sg3d_jax.io.archive import read_arrays
from sg3d_jax.io.files import parsed, replacing
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.padding import Capacity, pad
from sg3d_jax.train import DEFAULT_WEIGHTS
from sg3d_jax.train.card import Card, card_from_json, card_to_json
from sg3d_jax.train.config import Config, check_growth, from_dict, to_json
from sg3d_jax.train.methods import (
    METHODS,
    Measured,
    build_model,
    params_of,
    with_sampling_steps,
)
from sg3d_jax.train.upgrade import FORMAT_2, upgraded
from sg3d_jax.train.values import check_type, hints_of

FORMAT = "sg3d_jax weights 3"
TEXTS = ("format", "config", "card")
ARRAYS = ("statistics/", "params/")  # what the names of arrays begin with


class Trained(NamedTuple):
    """A model with its parameters, ready to complete graphs."""

    model: Model  # hashable, ready to jit with
    params: Params  # nested arrays
    config: Config  # of the run that made them
    statistics: Measured  # of its training set
    name: str  # as it was asked for
    card: Card | None = None  # what it was trained on, and how well it does; None if nobody said


def save_weights(
    path: Path, config: Config, statistics: Measured, params: Params, card: Card | None = None
) -> Path:
    """Writes weights to an npz file, under a temporary name first."""
    leaves = {**dict(_flat(statistics, "statistics")), **dict(_flat(params, "params"))}
    content: dict[str, Any] = {name: np.asarray(leaf) for name, leaf in leaves.items()}
    content |= {} if card is None else {"card": card_to_json(card)}
    with replacing(path) as temporary:
        np.savez_compressed(temporary, format=FORMAT, config=to_json(config), **content)
    return path


def pack_weights(weights: Path, folder: Path) -> Path:
    """Writes the weights of a run as they come with the package: small, and under their name.

    Parameters are rounded to half precision, 11 bits: half the size.

    Args:
      weights: an npz file of `save_weights`.
      folder: where METHOD-DATASET.npz goes.

    Returns:
      The path of the file.

    Raises:
      ValueError: no sound weights file.
    """
    trained = load_weights(weights)
    data, label = trained.config.data, trained.config.data.label
    if data.title is None:
        data = dataclasses.replace(data, name=label)
    config = dataclasses.replace(trained.config, data=data)
    rounded = jax.tree.map(lambda leaf: leaf.astype(jnp.float16), trained.params)
    path = folder / f"{config.method}-{label}.npz"
    return save_weights(path, config, trained.statistics, rounded, trained.card)


def names() -> list[str]:
    """Returns the names of the weights that come with the package."""
    folder = resources.files("sg3d_jax") / "pretrained"
    return sorted(file.name[:-4] for file in folder.iterdir() if file.name.endswith(".npz"))


def load_weights(name_or_path: str | Path = DEFAULT_WEIGHTS) -> Trained:
    """Loads weights by name, or from a file.

    Args:
      name_or_path: one of `names()`, such as "fd4-s-f", or the path of an npz file; by default the
        weights for scenes of every kind.

    Raises:
      ValueError: neither a known name nor a sound weights file.
    """
    name = str(name_or_path)
    if name in names():
        with resources.as_file(resources.files("sg3d_jax") / "pretrained" / f"{name}.npz") as path:
            return _read(path, name)
    if Path(name).is_file():
        return _read(Path(name), name)
    close = get_close_matches(name, names(), n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise ValueError(
        f"unknown weights {name!r}, expected the path of an npz file or one of "
        f"{', '.join(names())}{hint}"
    )


def with_diffusion_steps(trained: Trained, steps: int | None) -> Trained:
    """Returns the same weights, sampled with another number of diffusion steps of the topology.

    Args:
      trained: of `load_weights`.
      steps: None for those that they have.

    Raises:
      ValueError: not in 1..S of the trained schedule, or a method that does not diffuse.
    """
    if steps is None:
        return trained
    model = with_sampling_steps(trained.config.model, steps)
    config = dataclasses.replace(trained.config, model=model)
    built = build_model(model, config.flagg, trained.statistics, config.ontology)
    return trained._replace(model=built, config=config)


def _read(path: Path, name: str) -> Trained:
    """Reads one weights file; of a file of the user's, every parameter is looked at."""
    arrays = read_arrays(path, lambda name: name in TEXTS or name.startswith(ARRAYS))
    try:
        about = parsed(str(arrays["config"]), "config")
        if str(arrays["format"]) == FORMAT_2:
            arrays, about = upgraded(arrays, about)
        elif str(arrays["format"]) != FORMAT:
            raise ValueError
        method = METHODS.get(about.get("method", Config().method))
        statistics: Any = None if method is None else _statistics(method.statistics, arrays)
        card = card_from_json(str(arrays["card"])) if "card" in arrays else None
    except Exception as error:
        expected = "a weights file of this version of sg3d_jax"
        raise ValueError(f"{path}: not {expected}") from error
    try:
        config = from_dict(about)
        check_growth(config)
        _check_card(card)
        _check_statistics(statistics, config)
        model = build_model(config.model, config.flagg, statistics, config.ontology)
        if name not in names():
            _check_params(arrays, model)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    params = params_of(config.model, _nested(arrays, "params/"))
    return Trained(model, params, config, statistics, name, card)


def _statistics(kind: type[Measured], arrays: dict[str, np.ndarray]) -> Measured:
    """Returns statistics as plain numbers."""
    values: dict[str, Any] = dict(getattr(kind, "_field_defaults", {}))  # of what came later
    for field in kind._fields:
        if field in values and f"statistics/{field}" not in arrays:
            continue
        value = arrays[f"statistics/{field}"].tolist()
        values[field] = tuple(value) if isinstance(value, list) else value
    return kind(**values)


def _check_statistics(statistics: Any, config: Config) -> None:
    """Refuses statistics that are no numbers, or of other concepts."""
    for field, value in statistics._asdict().items():
        check_type(f"statistics/{field}", value, hints_of(statistics)[field])
        lengths = {"label": config.ontology.num_concepts, "block_edge": 2, "cross_edge": 2}
        if isinstance(value, tuple) and len(value) != lengths[field]:
            problem = f"has {len(value)} numbers, expected {lengths[field]}"
            raise ValueError(f"statistics/{field} {problem}")


def _check_card(card: Card | None) -> None:
    """Refuses a card that does not say what cards say."""
    if card is None:
        return
    for part in (card, *card.scores):
        for field, hint in hints_of(part).items():
            check_type(f"{field} of the card", getattr(part, field), hint)


def _check_params(arrays: dict[str, np.ndarray], model: Any) -> None:
    """Refuses parameters that are not those of a model, or no numbers.

    Raises:
      ValueError: one sentence that names the parameter.
    """
    held = {name: array for name, array in arrays.items() if name.startswith("params/")}
    expected = _shapes(model)
    for name in sorted(held.keys() ^ expected.keys()):
        problem = "is unknown, expected none" if name in held else "is missing, expected"
        raise ValueError(f"parameter {name} {problem} of its configuration")
    for name, array in held.items():
        if array.shape != expected[name] or array.dtype not in (np.float16, np.float32):
            found, wanted = f"{array.dtype}{list(array.shape)}", f"float32{list(expected[name])}"
            raise ValueError(f"parameter {name} is {found}, expected {wanted}")
        if not np.isfinite(array).all():
            raise ValueError(f"parameter {name} is not finite, expected finite numbers")


@functools.lru_cache
def _shapes(model: Any) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of the parameters of a model, by their names in a file.

    Raises:
      ValueError: there is no such model.
    """
    nothing = make_graph([], np.zeros((0, 3)), ontology=model.ontology)
    graph = pad(nothing, Capacity(nodes=16, edges=16))
    try:
        shapes = jax.eval_shape(model.init, jax.random.key(0), graph)
    except Exception as error:  # whatever a network of impossible sizes runs into
        raise ValueError("its configuration is of no model, expected sizes that fit") from error
    return {name: leaf.shape for name, leaf in _flat(shapes, "params")}


def _flat(tree: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yields the leaves of dictionaries and NamedTuples with their paths, separated by slashes."""
    if tree is None:
        return
    branches = tree._asdict() if hasattr(tree, "_asdict") else tree
    if not isinstance(branches, dict):
        yield path, branches
        return
    for name, branch in branches.items():
        yield from _flat(branch, f"{path}/{name}")


def _nested(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, Any]:
    """Rebuilds nested dictionaries from the paths that `_flat` gave; half precision is widened."""
    tree: dict[str, Any] = {}
    for path, array in arrays.items():
        if path.startswith(prefix):
            *folders, leaf = path[len(prefix) :].split("/")
            place = tree
            for folder in folders:
                place = place.setdefault(folder, {})
            half = array.dtype == np.float16  # widened here: JAX would compile that for each shape
            place[leaf] = jnp.asarray(array.astype(np.float32) if half else array)
    return tree
