"""Files as an accident, or somebody who means harm, would change them."""

import copy
import gzip
import io
import json
import re
import zipfile
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from tests.io.documents import places_of

TOKENS: Final = (
    *(b"", b"\x00", b"\xff\xfe", b"\r", b"\n\n", b'"', b"'", b",", b"<", b"&a;", b"{", b"[" * 3000),
    *(b"null", b"NaN", b"-Infinity", b"1e999", b"1e308", b"-1", b"-0.0", b"0", b"1_0", b"9" * 400),
    *("\u0663".encode(), "\u00b2".encode(), b"true", b"[]", b"{}", b'"id"', b'"links"', b"=cmd()"),
    *(b"POLYGON EMPTY", b"CIRCULARSTRING (0 0, 1 1, 2 0)", b"<node id='0'/>", b"../../etc/passwd"),
)
VALUES: Final = (
    *(None, True, False, 0, -1, 2**31, 2**64, 10**400, 0.5, -0.0, 1e308, -1e308, 1e-320),
    *(float("nan"), float("inf"), "", "0", "nan", "\n", "\u0663", "plane", "x" * 300, "\ud800"),
    *([], {}, [[]], [0, 0], [0.0] * 3, [None] * 3, [1e308] * 3, {"id": 0}, {"mean": 1}),
)
REMOVED: Final = object()
NUMBER: Final = re.compile(rb"-?\d+(?:\.\d+)?(?:e-?\d+)?")

Rng = np.random.Generator
Mutation = Callable[[bytes, Rng], bytes]


def mutated_bytes(data: bytes, rng: Rng) -> bytes:
    """Returns some bytes changed in one to three places."""
    for _ in range(_few(rng)):
        start = int(rng.integers(len(data) + 1))
        end = min(len(data), start + int(rng.integers(1, 2 ** int(rng.integers(1, 9)))))
        token = TOKENS[rng.integers(len(TOKENS))]
        kind = rng.integers(8)
        if kind == 0 and start < len(data):
            data = (
                data[:start] + bytes([data[start] ^ int(rng.integers(1, 256))]) + data[start + 1 :]
            )
        elif kind == 1:
            data = data[:start]
        elif kind == 2:
            data = data[:start] + data[end:]
        elif kind == 3:
            data = data[:end] + data[start:end] + data[end:]
        elif kind == 4:
            data = data[:start] + token + data[end:]
        elif kind == 5:
            data = data[:start] + token + data[start:]
        elif kind == 6:
            data = _with_number(data, token, rng)
        else:
            lines = data.split(b"\n")
            place = int(rng.integers(len(lines)))
            data = b"\n".join([*lines[:place], *lines[place : place + 1] * 2, *lines[place + 1 :]])
    return data


def _few(rng: Rng) -> int:
    """Returns a number of changes, more often one than several."""
    return int(rng.integers(1, rng.integers(2, 5)))


def _with_number(data: bytes, token: bytes, rng: Rng) -> bytes:
    """Replaces one of the numbers in a text."""
    found = list(NUMBER.finditer(data[:20_000]))
    if not found:
        return data
    match = found[rng.integers(len(found))]
    return data[: match.start()] + token + data[match.end() :]


def mutated_json(data: bytes, rng: Rng) -> bytes:
    """Returns a JSON document, or one a line, with other values in one to three places."""
    lines = data.decode().splitlines()
    if not lines[0].endswith("}"):  # one document on several lines
        lines = [data.decode()]
    place = int(rng.integers(len(lines)))
    document = json.loads(lines[place])
    for _ in range(_few(rng)):
        places = list(places_of(document))
        if not places:
            break
        where = places[rng.integers(len(places))]
        _put(document, where, _value(document, places, rng))
    lines[place] = json.dumps(document)
    return "\n".join(lines).encode()


def _put(document: Any, where: tuple, value: Any) -> None:
    """Replaces or removes what is at a place of a document."""
    *path, last = where
    for key in path:
        document = document[key]
    if value is REMOVED:
        del document[last]
    else:
        document[last] = copy.deepcopy(value)


def _value(document: Any, places: list[tuple], rng: Rng) -> Any:
    """Returns an odd value, or one from elsewhere in the document."""
    if (chance := rng.random()) < 0.1:
        return REMOVED
    if chance < 0.7:
        return VALUES[rng.integers(len(VALUES))]
    value = document
    for key in places[rng.integers(len(places))]:
        value = value[key]
    return value


def mutated_npz(data: bytes, rng: Rng) -> bytes:
    """Returns an npz file one of whose arrays has other values, another shape, type or name."""
    with np.load(io.BytesIO(data)) as content:
        arrays = dict(content)
    name = list(arrays)[rng.integers(len(arrays))]
    array = arrays[name]
    if str(array).startswith("{") and rng.random() < 0.8:
        arrays[name] = np.array(mutated_json(str(array).encode(), rng).decode())
        return saved(arrays)
    kind = rng.integers(7) if array.dtype.kind in "fiu" else rng.integers(3)
    if kind == 0:
        del arrays[name]
    elif kind == 1:
        arrays[f"{name}x"] = array
    elif kind == 2:
        arrays[name] = array[..., :-1] if array.ndim else array[None]
    elif kind == 3:
        kinds = ("f4", "f8", "i4", "i8", "?", "U3", "c16")
        arrays[name] = np.resize(array, array.shape).astype(kinds[rng.integers(len(kinds))], "C")
    elif kind == 4 and array.size and array.dtype.kind in "fi":
        array = array.astype("f4") if array.dtype == "f2" else array.copy()
        odd = (np.nan, np.inf, 1e38, -1e38) if array.dtype.kind == "f" else (-1, 2**31 - 1, 9)
        array.flat[rng.integers(array.size)] = odd[rng.integers(len(odd))]
        arrays[name] = array
    elif kind == 5:
        arrays[name] = np.concatenate([array, array]) if array.ndim else np.array([])
    else:
        arrays[name] = arrays[list(arrays)[rng.integers(len(arrays))]]
    return saved(arrays)


def saved(arrays: dict[str, np.ndarray]) -> bytes:
    """Returns the bytes of an npz file."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def mutated_zip(data: bytes, rng: Rng) -> bytes:
    """Returns a zip one of whose members is changed within; its checksum is right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    changed = list(members)[rng.integers(len(members))]
    members[changed] = mutated_bytes(members[changed], rng)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def mutated_gzip(data: bytes, rng: Rng) -> bytes:
    """Returns a gzip file whose text is changed."""
    return gzip.compress(mutated_json(gzip.decompress(data), rng), 1)
