"""Which part of a map is drawn again."""

import numpy as np
import numpy.testing as npt

from sg3d_jax.infer.region import CONTEXT, region_of, whole_region
from sg3d_jax.scene.graph import SceneGraph, make_graph, subgraph
from sg3d_jax.scene.ontology import FLOOR, PLANE, ROOM
from tests import own_world
from tests.two_rooms import two_rooms

MAP = two_rooms()  # planes 0 to 7, a wall of 1 and 4, two rooms, their floor
NONE = np.zeros(12, bool)


def these(*rows: int, size: int = 12) -> np.ndarray:
    return np.isin(np.arange(size), rows)


def row_of_rooms(count: int) -> SceneGraph:
    """Returns rooms of four planes, one beside the other, ten metres apart, and their floor."""
    one = two_rooms().nodes
    offsets = np.array([[10.0 * room, 0, 0] for room in range(count)])
    position = (offsets[:, None] + one.position[:4]).reshape(-1, 3)
    middle = position.reshape(count, 4, 3).mean(axis=1)
    rooms, planes = 4 * count + np.arange(count), np.arange(4 * count)
    pairs = [*zip(planes, np.repeat(rooms, 4), strict=True)]
    return make_graph(
        [PLANE] * 4 * count + [ROOM] * count + [FLOOR],
        np.concatenate([position, middle, middle.mean(axis=0, keepdims=True)]),
        np.pad(np.tile(one.normal[:4], (count, 1)), [(0, count + 1), (0, 0)]),
        np.pad(np.tile(one.width[:4], count), (0, count + 1)),
        [*pairs, *((room, 5 * count) for room in rooms)],
    )


def test_the_whole__has_what_is_observed_and_what_is_firm():
    rows, is_open = whole_region(MAP, these(9, 11))
    assert rows.tolist() == [*range(8), 9]
    npt.assert_array_equal(is_open, these(8, 10))


def test_wholes_of_what_has_changed__are_open_and_others_stay():
    rows, is_open = region_of(MAP, these(0), NONE)
    assert rows.tolist() == [*range(8), 8, 10]
    npt.assert_array_equal(is_open, these(9, 11))
    rows, is_open = region_of(MAP, these(1), NONE)
    assert rows.tolist() == [*range(8), 10]
    npt.assert_array_equal(is_open, these(8, 9, 11))


def test_wholes_that_are_due__are_open():
    rows, is_open = region_of(MAP, these(10), NONE)
    assert rows.tolist() == [*range(8), 8, 9]
    npt.assert_array_equal(is_open, these(10, 11))


def test_what_is_firm__is_never_open():
    rows, is_open = region_of(MAP, these(0, 10), these(9, 10, 11))
    assert rows.tolist() == [*range(8), 8, 9, 10]
    assert not is_open.any()


def without_plane(graph: SceneGraph, lost: int) -> SceneGraph:
    """Returns a graph in which a plane is part of nothing."""
    parts = [pair for pair in zip(graph.senders, graph.receivers, strict=True) if lost not in pair]
    nodes = graph.nodes
    pairs = [(a, b) for a, b in parts if a < b and nodes.label[b] != PLANE]
    return make_graph(nodes.label, nodes.position, nodes.normal, nodes.width, pairs)


def test_a_new_plane__opens_the_room_that_it_faces():
    _, is_open = region_of(without_plane(MAP, 4), these(4), NONE)
    npt.assert_array_equal(is_open, these(8, 10, 11))  # and the wall that it is the back of
    _, is_open = region_of(without_plane(MAP, 1), these(1), NONE)
    npt.assert_array_equal(is_open, these(8, 9, 11))


def test_a_new_plane_that_is_far_from_all__opens_nothing_below():
    graph = without_plane(MAP, 6)
    graph.nodes.position[6] += [0, 40.0, 0]
    _, is_open = region_of(graph, these(6), NONE)
    npt.assert_array_equal(is_open, these(11))
    graph.nodes.position[6] -= [0, 40.0, -4.0]  # four metres up are another storey
    _, is_open = region_of(graph, these(6), NONE)
    npt.assert_array_equal(is_open, these(11))


def test_a_region__has_whole_rooms_around_the_change_and_no_more():
    count = 20
    graph = row_of_rooms(count)
    rows, is_open = region_of(graph, these(0, size=101), np.zeros(101, bool))
    planes, rooms = rows[rows < 80], rows[rows >= 80]
    assert planes.tolist() == [*range(CONTEXT)]
    assert rooms.tolist() == [*range(81, 80 + CONTEXT // 4)]
    npt.assert_array_equal(is_open, these(80, 100, size=101))


def test_a_large_change__has_context_too():
    graph, count = row_of_rooms(20), 40
    rows, _ = region_of(graph, these(*range(count), size=101), np.zeros(101, bool))
    assert (rows < 80).sum() == 3 * count // 2


def test_what_has_no_normal__may_be_part_of_what_is_near():
    world = own_world.own_world()
    pillar, size = own_world.NUM_PLANES, len(world.nodes.label)
    graph = subgraph(world, np.delete(np.arange(size), [15]))  # the first room is not there
    due = these(pillar, size=size - 1)
    _, is_open = region_of(graph, due, np.zeros(size - 1, bool))
    opened = graph.nodes.label[is_open].tolist()
    assert opened.count(own_world.ROOM) == 2
