"""Pickles read as data: a stack machine for those words of the pickle format that build values.

A pickle is a program, and Python's own unpickler runs it. Restricted by `find_class` it still calls
what the pickle says to call, sizes its tables by numbers that the pickle declares, and overflows
the C stack on a deeply nested key. Here nothing is called (`io.pickle_words`): whoever knows what a
pickle ought to hold is told what it asks for.

A pickle that is long describes many things, one after the other. A caller can make its own of each
as soon as that is whole (`made`), and the memo keeps only what the pickle recalls later on, so what
is done with goes. What is there is counted word by word, and now and then afresh (`io.memory`).
"""

import struct
from collections.abc import Callable, Set
from contextlib import suppress
from io import BytesIO
from typing import Any, Final

from sg3d_jax.io.memory import Memory
from sg3d_jax.io.pickle_words import (
    ENDS,
    OFTEN,
    REMEMBERING,
    STOP,
    WORDS,
    Asked,
    Machine,
    Name,
    RefusedError,
    recall,
)

MAX_MEMORY: Final = 1_200_000_000  # bytes; the largest published set needs about half as many
# Words that `_recalls` need not look at, with their argument; 0 for others.
_SKIPPED: Final = tuple(0 if word is recall or size < 0 else 1 + size for word, size, _ in WORDS)


def _as_it_is(asked: Asked) -> tuple[Any, int]:
    return asked.state, 0


def read_pickle(
    data: bytes,
    admitted: Set[Name],
    where: str,
    expected: str,
    most: int = MAX_MEMORY,
    made: Callable[[Asked], tuple[Any, int]] = _as_it_is,
) -> Any:
    """Returns what a pickle describes, without making any of its objects.

    Args:
      data: one pickle, of protocol 0 to 5.
      admitted: the names that it may ask for.
      where: what an error starts with, such as "m-f.zip".
      expected: what the pickle ought to hold, for the error.
      most: bytes that the pickle and what it describes may take at once.
      made: called with each object when it has its state; returns what to keep in place of that,
        and how many bytes this takes. It refers to nothing of the state.

    Returns:
      Plain values, `Asked` for each object and `Name` for each class or function. Sets come as
      lists, bytearrays as bytes. Containers may contain themselves.

    Raises:
      ValueError: the pickle asks for something else, is cut short or too large, or is none.
    """
    try:
        remembered = _most_remembered(data)
        memory = Memory(most - len(data) - remembered)
        machine = Machine(admitted, memory, _recalls(data, remembered), made)
        end = _run(machine, data, most)
        (value,) = machine.stack
    except RefusedError as error:
        raise ValueError(f"{where}: the pickle {error}, expected {expected}") from None
    except MemoryError:
        problem = "describes more than fits into memory"
        raise ValueError(f"{where}: the pickle {problem}, expected {expected}") from None
    except (ValueError, LookupError, TypeError, struct.error) as error:
        problem = "is cut short, broken or no pickle"
        raise ValueError(f"{where}: the file {problem}, expected {expected}") from error
    if end != len(data):
        raise ValueError(f"{where}: the file goes on after the pickle, expected {expected}")
    return value


def _run(machine: Machine, data: bytes, most: int) -> int:
    """Reads words up to STOP; returns where the next byte is.

    Args:
      machine: in its first state.
      data: the pickle.
      most: bytes of memory, of which the share that may be used between two looks depends.
    """
    place = looked = weighed = 0
    while (code := data[place]) != STOP:
        word, size, read = WORDS[code]
        place += 1
        if not size:
            word(machine, None)
        elif size == 1:
            word(machine, data[place])
            place += 1
        elif size > 0:
            word(machine, read(data, place)[0])
            place += size
        else:
            end = ENDS[code](data, place)
            word(machine, read(BytesIO(data[place:end])))
            place = end
        if place > looked:
            machine.check()
            looked = place + most // 2**14
            if place - weighed > most // 2**6:
                machine.weigh()
                weighed = place
    machine.check()
    return place + 1


def _most_remembered(data: bytes) -> int:
    """Returns at least how many values a pickle remembers."""
    return sum(data.count(code) for code, (word, _, _) in enumerate(WORDS) if word in REMEMBERING)


def _recalls(data: bytes, remembered: int) -> bytearray:
    """Counts how often a pickle recalls each of so many values, up to `OFTEN` times.

    What comes after a broken word is not counted: the machine will not get there.
    """
    recalls, place = bytearray(remembered), 0
    with suppress(ValueError, LookupError, struct.error, RefusedError):
        while (code := data[place]) != STOP:
            if skipped := _SKIPPED[code]:
                place += skipped
                continue
            word, size, read = WORDS[code]
            place += 1
            end = place + size if size >= 0 else ENDS[code](data, place)
            if word is recall:
                index = read(data, place)[0] if size >= 0 else read(BytesIO(data[place:end]))
                if recalls[index] < OFTEN:
                    recalls[index] += 1
            place = end
    return recalls
