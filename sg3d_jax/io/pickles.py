"""Pickles read as data: a stack machine for those words of the pickle format that build values.

A pickle is a program, and Python's own unpickler runs it. Restricted by `find_class` it still calls
what the pickle says to call, sizes its tables by numbers that the pickle declares, and overflows
the C stack on a deeply nested key. Here nothing is called: what a pickle asks to be made is written
down as an `Asked`, for whoever knows what it ought to hold, and a name that is not on the caller's
list, or a word that plain data do without, is refused.

A pickle that is long describes many things, one after the other. A caller can make its own of each
as soon as that is whole (`made`), and the memo keeps only what the pickle recalls later on, so what
is done with goes. What is there is counted word by word, and now and then afresh (`io.memory`).
"""

import gc
import pickletools
import struct
import sys
from collections.abc import Callable, Mapping, Set
from contextlib import suppress
from io import BytesIO
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from sg3d_jax.io.memory import Memory, blocks

MAX_BITS: Final = 64  # longer integers name no node, and Python refuses to print some of them
MAX_STACK: Final = 1_000_000  # values at once; picklers put a thousand there before they use them
MAX_VALUE: Final = 2**22  # bytes of a text, a number or an array; a text may take seven times that
MAX_MEMORY: Final = 1_200_000_000  # bytes; the largest published set needs about half as many
OFTEN: Final = 255  # recalls that are no more counted


class Name(NamedTuple):
    """A module and what the pickle wants of it; it is never looked up."""

    module: str
    name: str

    def __repr__(self) -> str:
        """Returns the dotted name, on one line whatever it holds."""
        return ascii(f"{self.module}.{self.name}")[1:-1]


class Asked:
    """An object that a pickle asks for: its class or function, arguments and state; inert."""

    __slots__ = ("arguments", "name", "state")

    def __init__(self, name: Name, arguments: tuple[Any, ...]) -> None:
        """Writes the request down; the state comes later, if at all."""
        self.name = name
        self.arguments = arguments
        self.state: Any = None

    def __repr__(self) -> str:
        """Returns the name in brackets: arguments may be endless."""
        return f"<{self.name!r}>"


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
        machine = _Machine(admitted, memory, _recalls(data, remembered), made)
        end = _run(machine, data, most)
        (value,) = machine.stack
    except _RefusedError as error:
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


class _RefusedError(Exception):
    """What the pickle does that it must not."""


class _Machine:
    """The stack, where its marks are, and the memo of what is used again."""

    def __init__(
        self,
        admitted: Set[Name],
        memory: Memory,
        recalls: bytearray,
        made: Callable[[Asked], tuple[Any, int]],
    ) -> None:
        self.admitted = {name: name for name in admitted}
        self.memory = memory
        self.recalls = recalls  # how often each value will be recalled from the memo
        self.made = made
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}
        self.remembered = 0

    def push(self, value: Any) -> None:
        """Pushes a new value."""
        self.stack.append(value)
        self.memory.take(sys.getsizeof(value))

    def pop(self, kind: type) -> Any:
        """Pops a value that has to be of one type."""
        return _of(kind, self.stack.pop())

    def pop_to_mark(self) -> list[Any]:
        """Pops all values above the last mark, and the mark."""
        start = self.marks.pop()
        values = self.stack[start:]
        del self.stack[start:]
        return values

    def fill(self, container: dict[Any, Any] | list[Any], items: list[Any]) -> None:
        """Puts items, or keys and values in turn, into a container."""
        before = sys.getsizeof(container)
        self.memory.check(2 * before)  # for a moment, the old table is there and one twice as large
        _mapping(items, container) if isinstance(container, dict) else container.extend(items)
        if sys.getsizeof(container) != before:
            self.memory.take_table(container)

    def check(self) -> None:
        """Refuses more than fits into memory, or onto the stack."""
        self.memory.check()
        if len(self.stack) > MAX_STACK:
            raise _RefusedError(f"has more than {MAX_STACK} values on its stack")

    def weigh(self) -> None:
        """Gives back the memory of what can no more be reached."""
        gc.collect()
        used = blocks((self.stack, self.memo), {Asked: _parts})
        if used is not None:
            self.memory.free_all_but(used)


