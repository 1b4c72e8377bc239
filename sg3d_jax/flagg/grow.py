"""Growing whole graphs from planes: the FLAGG loop, compiled and mapped over scenes.

planes -> proximity graph -> [insert -> fill -> append block -> halt]* -> drop proximity edges.

Source: paper, Eq. (flagg_full) and Sec. "Generating 3DSGs".
"""

import functools
import itertools
import operator
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Integer, Key

from sg3d_jax.flagg.step import Flagg, Params, grow
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.graph import SceneGraph, observed_of
from sg3d_jax.scene.padding import (
    Capacity,
    bucket,
    centre_of_observed,
    stack,
    unpad,
    without_proximity,
)
from sg3d_jax.scene.proximity import connect_observed

HALT_REASONS = ("RUNNING", "HALTED", "CAPACITY", "MAX_STEPS", "ONE_SHOT")
RUNNING, HALTED, CAPACITY, MAX_STEPS, ONE_SHOT = range(len(HALT_REASONS))
# Scenes grown together: constant in a bucket, so that there is one compilation of each. Four reach
# the rate of 32, on two cores, and a scene alone pays for few.
BATCH = 4
BATCH_NODES = 1024


class Grown(NamedTuple):
    """A grown graph and why growing ended; on the device, padded."""

    graph: SceneGraph
    halt_reason: Array  # int32[], index into HALT_REASONS
    steps: Array  # int32[], blocks inserted


def grow_from_planes(
    model: Flagg, params: Params, key: Key[Array, ""], planes: SceneGraph, max_steps: int = 1000
) -> Grown:
    """Grows a complete scene graph from observed planes.

    Args:
      model: the three modules.
      params: their parameters.
      key: one key a sample; the same key and planes give the same graph in any batch.
      planes: padded, with room for what is to come; edges are ignored. `vmap` over scenes.
      max_steps: a limit on the number of blocks.

    Returns:
      The graph without proximity edges. The planes are as given, bit for bit.

    Source: paper, Sec. "Generating 3DSGs".
    """
    start = Grown(connect_observed(planes), jnp.asarray(RUNNING), jnp.asarray(0))

    def running(state: Grown) -> Bool[Array, ""]:
        return state.halt_reason == RUNNING

    def step(state: Grown) -> Grown:
        grown = grow(model, params, jax.random.fold_in(key, state.steps), state.graph)
        steps = state.steps + grown.fits
        reason = jnp.where(steps >= max_steps, MAX_STEPS, RUNNING)
        reason = jnp.where(grown.halted, HALTED, reason)
        return Grown(grown.graph, jnp.where(grown.fits, reason, CAPACITY), steps)

    final = jax.lax.while_loop(running, step, start)
    return final._replace(graph=without_proximity(final.graph))


def sample_keys(
    seed: int, scenes: Integer[Array, " B"], samples: Integer[Array, " B"]
) -> Key[Array, " B"]:
    """Returns a key for each (scene, sample) pair, so that neither batch nor count changes any."""

    def one(scene: Integer[Array, ""], sample: Integer[Array, ""]) -> Key[Array, ""]:
        return jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), scene), sample)

    return jax.vmap(one)(scenes, samples)


@functools.partial(jax.jit, static_argnums=(0, 4))
def grow_batch(
    model: Flagg, params: Params, keys: Key[Array, " B"], planes: SceneGraph, max_steps: int
) -> Grown:
    """Grows a batch of stacked scenes: `grow_from_planes`, vmapped and compiled."""

    def one(key: Key[Array, ""], planes: SceneGraph) -> Grown:
        return grow_from_planes(model, params, key, planes, max_steps)

    return jax.vmap(one)(keys, planes)


def growth_capacity(num_planes: int) -> Capacity:
    """Returns the bucket in which a scene grows: room for 0.8 new nodes a plane, and eight.

    Floors of the benchmark need 0.6 new nodes a plane, cities 0.64 and at most 0.76.
    """
    return bucket(int(1.8 * num_planes) + 8)


