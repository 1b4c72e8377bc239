"""How far a command has come: a bar on a terminal, and files that hold what is done when it ends.

Results are written as they come, so a command that is stopped has lost nothing.
"""

import json
import os
import signal
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
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


class _Rate(ProgressColumn):
    """How many are done in a second."""

    def render(self, task: Task) -> Text:
        """Returns the rate, nothing before it is known."""
        return Text(f"{task.speed:.2g}/s" if task.speed else "")


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
def ended_by_sigterm() -> Generator[None]:
    """Ends the block as Ctrl-C does, so that files are closed, with the exit code of a shell."""

    def end(number: int, _: Any) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def lines_to(path: Path, total: int, noun: str = "graph") -> Generator[Callable[[Any], None]]:
    """Gives what writes a document as a line of a file, or of standard output, at once.

    If the block ends before so many are written, however it ends, it is said how many are. SIGTERM
    ends it as Ctrl-C does.

    Raises:
      OSError: the file cannot be written.
    """
    written = 0
    file = sys.stdout if path == STANDARD else path.open("w", encoding="utf-8")

    def write(document: Any) -> None:
        nonlocal written
        try:
            print(json.dumps(document, allow_nan=False), file=file, flush=True)
        except BrokenPipeError:  # nobody reads on; what is left would be tried again at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), file.fileno())
            raise SystemExit(128 + signal.SIGPIPE) from None
        except OSError as error:
            raise OSError(f"{path}: cannot be written ({error.strerror})") from error
        written += 1

    try:
        with ended_by_sigterm():
            yield write
    finally:
        if file is not sys.stdout:
            with suppress(OSError):  # all that was written is flushed; what failed is told
                file.close()
        if written < total:
            done = f"{written} of {counted(total, noun)}"
            print(f"sg3d: {path}: has {done}, all that were done", file=sys.stderr)
