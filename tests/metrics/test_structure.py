from collections import Counter
from collections.abc import Sequence

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.metrics.structure import exact_structure, failures, node_count_error
from sg3d_jax.scene.graph import SceneGraph, make_graph, subgraph, undirected_edges
from sg3d_jax.scene.ontology import BUILDING, FLOOR, PART_OF, PLANE, ROOM, WALL
from sg3d_jax.scene.padding import Capacity, pad
from tests import own_world

# Two rooms of three planes each, a wall between planes 2 and 3, one floor.
LABEL = [PLANE] * 6 + [WALL, ROOM, ROOM, FLOOR]
WALL_EDGES = [(2, 6), (3, 6)]
FIRST_ROOM = [(0, 7), (1, 7), (2, 7)]
SECOND_ROOM = [(3, 8), (4, 8), (5, 8)]
FLOOR_EDGES = [(7, 9), (8, 9)]
EDGES = WALL_EDGES + FIRST_ROOM + SECOND_ROOM + FLOOR_EDGES


def graph_of(label: list[int], part_of: list[tuple[int, int]]) -> SceneGraph:
    count = len(label)
    return make_graph(label, np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count), part_of)


TRUTH = graph_of(LABEL, EDGES)
CASES = {
    "missing wall": (
        [*LABEL[:6], ROOM, ROOM, FLOOR],
        [(a, b - 1) if a < 6 else (a - 1, b - 1) for a, b in EDGES[2:]],
        {"missing wall": 1},
    ),
    "extra wall": ([*LABEL, WALL], [*EDGES, (0, 10), (5, 10)], {"extra wall": 1}),
    "duplicate wall": ([*LABEL, WALL], [*EDGES, (2, 10), (3, 10)], {"duplicate wall": 1}),
    "wall with wrong planes": (
        LABEL,
        [(2, 6), (4, 6), *EDGES[2:]],
        {"wall with wrong planes": 1},
    ),
    "isolated wall": ([*LABEL, WALL], EDGES, {"wall without planes": 1}),
    "rooms that swap a plane": (
        LABEL,
        [*WALL_EDGES, (0, 7), (1, 7), (3, 7), (2, 8), (4, 8), (5, 8), *FLOOR_EDGES],
        {"room with wrong planes": 2},
    ),
    "split room": (
        [*LABEL, ROOM],
        [*WALL_EDGES, (0, 7), (1, 7), (2, 10), *SECOND_ROOM, *FLOOR_EDGES, (10, 9)],
        {"split room": 1},
    ),
    "merged rooms": (
        [*LABEL[:8], FLOOR],
        [*WALL_EDGES, *((plane, 7) for plane in range(6)), (7, 8)],
        {"merged room": 1},
    ),
    "a plane in two rooms": (
        LABEL,
        [*EDGES, (3, 7)],
        {"room with wrong planes": 1, "plane with more than one room": 1},
    ),
    "a plane outside its room": (
        LABEL,
        [*WALL_EDGES, *FIRST_ROOM[1:], *SECOND_ROOM, *FLOOR_EDGES],
        {"room with wrong planes": 1},
    ),
    "room without floor": (LABEL, EDGES[:-1], {"room without floor": 1}),
    "extra floor": (
        [*LABEL, FLOOR],
        [*EDGES, (8, 10)],
        {"extra floor": 1, "room with more than one floor": 1},
    ),
    "missing floor": (LABEL[:-1], EDGES[:-2], {"missing floor": 1, "room without floor": 2}),
    "edge against the rules": (LABEL, [*EDGES, (6, 7)], {"edge against the rules": 1}),
    "plane on plane": (LABEL, [*EDGES, (0, 1)], {"edge against the rules": 1}),
    "new plane": ([*LABEL, PLANE], EDGES, {"extra plane": 1}),
}


@pytest.mark.parametrize("case", CASES)
def test_failures__are_named(case):
    label, part_of, expected = CASES[case]
    generated = graph_of(label, part_of)
    assert failures(generated, TRUTH) == Counter(expected)
    assert not exact_structure(generated, TRUTH)


