"""Whole files: read with refusals of one sentence, written so that no half file is ever seen."""

import json
import os
import secrets
import stat
import sys
import time
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any, Final

TEMPORARY: Final = ".sg3d-"  # what the names of temporary files begin with
ABANDONED: Final = 3600.0  # seconds; no file takes so long to write
# Limits on what is read, so that no file, however small, fills more than two gigabytes: parsed, a
# document takes up to 28 times as much as its text, and a graph about 2.5 kB beside its nodes.
MAX_BYTES: Final = 2**28  # of a file
MAX_DOCUMENT: Final = 48_000_000  # characters of a JSON document
MAX_GRAPHS: Final = 200_000  # of a file


@contextmanager
def replacing(path: str | Path) -> Generator[Path]:
    """Gives a temporary name beside `path`; renames it to `path` if the block succeeds.

    A link is written through, and a file that is replaced hands down its mode. What processes that
    were killed left in the folder is removed.

    Args:
      path: the file to write. Its folder exists; the temporary name keeps its suffix, by which
        writers of pictures and arrays choose their format.

    Yields:
      The name to write to.

    Raises:
      ValueError: there is no such folder, or `path` is itself a folder or a device.
      OSError: it cannot be written, for example because the disk is full.
    """
    target = Path(path).resolve()
    temporary = target.with_name(f"{TEMPORARY}{secrets.token_hex(4)}{target.suffix}")
    try:
        mode = _mode_of(target, f"{path}")
        _remove_abandoned(target.parent)
        flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY
        os.close(os.open(temporary, flags, 0o666 if mode is None else 0o600))
        yield temporary
        if mode is not None:
            temporary.chmod(mode)
        sync(temporary)  # else a power cut may leave the new name on no content
        temporary.replace(target)
        sync(target.parent)
    except Exception as error:
        failure = _failed_call(error)
        if failure is None:
            raise
        raise OSError(f"{path}: cannot be written ({failure.strerror or failure})") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _mode_of(target: Path, where: str) -> int | None:
    """Returns the mode of a file that is to be replaced; None if there is none yet."""
    if target.is_dir() or not target.parent.is_dir():
        within = f"lies in {target.parent}, which is no folder"
        problem = "is a folder" if target.is_dir() else within
        raise ValueError(f"{where}: {problem}, expected the name of a file to write")
    if not target.exists():
        return None
    if not target.is_file():
        raise ValueError(f"{where}: is a device, expected the name of a file to write")
    return stat.S_IMODE(target.stat().st_mode)


def _failed_call(error: BaseException | None) -> OSError | None:
    """Returns the call of the system that failed: some writers raise more while they clean up."""
    while error is not None and not isinstance(error, OSError):
        error = error.__context__
    return error


def _remove_abandoned(folder: Path) -> None:
    """Removes temporary files that nobody has written to for so long that nobody will."""
    for temporary in folder.glob(f"{TEMPORARY}*"):
        with suppress(OSError):  # gone, or not ours
            if time.time() - temporary.stat().st_mtime > ABANDONED:
                temporary.unlink()


def sync(path: Path) -> None:
    """Waits until a file, or the names in a folder, are on the disk.

    Windows can flush neither a folder nor a file that is open for reading; nothing is done there.
    """
    if sys.platform == "win32":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not path.is_dir():  # some file systems refuse it for folders
            raise
    finally:
        os.close(descriptor)


def read_bytes(path: str | Path, most: int = MAX_BYTES) -> bytes:
    """Returns what is in a file, which may be a pipe or a device without an end.

    Args:
      path: the file.
      most: bytes.

    Raises:
      ValueError: the file cannot be read, or is larger.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}, expected a file to read") from error
    if len(data) > most:
        raise ValueError(f"{path}: the file is too large, expected {most} bytes at most")
    return data


def read_text(path: str | Path) -> str:
    """Returns the text of a file; a byte-order mark, as spreadsheets write it, is dropped.

    Raises:
      ValueError: the file cannot be read, is too large, or is not UTF-8 text.
    """
    return _decoded(read_bytes(path), f"{path}").replace("\r\n", "\n").replace("\r", "\n")


def _decoded(data: bytes, where: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        problem = f"byte {error.start} is not UTF-8"
        raise ValueError(f"{where}: {problem}, expected a text file") from error


def read_documents(path: str | Path) -> Iterator[tuple[str, Any]]:
    """Yields the documents of a JSON (.json) or JSON Lines (.jsonl) file, one at a time.

    Args:
      path: a file with one document, or one a line (empty lines are skipped).

    Yields:
      A pair for each document: where it is, as an error should name it, and the document.

    Raises:
      ValueError: the file or one of its lines is broken, or there is no document.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        yield f"{path}", parsed(read_text(path), f"{path}")
    elif suffix == ".jsonl":
        yield from parsed_lines(read_bytes(path), path)
    else:
        raise ValueError(f"{path}: the name ends in {suffix!r}, expected .json or .jsonl")


