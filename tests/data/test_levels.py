"""Floors become scenes of three levels, and no floor gets into two parts."""

import re
from collections import Counter

import numpy as np
import pytest

from sg3d_jax.data.floorplan import storey_of_rooms
from sg3d_jax.data.levels import (
    LEVELS,
    MAX_NODES,
    Floor,
    building_scenes,
    city_scenes,
    floor_scenes,
    num_nodes,
)
from sg3d_jax.data.splits import split_groups
from sg3d_jax.scene.ontology import BUILDING, CITY, FLOOR, PLANE, ROOM
from sg3d_jax.scene.validate import validate_graph


def row_of_rooms(num_rooms, depth):
    """A floor of rectangles side by side, each with a wall to the next."""
    corners = [[0, 0], [3, 0], [3, depth], [0, depth]]
    return storey_of_rooms([corners + np.array([3.2 * room, 0]) for room in range(num_rooms)])


# Twelve buildings of one to three storeys; one floor is too large for a city, one for any stack.
SIZES = {**{i: 2 + i % 5 for i in range(24)}, 5: 14, 9: 30}
FLOORS = [
    Floor(f"b{i // 2}", f"b{i // 2} storey {i % 2}", row_of_rooms(SIZES[i], 3.0 + i / 7))
    for i in range(24)
]
IMPORTED = {name: scenes(FLOORS, seed=3) for name, scenes in LEVELS.items()}
TOP = {"floor": FLOOR, "building": BUILDING, "city": CITY}


def count(graph, concept):
    return int(np.sum(graph.nodes.label == concept))


def of_label(graph, concept):
    return graph.nodes.position[graph.nodes.label == concept]


@pytest.mark.parametrize("name", LEVELS)
def test_scenes_are_sound_and_each_has_a_part_and_an_origin(name):
    graphs, parts, origins, _ = IMPORTED[name]
    assert len(graphs) == len(parts) == len(origins) > 15
    for graph, origin in zip(graphs, origins, strict=True):
        validate_graph(graph, origin)
        assert graph.nodes.label.max() == TOP[name]


@pytest.mark.parametrize("name", LEVELS)
def test_the_same_seed_gives_the_same_scenes_and_another_gives_others(name):
    again, other = LEVELS[name](FLOORS, seed=3), LEVELS[name](FLOORS, seed=4)
    assert again.parts == IMPORTED[name].parts
    assert again.origins == IMPORTED[name].origins
    for mine, theirs in zip(again.graphs, IMPORTED[name].graphs, strict=True):
        np.testing.assert_array_equal(mine.nodes.position, theirs.nodes.position)
    assert other.parts != IMPORTED[name].parts
    assert not np.allclose(other.graphs[0].nodes.normal[0], again.graphs[0].nodes.normal[0])


def test_no_building_is_in_two_parts_at_whatever_level():
    parts_of = {}
    for _, parts, origins, _ in IMPORTED.values():
        for part, origin in zip(parts, origins, strict=True):
            for building in re.findall(r"b\d+", origin):
                parts_of.setdefault(building, set()).add(part)
    assert len(parts_of) == 12
    assert all(len(parts) == 1 for parts in parts_of.values())
    assert Counter(part for parts in parts_of.values() for part in parts) == {
        "train": 7,
        "validation": 2,
        "test": 3,
    }


def test_parts_are_those_of_the_buildings():
    buildings = [floor.building for floor in FLOORS]
    assert IMPORTED["floor"].parts == split_groups(buildings, 3)


def test_a_floor_keeps_its_shape_and_is_turned():
    for floor, graph in zip(FLOORS, IMPORTED["floor"].graphs, strict=True):
        planes = of_label(graph, PLANE)[:, :2]
        distances = np.linalg.norm(planes[:, None] - planes, axis=-1)
        plane = floor.storey.plane
        np.testing.assert_allclose(distances, np.linalg.norm(plane[:, None] - plane, axis=-1))
        np.testing.assert_allclose(of_label(graph, FLOOR)[0, :2], floor.storey.centre)
    turned = [graph.nodes.normal[0] for graph in IMPORTED["floor"].graphs]
    assert len(np.unique(np.round(turned, 3), axis=0)) == len(FLOORS)


@pytest.mark.parametrize("name", LEVELS)
def test_floors_that_are_not_axis_aligned_may_stay_as_they_are(name):
    imported = LEVELS[name](FLOORS, seed=3, rotate=False)
    storey = FLOORS[0].storey
    np.testing.assert_array_equal(
        of_label(imported.graphs[0], PLANE)[: len(storey.plane), :2], storey.plane
    )


