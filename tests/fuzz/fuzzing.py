"""Files are changed and read: each is refused in one sentence, or is what it ought to be."""

import contextlib
import faulthandler
import resource
import signal
import traceback
import warnings
from collections import Counter
from collections.abc import Generator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from tests.fuzz.files import Kind

SECONDS: Final = 10  # longer is a hang
MEGABYTES: Final = 2048  # more is too much


class Failure(NamedTuple):
    """A file that was neither refused in one sentence nor sound."""

    kind: str
    number: int  # of the case, from which it can be made again
    problem: str  # the last lines of a traceback


class Report(NamedTuple):
    """What became of changed files."""

    outcomes: Counter[tuple[str, str]]  # (kind, "refused" or "accepted")
    failures: list[Failure]
    peak: int  # megabytes that the process has had at most

    @classmethod
    def nothing(cls) -> "Report":
        """Returns the report of no files."""
        return cls(Counter(), [], 0)

    def with_more(self, other: "Report") -> "Report":
        """Returns the report of these files and others."""
        failures = [*self.failures, *other.failures]
        return Report(self.outcomes + other.outcomes, failures, max(self.peak, other.peak))


class HangError(BaseException):
    """What ends a reader that takes too long; no reader catches it."""


def changed(kind: Kind, seed: int, number: int) -> bytes:
    """Returns the content of one case: it depends on the seed, the kind and its number alone."""
    rng = np.random.default_rng([seed, number, *kind.name.encode()])
    mutation = kind.mutations[rng.integers(len(kind.mutations))]
    return mutation(kind.content, rng)


def try_files(kinds: list[Kind], folder: Path, seed: int, first: int, count: int) -> Report:
    """Reads changed files of each kind.

    Args:
      kinds: of files.
      folder: where they are written.
      seed: another seed gives other files.
      first: the number of the first.
      count: how many of each kind.
    """
    outcomes: Counter[tuple[str, str]] = Counter()
    failures = []
    for kind in kinds:
        path = folder / f"changed-{kind.name}"
        for number in range(first, first + count):
            path.write_bytes(changed(kind, seed, number))
            outcome = _outcome(kind, path)
            if outcome not in ("refused", "accepted"):
                failures.append(Failure(kind.name, number, outcome))
            outcomes[kind.name, outcome if len(outcome) < 9 else "failed"] += 1
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return Report(outcomes, failures, peak)


def _outcome(kind: Kind, path: Path) -> str:
    """Returns "refused" or "accepted", or what went wrong."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    try:
        with _limited(), warnings.catch_warnings():
            warnings.simplefilter("error")
            kind.read(path)
    except ValueError as error:
        sentence = str(error)
        if "\n" in sentence or not sentence.startswith(f"{path}"):
            return f"no sentence that names the file: {sentence}"
        outcome = "refused"
    except BaseException:
        return "".join(traceback.format_exc().splitlines(keepends=True)[-9:])
    else:
        outcome = "accepted"
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return outcome if after <= max(before, MEGABYTES) else f"{after} megabytes"


@contextlib.contextmanager
def _limited() -> Generator[None]:
    """Ends what takes too long; what never comes back to Python ends the process and says where."""

    def stop(*_: object) -> None:
        raise HangError(f"more than {SECONDS} seconds")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    faulthandler.dump_traceback_later(3 * SECONDS, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