def _parts(asked: Asked) -> tuple[Any, ...]:
    return asked.arguments, asked.state


_Word = Callable[[_Machine, Any], None]


def _run(machine: _Machine, data: bytes, most: int) -> int:
    """Reads words up to STOP; returns where the next byte is.

    Args:
      machine: in its first state.
      data: the pickle.
      most: bytes of memory, of which the share that may be used between two looks depends.
    """
    place = looked = weighed = 0
    while (code := data[place]) != _STOP:
        word, size, read = _WORDS[code]
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
            end = _ENDS[code](data, place)
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
    return sum(data.count(code) for code, (word, _, _) in enumerate(_WORDS) if word in _REMEMBERING)


def _recalls(data: bytes, remembered: int) -> bytearray:
    """Counts how often a pickle recalls each of so many values, up to `OFTEN` times.

    What comes after a broken word is not counted: the machine will not get there.
    """
    recalls, place = bytearray(remembered), 0
    with suppress(ValueError, LookupError, struct.error, _RefusedError):
        while (code := data[place]) != _STOP:
            if skipped := _SKIPPED[code]:
                place += skipped
                continue
            word, size, read = _WORDS[code]
            place += 1
            end = place + size if size >= 0 else _ENDS[code](data, place)
            if word is _recall:
                index = read(data, place)[0] if size >= 0 else read(BytesIO(data[place:end]))
                if recalls[index] < OFTEN:
                    recalls[index] += 1
            place = end
    return recalls


def _of(kind: type, value: Any) -> Any:
    if type(value) is not kind:
        raise TypeError(f"{type(value).__name__} is not {kind.__name__}")
    return value


def _constant(machine: _Machine, argument: Any) -> None:
    machine.push(argument)


def _shared(machine: _Machine, argument: Any) -> None:
    machine.stack.append(argument)  # what Python has once, however often it is asked for


def _integer(machine: _Machine, argument: int) -> None:
    if argument.bit_length() > MAX_BITS:
        raise _RefusedError(f"holds an integer of {argument.bit_length()} bits")
    machine.push(argument)


def _new(make: Callable[[], Any]) -> _Word:
    return lambda machine, _: machine.push(make())


def _filled(make: Callable[[], Any]) -> _Word:
    def word(machine: _Machine, _: Any) -> None:
        items = machine.pop_to_mark()
        machine.push(make())
        machine.fill(machine.stack[-1], items)

    return word


def _bytes(machine: _Machine, argument: bytearray) -> None:
    machine.push(bytes(argument))


def _tuple_to_mark(machine: _Machine, _: Any) -> None:
    machine.push(tuple(machine.pop_to_mark()))


def _tuple(size: int) -> _Word:
    def word(machine: _Machine, _: Any) -> None:
        values = [machine.stack.pop() for _ in range(size)]
        machine.push(tuple(reversed(values)))

    return word


def _mapping(items: list[Any], mapping: dict[Any, Any]) -> None:
    for key, value in zip(items[::2], items[1::2], strict=True):
        if isinstance(key, tuple):  # hashing one that is nested deeply overflows the C stack
            raise _RefusedError("has a key that is a tuple")
        mapping[key] = value


def _set_items(machine: _Machine, _: Any) -> None:
    items = machine.pop_to_mark()
    machine.fill(_of(dict, machine.stack[-1]), items)


def _set_item(machine: _Machine, _: Any) -> None:
    value, key = machine.stack.pop(), machine.stack.pop()
    machine.fill(_of(dict, machine.stack[-1]), [key, value])


def _extend(machine: _Machine, _: Any) -> None:
    items = machine.pop_to_mark()
    machine.fill(_of(list, machine.stack[-1]), items)


def _append(machine: _Machine, _: Any) -> None:
    item = machine.stack.pop()
    machine.fill(_of(list, machine.stack[-1]), [item])


