"""Pickles read as data: a stack machine for those words of the pickle format that build values.

A pickle is a program, and Python's own unpickler runs it. Restricted by `find_class` it still calls
what the pickle says to call, sizes its tables by numbers that the pickle declares, and overflows
the C stack on a deeply nested key. Here nothing is called: what a pickle asks to be made is written
down as an `Asked`, for whoever knows what it ought to hold, and a name that is not on the caller's
list, or a word that plain data do without, is refused.
"""

import pickletools
import struct
import sys
from collections.abc import Callable, Mapping, Set
from io import BytesIO
from types import MappingProxyType
from typing import Any, Final, NamedTuple

MAX_BITS: Final = 64  # longer integers name no node, and Python refuses to print some of them
MAX_STACK: Final = 1_000_000  # values at once; picklers put a thousand there before they use them
MAX_MEMORY: Final = 3_000_000_000  # bytes; the largest published set counts nearly as many
SLOT: Final = 8  # bytes of a place in a list


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


def read_pickle(
    data: bytes, admitted: Set[Name], where: str, expected: str, most: int = MAX_MEMORY
) -> Any:
    """Returns what a pickle describes, without making any of its objects.

    Args:
      data: one pickle, of protocol 0 to 5.
      admitted: the names that it may ask for.
      where: what an error starts with, such as "m-f.zip".
      expected: what the pickle ought to hold, for the error.
      most: bytes that the pickle and what it describes may take.

    Returns:
      Plain values, `Asked` for each object and `Name` for each class or function. Sets come as
      lists. Containers may contain themselves.

    Raises:
      ValueError: the pickle asks for something else, is cut short or too large, or is none.
    """
    machine = _Machine(admitted, most - len(data))
    try:
        end = _run(machine, data)
        (value,) = machine.stack
    except _RefusedError as error:
        raise ValueError(f"{where}: the pickle {error}, expected {expected}") from None
    except (ValueError, LookupError, TypeError, MemoryError, struct.error) as error:
        problem = "is cut short, broken or no pickle"
        raise ValueError(f"{where}: the file {problem}, expected {expected}") from error
    if end != len(data):
        raise ValueError(f"{where}: the file goes on after the pickle, expected {expected}")
    return value


class _RefusedError(Exception):
    """What the pickle does that it must not."""


class _Machine:
    """The stack, where its marks are, the memo of what is used again, and the memory left."""

    def __init__(self, admitted: Set[Name], room: int) -> None:
        self.admitted = admitted
        self.room = room
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: list[Any] = []

    def push(self, value: Any) -> None:
        """Pushes a new value."""
        self.stack.append(value)
        self.room -= sys.getsizeof(value)

    def pop(self, kind: type) -> Any:
        """Pops a value that has to be of one type."""
        return _of(kind, self.stack.pop())

    def pop_to_mark(self) -> list[Any]:
        """Pops all values above the last mark, and the mark."""
        start = self.marks.pop()
        values = self.stack[start:]
        del self.stack[start:]
        return values


_Word = Callable[[_Machine, Any], None]


def _run(machine: _Machine, data: bytes) -> int:
    """Reads words up to STOP; returns where the next byte is."""
    stream, place = BytesIO(data), 0
    while (code := data[place]) != _STOP:
        word, size, read = _WORDS[code]
        place += 1
        if not size:
            word(machine, None)
        elif size > 0:
            word(machine, read(data, place)[0])
            place += size
        else:
            stream.seek(place)
            word(machine, read(stream))
            place = stream.tell()
        if machine.room < 0:
            raise _RefusedError("describes more than fits into memory")
        if len(machine.stack) > MAX_STACK:
            raise _RefusedError(f"has more than {MAX_STACK} values on its stack")
    return place + 1


def _of(kind: type, value: Any) -> Any:
    if type(value) is not kind:
        raise TypeError(f"{type(value).__name__} is not {kind.__name__}")
    return value


def _constant(machine: _Machine, argument: Any) -> None:
    machine.push(argument)


def _integer(machine: _Machine, argument: int) -> None:
    if argument.bit_length() > MAX_BITS:
        raise _RefusedError(f"holds an integer of {argument.bit_length()} bits")
    machine.push(argument)