def parsed_lines(data: bytes, path: str | Path) -> Iterator[tuple[str, Any]]:
    """Yields the documents of the lines of a file as `read_documents` does.

    Args:
      data: what is in the file.
      path: what errors call it.

    Raises:
      ValueError: a line is broken, or there are none or too many.
    """
    count = 0
    for number, line in enumerate(BytesIO(data), 1):
        where = f"{path}: line {number}"
        text = _decoded(line, where).rstrip("\r\n")
        if text.strip():
            count += 1
            if count > MAX_GRAPHS:
                raise ValueError(f"{where}: one too many, expected {MAX_GRAPHS} documents at most")
            yield where, parsed(text, where)
    if not count:
        raise ValueError(f"{path}: the file is empty, expected one JSON document a line")


def write_document(path: str | Path, document: Mapping[str, Any]) -> None:
    """Writes one JSON document; a list of objects is written one object a line."""
    fields = (f"  {json.dumps(key)}: {_layout(value)}" for key, value in document.items())
    with replacing(path) as temporary:
        temporary.write_text("{\n" + ",\n".join(fields) + "\n}\n", encoding="utf-8")


def write_documents(path: str | Path, documents: Iterable[Mapping[str, Any]]) -> None:
    """Writes a JSON Lines file, one document a line."""
    lines = (json.dumps(document, allow_nan=False) + "\n" for document in documents)
    with replacing(path) as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")


def parsed(text: str, where: str) -> Any:
    """Returns what a JSON text holds, or refuses.

    Raises:
      ValueError: it is not JSON, has a key twice, or is of a kind that cannot be read.
    """
    if len(text) > MAX_DOCUMENT:
        problem = f"the document has {len(text)} characters"
        raise ValueError(f"{where}: {problem}, expected {MAX_DOCUMENT} at most")
    try:
        return json.loads(text, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno} column {error.colno}"
        raise ValueError(f"{where}: not JSON at {place} ({error.msg})") from error
    except (ValueError, RecursionError) as error:  # keys twice, numbers too long, brackets too deep
        raise ValueError(f"{where}: not JSON that can be read ({error})") from error


def _object(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Returns an object of a document; of a key that is there twice nobody knows which is meant."""
    made = dict(pairs)
    if len(made) < len(pairs):
        ((twice, _),) = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"the key {twice!r:.40} is there twice")
    return made


def field(record: Any, key: str, where: str) -> Any:
    """Returns what an object of a parsed document has under a key, or refuses.

    Raises:
      ValueError: it is no object, or lacks the key.
    """
    if not isinstance(record, dict):
        raise ValueError(f"{where} is {record!r:.40}, expected an object with {key!r}")
    if key not in record:
        raise ValueError(f"{where} lacks {key!r}, expected an object with it")
    return record[key]


def vector(value: Any, where: str, length: int = 3) -> list[float]:
    """Returns a list of numbers of a parsed document, or refuses.

    Raises:
      ValueError: it is not a list of so many numbers.
    """
    if not isinstance(value, list) or len(value) != length:
        many = "three" if length == 3 else length
        raise ValueError(f"{where} is {value!r:.40}, expected {many} numbers")
    # Nearly all are floats, and there are many: a call for each would double the time of reading.
    return [item if type(item) is float else number(item, where) for item in value]


def number(value: Any, where: str) -> float:
    """Returns a number of a parsed document, or refuses.

    Raises:
      ValueError: it is no number, or an integer that no float can hold.
    """
    try:
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return float(value)
    except OverflowError:
        pass
    raise ValueError(f"{where} is {value!r:.40}, expected a number")


def _layout(value: object) -> str:
    if isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        items = ",\n".join(f"    {json.dumps(item, allow_nan=False)}" for item in value)
        return f"[\n{items}\n  ]"
    return json.dumps(value, allow_nan=False)
