"""What pictures and pages share: colours, the view, and where nodes are drawn.

The concepts are lifted apart in z so that the hierarchy can be read, and the storeys of a building
are pulled apart so that each can be seen. Both are drawn; neither is part of the graph.
"""

from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.scene.ontology import (
    BUILDING,
    CITY,
    CONCEPTS,
    FLOOR,
    PART_OF,
    PLANE,
    ROOM,
    WALL,
)
from sg3d_jax.scene.graph import SceneGraph, undirected_edges


class Style(NamedTuple):
    """How one concept is drawn."""

    colour: str
    lift: float  # metres, up
    size: float  # diameter of the dot, points


STYLES: Final = {
    PLANE: Style("#1d4ed8", 0.0, 4.0),
    WALL: Style("#f59e0b", 1.0, 5.0),
    ROOM: Style("#dc2626", 2.0, 7.0),
    FLOOR: Style("#16a34a", 3.0, 9.0),
    BUILDING: Style("#06b6d4", 4.0, 11.0),
    CITY: Style("#111111", 5.0, 12.0),
}
EDGE_COLOUR: Final = "#8b919c"
ELEVATION, AZIMUTH = np.radians([32.0, -62.0])  # the camera; nearly that of the paper's pictures
CROWDED: Final = 60  # nodes; dots of larger graphs are smaller
STOREY_GAP: Final = 0.5  # drawn between storeys, in lengths of the largest floor
LARGE_FLOOR: Final = 25.0  # metres; the lifts of larger floors grow with them
SAME_STOREY: Final = 1.0  # metres; floors closer in z lie side by side


def lifted(graph: SceneGraph) -> np.ndarray:
    """Returns where the nodes of a host graph are drawn, float64[n, 3], metres."""
    label, length = np.asarray(graph.nodes.label), _largest_floor(graph)
    lifts = np.array([STYLES[concept].lift for concept in range(len(CONCEPTS))])
    points = np.array(graph.nodes.position, np.float64)
    points[:, 2] += lifts[label] * drawn_metre(graph)
    points[:, 2] += _storey(graph) * length * STOREY_GAP
    return points


def drawn_metre(graph: SceneGraph) -> float:
    """Returns how long a metre of lift is drawn, metres: longer if floors are large."""
    return max(1.0, _largest_floor(graph) / LARGE_FLOOR)


def plane_segments(graph: SceneGraph) -> np.ndarray:
    """Returns the two ends of every plane of a host graph as drawn, float64[planes, 2, 3]."""
    chosen = np.asarray(graph.nodes.label) == PLANE
    normal, width = (np.asarray(field)[chosen] for field in graph.nodes[2:4])
    along = np.cross(np.array([0.0, 0.0, 1.0]), normal)
    half = along * width[:, None] / 2
    middle = lifted(graph)[chosen]
    return np.stack([middle - half, middle + half], axis=1)


def view_of(graph: SceneGraph) -> float:
    """Returns the azimuth from which a host graph is seen, radians: its buildings side by side."""
    buildings = np.asarray(graph.nodes.position)[np.asarray(graph.nodes.label) == BUILDING]
    if len(buildings) < 2:
        return float(AZIMUTH)
    turns = np.radians(np.arange(-90.0, 90.0))
    views = AZIMUTH + turns[np.argsort(np.abs(turns), kind="stable")]  # the usual one, if as good
    across = np.stack([np.sort(project(buildings, view)[:, 0]) for view in views])
    return float(views[np.argmax(np.diff(across, axis=1).min(axis=1))])


def project(points: np.ndarray, azimuth: float = AZIMUTH) -> np.ndarray:
    """Returns the parallel projection of points [..., 3] on the picture [..., 2]: right and up."""
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    away = np.array([np.cos(azimuth), np.sin(azimuth)]) * -np.sin(ELEVATION)
    return points @ np.array([right, [*away, np.cos(ELEVATION)]]).T


def crowding(graph: SceneGraph) -> float:
    """Returns by how much the dots and lines of a host graph shrink, so that they keep apart."""
    return min(1.0, float(CROWDED / len(graph.nodes.label)) ** 0.4)


def floor_of(graph: SceneGraph) -> np.ndarray:
    """Returns the floor that each node of a host graph is drawn on.

    Args:
      graph: unpadded. It may break the hierarchy: what hangs on no floor is drawn on the nearest.

    Returns:
      int64[n], the row of a floor; -1 for buildings and cities, and where there is no floor.
    """
    label, position = np.asarray(graph.nodes.label), np.asarray(graph.nodes.position)
    floors = np.flatnonzero(label == FLOOR)
    found = np.full(len(label), -1)
    if not len(floors):
        return found
    found[floors] = floors
    for upper, lower in ((FLOOR, ROOM), (ROOM, PLANE), (PLANE, WALL)):
        above, below = _pairs(graph, upper, lower)
        found[below] = found[above]
    lost = np.flatnonzero((found < 0) & (label < FLOOR))
    # Storeys lie above one another: a metre in z says more than several in x and y.
    apart = (position[lost, None] - position[None, floors]) * np.array([[[1.0, 1.0, 10.0]]])
    found[lost] = floors[np.argmin(np.linalg.norm(apart, axis=-1), axis=-1)]
    return found


def _storey(graph: SceneGraph) -> np.ndarray:
    """Returns the storey of each node, int[n]; buildings and cities have that of their top."""
    label, height = np.asarray(graph.nodes.label), np.asarray(graph.nodes.position)[:, 2]
    floor, parent = floor_of(graph), np.full(len(label), -1)
    buildings, children = _pairs(graph, BUILDING, FLOOR)
    parent[children] = buildings
    floors = np.flatnonzero(label == FLOOR)
    lower = height[floors, None] - height[None, floors] > SAME_STOREY
    beside = parent[floors, None] == parent[None, floors]
    storey = np.zeros(len(label), np.int64)
    storey[floors] = np.sum(lower & beside, axis=1)
    storey = np.where(floor >= 0, storey[floor], 0)
    np.maximum.at(storey, buildings, storey[children])
    cities, buildings = _pairs(graph, CITY, BUILDING)
    np.maximum.at(storey, cities, storey[buildings])
    return storey


def _largest_floor(graph: SceneGraph) -> float:
    """Returns the longest extent in x or y of the planes of a floor, metres; 0 without floors."""
    planes = np.asarray(graph.nodes.label) == PLANE
    points, floor = np.asarray(graph.nodes.position)[planes, :2], floor_of(graph)[planes]
    extents = [np.ptp(points[floor == row], axis=0).max() for row in np.unique(floor[floor >= 0])]
    return float(max(extents, default=0.0))


def _pairs(graph: SceneGraph, upper: int, lower: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the rows of the upper and of the lower nodes of the part-of edges between two."""
    label, pairs = np.asarray(graph.nodes.label), undirected_edges(graph, PART_OF)
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    ends = ends[(label[ends[:, 0]] == upper) & (label[ends[:, 1]] == lower)]
    return ends[:, 0], ends[:, 1]
