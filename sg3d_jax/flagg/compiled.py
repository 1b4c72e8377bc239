"""How growing and training are compiled: quickly, in 32 bits, and keeping no memory of it."""

import ctypes
import functools
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, Final

import jax
import numpy as np

NARROW: Final = {np.dtype(np.float64): np.float32, np.dtype(np.int64): np.int32}


def quick_options(growing: bool = False) -> dict[str, int | bool] | None:
    """Returns options for programs of many small kernels; None where they do not apply.

    On a CPU, LLVM's first level of optimisation compiles growing and training in three quarters of
    the time of its third, and what it makes of them runs as fast. JAX 0.10 still has its older
    kernels, which compile in half the time.

    Args:
      growing: whether older kernels will do: growing runs as fast with them (cities 7 % slower),
        training would take a third longer.
    """
    if jax.default_backend() != "cpu" or jax.config.read("jax_disable_most_optimizations"):
        return None
    older = growing and jax.__version_info__ < (0, 11)
    return {"xla_backend_optimization_level": 1} | (
        {"xla_cpu_use_fusion_emitters": False} if older else {}
    )


@contextmanager
def own_types() -> Generator[None]:
    """Has JAX trace what is within in 32 bits and mix types, whatever its user has told it.

    What is drawn is then the same under `jax_enable_x64`, and masks may be multiplied under
    `jax_numpy_dtype_promotion=strict`.
    """
    with jax.enable_x64(False), jax.numpy_dtype_promotion("standard"):
        yield


def in_32_bits(tree: Any) -> Any:
    """Returns a tree of arrays whose wide numbers are float32 and int32; all others stay."""
    return jax.tree.map(lambda array: array.astype(NARROW.get(array.dtype, array.dtype)), tree)


def give_back_memory() -> None:
    """Returns to the system what a compiler has freed, and glibc would keep; elsewhere, nothing.

    After the buckets of cities that is a gigabyte, more than all that growing needs.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library, or none by this name
        ctypes.CDLL(None).malloc_trim(0)


class Compiled:
    """What grows, under `jax.jit` and in `own_types`.

    Its `quick_options` are known once JAX has a device.

    Whatever a jitted function has, such as `lower`, it has too. It is no part of another one.
    """

    def __init__(self, function: Callable[..., Any], static_argnames: Sequence[str] = ()) -> None:
        """Wraps a function; nothing is run."""

        @functools.wraps(function)
        def traced(*args: Any, **kwargs: Any) -> Any:
            with own_types():
                return function(*args, **kwargs)

        functools.update_wrapper(self, traced)
        self._static_argnames = static_argnames

    @functools.cached_property
    def _jitted(self) -> Any:
        return jax.jit(
            self.__wrapped__,
            static_argnames=self._static_argnames,
            compiler_options=quick_options(growing=True),
        )

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Runs the program."""
        return self._jitted(*args, **kwargs)

    def __getattr__(self, name: str) -> Any:
        """Returns what the jitted function has."""
        return getattr(self._jitted, name)
