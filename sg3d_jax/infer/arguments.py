"""What a caller gives beside scenes: whole numbers, and the parameters of a model."""

import operator
from typing import Any

import jax
import numpy as np

from sg3d_jax.flagg.step import Flagg, check_grows
from sg3d_jax.scene.graph import SceneGraph


def whole_number(name: str, value: Any, least: int = 1, most: int | None = None) -> int:
    """Returns a whole number, which may be one of numpy or JAX, as Python's.

    Args:
      name: what a refusal calls it.
      value: not yet trusted.
      least: the least that is allowed.
      most: the most; None for any.

    Raises:
      ValueError: it is none, or out of range.
    """
    expected = f"at least {least}" if most is None else f"{least} to {most}"
    try:
        number = operator.index(value)
    except TypeError as error:
        [held, *_] = f"{value!r:.40}".splitlines()
        held = f"{held}, a {type(value).__name__}"
        raise ValueError(f"{name} is {held}, expected a whole number, {expected}") from error
    if number < least or (most is not None and number > most):
        raise ValueError(f"{name} is {number}, expected {expected}")
    return number


def check_params(model: Any, params: Any) -> None:
    """Refuses parameters that cannot be those of a model, or are not finite.

    Their shapes are looked at only where completing fails (`check_shapes`), as that takes a second.

    Args:
      model: of any method.
      params: not yet trusted; of any floating type.

    Raises:
      ValueError: one sentence that names the first parameter that is wrong.
    """
    if isinstance(model, Flagg):
        check_grows(model, params)
    elif params is None:
        raise ValueError("the parameters are None, expected those of the model")
    check_finite(params)


def check_finite(params: Any) -> None:
    """Refuses parameters that are not finite.

    Args:
      params: of any floating type.

    Raises:
      ValueError: one sentence that names the first that is not.
    """
    finite = [np.isfinite(leaf).all() for leaf in jax.device_get(jax.tree.leaves(params))]
    if not all(finite):
        name = _name(jax.tree.leaves_with_path(params)[finite.index(False)][0])
        raise ValueError(f"the parameters {name} are not all finite, expected finite ones")


def check_shapes(model: Any, params: Any, graph: SceneGraph) -> None:
    """Refuses parameters that are not as many, named and shaped as those of a model.

    Args:
      model: of any method.
      params: not yet trusted.
      graph: padded, any.

    Raises:
      ValueError: one sentence that names the first parameter that differs.
    """
    expected = _shapes(jax.eval_shape(model.init, jax.random.key(0), graph))
    held = _shapes(params)
    for name in expected | held:
        if held.get(name) != expected.get(name):
            problem = f"the parameters {name} have the shape {held.get(name)}"
            raise ValueError(f"{problem}, expected {expected.get(name)}, as of this model")


def _shapes(params: Any) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of parameters by name."""
    return {_name(path): np.shape(leaf) for path, leaf in jax.tree.leaves_with_path(params)}


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator="/")
