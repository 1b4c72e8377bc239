"""The words of the pickle format that build values, and the stack machine that they are words of.

Nothing is called: what a pickle asks to be made is written down as an `Asked`, and a name that is
not on the caller's list, or a word that plain data do without, is refused.
"""

import gc
import pickletools
import struct
import sys
from collections.abc import Callable, Mapping, Set
from io import BytesIO
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from sg3d_jax.io.memory import Memory, blocks

MAX_BITS: Final = 64  # longer integers name no node, and Python refuses to print some of them
MAX_STACK: Final = 1_000_000  # values at once; picklers put a thousand there before they use them
MAX_VALUE: Final = 2**22  # bytes of a text, a number or an array; a text may take seven times that
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


class RefusedError(Exception):
    """What the pickle does that it must not."""


class Machine:
    """The stack, where its marks are, and the memo of what is used again."""

    def __init__(
        self,
        admitted: Set[Name],
        memory: Memory,
        recalls: bytearray,
        made: Callable[[Asked], tuple[Any, int]],
    ) -> None:
        """Begins with nothing on the stack; see `pickles.read_pickle`."""
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
            raise RefusedError(f"has more than {MAX_STACK} values on its stack")

    def weigh(self) -> None:
        """Gives back the memory of what can no more be reached."""
        gc.collect()
        used = blocks((self.stack, self.memo), {Asked: _parts})
        if used is not None:
            self.memory.free_all_but(used)


def _parts(asked: Asked) -> tuple[Any, ...]:
    return asked.arguments, asked.state


Word = Callable[[Machine, Any], None]


def _of(kind: type, value: Any) -> Any:
    if type(value) is not kind:
        raise TypeError(f"{type(value).__name__} is not {kind.__name__}")
    return value


def _constant(machine: Machine, argument: Any) -> None:
    machine.push(argument)


def _shared(machine: Machine, argument: Any) -> None:
    machine.stack.append(argument)  # what Python has once, however often it is asked for


def _integer(machine: Machine, argument: int) -> None:
    if argument.bit_length() > MAX_BITS:
        raise RefusedError(f"holds an integer of {argument.bit_length()} bits")
    machine.push(argument)


def _new(make: Callable[[], Any]) -> Word:
    return lambda machine, _: machine.push(make())


def _filled(make: Callable[[], Any]) -> Word:
    def word(machine: Machine, _: Any) -> None:
        items = machine.pop_to_mark()
        machine.push(make())
        machine.fill(machine.stack[-1], items)

    return word


def _bytes(machine: Machine, argument: bytearray) -> None:
    machine.push(bytes(argument))


def _tuple_to_mark(machine: Machine, _: Any) -> None:
    machine.push(tuple(machine.pop_to_mark()))


def _tuple(size: int) -> Word:
    def word(machine: Machine, _: Any) -> None:
        values = [machine.stack.pop() for _ in range(size)]
        machine.push(tuple(reversed(values)))

    return word


def _mapping(items: list[Any], mapping: dict[Any, Any]) -> None:
    for key, value in zip(items[::2], items[1::2], strict=True):
        if isinstance(key, tuple):  # hashing one that is nested deeply overflows the C stack
            raise RefusedError("has a key that is a tuple")
        mapping[key] = value


def _set_items(machine: Machine, _: Any) -> None:
    items = machine.pop_to_mark()
    machine.fill(_of(dict, machine.stack[-1]), items)


def _set_item(machine: Machine, _: Any) -> None:
    value, key = machine.stack.pop(), machine.stack.pop()
    machine.fill(_of(dict, machine.stack[-1]), [key, value])


def _extend(machine: Machine, _: Any) -> None:
    items = machine.pop_to_mark()
    machine.fill(_of(list, machine.stack[-1]), items)


def _append(machine: Machine, _: Any) -> None:
    item = machine.stack.pop()
    machine.fill(_of(list, machine.stack[-1]), [item])


def _mark(machine: Machine, _: Any) -> None:
    if len(machine.marks) == MAX_STACK:
        raise RefusedError(f"has more than {MAX_STACK} marks on its stack")
    machine.marks.append(len(machine.stack))


def _drop(machine: Machine, _: Any) -> None:
    at_mark = machine.marks[-1:] == [len(machine.stack)]
    (machine.marks if at_mark else machine.stack).pop()


def _drop_to_mark(machine: Machine, _: Any) -> None:
    machine.pop_to_mark()


def _repeat(machine: Machine, _: Any) -> None:
    machine.stack.append(machine.stack[-1])


def _remember(machine: Machine, index: int) -> None:
    if index != machine.remembered:  # picklers count
        raise IndexError(index)
    _remember_next(machine, None)


