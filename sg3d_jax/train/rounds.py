"""Training sets that are drawn anew while training goes on, a round ahead, on the host's cores.

A round is `Config.fresh_every` steps. In each, all that is drawn of the data is drawn anew: graphs
that are generated, and views. What a round has follows from the configuration and its number alone,
so a run that is cut short goes on with the graphs that it would have had. Every round has stacks of
the shapes of the first (`stacks_like`), so nothing is compiled again; and what a model knows of its
training set is that of the first.
"""

import contextlib
import dataclasses
import itertools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any, Final, NamedTuple

import jax

from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.train.config import Config, DataConfig
from sg3d_jax.train.dataset import numbered_parts, stacks_like, training_set
from sg3d_jax.train.log import say_remark

Job = tuple[Any, ...]  # what `training_set` is asked for
Make = Callable[[Sequence[Job]], list[list[SceneGraph]]]  # does jobs
LESS_URGENT: Final = (
    10  # by how much a worker gives way to training, which in time must wait for it
)


class Round(NamedTuple):
    """What is trained on for some steps."""

    stacks: list[PackedGraph]  # training graphs by size
    until: int  # the step that it ends with


def rounds(config: Config, stacks: list[PackedGraph], step: int) -> Generator[Round]:
    """Yields the rounds of a run to its end; the next one is drawn while one is trained on.

    Args:
      config: of the run.
      stacks: of the first round of the run.
      step: that the run goes on from; it is of the first round that is yielded.
    """
    length = config.fresh_every
    if length is None:
        yield Round(stacks, config.steps)
        return
    with ThreadPoolExecutor(1) as ahead, workers() as make:

        def begin(number: int) -> Future[list[PackedGraph]]:
            return ahead.submit(_drawn, make, config, stacks, number)

        coming = None
        while step < config.steps:
            number = step // length
            step = min((number + 1) * length, config.steps)
            present = (coming or begin(number)).result()
            coming = begin(number + 1) if step < config.steps else None
            yield Round(present, step)


def _drawn(make: Make, config: Config, stacks: list[PackedGraph], number: int) -> list[PackedGraph]:
    """Returns the stacks of a round, which have the shapes of those of the first."""
    if number == 0:
        return stacks
    graphs = made_side_by_side(make, config.data.anew(number), config.method)
    made, too_large = stacks_like(graphs, stacks)
    if too_large:
        say_remark(
            f"{config.data.label}: {too_large} of the {len(graphs)} graphs that were drawn anew "
            f"for the steps from {number * (config.fresh_every or 0)} are left out, because they "
            "are larger than those before"
        )
    return made


def made_side_by_side(make: Make, data: DataConfig, *methods: str) -> list[SceneGraph]:
    """Returns what `training_graphs` does; each view of a set is a job of its own.

    Args:
      make: of `workers`.
      data: which data sets.
      *methods: see `load_split`.

    Raises:
      ValueError: see `load_split`.
      MemoryError: a worker was killed.
    """
    jobs = [
        (dataclasses.replace(part, views=1), before * part.views + view, *methods)
        for part, before in numbered_parts(data)
        for view in range(part.views if "@" in part.name else 1)
    ]
    return list(itertools.chain.from_iterable(make(jobs)))


@contextlib.contextmanager
def workers() -> Generator[Make]:
    """Yields what does jobs in processes, as many as cores; they end with the block.

    They begin by importing the program that this is, as all do that Python spawns: a script must
    have what it does under `if __name__ == "__main__"`.
    """
    context, own = multiprocessing.get_context("spawn"), threading.local()
    begun: list[multiprocessing.process.BaseProcess] = []

    def begin() -> None:
        own.end, of_worker = context.Pipe()
        worker = context.Process(target=_work, args=(of_worker,), daemon=True)
        worker.start()
        of_worker.close()  # the worker has it: where that is gone, nobody answers
        begun.append(worker)

    def made(job: Job) -> list[SceneGraph]:
        try:
            own.end.send(job)
            graphs, error = own.end.recv()
        except (EOFError, OSError) as ended:
            problem = f"{job[0].label}: the process that made graphs has ended"
            raise MemoryError(f"{problem}, expected memory for one a core") from ended
        if error is not None:
            raise error
        return graphs

    threads = ThreadPoolExecutor(os.cpu_count(), initializer=begin)  # each has a worker
    try:
        yield lambda jobs: list(threads.map(made, jobs))
    finally:
        for worker in begun:
            worker.terminate()
        threads.shutdown(wait=False, cancel_futures=True)


def _work(asked: Connection) -> None:
    """Does jobs in a process of its own, until nobody is there to ask, if only by a kill.

    It leaves devices alone, and gives way to all else.
    """
    jax.config.update("jax_platforms", "cpu")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal; who asks is told, too
    if hasattr(os, "nice"):  # not on Windows
        os.nice(LESS_URGENT)
    with contextlib.suppress(EOFError, OSError):
        while True:
            asked.send(_answer(asked.recv()))


def _answer(job: Job) -> tuple[list[SceneGraph], Exception | None]:
    """Returns the graphs of a job, or why there are none."""
    try:
        return training_set(*job), None
    except Exception as error:
        return [], error
