"""Scenes as wide as the world, measured from their planes alone."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from sg3d_jax.data.synthetic import make_scene
from sg3d_jax.data.wide import G_B, G_C, G_F, WideConfig
from sg3d_jax.scene.graph import parts_first
from sg3d_jax.scene.ontology import BUILDING, FLOOR, PLANE, ROOM, WALL
from sg3d_jax.scene.validate import validate_graph
from tests.unchecked import unchecked

EVEN = replace(G_F, lined=0.0, thick_walls=0.0, cut_floors=0.5)  # one thickness a floor
NUM_FLOORS = 250


@pytest.fixture(scope="module")
def floors():
    with unchecked():
        return [make_scene(G_F, 0, index) for index in range(NUM_FLOORS)]


@pytest.fixture(scope="module")
def cities():
    with unchecked():
        return [make_scene(G_C, 0, index) for index in range(60)]


def children(graph, parent, child):
    """The parts of each node of a concept, as rows."""
    label, pairs = graph.nodes.label, parts_first(graph)
    pairs = pairs[(label[pairs[:, 0]] == child) & (label[pairs[:, 1]] == parent)]
    return [pairs[pairs[:, 1] == row, 0] for row in np.flatnonzero(label == parent)]


def ends_of(graph):
    """The end points of each plane, float[p, 2, 2]: widths are true."""
    nodes = graph.nodes
    planes = nodes.label == PLANE
    along = np.column_stack([nodes.normal[planes, 1], -nodes.normal[planes, 0]])
    half = along * nodes.width[planes, None] / 2
    middle = nodes.position[planes, :2]
    return np.stack([middle - half, middle + half], axis=1)


def rooms_of(graph):
    """Each room as the polygon that its planes close."""
    ends = ends_of(graph).round(6)
    shapes = []
    for planes in children(graph, ROOM, PLANE):
        pieces, *unused = shapely.polygonize_full(shapely.linestrings(ends[planes]))
        assert all(len(shapely.get_parts(part)) == 0 for part in unused)
        parts = shapely.get_parts(pieces)
        shapes.append(
            parts[np.argmax(shapely.area(shapely.polygons(shapely.get_exterior_ring(parts))))]
        )
    return np.array(shapes)


@pytest.fixture(scope="module")
def rooms_of_floors(floors):
    """The rooms of some of the floors."""
    return [rooms_of(graph) for graph in floors[:120]]


def num_nodes(graphs):
    return np.array([len(graph.nodes.label) for graph in graphs])


# --- rooms and walls ---


def test_planes_of_a_room_close_around_its_centroid_and_look_into_it(floors, rooms_of_floors):
    for graph, rooms in zip(floors, rooms_of_floors, strict=False):
        nodes, ends = graph.nodes, ends_of(graph)
        centre = nodes.position[nodes.label == ROOM, :2]
        np.testing.assert_allclose(
            shapely.get_coordinates(shapely.centroid(rooms)), centre, atol=1e-4
        )
        for shape, planes in zip(rooms, children(graph, ROOM, PLANE), strict=True):
            middle, normal = ends[planes].mean(axis=1), nodes.normal[planes, :2]
            assert shapely.contains(shape, shapely.points(middle + 0.01 * normal)).all()
            assert not shapely.intersects(shape, shapely.points(middle - 0.01 * normal)).any()


def test_rooms_keep_clear_of_each_other(rooms_of_floors):
    for rooms in rooms_of_floors:
        one, other = shapely.STRtree(rooms).query(rooms, "dwithin", 0.045)
        assert (one == other).all()


def test_gaps_of_walls_are_as_thick_as_drawn():
    thickest = []
    with unchecked():
        graphs = [make_scene(EVEN, 0, index) for index in range(80)]
    for graph in graphs:
        nodes = graph.nodes
        gaps = []
        for planes in children(graph, WALL, PLANE):
            if len(planes) == 2:
                one, other = planes
                gaps.append(nodes.normal[one] @ (nodes.position[one] - nodes.position[other]))
        if gaps:
            as_drawn = np.abs(gaps - np.median(gaps)) < 0.02
            assert as_drawn.mean() > 0.8  # the others have a shaft in them
            assert np.min(gaps) > np.median(gaps) - 0.02
            thickest.append(np.median(gaps))
    assert min(thickest) > 0.05 - 1e-6
    assert max(thickest) < 0.45 + 1e-6
    assert min(thickest) < 0.08
    assert max(thickest) > 0.35


def test_a_wall_has_planes_of_several_rooms_and_a_plane_one_wall(floors):
    most = 0
    for graph in floors:
        walls = children(graph, WALL, PLANE)
        room = np.zeros(len(graph.nodes.label), int)
        for number, planes in enumerate(children(graph, ROOM, PLANE)):
            room[planes] = number
        assert all(len(np.unique(room[planes])) > 1 for planes in walls)
        planes = np.concatenate([*walls, []])
        assert len(planes) == len(np.unique(planes))
        most = max([most, *map(len, walls)])
    assert most > 10


def test_floors_are_of_every_kind(floors, rooms_of_floors):
    sides = np.concatenate([[len(p) for p in children(g, ROOM, PLANE)] for g in floors])
    assert {3, 4, 5, 6, 8, 10, 12} <= set(sides.tolist())
    assert sides.min() == 3
    assert 14 < sides.max() <= 20
    assert 0.15 < np.mean(sides > 4) < 0.4
    extent = [np.ptp(ends_of(graph).reshape(-1, 2), axis=0).max() for graph in floors]
    assert min(extent) < 5
    assert 90 < max(extent) < 140
    rooms = [(graph.nodes.label == ROOM).sum() for graph in floors]
    assert min(rooms) == 1
    assert max(rooms) >= 60
    holes = sum(len(room.interiors) for rooms in rooms_of_floors for room in rooms)
    assert holes > 10


def test_walls_stand_at_any_angle_on_some_floors(floors):
    askew = 0
    for graph in floors:
        nodes = graph.nodes
        normal = nodes.normal[nodes.label == PLANE]
        turn = np.arctan2(normal[:, 1], normal[:, 0])
        askew += np.abs(np.sin(2 * (turn - turn[0]))).max() > 0.05
    assert 0.3 < askew / len(floors) < 0.6


# --- buildings and cities ---


@pytest.mark.parametrize("config", [G_F, G_B, G_C])
def test_scenes_are_sound_connected_and_depend_on_their_index_alone(config):
    for index in (0, 7, 33):
        graph, again = make_scene(config, 5, index), make_scene(config, 5, index)
        validate_graph(graph, f"graph {index}")
        assert (graph.nodes.label == config.top).sum() == 1
        for one, other in zip(graph.nodes, again.nodes, strict=True):
            np.testing.assert_array_equal(one, other)
    assert not np.array_equal(
        make_scene(config, 6, 0).nodes.width, make_scene(config, 5, 0).nodes.width
    )


def test_sizes_have_a_tail(floors, cities):
    assert num_nodes(floors).min() <= 6
    assert 70 < num_nodes(floors).mean() < 130
    assert num_nodes(floors).max() > 400
    assert 150 < num_nodes(cities).mean() < 280
    assert 600 < num_nodes(cities).max() <= G_C.max_nodes + 1


def test_cities_have_up_to_six_buildings_that_keep_clear(cities):
    numbers = []
    for graph in cities:
        floors, ends = children(graph, BUILDING, FLOOR), ends_of(graph)
        numbers.append(len(floors))
        rooms = dict(
            zip(
                np.flatnonzero(graph.nodes.label == FLOOR).tolist(),
                children(graph, FLOOR, ROOM),
                strict=True,
            )
        )
        planes = dict(
            zip(
                np.flatnonzero(graph.nodes.label == ROOM).tolist(),
                children(graph, ROOM, PLANE),
                strict=True,
            )
        )
        hulls = [
            shapely.MultiPoint(
                np.concatenate([ends[planes[r]].reshape(-1, 2) for f in own for r in rooms[f]])
            ).envelope
            for own in floors
        ]
        gaps = shapely.distance(np.array(hulls)[:, None], hulls)[np.triu_indices(len(hulls), 1)]
        assert (gaps > 2).all()
    assert set(numbers) == {1, 2, 3, 4, 5, 6}


def test_storeys_are_2_4_to_5_m_high_and_some_differ(cities):
    heights, same = [], []
    for graph in cities:
        for floors in children(graph, BUILDING, FLOOR):
            z = graph.nodes.position[floors, 2]
            heights += np.diff(z).tolist()
            counts = [
                len(children(graph, FLOOR, ROOM)[f - np.flatnonzero(graph.nodes.label == FLOOR)[0]])
                for f in floors
            ]
            same += (np.diff(counts) == 0).tolist()
    assert 2.4 <= min(heights) < 2.8
    assert 4.6 < max(heights) <= 5.0
    assert 0.4 < np.mean(same) < 0.9


REFUSED = {
    "thickness is": {"thickness": (0.3, 0.1)},
    "expected 0 to 1": {"lined": 1.5},
    "expected a share of each": {"kinds": (1.0,)},
    "storeys reaches 3 below a building": {"storeys": (1, 3)},
    "top is 2": {"top": ROOM},
    "unevenness is": {"unevenness": -1.0},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_settings_that_no_scene_can_be_drawn_with_are_refused(sentence):
    with pytest.raises(ValueError, match=sentence):
        WideConfig(**REFUSED[sentence])
