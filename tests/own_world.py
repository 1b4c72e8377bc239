"""A made-up kind of scenes: pillars are observed beside the planes, flats stand above the rooms.

Three rooms in a row, 21 nodes, metres; the first two make one flat, the third another.
"""

from typing import Final

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, make_graph
from sg3d_jax.scene.ontology import Concept, Ontology, Rule

ONTOLOGY: Final = Ontology(
    concepts=(
        Concept("plane", "#1d4ed8", "p", "PLANES", observed=True, features=("normal", "width")),
        Concept("pillar", "#7c3aed", "i", "PILLARS", observed=True),
        Concept("wall", "#f59e0b", "w", "WALLS", least_parts=2),
        Concept("room", "#dc2626", "R", "ROOMS", hears_kin=True),
        Concept("flat", "#db2777", "A", "FLATS", hears_kin=True),
        Concept("floor", "#16a34a", "F", "FLOORS", hears_kin=True),
    ),
    rules=(
        Rule("plane", "wall", single=False),
        Rule("plane", "room"),
        Rule("pillar", "room"),
        Rule("room", "flat"),
        Rule("flat", "floor"),
    ),
)
PLANE, PILLAR, WALL, ROOM, FLAT, FLOOR = range(ONTOLOGY.num_concepts)

HEIGHT: Final = 1.2  # of all centroids
ROOMS: Final = ((0.0, 4.0), (4.2, 9.0), (9.2, 12.0))  # from x to x; all reach from y 0 to DEPTH
DEPTH: Final = 3.0
PILLARS: Final = ((2.5, 1.0), (6.0, 2.0))  # x and y, in the first room and in the second
NUM_PLANES: Final = 4 * len(ROOMS)
NUM_OBSERVED: Final = NUM_PLANES + len(PILLARS)

# Rows: 12 planes, 2 pillars, a wall, 3 rooms, 2 flats, the floor.
PART_OF_PAIRS: Final = (
    *((plane, 15 + plane // 4) for plane in range(NUM_PLANES)),
    *((12, 15), (13, 16)),
    *((1, 14), (4, 14)),  # the wall between the first two rooms
    *((15, 18), (16, 18), (17, 19)),
    *((18, 20), (19, 20)),
)


def own_world() -> SceneGraph:
    """Returns the host graph; some of the observed nodes are near each other."""
    planes = np.concatenate([_planes(*room) for room in ROOMS])
    pillars = np.array([(x, y, HEIGHT) for x, y in PILLARS])
    wall = planes[[1, 4], :3].mean(axis=0)
    rooms = np.stack([planes[4 * room : 4 * room + 4, :3].mean(axis=0) for room in range(3)])
    flats = np.stack([rooms[:2].mean(axis=0), rooms[2]])
    others = [pillars, wall[None], rooms, flats, flats.mean(axis=0, keepdims=True)]
    counts = (NUM_PLANES, *(len(points) for points in others))
    return make_graph(
        np.repeat(np.arange(ONTOLOGY.num_concepts), counts),
        np.concatenate([planes[:, :3], *others]),
        np.pad(planes[:, 3:6], [(0, sum(counts[1:])), (0, 0)]),
        np.pad(planes[:, 6], (0, sum(counts[1:]))),
        part_of=np.array(PART_OF_PAIRS),
        proximity=[(i, j) for j in range(NUM_OBSERVED) for i in range(j) if (i + j) % 3 == 1],
        ontology=ONTOLOGY,
    )


def _planes(left: float, right: float) -> np.ndarray:
    """Returns centroid, normal and width of the sides of a room: left, right, low, high."""
    middle, width = (left + right) / 2, right - left
    return np.array(
        [
            (left, DEPTH / 2, HEIGHT, 1.0, 0.0, 0.0, DEPTH),
            (right, DEPTH / 2, HEIGHT, -1.0, 0.0, 0.0, DEPTH),
            (middle, 0.0, HEIGHT, 0.0, 1.0, 0.0, width),
            (middle, DEPTH, HEIGHT, 0.0, -1.0, 0.0, width),
        ]
    )
