"""Furnished scenes, measured from their graphs alone."""

from collections import Counter
from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY, O_C, O_F, FurnishedConfig
from sg3d_jax.data.synthetic import make_scene
from sg3d_jax.scene.graph import parts_first
from sg3d_jax.scene.ontology import CITY, PAPER_ONTOLOGY
from sg3d_jax.scene.validate import validate_graph
from tests.seen_rooms import assert_same_graph
from tests.unchecked import unchecked

LABEL = {name: FURNISHED_ONTOLOGY.label_of(name) for name in FURNISHED_ONTOLOGY.names}
NUM_FLOORS = 60


@pytest.fixture(scope="module")
def floors():
    with unchecked():
        return [make_scene(O_F, 0, index) for index in range(NUM_FLOORS)]


@pytest.fixture(scope="module")
def cities():
    with unchecked():
        return [make_scene(O_C, 0, index) for index in range(10)]


def wholes(graph, part, whole):
    """Of each node of a concept, by its row, the rows of its wholes of another."""
    label, pairs = graph.nodes.label, parts_first(graph)
    found = {row: [] for row in np.flatnonzero(label == LABEL[part]).tolist()}
    chosen = (label[pairs] == [LABEL[part], LABEL[whole]]).all(axis=1)
    for one, other in pairs[chosen].tolist():
        found[one].append(other)
    return found


def kind(graph, row):
    """The name of the kind of a node."""
    concept = FURNISHED_ONTOLOGY.concepts[graph.nodes.label[row]]
    return concept.kinds[int(graph.nodes.kind[row]) - 1]


def test_every_scene_is_sound_and_keeps_its_rules(floors, cities):
    for graph in (*floors, *cities):
        validate_graph(graph, "drawn")
        assert (np.diff(graph.nodes.label) >= 0).all()
        for rule in FURNISHED_ONTOLOGY.rules:
            count = {len(each) for each in wholes(graph, rule.part, rule.whole).values()}
            is_top = LABEL[rule.whole] > graph.nodes.label.max()
            assert count <= ({0} if is_top else {1} if rule.single else {0, 1, 2})
            assert count - {0} or not count or is_top or rule.whole == "wall"
        of_kinds = FURNISHED_ONTOLOGY.has("kind")[graph.nodes.label]
        assert (graph.nodes.kind[of_kinds] > 0).all()


def test_planes_walls_and_rooms_are_those_of_the_wide_scene_that_is_furnished(floors, cities):
    own = [LABEL[name] for name in PAPER_ONTOLOGY.names]
    for config, graph in ((O_F, floors[3]), (O_C, cities[4])):
        bare, rows = (
            make_scene(config.scene, 0, 3 if config is O_F else 4),
            np.isin(graph.nodes.label, own),
        )
        npt.assert_array_equal(graph.nodes.position[rows], bare.nodes.position)
        npt.assert_array_equal(graph.nodes.normal[rows], bare.nodes.normal)
        npt.assert_array_equal(graph.nodes.label[rows], np.take(own, bare.nodes.label))
        place = np.cumsum(rows) - 1
        pairs = parts_first(graph)
        kept = {tuple(place[pair].tolist()) for pair in pairs[rows[pairs].all(axis=1)]}
        rooms_of_floors = {
            (one, other)
            for one, other in parts_first(bare).tolist()
            if bare.nodes.label[one] == 2 and bare.nodes.label[other] == 3
        }
        assert kept == {*map(tuple, parts_first(bare).tolist())} - rooms_of_floors


def test_a_scene_depends_on_seed_and_index_alone(floors):
    assert_same_graph(make_scene(O_F, 0, 7), floors[7])
    for seed, index in ((1, 7), (0, 8)):
        other = make_scene(O_F, seed, index)
        assert other.nodes.position[0].tolist() != floors[7].nodes.position[0].tolist()


def test_a_door_is_in_the_wall_between_its_rooms(floors):
    doors = 0
    for graph in floors:
        position, normal = graph.nodes.position[:, :2], graph.nodes.normal[:, :2]
        sides = {}
        for plane, (room,) in wholes(graph, "plane", "room").items():
            sides.setdefault(room, []).append(plane)
        for door, rooms in wholes(graph, "door", "room").items():
            for room in rooms:
                planes = np.array(sides[room])
                offset = position[door] - position[planes]
                before = np.sum(offset * normal[planes], axis=1)
                along = np.abs(offset[:, 0] * normal[planes, 1] - offset[:, 1] * normal[planes, 0])
                within = along + graph.nodes.width[door] / 2 <= graph.nodes.width[planes] / 2 + 0.1
                assert ((before > -0.4) & (before < 0) & within).any()
                doors += 1
            assert 0.6 < graph.nodes.width[door] <= 1.2
            npt.assert_allclose(graph.nodes.position[door, 2], 1.0)
    assert doors > 10 * NUM_FLOORS