def test_a_building_is_its_floor_twice():
    kept = [floor for floor in FLOORS if num_nodes(floor.storey) <= MAX_NODES[BUILDING]]
    assert len(kept) == len(FLOORS) - 1
    for floor, graph in zip(kept, IMPORTED["building"].graphs, strict=True):
        assert len(graph.nodes.label) == 2 * num_nodes(floor.storey) + 1
        low, high = np.split(of_label(graph, PLANE), 2)
        np.testing.assert_allclose(high - low, np.tile([0.0, 0.0, 4.0], (len(low), 1)))
        np.testing.assert_allclose(of_label(graph, BUILDING)[0, 2], 6.0)


def test_a_city_has_a_building_of_two_storeys_and_one_of_one_or_two():
    by_origin = {floor.origin: floor for floor in FLOORS}
    kept = [floor for floor in FLOORS if num_nodes(floor.storey) <= MAX_NODES[CITY]]
    assert len(kept) == len(FLOORS) - 2
    graphs, _, origins, _ = IMPORTED["city"]
    num_extra = []
    for floor, graph, origin in zip(kept, graphs, origins, strict=True):
        pattern = r"(.*) \(x 2\) and (.*) \(x (1|2)\)"
        base, other, storeys = re.fullmatch(pattern, origin).groups()
        assert base == floor.origin
        assert other != base
        num_extra.append(int(storeys))
        size = num_nodes(by_origin[other].storey)
        assert len(graph.nodes.label) == 2 * num_nodes(floor.storey) + int(storeys) * size + 3
        assert count(graph, FLOOR) == 2 + int(storeys)
    assert set(num_extra) == {1, 2}


def test_the_buildings_of_a_city_keep_clear_of_each_other():
    by_origin = {floor.origin: floor for floor in FLOORS}
    for graph, origin in zip(IMPORTED["city"].graphs, IMPORTED["city"].origins, strict=True):
        num_base = 2 * len(by_origin[origin.split(" (x 2)")[0]].storey.plane)
        planes = of_label(graph, PLANE)
        one, other = planes[:num_base], planes[num_base:]
        gap = np.maximum(other.min(axis=0) - one.max(axis=0), one.min(axis=0) - other.max(axis=0))
        assert gap[:2].max() > 4.0
        assert -2.0 <= other[:, 2].min() <= 2.0


def test_a_city_needs_two_floors_in_each_part():
    one_each = [Floor(f"b{i}", f"b{i} storey 0", row_of_rooms(2, 3.0)) for i in range(5)]
    with pytest.raises(ValueError, match="is alone in its part, expected more floors"):
        city_scenes(one_each)


@pytest.mark.parametrize("scenes", [floor_scenes, building_scenes, city_scenes])
def test_floors_of_few_buildings_are_all_for_test(scenes):
    graphs, parts, _, _ = scenes(FLOORS[:2])
    assert len(graphs) == 2
    assert parts == ["test"] * 2
    with pytest.raises(ValueError, match="there are no floors, expected at least one"):
        scenes([])


def test_names_are_those_of_the_rooms_floors_and_buildings():
    called = [("hall", None), ("kitchen", "bath")]
    floors = [floor._replace(rooms=names) for floor, names in zip(FLOORS[:2], called, strict=True)]
    (graph, other), _, _, (names, others) = city_scenes(floors)
    for scene, said, rooms in ((graph, names, ["hall"]), (other, others, ["kitchen", "bath"])):
        label = scene.nodes.label
        of = {
            concept: [said[row] for row in np.flatnonzero(label == concept) if row in said]
            for concept in (ROOM, FLOOR, BUILDING, CITY)
        }
        assert of[ROOM][: 2 * len(rooms)] == 2 * rooms  # of two storeys
        assert of[BUILDING] == ["b0", "b0"]
        assert of[CITY] == []
        assert len(of[FLOOR]) == count(scene, FLOOR)
        assert sum(map(len, of.values())) == len(said)


def test_floors_that_are_all_too_large_are_refused():
    large = [Floor(f"b{i}", f"b{i} storey 0", row_of_rooms(30, 3.0)) for i in range(6)]
    with pytest.raises(ValueError, match="all floors have more than 110 nodes, expected smaller"):
        building_scenes(large)
