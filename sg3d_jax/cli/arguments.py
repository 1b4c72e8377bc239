"""What the commands share: how arguments look, and what is refused before any work is done."""

import json
import os
import runpy
import sys
import tempfile
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from rich.console import Console
from rich.table import Table

Positional = tyro.conf.Positional
Output = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
OptionalOutput = Annotated[Path | None, tyro.conf.arg(aliases=["-o"])]
Code = tuple[Path, ...]

PICTURES: Final = (".png", ".pdf", ".svg")
PAGES: Final = (".html",)
STANDARD: Final = Path("-")  # standard input, or output
WIDEST: Final = 10_000  # letters in a line off a terminal


def read(source: str, index: int | None = None, count: int | None = None) -> list[Any]:
    """Returns graphs of a data set or a file: one of them, or the first so many."""
    return [each.graph for each in read_with_attributes(source, index, count)]


def read_with_attributes(
    source: str,
    index: int | None = None,
    count: int | None = None,
    columns: str | None = None,
) -> list[Any]:
    """Returns graphs as `read` does, each with what else a file says of its nodes and edges."""
    from sg3d_jax.data import registry
    from sg3d_jax.io import formats
    from sg3d_jax.io.attributes import bare

    if index is not None:
        check_at_least("--index", index, 0)
    if registry.is_name(source):
        graphs = registry.make(source, count if index is None else index + 1)
        reads = [bare(graph) for graph in graphs]
    else:
        reads = formats.read_with_attributes(source, columns_in(columns))
        reads = reads[: None if index is not None else count]
        say_remarks([f"{source}: {remark}" for each in reads for remark in each.remarks])
    if index is None:
        return reads
    return [one_of(source, reads, index)]


def one_of(source: str, held: Sequence[Any], index: int) -> Any:
    """Returns one of what a data set or a file holds; refuses a place where there is none."""
    if not 0 <= index < len(held):
        raise ValueError(f"{source}: --index must be in 0..{len(held) - 1}, got {index}")
    return held[index]


def columns_in(option: str | None) -> dict[str, str] | None:
    """Returns what columns of a CSV file are called here, by what `--columns` says."""
    if option is None:
        return None
    pairs = [pair.split("=") for pair in option.split(",")]
    if odd := [pair for pair in pairs if len(pair) != 2]:
        expected = "expected such as x=cx,y=cy,length=width"
        raise ValueError(f"--columns has {'='.join(odd[0])!r:.40}, {expected}")
    return {theirs.strip(): ours.strip() for theirs, ours in pairs}


def say_remarks(remarks: Iterable[str]) -> None:
    """Prints remarks on stderr, each once."""
    for remark in dict.fromkeys(remarks):
        print(f"sg3d: remark: {remark}", file=sys.stderr)


@contextmanager
def to_read(path: Path) -> Generator[tuple[Path, str]]:
    """Gives a file and its name: the file itself, or a copy of standard input, JSON or JSON Lines.

    A document on one line is read as JSON Lines, which is the same.
    """
    if path != STANDARD:
        yield path, f"{path}"
        return
    from sg3d_jax.io.files import MAX_BYTES

    data = sys.stdin.buffer.read(MAX_BYTES + 1)  # one more, and it is refused as too large
    try:
        json.loads(data.lstrip().split(b"\n", 1)[0])
        suffix = ".jsonl"
    except (ValueError, RecursionError):
        suffix = ".json"
    with _passing("standard input", suffix) as copy:
        copy.write_bytes(data)
        yield copy, "standard input"


@contextmanager
def to_write(path: Path, suffix: str) -> Generator[Path]:
    """Gives a file to write: the file itself, or one that then goes to standard output."""
    if path != STANDARD:
        yield path
        return
    with _passing("standard output", suffix) as copy:
        yield copy
        sys.stdout.write(copy.read_text(encoding="utf-8"))
        sys.stdout.flush()


@contextmanager
def _passing(name: str, suffix: str) -> Generator[Path]:
    """Gives the name of a file that is gone after the block; refusals call it by another name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"graphs{suffix}"
        try:
            yield path
        except ValueError as error:
            raise ValueError(f"{error}".replace(f"{path}", name)) from error


def run_code(files: Code) -> None:
    """Runs Python files of the user's, which register methods of their own."""
    for path in files:
        if not path.is_file():
            raise ValueError(f"{path}: no such file, expected Python that calls sg.register_fill")
        runpy.run_path(str(path))


def check_at_least(option: str, value: int, least: int) -> None:
    """Refuses a number that is too small."""
    if value < least:
        raise ValueError(f"{option} must be at least {least}, got {value}")


def check_at_most(option: str, value: int, most: int) -> None:
    """Refuses a number that no machine has the memory for."""
    if value > most:
        raise ValueError(f"{option} must be at most {most}, got {value}")


def check_output(path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Refuses, before minutes of work, a file that could not be written after them."""
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        expected = " or ".join(suffixes)
        raise ValueError(f"{path}: the name ends in {path.suffix!r}, expected {expected}")
    if path.is_dir() or not (path.parent.is_dir() and os.access(path.parent, os.W_OK)):
        raise ValueError(f"{path}: cannot be written, expected a file in a folder that can")


def print_table(table: Table) -> None:
    """Prints a table; off a terminal it is as wide as it must be, so that no cell is cut."""
    Console(width=None if Console().is_terminal else WIDEST).print(table)


def counted(count: int, noun: str = "graph") -> str:
    """Returns a number with its noun, such as "1 graph" or "3 graphs"."""
    return f"{count} {noun}{'s' * (count != 1)}"
