"""Checkpoints of a run: the latest two, to go on from, and the best by validation FGW, to use.

The only file that knows orbax, and of that only how a state is written and read: its own keeper of
checkpoints deletes the newest (orbax issue 526). A checkpoint gets its name when it is whole, with
a digest of its files. One that is no longer what that says is set aside in the folder `damaged`
beside the others; as the latest may be that one, after a power cut for example, the one before it
stays, too.

Of several processes the first alone comes here, but for `restore` and `write_state`: orbax has all
processes read and write together, and as often as one another.
"""

import contextlib
import hashlib
import itertools
import json
import logging
import math
import os
import re
import shutil
import sys
import time
import warnings
from collections.abc import Generator
from pathlib import Path
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from orbax.checkpoint import v1 as ocp

from sg3d_jax.io.files import sync
from sg3d_jax.train.step import TrainState

METRICS: Final = "metrics/metrics"  # the file of them in the folder of a checkpoint,
DIGEST: Final = "digest"  # and that of its digest, which is written last
UNFINISHED: Final = ".unfinished"  # ends the name of a folder that is not whole yet, or no longer
LATEST: Final = 2  # how many of them are kept
PATIENCE: Final = 1.0  # seconds in which all writes fail, once one has


class Kept(NamedTuple):
    """A checkpoint that is there and sound."""

    step: int  # of the run
    fgw: float  # of its validation


class Checkpoints(NamedTuple):
    """The open checkpoints of one run."""

    directory: Path  # theirs
    damaged: tuple[str, ...] = ()  # names of those that were found so, and set aside


def open_checkpoints(directory: Path) -> Checkpoints:
    """Opens, or begins, the checkpoints of a run, without those that are damaged.

    Args:
      directory: theirs; no other run writes there.
    """
    directory.mkdir(parents=True, exist_ok=True)
    _remove_unfinished(directory)
    damaged = [path for path in _folders(directory) if not _is_sound(path)]
    for path in damaged:
        _set_aside(path)
    return Checkpoints(directory, tuple(path.name for path in damaged))


def save(checkpoints: Checkpoints, state: TrainState, fgw: float) -> None:
    """Saves the state under its step, and removes what need not be kept.

    Args:
      checkpoints: of the run.
      state: of the run.
      fgw: of its validation; not a number is the worst.

    Raises:
      OSError: it cannot be written, for example because the disk is full.
    """
    step, fgw = int(state.step), math.inf if math.isnan(fgw) else float(fgw)
    path = checkpoints.directory / str(step)
    try:
        temporary = write_state(checkpoints, state)
        (temporary / METRICS).parent.mkdir()
        (temporary / METRICS).write_text(json.dumps({"step": step, "fgw": fgw}))
        (temporary / DIGEST).write_text(_digest(temporary))
        for written in (*temporary.rglob("*"), temporary):
            sync(written)
        temporary.rename(path)
        sync(path.parent)
    except Exception as error:  # orbax raises almost anything
        _remove_unfinished(path.parent)
        raise OSError(
            f"{path}: the checkpoint could not be written ({_reason(error)}); those before it are "
            "untouched"
        ) from error
    _remove_needless(checkpoints)


def write_state(checkpoints: Checkpoints, state: TrainState) -> Path:
    """Writes a state, once for all processes, to what is a part of a checkpoint; returns where."""
    path = checkpoints.directory.resolve() / f"{int(state.step)}{UNFINISHED}"
    with _quiet():
        ocp.save_checkpointables(str(path), {"state": jax.tree.map(np.asarray, state)})
    return path


def steps(checkpoints: Checkpoints) -> list[Kept]:
    """Returns what is kept, oldest first."""
    return [Kept(int(path.name), _metrics(path)["fgw"]) for path in _folders(checkpoints.directory)]


def restore(checkpoints: Checkpoints, template: TrainState, step: int) -> TrainState:
    """Loads the state of one step.

    Args:
      checkpoints: of the run.
      template: a state of the same shapes; its values do not matter.
      step: one that is kept.
    """
    path, abstract = checkpoints.directory / str(step), jax.tree.map(np.asarray, template)
    with _quiet():
        loaded = ocp.load_checkpointables(str(path.resolve()), {"state": abstract})["state"]
    return jax.tree.map(jnp.asarray, loaded)  # on no device in particular, as a new state


def _remove_needless(checkpoints: Checkpoints) -> None:
    """Removes what is neither among the latest nor the best, of equals the first."""
    kept = steps(checkpoints)
    best = min(kept, key=lambda one: one.fgw)
    for one in kept[:-LATEST]:
        if one != best:
            path = checkpoints.directory / str(one.step)
            path.rename(path.with_name(f"{path.name}{UNFINISHED}"))
    _remove_unfinished(checkpoints.directory)


def _remove_unfinished(directory: Path) -> None:
    """Removes what is not whole, as of a process that was killed."""
    for pattern in (f"*{UNFINISHED}", "*.orbax-checkpoint-tmp"):
        for path in directory.glob(pattern):
            shutil.rmtree(path)


def _folders(directory: Path) -> list[Path]:
    """Returns the checkpoints, sound or not, oldest first."""
    folders = directory.iterdir() if directory.is_dir() else ()
    return sorted((path for path in folders if path.name.isdecimal()), key=lambda p: int(p.name))


def _is_sound(path: Path) -> bool:
    """Returns whether a checkpoint is what its digest says; earlier versions wrote none."""
    try:
        digest = path / DIGEST
        if digest.exists() and digest.read_text() != _digest(path):
            return False
        metrics = _metrics(path)
        return not math.isnan(metrics["fgw"]) and path.name == str(metrics.get("step", path.name))
    except (OSError, ValueError, TypeError, KeyError):  # a file is missing, or not what we wrote
        return False


def _metrics(path: Path) -> dict[str, Any]:
    """Returns what a checkpoint says of itself: its step, if it is no older, and its score."""
    return json.loads((path / METRICS).read_text())


def _digest(path: Path) -> str:
    """Returns a digest of the files of a checkpoint, by their names and bytes."""
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(path.rglob("*")):
        if file.is_file() and file != path / DIGEST:
            name = file.relative_to(path).as_posix().encode()
            digest.update(name + b"\0" + file.read_bytes())
    return digest.hexdigest()


def _set_aside(path: Path) -> None:
    """Moves a damaged checkpoint to where it is in nobody's way."""
    folder = path.parent.with_name("damaged")
    folder.mkdir(exist_ok=True)
    names = (f"{path.name}-{number}" for number in itertools.count(1))
    path.rename(next(folder / name for name in names if not (folder / name).exists()))


def _reason(error: Exception) -> str:
    """Returns what the system said, which orbax hides in lines of its own."""
    code = re.search(r"os_error_code='(\d+)'", str(error))
    if code:
        return os.strerror(int(code[1]))
    return getattr(error, "strerror", None) or str(error).partition("\n")[0]


@contextlib.contextmanager
def _quiet() -> Generator[None]:
    """Keeps from stderr the thousand lines that orbax prints of what it raises as well."""
    logger = logging.getLogger("absl")
    level, hook = logger.level, sys.unraisablehook
    logger.setLevel(logging.CRITICAL + 1)
    sys.unraisablehook = lambda unraisable: None
    try:
        yield
    except Exception:
        warnings.filterwarnings("ignore", "coroutine .* was never awaited")  # said at the very end
        time.sleep(PATIENCE)
        raise
    finally:
        logger.setLevel(level)
        sys.unraisablehook = hook
