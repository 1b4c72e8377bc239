"""Many scenes in compiled batches: buckets by size, lanes of a batch, one key a sample.

What a lane makes of its scene does not depend on the other lanes, nor on how many there are.
"""

import itertools
import operator
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.fill.protocol import Params, Terms
from sg3d_jax.flagg.grow import CAPACITY, Grown, grow_lanes
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.prepare import Scene
from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.padding import NODE_CAPACITIES, Capacity, bucket, stack, unpad

LANES = 256  # scenes that an accelerator grows together at most, and
LANE_NODES = 32_768  # nodes of all of them
MAX_OBSERVED = 1133  # that with what grows from them fit the largest bucket
_programs: Final[set[Any]] = set()  # that this process has compiled
WORD = 32  # bits of a seed that JAX takes at once


@runtime_checkable
class Model(Protocol):
    """What can be trained and completes scenes. It is hashed by what it is built from."""

    @property
    def ontology(self) -> Ontology:
        """The concepts of its graphs."""
        ...

    def init(self, key: Key[Array, ""], graph: SceneGraph) -> Params:
        """Draws initial parameters, given any complete padded graph with proximity edges."""
        ...

    def loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the loss of a training step on one such graph, and its terms."""
        ...


@runtime_checkable
class OneShot(Model, Protocol):
    """A model that completes a scene at once, and not by growing it."""

    def capacity(self, num_observed: int, num_missing: int) -> Capacity:
        """Returns the bucket of a scene."""
        ...

    def complete_lanes(
        self,
        params: Params,
        keys: Key[Array, " B"],
        given: PackedGraph,
        num_missing: Int[Array, " B"],
    ) -> Grown:
        """Completes a stack of observed nodes; an oracle says how many others there are."""
        ...


class Job(NamedTuple):
    """One sample of one scene, as far as it has come."""

    scene: int  # its place in the list
    sample: int  # its number among those of the scene
    graph: SceneGraph  # host graph, centred: what is given, and what was grown in a smaller bucket
    steps: int  # blocks inserted so far


class Finished(NamedTuple):
    """What became of a job, on the host."""

    graph: SceneGraph  # centred; what was given comes first
    halt_reason: int  # index into HALT_REASONS
    steps: int  # blocks inserted


def root_key(seed: int) -> Key[Array, ""]:
    """Returns the key of a seed of any size; seeds below 2^32 are those of `jax.random.key`.

    Raises:
      ValueError: the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"the seed is {seed}, expected 0 or more")
    key = jax.random.key(np.uint32(seed % 2**WORD))
    while seed := seed >> WORD:
        key = jax.random.fold_in(key, np.uint32(seed % 2**WORD))
    return key


def sample_keys(seed: int, scenes: Sequence[int], samples: Sequence[int]) -> Key[Array, " B"]:
    """Returns a key for each (scene, sample) pair, so that neither batch nor count changes any."""

    def one(scene: Array, sample: Array) -> Key[Array, ""]:
        return jax.random.fold_in(jax.random.fold_in(root_key(seed), scene), sample)

    return jax.vmap(one)(jnp.asarray(scenes, jnp.uint32), jnp.asarray(samples, jnp.uint32))


def growth_capacity(num_observed: int, num_given: int = 0) -> Capacity:
    """Returns the bucket in which a scene begins to grow: room for 0.8 nodes a plane, and eight.

    Floors of the benchmark need 0.6 new nodes a plane, cities 0.64 and at most 0.76. A graph that
    outgrows it goes on in the next.

    Args:
      num_observed: observed nodes.
      num_given: all nodes that are given; 0 for the observed ones alone.
    """
    return bucket(max(int(1.8 * num_observed), num_given) + 8)


def largest_capacity(num_observed: int, num_given: int = 0) -> Capacity:
    """Returns the largest bucket in which a scene goes on: room for three nodes a plane.

    That is four times what complete graphs need: a graph beyond it will hardly come to an end.

    Args:
      num_observed: observed nodes.
      num_given: all nodes that are given; 0 for the observed ones alone.
    """
    return bucket(min(max(3 * num_observed, num_given) + 16, NODE_CAPACITIES[-1]))