def _mark(machine: _Machine, _: Any) -> None:
    if len(machine.marks) == MAX_STACK:
        raise _RefusedError(f"has more than {MAX_STACK} marks on its stack")
    machine.marks.append(len(machine.stack))


def _drop(machine: _Machine, _: Any) -> None:
    at_mark = machine.marks[-1:] == [len(machine.stack)]
    (machine.marks if at_mark else machine.stack).pop()


def _drop_to_mark(machine: _Machine, _: Any) -> None:
    machine.pop_to_mark()


def _repeat(machine: _Machine, _: Any) -> None:
    machine.stack.append(machine.stack[-1])


def _remember(machine: _Machine, index: int) -> None:
    if index != machine.remembered:  # picklers count
        raise IndexError(index)
    _remember_next(machine, None)


def _remember_next(machine: _Machine, _: Any) -> None:
    index, value = machine.remembered, machine.stack[-1]
    machine.remembered += 1
    if machine.recalls[index]:
        machine.memory.take(sys.getsizeof(index))
        machine.fill(machine.memo, [index, value])


def _recall(machine: _Machine, index: int) -> None:
    machine.stack.append(machine.memo[index])
    recalls = machine.recalls[index]
    if recalls == 1:
        del machine.memo[index]
    elif recalls < OFTEN:
        machine.recalls[index] = recalls - 1


def _name(machine: _Machine, argument: str) -> None:
    module, _, name = argument.partition(" ")
    admitted = machine.admitted.get(Name(module, name))
    if admitted is None:
        raise _RefusedError(f"asks for {Name(module, name)!r:.80}")
    machine.stack.append(admitted)


def _name_on_stack(machine: _Machine, _: Any) -> None:
    name, module = machine.pop(str), machine.pop(str)
    _name(machine, f"{module} {name}")


def _ask(machine: _Machine, _: Any) -> None:
    arguments, name = machine.pop(tuple), machine.pop(Name)
    if name.name == "_reconstructor":  # how protocols 0 and 1 say: an empty object of this class
        name, arguments = _of(Name, arguments[0]), ()
    machine.push(Asked(name, arguments))


def _state(machine: _Machine, _: Any) -> None:
    state = machine.stack.pop()
    asked = _of(Asked, machine.stack[-1])
    if asked.state is not None:
        raise _RefusedError(f"gives {asked!r:.80} a second state")
    asked.state = state
    asked.state, size = machine.made(asked)
    machine.memory.room -= size


def _ignore(_: _Machine, __: Any) -> None:
    """A word that says nothing about values."""


def _two_lines(stream: BytesIO) -> str:
    """Returns what GLOBAL names; the reader of `pickletools` warns of a backslash in it."""
    lines = [stream.readline() for _ in range(2)]
    if not all(line.endswith(b"\n") for line in lines):
        raise ValueError("a line has no end")
    return " ".join(line[:-1].decode() for line in lines)


def _refuse(name: str) -> _Word:
    def word(_: _Machine, __: Any) -> None:
        raise _RefusedError(f"uses {name}, a word that plain data do without")

    return word


def _unknown(_: _Machine, __: Any) -> None:
    raise ValueError("a byte is no word of a pickle")


