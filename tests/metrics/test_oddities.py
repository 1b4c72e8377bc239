"""What is unusual about graphs, on scenes that were spoilt in one way each."""

import numpy as np
import pytest

from sg3d_jax.data import registry
from sg3d_jax.metrics.oddities import Remark, check, oddities
from sg3d_jax.scene.ontology import BUILDING, FLOOR, PLANE, ROOM, WALL
from sg3d_jax.scene.graph import make_graph
from tests.two_rooms import LABELS, NUM_PLANES, PART_OF_PAIRS

WALL_NODE, ROOM_NODE, FLOOR_NODE = NUM_PLANES, NUM_PLANES + 1, NUM_PLANES + 3


def scene(label=tuple(LABELS), part_of=tuple(PART_OF_PAIRS), position=None):
    label = np.array(label)
    if position is None:
        position = np.arange(3.0 * len(label)).reshape(-1, 3)
    planes = label == PLANE
    return make_graph(label, position, planes[:, None] * [1.0, 0.0, 0.0], planes * 1.0, part_of)


def without(*pairs):
    return [pair for pair in PART_OF_PAIRS if tuple(pair) not in pairs]


@pytest.mark.parametrize("name", ["s-f-square", "s-f"])
def test_synthetic_floors_are_as_they_should_be(name):
    assert check(registry.make(name, 50)) == []


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        (scene(), {}),
        (
            scene(part_of=without((0, ROOM_NODE))),
            {"plane without a room": 1, "node apart from the rest": 1},
        ),
        (scene(part_of=[*PART_OF_PAIRS, (0, ROOM_NODE + 1)]), {"plane with more than one room": 1}),
        (scene(part_of=without((1, WALL_NODE))), {"wall with fewer than two planes": 1}),
        (
            scene([*LABELS, WALL]),
            {"wall with fewer than two planes": 1, "node apart from the rest": 1},
        ),
        (
            scene([*LABELS, ROOM], [*PART_OF_PAIRS, (NUM_PLANES + 4, FLOOR_NODE)]),
            {"empty room": 1},
        ),
        (
            scene([*LABELS, BUILDING]),
            {"floor without a building": 1, "empty building": 1} | {"node apart from the rest": 1},
        ),
        (
            scene([*LABELS, FLOOR], [*PART_OF_PAIRS, (ROOM_NODE, NUM_PLANES + 4)]),
            {"room with more than one floor": 1},
        ),
        (scene(position=np.zeros((len(LABELS), 3))), {"repeated plane": NUM_PLANES - 1}),
        (
            scene([PLANE] * 3, np.zeros((0, 2), int)),
            {"node apart from the rest": 2},
        ),
    ],
)
def test_what_is_unusual_is_named_and_counted(graph, expected):
    assert oddities(graph) == expected


def test_remarks_say_how_often_and_where_first():
    fewer = scene(part_of=without((1, WALL_NODE)))
    assert check([scene(), fewer, scene(), fewer]) == [
        Remark("wall with fewer than two planes", 2, 2, 1)
    ]