def test_the_truth_is_exact_and_has_no_failures():
    assert exact_structure(TRUTH, TRUTH)
    assert failures(TRUTH, TRUTH) == Counter()


def test_rooms_on_the_wrong_floors_are_a_wrong_grouping():
    # Four rooms on two floors of a building; one plane a room.
    label = [PLANE] * 4 + [ROOM] * 4 + [FLOOR, FLOOR, BUILDING]
    below = [(room, room + 4) for room in range(4)]
    above = [(8, 10), (9, 10)]
    truth = graph_of(label, [*below, (4, 8), (5, 8), (6, 9), (7, 9), *above])
    crossed = graph_of(label, [*below, (4, 8), (6, 8), (5, 9), (7, 9), *above])
    renamed = graph_of(label, [*below, (4, 9), (5, 9), (6, 8), (7, 8), *above])
    assert failures(crossed, truth) == {"wrong grouping": 1}
    assert exact_structure(renamed, truth)


def test_what_the_truth_has_too_is_no_failure():
    # In recordings a plane may bound two rooms, and a room may lie on no floor.
    two = [*EDGES[:-1], (3, 7)]
    truth = graph_of(LABEL, two)
    assert failures(truth, truth) == Counter()
    thrice = graph_of([*LABEL, ROOM], [*two, (3, 10), (10, 9)])
    assert failures(thrice, truth) == {"extra room": 1, "plane with more than one room": 1}


OWN = own_world.own_world()
PILLARS = (own_world.NUM_PLANES, own_world.NUM_PLANES + 1)
OWN_WALL, OWN_ROOMS, OWN_FLATS, OWN_FLOOR = 14, (15, 16, 17), (18, 19), 20


def own_graph(label: Sequence[int] = (), without: Sequence = (), more: Sequence = ()) -> SceneGraph:
    """The made-up world with further nodes, other edges."""
    label = [*OWN.nodes.label, *label]
    pairs = [pair for pair in own_world.PART_OF_PAIRS if pair not in without]
    position = np.zeros((len(label), 3))
    return make_graph(label, position, part_of=[*pairs, *more], ontology=own_world.ONTOLOGY)


OWN_CASES = {
    "sound": (own_graph(), {}),
    "pillar in another room": (
        own_graph(without=[(PILLARS[0], 15)], more=[(PILLARS[0], 16)]),
        {"room with wrong planes or pillars": 2},
    ),
    "pillars swapped": (
        own_graph(
            without=[(PILLARS[0], 15), (PILLARS[1], 16)],
            more=[(PILLARS[1], 15), (PILLARS[0], 16)],
        ),
        {"room with wrong planes or pillars": 2},
    ),
    "pillar in two rooms": (
        own_graph(more=[(PILLARS[0], 17)]),
        {"room with wrong planes or pillars": 1, "pillar with more than one room": 1},
    ),
    "empty room": (
        own_graph([own_world.ROOM]),
        {"room without planes or pillars": 1, "room without flat": 1},
    ),
    "wall of a pillar": (
        own_graph(more=[(PILLARS[0], OWN_WALL)]),
        {"wall with wrong planes": 1, "edge against the rules": 1},
    ),
    "wall without planes": (
        own_graph(without=[(1, OWN_WALL), (4, OWN_WALL)]),
        {"wall without planes": 1, "missing wall": 1},
    ),
    "further flat": (
        own_graph([own_world.FLAT], more=[(21, OWN_FLOOR)]),
        {"extra flat": 1},
    ),
    "room without flat": (own_graph(without=[(17, 19)]), {"room without flat": 1}),
    "flat on a flat": (own_graph(more=[(18, 19)]), {"edge against the rules": 1}),
    "room on the floor": (own_graph(more=[(15, 20)]), {"edge against the rules": 1}),
    "further pillar": (own_graph([own_world.PILLAR]), {"extra pillar": 1}),
    "rooms in the wrong flats": (
        own_graph(without=[(16, 18)], more=[(16, 19)]),
        {"wrong grouping": 1},
    ),
}