def num_lanes(capacity: Capacity) -> int:
    """Returns how many scenes of a bucket are grown together by default; one program a bucket.

    A core of a CPU is as fast with one as with eight, and no lane then waits for another.
    """
    if jax.default_backend() == "cpu":
        return 1
    return max(1, min(LANES, LANE_NODES // capacity.nodes))


def num_workers() -> int:
    """Returns how many batches are grown side by side: as many as there are cores, on a CPU."""
    if jax.default_backend() != "cpu":
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def complete_lanes(
    model: Model,
    params: Params,
    scenes: Sequence[Scene],
    draws: Sequence[tuple[int, int]],
    seed: int,
    max_steps: int,
    lanes: int | None = None,
    outgrow: bool = True,
) -> list[Finished]:
    """Completes prepared scenes in batches of one size.

    Args:
      model: grows, or completes at once.
      params: its parameters.
      scenes: of `prepare`.
      draws: what is drawn: the place of a scene in the list, and the number of the sample.
      seed: of `sample_keys`.
      max_steps: a limit on the number of blocks.
      lanes: scenes grown together; None for `num_lanes`. The results do not depend on it.
      outgrow: whether a graph that does not fit goes on in the next bucket, up to
        `largest_capacity`.

    Returns:
      What was drawn, in the order of `draws`.
    """
    waiting: dict[Capacity, list[Job]] = {}
    capacities = [_capacity(model, scene) for scene in scenes]
    for number, sample in draws:
        job = Job(number, sample, scenes[number].centred, 0)
        waiting.setdefault(capacities[number], []).append(job)
    finished: dict[tuple[int, int], Finished] = {}
    while waiting:
        capacity = min(waiting)
        jobs, width = waiting.pop(capacity), lanes or num_lanes(capacity)
        # Neighbours in a batch are of like size, so that they need like numbers of steps.
        jobs.sort(key=lambda job: len(job.graph.nodes.label))
        batches = [jobs[first : first + width] for first in range(0, len(jobs), width)]

        def run(batch: list[Job], capacity: Capacity = capacity, width: int = width) -> Any:
            padded = [*batch, *[batch[-1]] * (width - len(batch))]  # idle lanes repeat the last
            missing = [scenes[job.scene].num_missing for job in padded]
            return _run(model, params, padded, missing, capacity, seed, max_steps)

        program = model, capacity, width, max_steps
        results = _side_by_side(run, batches, first_alone=program not in _programs)
        _programs.add(program)
        for job, result in zip(jobs, itertools.chain(*results), strict=False):
            if result.halt_reason == CAPACITY and outgrow and capacity < _most(scenes[job.scene]):
                larger = bucket(capacity.nodes + 1)
                later = Job(job.scene, job.sample, result.graph, result.steps)
                waiting.setdefault(larger, []).append(later)
            else:
                finished[job.scene, job.sample] = result
    return [finished[draw] for draw in draws]


def _side_by_side(
    run: Callable[[list[Any]], list[Any]], batches: Sequence[list[Any]], first_alone: bool
) -> list[list[Any]]:
    """Runs batches in threads, on request the first alone, so that a program is compiled once.

    What JAX is told for one thread, such as by `jax.default_device`, is so in all.
    """
    number = int(first_alone)
    results = [run(batch) for batch in batches[:number]]
    told: Any = jax.config
    device, checks = told.jax_default_device, told.jax_debug_key_reuse

    def as_here(batch: list[Any]) -> list[Any]:
        with jax.default_device(device), jax.debug_key_reuse(checks):
            return run(batch)

    pool = ThreadPoolExecutor(num_workers())
    try:
        return [*results, *pool.map(as_here, batches[number:])]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # after Ctrl-C nothing more is begun


def _capacity(model: Model, scene: Scene) -> Capacity:
    """Returns the bucket in which a scene begins."""
    nodes = scene.centred.nodes
    num_observed = int(np.sum(nodes.observed))
    try:
        if isinstance(model, OneShot):
            return model.capacity(num_observed, scene.num_missing)
    except ValueError as error:
        raise ValueError(f"{scene.where}: {error}") from error
    try:
        return growth_capacity(num_observed, len(nodes.label))
    except ValueError as error:
        held = f"{num_observed} {model.ontology.observed_plural}, with their pieces"
        most = f"{MAX_OBSERVED} among {NODE_CAPACITIES[-1] - 8}"
        problem = f"there are {held}, among {len(nodes.label)} nodes, expected at most {most}"
        raise ValueError(f"{scene.where}: {problem}") from error


def _most(scene: Scene) -> Capacity:
    """Returns the largest bucket of a scene."""
    nodes = scene.centred.nodes
    return largest_capacity(int(np.sum(nodes.observed)), len(nodes.label))


def _run(
    model: Model,
    params: Params,
    jobs: Sequence[Job],
    num_missing: Sequence[int],
    capacity: Capacity,
    seed: int,
    max_steps: int,
) -> list[Finished]:
    """Runs the jobs of one batch in one call."""
    keys = sample_keys(seed, [job.scene for job in jobs], [job.sample for job in jobs])
    given = stack([job.graph for job in jobs], capacity)
    if isinstance(model, Flagg):
        steps = jnp.asarray([job.steps for job in jobs], jnp.int32)
        nodes = given.nodes  # a graph of observed nodes alone is not asked about: one program less
        ask_first = bool(np.any(nodes.mask & ~nodes.observed & (np.asarray(steps) == 0)[:, None]))
        grown = grow_lanes(model, params, keys, given, steps, max_steps, ask_first)
    elif isinstance(model, OneShot):
        grown = model.complete_lanes(params, keys, given, jnp.asarray(num_missing, jnp.int32))
    else:
        raise TypeError(f"{type(model).__name__} neither grows nor completes at once")
    grown = jax.tree.map(np.asarray, grown)
    return [_unstacked(jax.tree.map(operator.itemgetter(i), grown)) for i in range(len(jobs))]


def _unstacked(grown: Any) -> Finished:
    return Finished(unpad(grown.graph), int(grown.halt_reason), int(grown.steps))