def num_lanes(capacity: Capacity) -> int:
    """Returns how many scenes of a bucket are grown together."""
    return max(1, min(BATCH, BATCH_NODES // capacity.nodes))


# (keys, stacked planes, indices of their scenes) -> stacked results.
GrowLanes = Callable[[Key[Array, " B"], SceneGraph, Sequence[int]], Grown]


class Completion(NamedTuple):
    """A grown graph on the host."""

    graph: SceneGraph  # unpadded, float64; its planes are the observed ones, bit for bit
    halt_reason: str  # one of HALT_REASONS
    steps: int  # blocks inserted


def complete(
    model: Flagg,
    params: Params,
    scenes: Sequence[SceneGraph],
    seed: int = 0,
    samples: int = 1,
    max_steps: int = 1000,
) -> list[list[Completion]]:
    """Grows scene graphs from the planes of host graphs, in compiled batches.

    Args:
      model: the three modules.
      params: their parameters.
      scenes: host graphs; everything but their planes is ignored.
      seed: with the position of a scene in `scenes` and the number of the sample, fixes it.
      samples: graphs a scene.
      max_steps: a limit on the number of blocks.

    Returns:
      For every scene, in order, its samples.
    """

    def grow_lanes(keys: Key[Array, " B"], planes: SceneGraph, lanes: Sequence[int]) -> Grown:
        return grow_batch(model, params, keys, planes, max_steps)

    num_planes = [int(np.sum(scene.nodes.label == PLANE)) for scene in scenes]
    capacities = [growth_capacity(number) for number in num_planes]
    return complete_in_batches(grow_lanes, scenes, capacities, seed, samples)


def complete_in_batches(
    grow_lanes: GrowLanes,
    scenes: Sequence[SceneGraph],
    capacities: Sequence[Capacity],
    seed: int,
    samples: int,
) -> list[list[Completion]]:
    """Completes host graphs in batches of one size, each centred on its planes.

    Args:
      grow_lanes: grows one batch of stacked scenes, always of as many lanes.
      scenes: host graphs; their planes are observed.
      capacities: the bucket of each scene.
      seed: of `sample_keys`.
      samples: graphs a scene.

    Returns:
      For every scene, in order, its samples.
    """
    observed = [observed_of(scene) for scene in scenes]
    jobs = [(scene, sample) for scene in range(len(scenes)) for sample in range(samples)]
    # Neighbours in a batch are of like size, so that they need like numbers of steps.
    jobs.sort(key=lambda job: (capacities[job[0]].nodes, len(observed[job[0]].nodes.label)))
    finished: dict[tuple[int, int], Completion] = {}
    for capacity, group in itertools.groupby(jobs, lambda job: capacities[job[0]]):
        members, width = list(group), num_lanes(capacity)
        for first in range(0, len(members), width):
            batch = members[first : first + width]
            lanes = [*batch, *[batch[-1]] * (width - len(batch))]  # idle ones repeat the last
            completions = _complete_lanes(grow_lanes, lanes, observed, capacity, seed)
            finished.update(zip(batch, completions, strict=False))
    return [[finished[scene, s] for s in range(samples)] for scene in range(len(scenes))]


def _complete_lanes(
    grow_lanes: GrowLanes,
    lanes: Sequence[tuple[int, int]],
    observed: Sequence[SceneGraph],
    capacity: Capacity,
    seed: int,
) -> list[Completion]:
    """Grows (scene, sample) pairs of one bucket in one call."""
    planes = [observed[scene] for scene, _ in lanes]
    centres = [centre_of_observed(graph) for graph in planes]
    centred = [_shift(graph, -centre) for graph, centre in zip(planes, centres, strict=True)]
    keys = sample_keys(seed, *jnp.asarray(lanes, jnp.uint32).T)
    grown = grow_lanes(keys, stack(centred, capacity), [scene for scene, _ in lanes])
    grown = jax.tree.map(np.asarray, grown)
    return [
        _on_host(jax.tree.map(operator.itemgetter(lane), grown), planes[lane], centres[lane])
        for lane in range(len(lanes))
    ]


def _shift(graph: SceneGraph, offset: np.ndarray) -> SceneGraph:
    """Moves a host graph; near the origin float32 resolves micrometres."""
    return graph._replace(nodes=graph.nodes._replace(position=graph.nodes.position + offset[None]))


def _on_host(grown: Grown, observed: SceneGraph, centre: np.ndarray) -> Completion:
    """Unpads a grown graph, moves it back, and restores the observed planes exactly."""
    graph = _shift(unpad(grown.graph), centre)
    num_planes = len(observed.nodes.label)

    def restore(observed_rows: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return np.concatenate([observed_rows, rows[num_planes:]])

    nodes = jax.tree.map(restore, observed.nodes, graph.nodes)
    reason = HALT_REASONS[int(grown.halt_reason)]
    return Completion(graph._replace(nodes=nodes), reason, int(grown.steps))
