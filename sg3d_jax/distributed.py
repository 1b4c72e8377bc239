"""Several processes that work on one thing, on one machine or many: who is here, what is whose.

They are JAX's own (`jax.distributed`): each is started with the address of the first one, which
becomes the coordinator, with their number, and with its own number from 0. Slurm, Open MPI and
Kubernetes tell JAX all three. Without any of this a process is alone, and all functions say so.
"""

import itertools
import os
import pickle
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import jax

Item = TypeVar("Item")

ADDRESS_VARIABLE: Final = "JAX_COORDINATOR_ADDRESS"  # JAX's own
CLUSTER: Final = "auto"  # the coordinator that a cluster names
SLOWEST: Final = 7 * 24 * 3600  # seconds that processes may wait for one that is at work
# Seconds that one which ends waits for the others to end, too. They do so together (`part`), but
# where one has failed: then JAX ends them all.
ENDING: Final = 60
_gatherings: Final[Iterator[int]] = itertools.count()  # the same in all processes


def initialise(
    coordinator: str | None = None, num_processes: int | None = None, process_id: int | None = None
) -> None:
    """Joins this process to the others, before JAX computes anything.

    Nothing is done where it is alone, or has joined them before.

    Args:
      coordinator: the address of process 0 and a free port there, such as "10.0.0.1:1234"; "auto"
        for what a cluster says of itself. None for what the environment names, if it does.
      num_processes: how many there are; None if the cluster says.
      process_id: the number of this one, from 0; None if the cluster says.

    Raises:
      ValueError: numbers without a coordinator, an address that is none, numbers that do not fit
        each other, or that nobody says.
    """
    coordinator = coordinator or os.environ.get(ADDRESS_VARIABLE)
    if coordinator is None:
        if (num_processes, process_id) != (None, None):
            problem = f"process {process_id} of {num_processes} has no coordinator"
            raise ValueError(f"{problem}, expected its address, such as 10.0.0.1:1234")
        return
    if jax.distributed.is_initialized():
        return
    if coordinator != CLUSTER and not coordinator.rpartition(":")[2].isdecimal():
        expected = f"an address such as 10.0.0.1:1234, or {CLUSTER}"
        raise ValueError(f"the coordinator is {coordinator!r:.60}, expected {expected}")
    if num_processes is not None and not 0 <= (process_id or 0) < num_processes:
        expected = "a number from 0 that is less than how many there are"
        raise ValueError(f"this is process {process_id} of {num_processes}, expected {expected}")
    address = None if coordinator == CLUSTER else coordinator
    try:
        jax.distributed.initialize(
            address, num_processes, process_id, shutdown_timeout_seconds=ENDING
        )
    except ValueError as error:
        problem = "nobody says how many processes there are, or which this is"
        expected = "both numbers, or a cluster that JAX knows"
        raise ValueError(f"{coordinator}: {problem}, expected {expected}") from error


def is_first() -> bool:
    """Returns whether this process is the one that writes what is written once."""
    return jax.process_index() == 0


def share(items: Sequence[Item]) -> Sequence[Item]:
    """Returns this process's share of what all have: a run of it, so that the runs joined are all.

    Args:
      items: the same in every process.
    """
    here, processes = jax.process_index(), jax.process_count()
    return items[len(items) * here // processes : len(items) * (here + 1) // processes]


def own_file(path: Path) -> Path:
    """Returns the file to which this process writes its share of what is to be in a file.

    The name says which share it is, such as graphs.0-of-2.jsonl, in digits as many as are needed
    for the files to sort as the shares do. A process that is alone writes to the file itself.

    Raises:
      ValueError: it is standard output, which processes cannot share.
    """
    here, processes = jax.process_index(), jax.process_count()
    if processes == 1:
        return path
    if not path.suffix:
        problem = f"cannot hold what {processes} processes write"
        raise ValueError(f"{path}: {problem}, expected the name of a file")
    return path.with_stem(f"{path.stem}.{here:0{len(str(processes - 1))}}-of-{processes}")


def gathered(items: Sequence[Item]) -> list[Item]:
    """Returns the items of all processes, in their order, once all of them have come so far.

    They go through the store of JAX's coordinator, which waits: JAX's own gathering of arrays gives
    up on a CPU after 30 seconds. For results, then, and not for what a training step exchanges.

    Args:
      items: of this process; as they are pickled, so are they had.
    """
    here, processes = jax.process_index(), jax.process_count()
    if processes == 1:
        return list(items)
    store, round_ = _store(), next(_gatherings)
    store.key_value_set_bytes(f"sg3d/{round_}/{here}", pickle.dumps(list(items)))
    of_all = [
        store.blocking_key_value_get_bytes(f"sg3d/{round_}/{process}", 1000 * SLOWEST)
        for process in range(processes)
    ]
    return [item for of_one in of_all for item in pickle.loads(of_one)]


def part() -> None:
    """Waits, at the end of what all do, until all are there; one that has failed never comes."""
    gathered([])


def _store() -> Any:
    """Returns the client of JAX's coordinator, which JAX does not show."""
    from jax._src import distributed

    return distributed.global_state.client
