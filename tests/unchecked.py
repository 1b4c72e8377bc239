"""Reads or draws much at once without checking the types of every call, as other tests do."""

from collections.abc import Generator
from contextlib import contextmanager

from jaxtyping import config


@contextmanager
def unchecked() -> Generator[None]:
    """Switches off the checks of types, which take many times as long as a short function."""
    config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        config.update("jaxtyping_disable", False)