@pytest.mark.parametrize(("generated", "expected"), OWN_CASES.values(), ids=OWN_CASES.keys())
def test_failures__of_a_made_up_ontology_are_named(generated, expected):
    assert failures(generated, OWN) == Counter(expected)
    assert exact_structure(generated, OWN) == (not expected)


def test_node_count_error__counts_the_concepts_of_the_ontology():
    errors = node_count_error(own_graph([own_world.FLAT, own_world.PILLAR]), OWN)
    assert errors == {"plane": 0, "pillar": 1, "wall": 0, "room": 0, "flat": 1, "floor": 0}


def test_observed_nodes_are_known_by_their_rank_wherever_they_are_listed():
    # Floor first, pillars amid the planes' rows: only the order among the observed counts.
    order = np.array([20, *range(14), *range(14, 20)])
    again = subgraph(OWN, order)
    assert exact_structure(again, OWN)
    assert failures(again, OWN) == Counter()


def test_node_count_error__is_signed():
    generated = graph_of([PLANE] * 6 + [WALL, WALL, ROOM, FLOOR], [])
    errors = node_count_error(generated, TRUTH)
    assert errors == {"plane": 0, "wall": 1, "room": -1, "floor": 0, "building": 0, "city": 0}


def as_networkx(graph: SceneGraph) -> nx.Graph:
    """Planes carry their index, the other nodes only their label."""
    result = nx.Graph()
    for node, label in enumerate(graph.nodes.label.tolist()):
        result.add_node(node, kind=(label, node if label == PLANE else -1))
    result.add_edges_from(undirected_edges(graph, PART_OF).tolist())
    return result


@given(st.data())
@settings(deadline=None, max_examples=100)
def test_exact_structure__is_isomorphism_with_planes_fixed(data):
    # Few planes and many rooms without any: symmetric forests, the hard case.
    rooms = data.draw(st.lists(st.sampled_from([0, 0, 1, 2]), min_size=1, max_size=5))
    floors = data.draw(st.lists(st.integers(0, 2), min_size=len(rooms), max_size=len(rooms)))
    label = [PLANE, PLANE] + [ROOM] * len(rooms) + [FLOOR] * 3
    first_floor = 2 + len(rooms)
    part_of = [(plane - 1, 2 + room) for room, plane in enumerate(rooms) if plane]
    part_of += [(2 + room, first_floor + floor) for room, floor in enumerate(floors)]
    truth = graph_of(label, part_of)
    order = np.array([0, 1, *(2 + np.array(data.draw(st.permutations(range(len(label) - 2)))))])
    moved = [(order[first], order[second]) for first, second in part_of]
    changes = data.draw(st.integers(0, 2))
    for _ in range(changes):
        index = data.draw(st.integers(0, len(moved) - 1))
        part = data.draw(st.integers(0, len(label) - 1))
        if part != moved[index][1] and (part, moved[index][1]) not in moved:
            moved[index] = (part, moved[index][1])
    moved = sorted({(min(pair), max(pair)) for pair in moved})
    generated = graph_of(np.array(label)[np.argsort(order)].tolist(), moved)
    expected = nx.is_isomorphic(
        as_networkx(generated), as_networkx(truth), node_match=lambda a, b: a == b
    )
    assert exact_structure(generated, truth) == expected
    assert (not failures(generated, truth)) == expected
    if not changes:
        assert expected


def test_padding_does_not_count():
    generated, truth = graph_of([*LABEL, WALL], EDGES), pad(TRUTH, Capacity(16, 192))
    assert exact_structure(truth, TRUTH)
    assert not failures(TRUTH, truth)
    expected = {"wall without planes": 1}
    assert failures(pad(generated, Capacity(24, 288)), truth) == expected
