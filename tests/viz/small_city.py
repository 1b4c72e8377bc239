"""Scenes small enough to draw quickly: a room, and a city of two buildings of two storeys."""

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, make_graph
from sg3d_jax.scene.ontology import BUILDING, CITY, FLOOR, PLANE, ROOM

NORMALS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float)
SIDE = 8.0  # metres, of each floor of the city
CORNERS = [(0.0, 0.0, 0.0), (0.0, 0.0, 3.0), (20.0, 5.0, 1.0), (20.0, 5.0, 4.0)]
FLOORS, BUILDINGS, TOP = [5, 11, 17, 23], [24, 25], 26  # rows


def one_room() -> SceneGraph:
    return make_graph(
        [PLANE, PLANE, PLANE, ROOM, FLOOR],
        [[0, 2, 1], [3, 0, 1], [0, -2, 1], [1, 0, 1], [1, 0, 1]],
        [[0, -1, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0]],
        [6, 4, 5, 0, 0],
        part_of=[[0, 3], [1, 3], [2, 3], [3, 4]],
        proximity=[[0, 1], [1, 2], [0, 2]],
    )


def small_city() -> SceneGraph:
    """Returns four planes, a room and a floor a storey; then both buildings, then the city."""
    middle = np.array(CORNERS) + np.array([[SIDE, SIDE, 0.0]]) / 2
    storeys = [np.concatenate([m - NORMALS * SIDE / 2, [m, m]]) for m in middle]
    buildings = [middle[1] + [0, 0, 2], middle[3] + [0, 0, 2]]
    position = [
        *np.concatenate(storeys),
        *buildings,
        np.mean(buildings, axis=0) + np.array([0, 0, 4]),
    ]
    normal = np.zeros((27, 3))
    label = np.array(([PLANE] * 4 + [ROOM, FLOOR]) * 4 + [BUILDING, BUILDING, CITY])
    normal[label == PLANE] = np.tile(NORMALS, (4, 1))
    inside = [
        (row + first, row + second)
        for row in range(0, 24, 6)
        for first, second in [(0, 4), (1, 4), (2, 4), (3, 4), (4, 5)]
    ]
    above = [(5, 24), (11, 24), (17, 25), (23, 25), (24, TOP), (25, TOP)]
    return make_graph(label, position, normal, SIDE * (label == PLANE), inside + above)
