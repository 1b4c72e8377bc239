"""How growing and training are compiled: quickly, and without keeping the memory of it."""

import ctypes
import functools
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import jax


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


def give_back_memory() -> None:
    """Returns to the system what a compiler has freed, and glibc would keep; elsewhere, nothing.

    After the buckets of cities that is a gigabyte, more than all that growing needs.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library, or none by this name
        ctypes.CDLL(None).malloc_trim(0)


class Compiled:
    """What grows, under `jax.jit` with `quick_options`, which are known once JAX has a device.

    Whatever a jitted function has, such as `lower`, it has too. It is no part of another one.
    """

    def __init__(self, function: Callable[..., Any], static_argnames: Sequence[str] = ()) -> None:
        """Wraps a function; nothing is run."""
        functools.update_wrapper(self, function)
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