_MEANING: Final[Mapping[_Word, str]] = MappingProxyType(
    {
        _shared: "NONE BININT1",
        _constant: "BININT BININT2 FLOAT BINFLOAT UNICODE SHORT_BINUNICODE BINUNICODE "
        "BINUNICODE8 BINBYTES SHORT_BINBYTES BINBYTES8",
        _bytes: "BYTEARRAY8",
        _integer: "INT LONG LONG1 LONG4",
        _new(lambda: True): "NEWTRUE",
        _new(lambda: False): "NEWFALSE",
        _new(list): "EMPTY_LIST EMPTY_SET",
        _new(dict): "EMPTY_DICT",
        _new(tuple): "EMPTY_TUPLE",
        _filled(list): "LIST FROZENSET",
        _filled(dict): "DICT",
        _tuple_to_mark: "TUPLE",
        _tuple(1): "TUPLE1",
        _tuple(2): "TUPLE2",
        _tuple(3): "TUPLE3",
        _set_items: "SETITEMS",
        _set_item: "SETITEM",
        _extend: "APPENDS ADDITEMS",
        _append: "APPEND",
        _mark: "MARK",
        _drop: "POP",
        _drop_to_mark: "POP_MARK",
        _repeat: "DUP",
        _remember: "PUT BINPUT LONG_BINPUT",
        _remember_next: "MEMOIZE",
        _recall: "GET BINGET LONG_BINGET",
        _name: "GLOBAL",
        _name_on_stack: "STACK_GLOBAL",
        _ask: "REDUCE NEWOBJ",
        _state: "BUILD",
        _ignore: "PROTO FRAME",
    }
)
_REMEMBERING: Final = (_remember, _remember_next)
_FIXED: Final = MappingProxyType(
    {"uint1": "<B", "uint2": "<H", "int4": "<i", "uint4": "<I", "uint8": "<Q", "float8": ">d"}
)
_COUNTED: Final = MappingProxyType(
    {
        pickletools.TAKEN_FROM_ARGUMENT1: "<B",
        pickletools.TAKEN_FROM_ARGUMENT4: "<i",
        pickletools.TAKEN_FROM_ARGUMENT4U: "<I",
        pickletools.TAKEN_FROM_ARGUMENT8U: "<Q",
    }
)


def _words() -> list[tuple[_Word, int, Callable[..., Any]]]:
    """Returns what each byte does, how many bytes its argument has, and how to read that.

    An argument whose length the pickle tells has size -1; its end is in `_ENDS`, and it is read by
    `pickletools`.
    """
    words: list[tuple[_Word, int, Callable[..., Any]]] = [(_unknown, 0, _ignore)] * 256
    meaning = {name: word for word, names in _MEANING.items() for name in names.split()}
    for opcode in pickletools.opcodes:
        word, argument, code = meaning.get(opcode.name), opcode.arg, ord(opcode.code)
        if word is None:
            words[code] = _refuse(opcode.name), 0, _ignore
        elif argument is None:
            words[code] = word, 0, _ignore
        elif argument.name in _FIXED:
            layout = struct.Struct(_FIXED[argument.name])
            words[code] = word, layout.size, layout.unpack_from
        else:
            words[code] = word, -1, _two_lines if word is _name else argument.reader
    return words


def _end_of_counted(layout: str) -> Callable[[bytes, int], int]:
    count = struct.Struct(layout)

    def end(data: bytes, place: int) -> int:
        (length,) = count.unpack_from(data, place)
        if length > MAX_VALUE and place + length <= len(data):
            raise _RefusedError(f"holds a value of {length} bytes")
        return place + count.size + length

    return end


def _end_of_lines(lines: int) -> Callable[[bytes, int], int]:
    def end(data: bytes, place: int) -> int:
        most, end = place + MAX_VALUE, place
        for _ in range(lines):
            end = data.find(b"\n", end, most) + 1
            if not end and most < len(data):
                raise _RefusedError(f"holds a line of more than {MAX_VALUE} bytes")
            if not end:
                raise ValueError("a line has no end")
        return end

    return end


def _ends() -> dict[int, Callable[[bytes, int], int]]:
    """Returns where an argument ends whose length the pickle tells, by the byte of its word."""
    counted = {count: _end_of_counted(layout) for count, layout in _COUNTED.items()}
    lines = {False: _end_of_lines(1), True: _end_of_lines(2)}
    return {
        ord(opcode.code): counted.get(opcode.arg.n) or lines[_WORDS[ord(opcode.code)][0] is _name]
        for opcode in pickletools.opcodes
        if opcode.arg is not None
    }


_WORDS: Final = tuple(_words())
_ENDS: Final = MappingProxyType(_ends())
_STOP: Final = ord(".")
# Words that `_recalls` need not look at, with their argument; 0 for others.
_SKIPPED: Final = tuple(0 if word is _recall or size < 0 else 1 + size for word, size, _ in _WORDS)
