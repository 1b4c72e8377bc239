"""How far a data set has come while it is made, for whoever wants to see it.

Results do not depend on it; by default nobody watches.
"""

from collections.abc import Callable, Iterable, Sequence
from contextvars import ContextVar
from typing import Any, Final, TypeVar

T = TypeVar("T")

# Takes what is gone through, and what it is called; gives it out again, one by one.
watch: Final[ContextVar[Callable[[Sequence[Any], str], Iterable[Any]]]] = ContextVar(
    "watch", default=lambda items, noun: items
)


def watched(items: Sequence[T], noun: str) -> Iterable[T]:
    """Returns items as they are, for a loop that may take long.

    Args:
      items: what is gone through.
      noun: what they are called, plural.
    """
    return watch.get()(items, noun)
