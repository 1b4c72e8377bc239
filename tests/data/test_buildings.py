"""Storeys, buildings and cities: rigid motions, placement, and the graph of it all."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.data.buildings import (
    CLEARANCE,
    Building,
    Motion,
    Storey,
    city_graph,
    move,
    move_points,
    outline,
    place,
    turn,
)
from sg3d_jax.scene.graph import undirected_edges
from sg3d_jax.scene.ontology import BUILDING, CITY, FLOOR, PART_OF, PROXIMITY
from sg3d_jax.scene.validate import validate_graph

seeds = st.integers(0, 2**32)
angles = st.floats(-10, 10)
metres = st.floats(-1e3, 1e3)


def two_rooms() -> Storey:
    """Two rooms of 2 x 2 m, side by side along x, 0.2 m apart, with a wall between."""
    outward = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    centre = np.array([[1.0, 1.0], [3.2, 1.0]])
    plane = (centre[:, None] + outward).reshape(-1, 2)
    return Storey(
        plane=plane,
        normal=np.tile(-outward, (2, 1)),
        width=np.full(8, 2.0),
        room=np.repeat([0, 1], 4),
        room_centre=centre,
        wall=np.array([[0, 0], [6, 0]]),
        wall_centre=plane[[0, 6]].mean(axis=0, keepdims=True),
        centre=centre.mean(axis=0),
    )


def one_room() -> Storey:
    """The first room alone, without a wall."""
    storey = two_rooms()
    return Storey(
        plane=storey.plane[:4],
        normal=storey.normal[:4],
        width=storey.width[:4],
        room=storey.room[:4],
        room_centre=storey.room_centre[:1],
        wall=np.zeros((0, 2), int),
        wall_centre=np.zeros((0, 2)),
        centre=storey.room_centre[0],
    )


# --- motions ---


def test_a_quarter_turn_is_counter_clockwise():
    np.testing.assert_allclose(turn(np.array([1.0, 0.0]), np.pi / 2), [0, 1], atol=1e-12)


@given(angles, metres, metres)
@settings(deadline=None)
def test_moving_there_and_back_changes_nothing(angle, x, y):
    storey, shift = two_rooms(), np.array([x, y])
    there = move(storey, angle, storey.centre, shift)
    back = move(there, -angle, there.centre, -shift)
    for before, after in zip(storey, back, strict=True):
        np.testing.assert_allclose(after, before, atol=1e-9)


@given(angles, metres, metres)
@settings(deadline=None)
def test_moving_keeps_every_distance_and_the_angles_of_normals(angle, x, y):
    storey = two_rooms()
    moved = move(storey, angle, np.array([y, x]), np.array([x, y]))

    def points(of: Storey) -> np.ndarray:
        return np.concatenate([of.plane, of.room_centre, of.wall_centre, of.centre[None]])

    before, after = (
        np.linalg.norm(p[:, None] - p[None], axis=-1) for p in (points(storey), points(moved))
    )
    np.testing.assert_allclose(after, before, atol=1e-9)
    inwards = ((moved.room_centre[moved.room] - moved.plane) * moved.normal).sum(axis=1)
    np.testing.assert_allclose(inwards, 1)


@given(angles)
@settings(deadline=None)
def test_outline_holds_the_corners_of_every_room(angle):
    storey = move(two_rooms(), angle, np.zeros(2), np.array([5.0, -7.0]))
    corners = turn(np.array([[0.0, 0], [2, 0], [2, 2], [0, 2], [2.2, 0], [4.2, 2]]), angle)
    distance = np.linalg.norm(corners[:, None] + [5.0, -7.0] - outline([storey]), axis=-1)
    np.testing.assert_allclose(distance.min(axis=1), 0, atol=1e-9)


# --- placement ---


def gap(one: np.ndarray, other: np.ndarray) -> float:
    """Returns how far apart two axis-aligned boxes are along the axis that parts them."""
    lows, highs = ([f(points, axis=0) for points in (one, other)] for f in (np.min, np.max))
    return float(np.maximum(lows[0] - highs[1], lows[1] - highs[0]).max())


def test_a_building_is_placed_clear_of_all_others_within_the_radius():
    rng, points = np.random.default_rng(0), outline([two_rooms()])
    centre, placed = points.mean(axis=0), [points]
    for _ in range(4):
        motion = place(points, centre, placed, centre, radius=20.0, rng=rng)
        moved = move_points(points, *motion)
        assert min(gap(moved, other) for other in placed) > 2 * CLEARANCE
        assert np.linalg.norm(moved.mean(axis=0) - centre) < 20
        placed.append(moved)


def test_places_are_uniform_in_the_disc_and_turns_in_the_circle():
    rng, points = np.random.default_rng(0), outline([one_room()])
    motions = [place(points, np.ones(2), [], np.zeros(2), 10.0, rng) for _ in range(2000)]
    targets = np.array([motion.about + motion.shift for motion in motions])
    assert np.mean(np.linalg.norm(targets, axis=1) < 5) == pytest.approx(1 / 4, abs=0.03)
    np.testing.assert_allclose(targets.mean(axis=0), 0, atol=0.4)
    share = np.histogram([motion.angle for motion in motions], 4, (0, 2 * np.pi))[0] / 2000
    np.testing.assert_allclose(share, 1 / 4, atol=0.04)


def test_a_radius_too_small_for_any_place_grows_until_there_is_one():
    points = outline([two_rooms()])
    centre = points.mean(axis=0)
    motion = place(points, centre, [100 * points], 100 * centre, 1.0, np.random.default_rng(0))
    assert gap(move_points(points, *motion), 100 * points) > 2 * CLEARANCE


@given(seeds)
@settings(deadline=None, max_examples=20)
def test_a_place_depends_on_the_generator_alone(seed):
    points = outline([two_rooms()])
    first, second = (
        place(points, np.zeros(2), [points], np.zeros(2), 20.0, np.random.default_rng(seed))
        for _ in range(2)
    )
    assert isinstance(first, Motion)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


# --- graphs ---


def test_one_storey_is_a_floor_alone():
    graph = city_graph([Building((two_rooms(),), (1.5,))], FLOOR)
    validate_graph(graph, "floor")
    assert graph.nodes.label.tolist() == [0] * 8 + [1] + [2] * 2 + [3]
    assert (graph.nodes.position[:, 2] == 1.5).all()
    assert undirected_edges(graph, PART_OF).tolist() == sorted(
        [[0, 8], [6, 8], *([plane, 9 + plane // 4] for plane in range(8)), [9, 11], [10, 11]]
    )


def test_a_floor_without_a_wall_is_a_sound_graph():
    graph = city_graph([Building((one_room(),), (0.0,))], FLOOR)
    validate_graph(graph, "floor")
    assert graph.nodes.label.tolist() == [0] * 4 + [2, 3]


def test_storeys_are_told_apart_in_a_city():
    buildings = [
        Building((two_rooms(), one_room()), (0.0, 3.0)),
        Building((two_rooms(),), (-1.0,)),
    ]
    graph = city_graph(buildings, CITY)
    validate_graph(graph, "city")
    position = graph.nodes.position
    assert graph.nodes.label.tolist() == [0] * 20 + [1] * 2 + [2] * 5 + [3] * 3 + [4] * 2 + [5]
    np.testing.assert_array_equal(position[:20, 2], [0] * 8 + [3] * 4 + [-1] * 8)
    np.testing.assert_array_equal(position[20:22, 2], [0, -1])
    np.testing.assert_array_equal(position[22:27, 2], [0, 0, 3, -1, -1])
    edges = undirected_edges(graph, PART_OF).tolist()
    rooms = [22] * 4 + [23] * 4 + [24] * 4 + [25] * 4 + [26] * 4
    expected = [[plane, room] for plane, room in enumerate(rooms)]
    expected += [[0, 20], [6, 20], [12, 21], [18, 21]]
    expected += [[22, 27], [23, 27], [24, 28], [25, 29], [26, 29]]
    expected += [[27, 30], [28, 30], [29, 31], [30, 32], [31, 32]]
    assert edges == sorted(expected)


def test_building_and_city_stand_above_the_mean_of_their_parts():
    buildings = [
        Building((two_rooms(), one_room()), (0.0, 3.0)),
        Building((one_room(),), (-1.0,)),
    ]
    position = city_graph(buildings, CITY).nodes.position
    np.testing.assert_allclose(position[-3:], [[1.55, 1, 5], [1, 1, 1], [1.275, 1, 9]])


def test_a_building_alone_has_no_city():
    graph = city_graph([Building((one_room(), one_room()), (0.0, 3.0))], BUILDING)
    validate_graph(graph, "building")
    assert graph.nodes.label[-1] == BUILDING


def test_floor_node_is_where_the_storey_says():
    elsewhere = one_room()._replace(centre=np.array([7.0, 8.0]))
    graph = city_graph([Building((elsewhere,), (0.0,))], FLOOR)
    np.testing.assert_array_equal(graph.nodes.position[-1], [7, 8, 0])


def test_proximity_edges_are_kept():
    pairs = np.array([[0, 3], [1, 2]])
    graph = city_graph([Building((one_room(),), (0.0,))], FLOOR, pairs)
    np.testing.assert_array_equal(undirected_edges(graph, PROXIMITY), pairs)


@pytest.mark.parametrize(
    ("buildings", "top", "message"),
    [
        ([Building((one_room(), one_room()), (0.0, 3.0))], FLOOR, "2 floor nodes"),
        ([Building((one_room(),), (0.0,))] * 3, BUILDING, "3 building nodes"),
    ],
)
def test_several_highest_nodes_are_refused(buildings, top, message):
    with pytest.raises(ValueError, match=message):
        city_graph(buildings, top)