def _remember_next(machine: Machine, _: Any) -> None:
    index, value = machine.remembered, machine.stack[-1]
    machine.remembered += 1
    if machine.recalls[index]:
        machine.memory.take(sys.getsizeof(index))
        machine.fill(machine.memo, [index, value])


def recall(machine: Machine, index: int) -> None:
    """Pushes a value that was remembered, and forgets it after the last time."""
    machine.stack.append(machine.memo[index])
    recalls = machine.recalls[index]
    if recalls == 1:
        del machine.memo[index]
    elif recalls < OFTEN:
        machine.recalls[index] = recalls - 1


def _name(machine: Machine, argument: str) -> None:
    module, _, name = argument.partition(" ")
    admitted = machine.admitted.get(Name(module, name))
    if admitted is None:
        raise RefusedError(f"asks for {Name(module, name)!r:.80}")
    machine.stack.append(admitted)


def _name_on_stack(machine: Machine, _: Any) -> None:
    name, module = machine.pop(str), machine.pop(str)
    _name(machine, f"{module} {name}")


def _ask(machine: Machine, _: Any) -> None:
    arguments, name = machine.pop(tuple), machine.pop(Name)
    if name.name == "_reconstructor":  # how protocols 0 and 1 say: an empty object of this class
        name, arguments = _of(Name, arguments[0]), ()
    machine.push(Asked(name, arguments))


def _state(machine: Machine, _: Any) -> None:
    state = machine.stack.pop()
    asked = _of(Asked, machine.stack[-1])
    if asked.state is not None:
        raise RefusedError(f"gives {asked!r:.80} a second state")
    asked.state = state
    asked.state, size = machine.made(asked)
    machine.memory.room -= size


def _ignore(_: Machine, __: Any) -> None:
    """A word that says nothing about values."""


def _two_lines(stream: BytesIO) -> str:
    """Returns what GLOBAL names; the reader of `pickletools` warns of a backslash in it."""
    lines = [stream.readline() for _ in range(2)]
    if not all(line.endswith(b"\n") for line in lines):
        raise ValueError("a line has no end")
    return " ".join(line[:-1].decode() for line in lines)


def _refuse(name: str) -> Word:
    def word(_: Machine, __: Any) -> None:
        raise RefusedError(f"uses {name}, a word that plain data do without")

    return word


def _unknown(_: Machine, __: Any) -> None:
    raise ValueError("a byte is no word of a pickle")


_MEANING: Final[Mapping[Word, str]] = MappingProxyType(
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
        recall: "GET BINGET LONG_BINGET",
        _name: "GLOBAL",
        _name_on_stack: "STACK_GLOBAL",
        _ask: "REDUCE NEWOBJ",
        _state: "BUILD",
        _ignore: "PROTO FRAME",
    }
)
REMEMBERING: Final = (_remember, _remember_next)
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


def _words() -> list[tuple[Word, int, Callable[..., Any]]]:
    """Returns what each byte does, how many bytes its argument has, and how to read that.

    An argument whose length the pickle tells has size -1; its end is in `ENDS`, and it is read by
    `pickletools`.
    """
    words: list[tuple[Word, int, Callable[..., Any]]] = [(_unknown, 0, _ignore)] * 256
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
            raise RefusedError(f"holds a value of {length} bytes")
        return place + count.size + length

    return end


def _end_of_lines(lines: int) -> Callable[[bytes, int], int]:
    def end(data: bytes, place: int) -> int:
        most, end = place + MAX_VALUE, place
        for _ in range(lines):
            end = data.find(b"\n", end, most) + 1
            if not end and most < len(data):
                raise RefusedError(f"holds a line of more than {MAX_VALUE} bytes")
            if not end:
                raise ValueError("a line has no end")
        return end

    return end


def _ends() -> dict[int, Callable[[bytes, int], int]]:
    """Returns where an argument ends whose length the pickle tells, by the byte of its word."""
    counted = {count: _end_of_counted(layout) for count, layout in _COUNTED.items()}
    lines = {False: _end_of_lines(1), True: _end_of_lines(2)}
    return {
        ord(opcode.code): counted.get(opcode.arg.n) or lines[WORDS[ord(opcode.code)][0] is _name]
        for opcode in pickletools.opcodes
        if opcode.arg is not None
    }


# Of each byte what it does, how many bytes its argument has (-1: the pickle tells), and its reader.
WORDS: Final = tuple(_words())
ENDS: Final = MappingProxyType(_ends())  # where an argument ends whose length the pickle tells
STOP: Final = ord(".")