def test_the_rooms_of_a_flat_hang_together_by_doors_and_no_door_leads_into_another(floors, cities):
    for graph in (*floors, *cities):
        unit = {room: of for room, (of,) in wholes(graph, "room", "unit").items()}
        head = {room: room for room in unit}
        for rooms in wholes(graph, "door", "room").values():
            if len(rooms) < 2:
                continue
            units = [unit[room] for room in rooms]
            assert units[0] == units[1] or "common" in [kind(graph, each) for each in units]
            if units[0] == units[1]:
                one, other = (head[room] for room in rooms)
                head = {room: one if of == other else of for room, of in head.items()}
        for of in {*unit.values()}:
            if kind(graph, of) == "flat":
                assert len({head[room] for room in unit if unit[room] == of}) == 1


def test_flats_have_the_rooms_that_people_need(floors):
    flats = Counter()
    for graph in floors:
        members = {}
        for room, (unit,) in wholes(graph, "room", "unit").items():
            members.setdefault(unit, []).append(kind(graph, room))
        for unit, kinds in members.items():
            if kind(graph, unit) != "flat":
                continue
            count = Counter(kinds)
            assert max(count[name] for name in ("kitchen", "living room", "corridor")) <= 1
            assert not {*kinds} & {"classroom", "meeting room", "hall"}
            flats["all"] += 1
            flats["to cook in"] += count["kitchen"] + count["living room"] > 0
            flats["bath"] += count["bathroom"] > 0 or len(kinds) < 3
    assert flats["to cook in"] == flats["all"] > 30
    assert flats["bath"] > 0.8 * flats["all"]


def test_a_room_has_things_of_its_kind_and_no_more_than_stated(floors):
    there = {"bed": set(), "toilet": set(), "stove": set(), "desk": set(), "board": set()}
    for graph in floors:
        rooms = [room for (room,) in wholes(graph, "object", "room").values()]
        assert max(Counter(rooms).values(), default=0) <= O_F.max_objects
        for thing, (room,) in wholes(graph, "object", "room").items():
            if kind(graph, thing) in there:
                there[kind(graph, thing)].add(kind(graph, room))
    assert there["bed"] <= {"bedroom", "living room"}
    assert there["toilet"] == {"bathroom"}
    assert there["stove"] <= {"kitchen", "living room"}
    assert there["desk"] <= {"bedroom", "office", "classroom"}
    assert there["board"] <= {"classroom", "meeting room"}
    assert all(there.values())


def test_stairs_join_stairwells_above_one_another(cities):
    joined = 0
    for graph in cities:
        position = graph.nodes.position
        for stairs, rooms in wholes(graph, "stairs", "room").items():
            assert [kind(graph, room) for room in rooms] == ["stairwell"] * 2
            low, high = sorted(position[rooms].tolist(), key=lambda place: place[2])
            assert low[2] < position[stairs, 2] < high[2]
            assert np.linalg.norm(np.subtract(low, high)[:2]) < 3
            joined += 1
    assert joined > 5


def test_a_unit_is_in_the_middle_of_its_rooms(cities):
    graph = cities[1]
    members = {}
    for room, (unit,) in wholes(graph, "room", "unit").items():
        members.setdefault(unit, []).append(room)
    for unit, rooms in members.items():
        middle = graph.nodes.position[rooms].mean(axis=0)
        npt.assert_allclose(graph.nodes.position[unit], middle, atol=1e-9)


def test_without_furniture_there_are_doors_and_no_objects():
    graph = make_scene(replace(O_F, furnished=0.0), 0, 3)
    count = np.bincount(graph.nodes.label, minlength=len(LABEL))
    assert not count[LABEL["object"]]
    assert count[LABEL["door"]]


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"furnished": 1.1}, r"furnished is 1\.1, expected 0 to 1"),
        ({"inner_doors": -0.1}, r"inner_doors is -0\.1, expected 0 to 1"),
        ({"max_objects": 0}, "max_objects is 0, expected one or more"),
    ],
)
def test_settings_that_no_scene_can_be_drawn_with_are_refused(wrong, sentence):
    with pytest.raises(ValueError, match=sentence):
        FurnishedConfig(**wrong)


def test_a_city_is_the_highest_of_o_c(cities):
    assert O_C.scene.top == CITY
    assert {int(graph.nodes.label.max()) for graph in cities} == {LABEL["city"]}
