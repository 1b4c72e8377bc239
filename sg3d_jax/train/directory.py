"""What a run directory says of its run: what it is, what it was made of, and who works in it.

`config.json` is the configuration, `origins.jsonl` what else the weights depend on: data, code and
machine, a line for each change, with the step from which on it holds. `lock` names the process that
trains.
"""

import contextlib
import dataclasses
import json
import os
import socket
import sys
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any, Final

import jax

from sg3d_jax import origin
from sg3d_jax.io.files import field, number, read_documents, replacing, write_documents
from sg3d_jax.train.config import Config, from_dict, to_json

CONFIG: Final = "config.json"
ORIGINS: Final = "origins.jsonl"
LOCK: Final = "lock"

# What must be the same for a run to go on bit for bit; the rest of an origin tells people where
# to find it again.
COMPARED: Final = ("code", "jax", "device", "training", "validation")


@contextlib.contextmanager
def held(directory: Path) -> Generator[None]:
    """Makes a run directory, and keeps other processes out of it during the block.

    The lock is the kernel's: it is gone however the process ends, while the file stays. Where there
    is no such lock, on Windows and on some network file systems, processes are not kept apart.
    Folders that were made are removed again if nothing was begun in them.

    Raises:
      ValueError: another process trains in it; the sentence says which.
    """
    made = [path for path in (directory, *directory.parents) if not path.exists()]
    directory.mkdir(parents=True, exist_ok=True)
    lock = directory / LOCK
    with lock.open("ab+", buffering=0) as file:
        if not _locked(file):
            file.seek(0)
            holder = file.read().decode(errors="replace").strip() or "another process"
            raise ValueError(f"{directory}: {holder} is training in it, expected it to have ended")
        try:
            file.truncate(0)
            file.write(f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        except OSError as error:
            raise OSError(f"{lock}: cannot be written ({error.strerror})") from error
        try:
            yield
        finally:
            if list(directory.iterdir()) == [lock]:
                lock.unlink()
                with contextlib.suppress(OSError):  # somebody has begun something meanwhile
                    for path in made:
                        path.rmdir()


def _locked(file: Any) -> bool:
    """Takes the lock of an open file; returns False if another process has it."""
    if sys.platform == "win32":
        return True
    import fcntl  # not on Windows

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def check_same_run(directory: Path, config: Config) -> int | None:
    """Refuses a directory that holds the run of another configuration; it may have fewer steps.

    Returns:
      The steps of the run that is there; None if there is none.

    Raises:
      ValueError: the configurations differ.
    """
    path = directory / CONFIG
    if not path.exists():
        return None
    ((_, there),) = read_documents(path)
    here = json.loads(to_json(config))
    steps = field(there, "steps", f"{path}")
    with contextlib.suppress(ValueError):  # what is newer than the run has its default
        before = from_dict(there)
        if before.ontology == config.ontology:  # but for how its concepts are drawn
            before = dataclasses.replace(before, ontology=config.ontology)
        there = json.loads(to_json(before))
    is_longer = isinstance(steps, int) and steps < config.steps
    changed = _changes(there | ({"steps": config.steps} if is_longer else {}), here)
    if changed:
        listed = "; ".join(f"{name} {old} there, {new} here" for name, old, new in changed)
        raise ValueError(f"{path}: the run has another configuration: {listed}")
    return steps


def origin_of(data: Mapping[str, str]) -> dict[str, str]:
    """Returns what a run depends on beside its configuration.

    Args:
      data: digests of the graphs, by what they are for.
    """
    return {
        "version": origin.VERSION,
        "commit": origin.commit(),
        "code": origin.code(),
        "jax": jax.__version__,
        "device": jax.devices()[0].device_kind,
        **data,
    }


def changes_of_origin(directory: Path, here: Mapping[str, str]) -> list[str] | None:
    """Lists in words what a run would go on with that is not what it was last made of.

    Args:
      directory: of the run.
      here: `origin_of` what it would go on with.

    Returns:
      Nothing for a new run; None for one of an earlier version, which does not say.
    """
    path = directory / ORIGINS
    if not path.exists():
        return None if (directory / CONFIG).exists() else []
    there = _origins(path)[-1]
    changed = [name for name in COMPARED if there.get(name) != here[name]]
    shown = ["commit", *changed] if "code" in changed else changed
    return [f"{name} {there.get(name)} there, {here[name]} here" for name in shown]


def write_run(directory: Path, config: Config, here: Mapping[str, str], step: int) -> None:
    """Writes the configuration of a run, and its origins from a step on if they have changed.

    Args:
      directory: of the run.
      config: of the run; its steps give the schedule of the learning rate.
      here: `origin_of` it.
      step: that it goes on from.
    """
    path, new = directory / ORIGINS, {"step": step, "steps": config.steps, **here}
    rows = _origins(path) if path.exists() else []
    before = [row for row in rows if row["step"] < step]  # later ones are made again
    if not before or before[-1] != new | {"step": before[-1]["step"]}:
        before.append(new)
    if before != rows:
        write_documents(path, before)
    with replacing(directory / CONFIG) as temporary:  # last: a run that has one has origins
        temporary.write_text(to_json(config) + "\n")


def _origins(path: Path) -> list[dict[str, Any]]:
    """Reads the lines of origins, each with its step."""
    rows = list(read_documents(path))
    for where, row in rows:
        number(field(row, "step", where), f"{where}: step")
    return [row for _, row in rows]


def _changes(there: dict[str, Any], here: dict[str, Any], prefix: str = "") -> list[tuple]:
    """Lists the fields in which two nested dictionaries differ."""
    found = []
    for name in sorted(there.keys() | here.keys()):
        old, new = there.get(name), here.get(name)
        if isinstance(old, dict) and isinstance(new, dict):
            found += _changes(old, new, f"{prefix}{name}.")
        elif old != new:
            found.append((f"{prefix}{name}", old, new))
    return found
