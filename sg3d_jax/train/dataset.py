"""A split of a data set as a few stacks of padded graphs on the device, one a size bucket."""

import functools
import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np

from sg3d_jax.data import registry
from sg3d_jax.data.robot import VIEWS, in_pieces, view
from sg3d_jax.data.splits import split_of
from sg3d_jax.nn.kin import kin_slots
from sg3d_jax.scene.graph import PackedGraph, SceneGraph, ontology_of
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.padding import Capacity, stack
from sg3d_jax.scene.proximity import connect_observed
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.methods import METHODS

EDGE_ROUNDING = 32


def load_split(config: DataConfig, part: str, *methods: str) -> list[SceneGraph]:
    """Returns the host graphs of "train", "validation", "test" or "all".

    Args:
      config: which data sets, and how they are dealt. Of several the graphs take turns, so that the
        first ones are of all.
      part: of them.
      *methods: that are to be trained or scored on them; they refuse graphs that are beyond them.

    Raises:
      ValueError: there is no such data set, it has no graphs for this part, or a method does not
        apply to them.
    """
    sets = [_load_split(one, part, *methods) for one in dict.fromkeys(config.parts)]
    turns = itertools.zip_longest(*sets)
    return [graph for turn in turns for graph in turn if graph is not None]


def training_graphs(config: DataConfig, *methods: str) -> list[SceneGraph]:
    """Returns the host graphs that are trained on: those for "train".

    Of a set that a robot sees there are `views` views of each graph, over the pieces that its
    planes are cut into before growing. A set that is named again has other views.

    Args:
      config: which data sets.
      *methods: see `load_split`.

    Raises:
      ValueError: see `load_split`.
    """
    sets = [training_set(*pair, *methods) for pair in numbered_parts(config)]
    return list(itertools.chain(*sets))


def numbered_parts(config: DataConfig) -> list[tuple[DataConfig, int]]:
    """Returns the data sets that are mixed, and how often each was named before."""
    parts = config.parts
    return [(one, parts[:index].count(one)) for index, one in enumerate(parts)]


def training_set(config: DataConfig, before: int = 0, *methods: str) -> list[SceneGraph]:
    """Returns the graphs of one data set that are trained on, if it was named before so often."""
    base, at, seen = config.name.rpartition("@")
    if not at:
        return _load_split(config, "train", *methods)
    if seen not in VIEWS:
        registry.get(config.name)  # refuses it
    complete = _load_split(replace(config, name=f"{base}@clean"), "train", *methods)
    first = before * config.views
    return [
        in_pieces(view(graph, VIEWS[seen], config.seed, index, number))
        for number in range(first, first + config.views)
        for index, graph in enumerate(complete)
    ]


def _load_split(config: DataConfig, part: str, *methods: str) -> list[SceneGraph]:
    """Returns the graphs of one data set."""
    name = config.name
    if spec := registry.DATASETS.get(name):
        _check_top(name, spec.top, spec.ontology, methods)
        if spec.config is None:
            raise ValueError(
                f"{name} is made of a file that you have, expected the npz file that "
                f"`sg3d data import {name} FILE -o {name}.npz` writes, as --data or --data.name"
            )
    graphs, header = registry.load(name, config.num_graphs, config.seed)
    for graph in graphs:
        _check_top(name, int(graph.nodes.label.max()), ontology_of(graph), methods)
    if part == "all":
        return graphs
    chosen = getattr(split_of(header, len(graphs), config.split_seed), part)
    if not len(chosen):
        raise ValueError(f"{name}: none of its {len(graphs)} graphs is for {part}")
    return [graphs[i] for i in chosen]


def _check_top(name: str, top: int, ontology: Ontology, methods: Sequence[str]) -> None:
    """Refuses a data set whose highest concept is above those of a method."""
    for method in methods:
        highest = METHODS[method].top if method in METHODS else None
        if highest is not None and top > highest:
            raise ValueError(
                f"{name} reaches up to a {ontology.names[top]}, expected a "
                f"{ontology.names[highest]} at most, because {method} knows nothing above"
            )


