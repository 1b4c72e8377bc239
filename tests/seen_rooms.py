"""Graphs for a robot to see, and how to look at them."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.testing as npt

from sg3d_jax.data import synthetic
from sg3d_jax.data.robot import View, view
from sg3d_jax.scene.graph import SceneGraph, make_graph, observed_of, parts_first, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PLANE, ROOM, WALL

S_F: Final = dataclasses.replace(synthetic.S_F, stale_width=False)
S_C: Final = dataclasses.replace(synthetic.S_C, floor=dataclasses.replace(S_F, merge_ratio=0.5))


def views(graphs: Sequence[SceneGraph], config: Any, seed: int = 0) -> list[View]:
    """Returns a view of each graph."""
    return [view(graph, config, seed, index) for index, graph in enumerate(graphs)]


def ends(graph: SceneGraph) -> np.ndarray:
    """Returns the ends of every plane, float[p, 2, 2]."""
    planes = observed_of(graph).nodes
    along = np.stack([-planes.normal[:, 1], planes.normal[:, 0]], axis=1)
    half = planes.width[:, None] / 2 * along
    return np.stack([planes.position[:, :2] - half, planes.position[:, :2] + half], axis=1)


def wholes(graph: SceneGraph) -> list[set[tuple[float, ...]]]:
    """Returns, of each node, the set of the places of its wholes."""
    found = [set() for _ in graph.nodes.label]
    for part, whole in parts_first(graph).tolist():
        found[part].add(tuple(graph.nodes.position[whole].tolist()))
    return found


def assert_same_graph(one: SceneGraph, other: SceneGraph) -> None:
    """Asserts that nodes and part-of edges are the same, bit for bit."""
    for mine, theirs in zip(one.nodes, other.nodes, strict=True):
        npt.assert_array_equal(mine, theirs)
    npt.assert_array_equal(undirected_edges(one, PART_OF), undirected_edges(other, PART_OF))


def row_of_planes(*rooms: float, thickness: float = 0.2, depth: float = 4.0) -> SceneGraph:
    """Returns a floor of rooms side by side, x being the widths of the rooms."""
    label, position, normal, width, edges = [], [], [], [], []
    starts = np.cumsum([0, *(room + thickness for room in rooms)])
    for room, (start, size) in enumerate(zip(starts, rooms, strict=False)):
        middle = start + size / 2
        for x, y, nx, ny, wide in (
            (start, depth / 2, 1, 0, depth),
            (start + size, depth / 2, -1, 0, depth),
            (middle, 0, 0, 1, size),
            (middle, depth, 0, -1, size),
        ):
            edges.append((len(label), ("room", room)))
            wall = room - (nx > 0)  # beyond this plane
            if nx and 0 <= wall < len(rooms) - 1:
                edges.append((len(label), ("wall", wall)))
            label.append(PLANE)
            position.append([x, y, 0])
            normal.append([nx, ny, 0])
            width.append(wide)
    place = {}
    for index in range(len(rooms) - 1):
        place["wall", index] = len(label)
        label.append(WALL)
        position.append([starts[index + 1] - thickness / 2, depth / 2, 0])
    for index, size in enumerate(rooms):
        place["room", index] = len(label)
        label.append(ROOM)
        position.append([starts[index] + size / 2, depth / 2, 0])
    label.append(FLOOR)
    position.append(np.mean(position[-len(rooms) :], axis=0))
    pairs = [(plane, place[whole]) for plane, whole in edges]
    pairs += [(place["room", index], len(label) - 1) for index in range(len(rooms))]
    none = len(label) - len(width)
    return make_graph(
        label,
        np.array(position, float),
        normal=np.array(normal + [[0, 0, 0]] * none, float),
        width=np.array(width + [0] * none, float),
        part_of=pairs,
    )
