"""Checkpoints of a run: the latest two, to go on from, and the best by validation FGW, to use.

The only file that knows orbax. Its `best_fn` with `max_to_keep` deletes the newest checkpoint
(orbax issue 526), so they are kept by name here. Each has a digest of its files. One that is not
what its digest says, or cannot be read, is set aside in the folder `damaged` beside the others; as
the latest may be that one, after a power cut for example, the one before it stays, too.
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

from sg3d_jax.io.files import replacing, sync
from sg3d_jax.train.step import TrainState

DIGEST: Final = "digest"  # the file of it in the folder of a checkpoint
PATIENCE: Final = 1.0  # seconds in which all writes fail, once one has


class Kept(NamedTuple):
    """A checkpoint that is there and sound."""

    step: int  # of the run
    fgw: float  # of its validation


class Checkpoints(NamedTuple):
    """The open checkpoints of one run."""

    manager: Any  # ocp.training.Checkpointer
    directory: Path  # theirs
    damaged: list[str]  # names of those that were found so, and set aside


def open_checkpoints(directory: Path, template: TrainState) -> Checkpoints:
    """Opens, or begins, the checkpoints of a run, without those that are damaged.

    Args:
      directory: theirs; no other process writes there.
      template: a state of the same shapes; its values do not matter.
    """
    directory = directory.resolve()
    for unfinished in directory.glob("*.orbax-checkpoint-tmp"):  # of a process that was killed
        shutil.rmtree(unfinished)
    damaged = [path for path in _folders(directory) if not _is_sound(path, template)]
    for path in damaged:
        _set_aside(path)
    policies: Any = ocp.training.preservation_policies
    best = policies.BestN(n=1, get_metric_fn=lambda metrics: metrics["fgw"], reverse=True)
    keep = policies.AnyPreservationPolicy([policies.LatestN(2), best])
    with _quiet():
        manager = ocp.training.Checkpointer(str(directory), preservation_policy=keep)
    return Checkpoints(manager, directory, [path.name for path in damaged])


def save(checkpoints: Checkpoints, state: TrainState, fgw: float) -> None:
    """Saves the state under its step; orbax writes to a temporary name and renames.

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
        with _quiet():
            saved = {"state": state}
            checkpoints.manager.save_checkpointables(step, saved, metrics={"fgw": fgw})
        for written in (*path.rglob("*"), path.parent):
            sync(written)
        digest = _digest(path)
        with replacing(path / DIGEST) as temporary:
            temporary.write_text(digest)
    except Exception as error:  # orbax raises almost anything
        raise OSError(
            f"{path}: the checkpoint could not be written ({_reason(error)}); those before it are "
            "untouched"
        ) from error


def steps(checkpoints: Checkpoints) -> list[Kept]:
    """Returns what is kept, oldest first."""
    return [Kept(kept.step, kept.metrics["fgw"]) for kept in checkpoints.manager.checkpoints]


def restore(checkpoints: Checkpoints, template: TrainState, step: int) -> TrainState:
    """Loads the state of one step.

    Args:
      checkpoints: of the run.
      template: a state of the same shapes; its values do not matter.
      step: one that is kept.
    """
    loaded = _load(checkpoints.directory / str(step), template)
    return jax.tree.map(jnp.asarray, loaded)  # on no device in particular, as a new state


def close(checkpoints: Checkpoints) -> None:
    """Closes; what could not be written has been said by `save`, and orbax says it once more."""
    with _quiet(), contextlib.suppress(Exception):
        checkpoints.manager.close()


def _folders(directory: Path) -> list[Path]:
    """Returns what orbax takes for checkpoints, oldest first."""
    folders = directory.iterdir() if directory.is_dir() else ()
    return sorted((path for path in folders if path.name.isdecimal()), key=lambda p: int(p.name))


def _is_sound(path: Path, template: TrainState) -> bool:
    """Returns whether a checkpoint is what its digest says and can be read.

    One without a digest, of an earlier version or of a process that was killed just before it
    wrote it, is taken if it can be read.
    """
    try:
        digest = path / DIGEST
        if digest.exists() and digest.read_text() != _digest(path):
            return False
        fgw = json.loads((path / "metrics" / "metrics").read_text())["fgw"]
        with _quiet():
            step = int(_load(path, template).step)
        return not math.isnan(fgw) and path.name == str(step)
    except Exception:  # a damaged checkpoint raises almost anything
        return False


def _digest(path: Path) -> str:
    """Returns a digest of the files of a checkpoint, by their names and bytes."""
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(path.rglob("*")):
        if file.is_file() and file != path / DIGEST:
            name = file.relative_to(path).as_posix().encode()
            digest.update(name + b"\0" + file.read_bytes())
    return digest.hexdigest()


def _load(path: Path, template: TrainState) -> TrainState:
    """Loads the state of a checkpoint as arrays of the host."""
    abstract = jax.tree.map(np.asarray, template)
    return ocp.load_checkpointables(str(path), {"state": abstract})["state"]


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
