"""Many scenes in compiled batches: buckets by size, lanes of a batch, one key a sample.

What a lane makes of its scene depends neither on the other lanes nor on how many there are, nor on
threads and devices. Scenes are begun in order, some ahead of those that are done, so that results
come while others are grown, and no more is kept than of those under way.
"""

import operator
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from typing import Any, Final, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.fill.protocol import Params, Terms
from sg3d_jax.flagg.compiled import give_back_memory, own_types
from sg3d_jax.flagg.grow import CAPACITY, Grown, grow_lanes
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.arguments import check_shapes
from sg3d_jax.infer.devices import LANES, lane_mesh, num_lanes, num_workers
from sg3d_jax.infer.prepare import Scene
from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.padding import (
    NODE_CAPACITIES,
    Capacity,
    bucket,
    centre_of_observed,
    moved_by,
    pad,
    stack,
    unpad,
)

QUEUE = 4  # scenes that each of several lanes takes in one call, one after another
BEGUN = 16  # scenes under way for each core of a CPU
MAX_OBSERVED = 1133  # that with what grows from them fit the largest bucket
_programs: Final[set[Any]] = set()  # that this process has compiled
WORD = 32  # bits of a seed that JAX takes at once
# Context managers of JAX that count for one thread alone, each of an option of the same name.
TOLD: Final = (
    *("default_device", "default_matmul_precision", "default_prng_impl"),
    *("enable_x64", "numpy_dtype_promotion", "numpy_rank_promotion", "disable_jit"),
    *("debug_nans", "debug_infs", "debug_key_reuse", "check_tracer_leaks", "log_compiles"),
)


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


Result = TypeVar("Result")
# How a scene is completed: it yields the numbers of the samples that it needs, is sent what became
# of them, perhaps asks for more, and returns what it makes of them all.
Course = Generator[Sequence[int], Sequence[Finished], Result]


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
    pairs = (np.asarray(numbers, np.uint32) for numbers in (scenes, samples))
    return _folded_in(root_key(seed), *pairs)


@jax.jit
def _folded_in(root: Key[Array, ""], scenes: Array, samples: Array) -> Key[Array, " B"]:
    def one(scene: Array, sample: Array) -> Key[Array, ""]:
        return jax.random.fold_in(jax.random.fold_in(root, scene), sample)

    return jax.vmap(one)(scenes, samples)


def growth_capacity(num_observed: int, num_given: int = 0) -> Capacity:
    """Returns the bucket in which a scene begins to grow: room for 0.8 nodes a plane, and eight.

    Floors of the benchmark need 0.6 new nodes a plane, cities 0.64 and at most 0.76. A graph that
    outgrows it goes on in the next.

    Args:
      num_observed: observed nodes.
      num_given: all nodes that are given; 0 for the observed ones alone.
    """
    return bucket(max(int(1.8 * num_observed), num_given) + 8)


def padded_around(
    graph: SceneGraph, capacity: Capacity | None = None
) -> tuple[PackedGraph, np.ndarray]:
    """Pads a complete host graph, moved to the centre of what is observed, and returns that, too.

    Args:
      graph: unpadded.
      capacity: None for the bucket in which it begins to grow, or the next that holds it.
    """
    nodes, centre = graph.nodes, centre_of_observed(graph)
    if capacity is None:
        capacity = max(bucket(len(nodes.label)), growth_capacity(int(np.sum(nodes.observed))))
    return pad(moved_by(graph, -centre), capacity), centre


