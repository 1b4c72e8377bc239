"""Two rooms of a flat with a door between them, stairs and a bed: 9 nodes that have kinds."""

from typing import Final

import numpy as np

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.scene.graph import SceneGraph, make_graph

PLANE, DOOR, STAIRS, OBJECT, WALL, ROOM, UNIT, FLOOR, _, _ = range(FURNISHED_ONTOLOGY.num_concepts)
BED: Final = 4  # rows
ROOMS: Final = (5, 6)
NUM_OBSERVED: Final = 5


def furnished_rooms() -> SceneGraph:
    """Returns the host graph: a bedroom and a kitchen make up a department."""
    return make_graph(
        [PLANE, PLANE, DOOR, STAIRS, OBJECT, ROOM, ROOM, UNIT, FLOOR],
        [[x, x % 2, 0] for x in range(9)],
        [[1, 0, 0], [-1, 0, 0], *[[0, 0, 0]] * 7],
        [2, 2, 0.9, 1, 2, 0, 0, 0, 0],
        part_of=[(0, 5), (1, 6), (2, 5), (2, 6), (3, 6), (4, 5), (5, 7), (6, 7), (7, 8)],
        proximity=[(0, 2), (1, 2), (0, 4)],
        ontology=FURNISHED_ONTOLOGY,
        kind=[0, 0, 0, 0, 1, 1, 3, 2, 0],
    )


def with_kind(graph: SceneGraph, row: int, kind: float) -> SceneGraph:
    """Returns a host graph in which a node is of another kind."""
    kinds = np.array(graph.nodes.kind)
    kinds[row] = kind
    return graph._replace(nodes=graph.nodes._replace(kind=kinds))
