"""What a run says of itself: JSON lines, TensorBoard if it is installed, a line on the terminal."""

import contextlib
import importlib
import json
import math
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sg3d_jax.io.files import replacing

# (kind, step, values): records scalars under a kind, such as "train" or "validation".
Writer = Callable[[str, int, dict[str, float]], None]


class JsonLines(NamedTuple):
    """Appends one JSON object a record to a file: greppable, and mended by `trim` after a crash."""

    path: Path  # of the file
    started: float  # when the run began, seconds of `time.time`

    def __call__(self, kind: str, step: int, values: dict[str, float]) -> None:
        """Appends the record, with the seconds since this process began; null if not finite.

        Raises:
          OSError: it cannot be written, for example because the disk is full.
        """
        seconds = round(time.time() - self.started, 1)
        known = {name: value if math.isfinite(value) else None for name, value in values.items()}
        record = {"kind": kind, "step": step, "seconds": seconds, **known}
        try:
            with self.path.open("a") as file:
                file.write(json.dumps(record) + "\n")
        except OSError as error:
            raise OSError(f"{self.path}: cannot be written ({error.strerror})") from error


class TensorBoard(NamedTuple):
    """Writes to a tensorboardX summary writer."""

    summary: Any  # a tensorboardX SummaryWriter

    def __call__(self, kind: str, step: int, values: dict[str, float]) -> None:
        """Adds every value as a scalar named kind/name."""
        for name, value in values.items():
            self.summary.add_scalar(f"{kind}/{name}", value, step)

    def close(self) -> None:
        """Ends it and its thread; log.jsonl has all that it has, so a full disk is no error."""
        with contextlib.suppress(OSError):
            self.summary.close()


@contextlib.contextmanager
def writers(directory: Path, step: int) -> Generator[list[Writer]]:
    """Opens the writers of a run directory: log.jsonl always, TensorBoard if at hand.

    They end with the block.

    Args:
      directory: of the run.
      step: that it goes on from; what was recorded of later ones is dropped.
    """
    path = directory / "log.jsonl"
    trim(path, step)
    chosen: list[Writer] = [JsonLines(path, time.time())]
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError):
            tensorboard = importlib.import_module("tensorboardX")
            folder = str(directory / "tensorboard")
            board = TensorBoard(tensorboard.SummaryWriter(folder, purge_step=step + 1))
            stack.callback(board.close)
            chosen.append(board)
        yield chosen


def trim(path: Path, step: int) -> None:
    """Drops the records of steps behind one, which are to be made again, and what is no record.

    One record of each kind and step stays, so that after a crash there are no half lines and no
    steps twice.
    """
    text = path.read_text(errors="replace") if path.exists() else ""
    records = {}
    for line in text.splitlines():
        place = _place(line)
        if place and place[1] <= step:
            records[place] = f"{line}\n"
    if text != (kept := "".join(records.values())):
        with replacing(path) as temporary:
            temporary.write_text(kept)


def _place(line: str) -> tuple[str, int] | None:
    """Returns kind and step of a record; None if it is none."""
    try:
        record = json.loads(line)
        return str(record["kind"]), int(record["step"])
    except (ValueError, TypeError, KeyError):  # cut short, or nothing of ours
        return None


def say_remark(text: str) -> None:
    """Prints a remark on stderr, as the command line does."""
    print(f"sg3d: remark: {text}", file=sys.stderr)


class Display(NamedTuple):
    """The progress of a run on the terminal."""

    progress: Progress  # rich's
    task: Any  # rich's, of the whole run

    def advance(self, step: int, text: str) -> None:
        """Moves the bar to a step; off a terminal, prints one line instead."""
        self.progress.update(self.task, completed=step, text=text)
        if not self.progress.console.is_terminal:
            self.progress.console.print(f"step {step}  {text}", soft_wrap=True)


@contextlib.contextmanager
def display(num_steps: int, step: int) -> Generator[Display]:
    """Shows a bar with rate and remaining time on stderr, or plain lines off a terminal."""
    console = Console(stderr=True)
    text = TextColumn("{task.fields[text]}")
    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), text
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        yield Display(progress, progress.add_task("", total=num_steps, completed=step, text=""))