def _new(make: Callable[[], Any]) -> _Word:
    return lambda machine, _: machine.push(make())


def _from_mark(make: Callable[[list[Any]], Any]) -> _Word:
    return lambda machine, _: machine.push(make(machine.pop_to_mark()))


def _tuple(size: int) -> _Word:
    def word(machine: _Machine, _: Any) -> None:
        values = [machine.stack.pop() for _ in range(size)]
        machine.push(tuple(reversed(values)))

    return word


def _mapping(items: list[Any], mapping: dict[Any, Any] | None = None) -> dict[Any, Any]:
    mapping = {} if mapping is None else mapping
    for key, value in zip(items[::2], items[1::2], strict=True):
        if isinstance(key, tuple):  # hashing one that is nested deeply overflows the C stack
            raise _RefusedError("has a key that is a tuple")
        mapping[key] = value
    return mapping


def _grow(machine: _Machine, kind: type, items: list[Any]) -> None:
    """Puts items into the container on top of the stack."""
    container = _of(kind, machine.stack[-1])
    before = sys.getsizeof(container)
    _mapping(items, container) if kind is dict else container.extend(items)
    machine.room -= sys.getsizeof(container) - before


def _set_items(machine: _Machine, _: Any) -> None:
    _grow(machine, dict, machine.pop_to_mark())


def _set_item(machine: _Machine, _: Any) -> None:
    value, key = machine.stack.pop(), machine.stack.pop()
    _grow(machine, dict, [key, value])


def _extend(machine: _Machine, _: Any) -> None:
    _grow(machine, list, machine.pop_to_mark())


def _append(machine: _Machine, _: Any) -> None:
    _grow(machine, list, [machine.stack.pop()])


def _mark(machine: _Machine, _: Any) -> None:
    machine.marks.append(len(machine.stack))
    machine.room -= SLOT


def _drop(machine: _Machine, _: Any) -> None:
    at_mark = machine.marks[-1:] == [len(machine.stack)]
    (machine.marks if at_mark else machine.stack).pop()


def _drop_to_mark(machine: _Machine, _: Any) -> None:
    machine.pop_to_mark()


def _repeat(machine: _Machine, _: Any) -> None:
    machine.stack.append(machine.stack[-1])


def _remember(machine: _Machine, index: int) -> None:
    if index != len(machine.memo):  # picklers count; a number of their choice could be any size
        raise IndexError(index)
    _remember_next(machine, None)


def _remember_next(machine: _Machine, _: Any) -> None:
    machine.memo.append(machine.stack[-1])
    machine.room -= SLOT


def _recall(machine: _Machine, index: int) -> None:
    if index < 0:
        raise IndexError(index)
    machine.stack.append(machine.memo[index])


def _name(machine: _Machine, argument: str) -> None:
    module, _, name = argument.partition(" ")
    if Name(module, name) not in machine.admitted:
        raise _RefusedError(f"asks for {Name(module, name)!r:.80}")
    machine.push(Name(module, name))


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
        _constant: "NONE BININT BININT1 BININT2 FLOAT BINFLOAT UNICODE SHORT_BINUNICODE BINUNICODE "
        "BINUNICODE8 BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8",
        _integer: "INT LONG LONG1 LONG4",
        _new(lambda: True): "NEWTRUE",
        _new(lambda: False): "NEWFALSE",
        _new(list): "EMPTY_LIST EMPTY_SET",
        _new(dict): "EMPTY_DICT",
        _new(tuple): "EMPTY_TUPLE",
        _from_mark(list): "LIST FROZENSET",
        _from_mark(tuple): "TUPLE",
        _from_mark(_mapping): "DICT",
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
_FIXED: Final = MappingProxyType(
    {"uint1": "<B", "uint2": "<H", "int4": "<i", "uint4": "<I", "uint8": "<Q", "float8": ">d"}
)


def _words() -> list[tuple[_Word, int, Callable[..., Any]]]:
    """Returns what each byte does, how many bytes its argument has, and how to read that.

    An argument whose length the pickle tells has size -1 and is read by `pickletools`.
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


_WORDS: Final = tuple(_words())
_STOP: Final = ord(".")