def stack_by_size(
    graphs: Sequence[SceneGraph], capacities: Sequence[int], spare: float = 0.0
) -> list[PackedGraph]:
    """Stacks complete host graphs with their proximity edges, each in the smallest bucket.

    Args:
      graphs: host graphs.
      capacities: node capacities in increasing order; larger graphs get further ones, each twice
        as large as the one before.
      spare: edge slots for graphs to come (`stacks_like`), as a share of those that are needed.

    Returns:
      One stack a bucket that is used; as many edge slots as its graphs need.
    """
    sizes = np.array([slots_of(graph) for graph in graphs])
    capacities = list(capacities)
    while sizes.max() > capacities[-1]:
        capacities.append(2 * capacities[-1])
    bucket_of = np.searchsorted(np.asarray(capacities), sizes)

    def stacked(bucket: int) -> PackedGraph:
        members = np.flatnonzero(bucket_of == bucket)
        connected = _connected([graphs[i] for i in members], capacities[bucket])
        needed = int(jnp.max(connected.n_edge[:, 0]) * (1 + spare))
        slots = -(-needed // EDGE_ROUNDING) * EDGE_ROUNDING
        return _with_edge_slots(connected, min(slots, connected.senders.shape[1]))

    with ThreadPoolExecutor() as pool:  # they compile side by side
        return list(pool.map(stacked, np.unique(bucket_of).tolist()))


def stacks_like(
    graphs: Sequence[SceneGraph], stacks: Sequence[PackedGraph]
) -> tuple[list[PackedGraph], int]:
    """Stacks other graphs of the same kind in the same shapes, each in the smallest bucket.

    A bucket has as many as before: if there are more, some of all are left out; if there are fewer,
    some come twice; if there is none, it stays as it is.

    Args:
      graphs: host graphs.
      stacks: of `stack_by_size`, with spare edge slots.

    Returns:
      A stack for each; and how many graphs fit in none, for their nodes or their edges.
    """
    sizes = np.array([slots_of(graph) for graph in graphs])
    bucket_of = np.searchsorted([stack.nodes.mask.shape[1] for stack in stacks], sizes)
    made, too_large = list(stacks), int(np.sum(bucket_of == len(stacks)))
    for bucket in np.unique(bucket_of[bucket_of < len(stacks)]):
        members, (count, slots) = np.flatnonzero(bucket_of == bucket), stacks[bucket].senders.shape
        chosen = [graphs[i] for i in members[_spread(count, len(members))]]
        connected = _connected(chosen, stacks[bucket].nodes.mask.shape[1])
        fitting = np.flatnonzero(np.asarray(connected.n_edge[:, 0]) <= slots)
        too_large += count - len(fitting)
        if not len(fitting):
            continue
        if len(fitting) < count:
            connected = _rows(connected, fitting[_spread(count, len(fitting))])
        made[bucket] = _with_edge_slots(connected, slots)
    return made, too_large


def _spread(count: int, number: int) -> np.ndarray:
    """Returns so many indices, evenly spread over a number of things."""
    return np.arange(count) * number // count


def _connected(graphs: Sequence[SceneGraph], nodes: int) -> PackedGraph:
    """Stacks host graphs of one bucket, with their proximity edges and slots for more than any."""
    room = nodes * min(nodes, 20)  # more than any union of 10 nearest neighbours has used
    return _connect(stack(graphs, Capacity(nodes, room)))


_connect: Final = jax.jit(jax.vmap(connect_observed))
_rows: Final = jax.jit(lambda stack, rows: jax.tree.map(lambda leaf: leaf[rows], stack))


def slots_of(graph: SceneGraph) -> int:
    """Returns the least capacity of a host graph, in which all kin have a slot, too."""
    num_kin = int(np.sum(ontology_of(graph).hears_kin[graph.nodes.label]))
    slots = len(graph.nodes.label)
    while kin_slots(slots) < num_kin:
        slots += 1
    return slots


@functools.partial(jax.jit, static_argnames="slots")
def _with_edge_slots(graphs: PackedGraph, slots: int) -> PackedGraph:
    """Drops the edge slots that no graph of the stack uses."""
    real = graphs.n_edge[:, 0]
    return graphs._replace(
        edges=jax.tree.map(lambda leaf: leaf[:, :slots], graphs.edges),
        senders=graphs.senders[:, :slots],
        receivers=graphs.receivers[:, :slots],
        n_edge=jnp.stack([real, slots - real], axis=-1),
    )
