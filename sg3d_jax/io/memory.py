"""How much memory values take, counted: what is refused does not depend on the machine."""

import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from types import MappingProxyType
from typing import Any, Final

MAX_WEIGHED: Final = 1_000_000  # values; more take long to count, and counting them takes memory
ALIGNMENT: Final = 16  # bytes, of every block


class Memory:
    """The blocks of memory that are taken, by their size, and what is left of a budget.

    A block that is given back makes room for blocks of the same size only: an allocator can give
    a page of small blocks to no other size, and a hole to nothing larger, while one beside is in
    use. So no order of sizes takes more than the sum of what each of them took at its most.
    """

    def __init__(self, room: int) -> None:
        """Begins with nothing but a budget, of bytes."""
        self.room = room  # bytes
        self.check()
        self.held: Counter[int] = Counter()  # blocks of each size; most there were at a weighing
        self.free: defaultdict[int, int] = defaultdict(int)  # of these; below zero: taken beyond

    def check(self, size: int = 0) -> None:
        """Raises MemoryError if fewer bytes than these are left."""
        if self.room < size:
            raise MemoryError

    def take(self, size: int) -> None:
        """Takes a block of some bytes."""
        free = self.free[size] = self.free[size] - 1
        if free < 0:
            self.room -= -(-size // ALIGNMENT) * ALIGNMENT

    def take_table(self, container: list[Any] | dict[Any, Any]) -> None:
        """Takes what a list or a dict has beside its head."""
        self.take(sys.getsizeof(container) - _HEADS[type(container)])

    def free_all_but(self, used: Counter[int]) -> None:
        """Gives back what is no more in use."""
        for size, free in self.free.items():
            self.held[size] += max(-free, 0)
        left = {size: max(held - used[size], 0) for size, held in self.held.items()}
        self.free = defaultdict(int, left)


_HEADS: Final[Mapping[type, int]] = MappingProxyType(
    {kind: sys.getsizeof(kind()) for kind in (list, dict)}
)


def blocks(
    roots: Iterable[Any], parts: Mapping[type, Callable[[Any], tuple[Any, ...]]]
) -> Counter[int] | None:
    """Counts the blocks of all values that can be reached, by size; None if those are too many.

    What is in many containers counts many times, but containers count once.

    Args:
      roots: where to begin.
      parts: what is in objects that are no lists, tuples or dicts, by their class; others count as
        if nothing were in them.
    """
    used: Counter[int] = Counter()
    seen: set[int] = set()
    todo = [*roots]
    left = MAX_WEIGHED
    while todo:
        value = todo.pop()
        kind = type(value)
        if id(value) in seen:
            continue
        size, head = sys.getsizeof(value), _HEADS.get(kind, 0)
        used.update((head, size - head) if head else (size,))
        if kind is dict:
            number, inside = 2 * len(value), chain(value, value.values())
        elif kind is list or kind is tuple:
            number, inside = len(value), value
        elif kind in parts:
            inside = parts[kind](value)
            number = len(inside)
        else:
            continue
        left -= number
        if left < 0:
            return None
        seen.add(id(value))
        todo.extend(inside)
    return used