def largest_capacity(num_observed: int, num_given: int = 0) -> Capacity:
    """Returns the largest bucket in which a scene goes on: room for 1.25 nodes a plane, and 16.

    Of what is drawn and of real plans, as a robot sees them, too, no complete graph needs more than
    0.75, and eight: one beyond this repeats itself and would not come to an end.

    Args:
      num_observed: observed nodes.
      num_given: all nodes that are given; 0 for the observed ones alone.
    """
    return bucket(min(max(9 * num_observed // 4, num_given) + 16, NODE_CAPACITIES[-1]))


def complete_lanes(
    model: Model,
    params: Params,
    scenes: Sequence[Scene],
    course: Callable[[Scene], Course[Result]],
    seed: int,
    max_steps: int,
    numbers: Sequence[int] | None = None,
    lanes: int | None = None,
    outgrow: bool = True,
    draws: int = 1,
) -> Generator[Result]:
    """Completes prepared scenes in batches of one size.

    Args:
      model: grows, or completes at once.
      params: its parameters.
      scenes: of `prepare`.
      course: how a scene is completed.
      seed: of `sample_keys`.
      max_steps: a limit on the number of blocks.
      numbers: of the scenes, for `sample_keys`; None for their places in the list.
      lanes: scenes that a device grows together; None for `num_lanes`. Results do not depend on it,
        but for rounding.
      outgrow: whether a graph that does not fit goes on in the next bucket, up to
        `largest_capacity`.
      draws: samples that a scene asks for at once, to tell how many lanes suit.

    Returns:
      What becomes of the scenes, in order, each as soon as it and those before it are done.

    Raises:
      ValueError: a scene exceeds the largest bucket; nothing is begun.
    """
    capacities = [_capacity(model, scene) for scene in scenes]
    mesh = lane_mesh() if isinstance(model, Flagg) else None
    if mesh is not None:
        params = jax.device_put(params, NamedSharding(mesh, PartitionSpec()))
    numbers = range(len(scenes)) if numbers is None else numbers
    count = draws * len(scenes)
    runner = _Runner(model, params, scenes, numbers, seed, max_steps, lanes, count, mesh)
    return _in_order(_Work(runner, capacities, course, outgrow), len(scenes))


class _Runner(NamedTuple):
    """What is the same for all batches of one call."""

    model: Model
    params: Params
    scenes: Sequence[Scene]
    numbers: Sequence[int]  # of the scenes, for their keys
    seed: int
    max_steps: int
    lanes: int | None  # of a device; None for `num_lanes`
    count: int  # graphs that are asked for at once, of all scenes
    mesh: Mesh | None  # devices; None for one

    @property
    def devices(self) -> int:
        """How many devices share a batch."""
        return 1 if self.mesh is None else self.mesh.size

    def width(self, capacity: Capacity) -> int:
        """Returns how many scenes of a bucket a device grows together."""
        return self.lanes or num_lanes(capacity, -(-self.count // self.devices))

    def size(self, capacity: Capacity) -> int:
        """Returns how many scenes of a bucket are a full batch."""
        width, is_queue = self.width(capacity), isinstance(self.model, Flagg)
        return width * self.devices * (QUEUE if is_queue and width > 1 else 1)

    def program(self, capacity: Capacity) -> Any:
        """Returns what a compiled program of a bucket is known by."""
        return self.model, capacity, self.width(capacity), self.mesh

    def run(self, capacity: Capacity, jobs: Sequence[Job]) -> list[Finished]:
        """Runs a batch in one call; those that are no full one are filled up.

        What is dealt to devices are runs of the batch, so the jobs are dealt to those, and fillers
        come last in each. They repeat a job, but are not grown: they have had all their steps.
        """
        size = self.size(capacity)
        order = np.arange(size).reshape(-1, self.devices).T.ravel()
        filled = [*jobs, *[jobs[-1]._replace(steps=self.max_steps)] * (size - len(jobs))]
        filled = [filled[index] for index in order.tolist()]
        keys = sample_keys(
            self.seed, [self.numbers[job.scene] for job in filled], [job.sample for job in filled]
        )
        with own_types():  # for models that complete at once; growing sees to it by itself
            given = stack([job.graph for job in filled], capacity)
            try:
                grown = jax.tree.map(np.asarray, self._completed(capacity, filled, keys, given))
            except Exception:
                check_shapes(self.model, self.params, jax.tree.map(lambda leaf: leaf[0], given))
                raise
        places = np.argsort(order)[: len(jobs)]
        return [_unstacked(jax.tree.map(operator.itemgetter(i), grown)) for i in places.tolist()]

    def _completed(
        self,
        capacity: Capacity,
        jobs: Sequence[Job],
        keys: Key[Array, " B"],
        given: PackedGraph,
    ) -> Grown:
        """Completes a full batch."""
        if isinstance(self.model, Flagg):
            steps = np.asarray([job.steps for job in jobs], np.int32)
            # Observed nodes alone are not asked about: one program less.
            ask_first = any(job.steps == 0 and not _is_observed(job.graph).all() for job in jobs)
            lanes = self.width(capacity)
            limits = self.max_steps, ask_first, lanes, self.mesh
            return grow_lanes(self.model, self.params, keys, given, steps, *limits)
        if isinstance(self.model, OneShot):
            missing = [self.scenes[job.scene].num_missing for job in jobs]
            missing = jnp.asarray(missing, jnp.int32)
            return self.model.complete_lanes(self.params, keys, given, missing)
        raise TypeError(f"{type(self.model).__name__} neither grows nor completes at once")


class _Work:
    """Scenes that are begun: the samples that they wait for, and the batches under way."""

    def __init__(
        self,
        runner: _Runner,
        capacities: Sequence[Capacity],
        course: Callable[[Scene], Course],
        outgrow: bool,
    ) -> None:
        """Begins nothing."""
        self.done: dict[int, Any] = {}  # what became of scenes
        self._runner, self._course, self._outgrow = runner, course, outgrow
        self._capacities = capacities  # in which the scenes begin
        self._courses: dict[int, Course] = {}  # of scenes that are begun and not done
        self._asked: dict[int, Sequence[int]] = {}  # samples that they wait for
        self._known: dict[int, dict[int, Finished]] = {}  # what became of some of those
        self._waiting: dict[Capacity, list[Job]] = {}
        self._under_way: dict[Future[list[Finished]], tuple[Capacity, list[Job]]] = {}
        self._pool = ThreadPoolExecutor(num_workers())
        self._run = as_here(runner.run)

    def begin(self, place: int) -> None:
        """Begins a scene."""
        self._courses[place] = self._course(self._runner.scenes[place])
        self._tell(place, None)

    def go_on(self) -> None:
        """Begins batches, one more for each thread than it can run, and waits until one is done."""
        while len(self._under_way) < 2 * num_workers() and (found := self._startable()) is not None:
            jobs, size = self._waiting.pop(found), self._runner.size(found)
            jobs.sort(key=lambda job: job.scene)
            if jobs[size:]:
                self._waiting[found] = jobs[size:]
            # Large ones take the most steps: begun last, they would be waited for.
            batch = sorted(jobs[:size], key=lambda job: -len(job.graph.nodes.label))
            self._under_way[self._pool.submit(self._run, found, batch)] = found, batch
        for future in wait(self._under_way, return_when=FIRST_COMPLETED).done:
            capacity, jobs = self._under_way.pop(future)
            for job, result in zip(jobs, future.result(), strict=True):
                self._take(job, result, capacity)
            if (program := self._runner.program(capacity)) not in _programs:
                _programs.add(program)
                give_back_memory()

    def stop(self) -> None:
        """Begins nothing more, as after Ctrl-C."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _startable(self) -> Capacity | None:
        """Returns the bucket of the next batch, that of the first scene: if it is a full one.

        It need not be if nothing else is under way, or if its program is to be compiled, which
        takes long. While it is compiled no other batch of the bucket is begun, which would compile
        it again.
        """
        begun = {capacity for capacity, _ in self._under_way.values()}
        first = {}
        for capacity, jobs in self._waiting.items():
            is_new = self._runner.program(capacity) not in _programs
            is_full = len(jobs) >= self._runner.size(capacity)
            if (is_new and capacity not in begun) or (not is_new and (is_full or not begun)):
                first[capacity] = min(job.scene for job in jobs)
        return min(first, key=first.__getitem__, default=None)

    def _take(self, job: Job, result: Finished, capacity: Capacity) -> None:
        """Notes what became of a job, or lets it go on in the next bucket."""
        most = _most(self._runner.scenes[job.scene])
        if result.halt_reason == CAPACITY and self._outgrow and capacity < most:
            later = job._replace(graph=result.graph, steps=result.steps)
            self._waiting.setdefault(bucket(capacity.nodes + 1), []).append(later)
            return
        known, asked = self._known[job.scene], self._asked[job.scene]
        known[job.sample] = result
        if len(known) == len(asked):
            self._tell(job.scene, [known[sample] for sample in asked])

    def _tell(self, place: int, results: Sequence[Finished] | None) -> None:
        """Tells a scene what became of its samples, none at first, and hears what it needs more."""
        try:
            samples = self._courses[place].send(results)  # ty: ignore[invalid-argument-type]
        except StopIteration as end:
            self.done[place] = end.value
            for of_scenes in (self._courses, self._asked, self._known):
                of_scenes.pop(place, None)
            return
        self._asked[place], self._known[place] = samples, {}
        given = self._runner.scenes[place].centred
        jobs = [Job(place, sample, given, 0) for sample in samples]
        self._waiting.setdefault(self._capacities[place], []).extend(jobs)


def _in_order(work: _Work, count: int) -> Generator[Any]:
    """Yields what becomes of so many scenes, each as soon as it is known."""
    is_cpu = jax.default_backend() == "cpu"
    ahead = BEGUN * num_workers() if is_cpu else 2 * QUEUE * LANES[-1]
    begun = 0
    try:
        for place in range(count):
            while place not in work.done:
                while begun < min(place + ahead, count):
                    work.begin(begun)
                    begun += 1
                work.go_on()
            yield work.done.pop(place)
    finally:
        work.stop()


def as_here(run: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a function for other threads, in which JAX is told what it is told in this one.

    By the context managers of `TOLD`, such as `jax.default_device`.
    """
    told = [(getattr(jax, name), getattr(jax.config, f"jax_{name}")) for name in TOLD]

    def run_here(*arguments: Any) -> Any:
        with ExitStack() as everything:
            for tell, value in told:
                everything.enter_context(tell(value))
            return run(*arguments)

    return run_here


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


def _is_observed(graph: SceneGraph) -> np.ndarray:
    return np.asarray(graph.nodes.observed)


def _unstacked(grown: Any) -> Finished:
    return Finished(unpad(grown.graph), int(grown.halt_reason), int(grown.steps))
