"""How far a command has come: a bar on a terminal, and files that hold what is done when it ends.

Results are written as they come, so a command that is stopped has lost nothing.
"""

import json
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from sg3d_jax.cli.arguments import STANDARD, counted
from sg3d_jax.data.watching import watch


class _Rate(ProgressColumn):
    """How many are done in a second."""

    def render(self, task: Task) -> Text:
        """Returns the rate, nothing before it is known."""
        return Text(rate_text(task.speed))


def rate_text(speed: float | None) -> str:
    """Returns how many are done in a second, with two digits that count."""
    return f"{float(f'{speed:.2g}'):g}/s" if speed else ""


@contextmanager
def progress(total: int, noun: str, quiet: bool = False) -> Generator[Callable[[], None]]:
    """Gives what is called whenever one of so many is done, and shows it.

    On a terminal it is a bar with rate and remaining time, on stderr; elsewhere, or of a single
    one, nothing.
    """
    console = Console(stderr=True)
    hidden = quiet or total < 2 or not console.is_terminal
    columns = TextColumn(noun), BarColumn(), MofNCompleteColumn(), _Rate(), TimeRemainingColumn()
    with Progress(
        *columns, console=console, disable=hidden, transient=True, redirect_stdout=False
    ) as bar:
        task = bar.add_task(noun, total=total)
        yield lambda: bar.advance(task)


@contextmanager
def shown_data(quiet: bool) -> Generator[None]:
    """Shows how far data sets have come that are made in the block, whatever ends it."""
    with ExitStack() as bars:

        def each(items: Sequence[Any], noun: str) -> Iterator[Any]:
            return bars.enter_context(closing(_each_of(items, noun, quiet)))

        token = watch.set(each)
        bars.callback(watch.reset, token)
        yield


def _each_of(items: Sequence[Any], noun: str, quiet: bool) -> Generator[Any]:
    """Yields items, and shows how many are done."""
    with progress(len(items), noun, quiet) as advance:
        for item in items:
            yield item
            advance()


@contextmanager
def lines_to(path: Path, total: int, noun: str = "graph") -> Generator[Callable[[Any], None]]:
    """Gives what writes a document as a line of a file, or of standard output, at once.

    If the block ends before so many are written, however it ends, it is said how many are.

    Raises:
      OSError: the file cannot be written.
    """
    written = 0
    file = sys.stdout if path == STANDARD else path.open("w", encoding="utf-8")

    def write(document: Any) -> None:
        nonlocal written
        try:
            print(json.dumps(document, allow_nan=False), file=file, flush=True)
        except BrokenPipeError:  # nobody reads on
            raise
        except OSError as error:
            raise OSError(f"{path}: cannot be written ({error.strerror})") from error
        written += 1

    try:
        yield write
    finally:
        if file is not sys.stdout:
            with suppress(OSError):  # all that was written is flushed; what failed is told
                file.close()
        if written < total:
            done = f"{written} of {counted(total, noun)}"
            print(f"sg3d: {path}: has {done}, all that were done", file=sys.stderr)
