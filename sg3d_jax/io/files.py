"""Whole files: read with refusals of one sentence, written so that no half file is ever seen."""

import json
import secrets
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: str | Path) -> Generator[Path]:
    """Gives a temporary name beside `path`; renames it to `path` if the block succeeds.

    Args:
      path: the file to write. Its folder exists; the temporary name keeps its suffix, by which
        writers of pictures and arrays choose their format.

    Yields:
      The name to write to.

    Raises:
      ValueError: there is no such folder, or `path` is itself a folder.
    """
    path = Path(path)
    if path.is_dir() or not path.parent.is_dir():
        problem = "is a folder" if path.is_dir() else f"lies in {path.parent}, which is no folder"
        raise ValueError(f"{path}: {problem}, expected the name of a file to write")
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def read_text(path: str | Path) -> str:
    """Returns the text of a file; a byte-order mark, as spreadsheets write it, is dropped.

    Raises:
      ValueError: the file cannot be read, or is not UTF-8 text.
    """
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}, expected a file to read") from error
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: byte {error.start} is not UTF-8, expected a text file"
        ) from error


def read_documents(path: str | Path) -> list[tuple[str, Any]]:
    """Returns the documents of a JSON (.json) or JSON Lines (.jsonl) file.

    Args:
      path: a file with one document, or one a line (empty lines are skipped).

    Returns:
      A pair for each document: where it is, as an error should name it, and the document.

    Raises:
      ValueError: the file or one of its lines is broken, or there is no document.
    """
    text, suffix = read_text(path), Path(path).suffix.lower()
    if suffix == ".json":
        return [(f"{path}", parsed(text, f"{path}"))]
    if suffix != ".jsonl":
        raise ValueError(f"{path}: the name ends in {suffix!r}, expected .json or .jsonl")
    lines = [(f"{path}: line {number}", line) for number, line in enumerate(text.split("\n"), 1)]
    documents = [(where, parsed(line, where)) for where, line in lines if line.strip()]
    if not documents:
        raise ValueError(f"{path}: the file is empty, expected one JSON document a line")
    return documents


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
      ValueError: it is not JSON, or of a kind that cannot be read.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno} column {error.colno}"
        raise ValueError(f"{where}: not JSON at {place} ({error.msg})") from error
    except (ValueError, RecursionError) as error:  # numbers too long, brackets too deep
        raise ValueError(f"{where}: not JSON that can be read ({error})") from error


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
