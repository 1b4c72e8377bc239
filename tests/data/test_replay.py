"""How a robot comes to its map: what it is told step by step, and the truth of what it then has."""

import dataclasses
from typing import get_args, get_type_hints

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.cli import data
from sg3d_jax.data.replay import DRIVE, REPLAYS, ReplayConfig, replay
from sg3d_jax.data.robot_effects import CLIMB, RobotConfig
from sg3d_jax.scene.graph import make_graph, observed_of, parts_first, subgraph
from sg3d_jax.scene.ontology import PLANE, ROOM, WALL
from sg3d_jax.scene.validate import validate_graph
from tests.own_world import own_world
from tests.seen_rooms import assert_same_graph, row_of_planes


def table(graph):
    nodes = observed_of(graph).nodes
    return np.column_stack([nodes.position, nodes.normal, nodes.width])


def told(steps):
    """Returns every telling of each plane, as pairs of a step and a row of `table`, by id."""
    tellings = {}
    for number, step in enumerate(steps):
        if step.changes.observed is not None:
            for name, row in zip(step.changes.ids, table(step.changes.observed), strict=True):
                tellings.setdefault(name, []).append((number, row))
    return tellings


def rooms_of(graph):
    """Returns the room of each plane that has one."""
    label = graph.nodes.label
    return {
        part: whole
        for part, whole in parts_first(graph).tolist()
        if label[part] == PLANE and label[whole] == ROOM
    }


@pytest.mark.parametrize("how", REPLAYS)
def test_what_is_told_adds_up_to_the_planes_of_the_truth(how, floors, cities):
    for index, graph in enumerate([*floors[:3], cities[1]]):
        known = {}
        for step in replay(graph, REPLAYS[how], 0, index):
            changes = step.changes
            for gone, heir in changes.merged:
                assert heir in step.ids
                del known[gone]
            for gone in changes.removed:
                del known[gone]
            if changes.observed is not None:
                known |= dict(zip(changes.ids, table(changes.observed), strict=True))
            assert {*known} == {*step.ids}
            npt.assert_array_equal([known[name] for name in step.ids], table(step.truth))
            validate_graph(step.truth, how)
            rest = step.truth.nodes.label[len(step.ids) :]
            npt.assert_array_equal(graph.nodes.label[step.rows], rest)


def test_with_nothing_amiss_the_map_ends_as_the_graph_and_every_plane_is_told_once(floors, cities):
    for index, graph in enumerate([*floors[:4], cities[1]]):
        steps = replay(graph, ReplayConfig(), 0, index)
        assert_same_graph(steps[-1].truth, graph)
        assert {len(each) for each in told(steps).values()} == {1}
        assert not any(step.changes.removed or step.changes.merged for step in steps)


def test_the_robot_goes_on_to_rooms_that_are_near_and_sees_one_at_a_time(cities):
    detours = []  # how much farther the next room is than the nearest
    for index, graph in enumerate(cities[1:3]):
        room_of, way = rooms_of(graph), []
        for step in replay(graph, ReplayConfig(), 0, index):
            seen = {room_of[name] for name in step.changes.ids}
            assert len(seen) <= 1
            way += [room for room in seen if room not in way]
        assert {*way} == {*room_of.values()}
        place = graph.nodes.position[way] * [1, 1, CLIMB]
        away = np.linalg.norm(place[:, None] - place, axis=-1)
        detours += [away[at, at + 1] / away[at, at + 1 :].min() for at in range(len(way) - 1)]
    assert np.mean(detours) < 1.3


def test_a_replay_depends_on_seed_and_index_alone(floors):
    first = [step.truth.nodes.position.tobytes() for step in replay(floors[0], DRIVE, 1, 2)]
    for seed, index in ((1, 2), (2, 2), (1, 3)):
        steps = replay(floors[0], DRIVE, seed, index)
        same = [step.truth.nodes.position.tobytes() for step in steps] == first
        assert same == ((seed, index) == (1, 2))


def test_a_plane_is_seen_in_part_and_a_step_later_whole(floors):
    config = ReplayConfig(RobotConfig(shortened=1.0, shortened_by=(0.1, 0.4)))
    for index, graph in enumerate(floors[:5]):
        steps, whole = replay(graph, config, 0, index), table(graph)
        for name, ((first, part), (then, all_of_it)) in told(steps).items():
            assert then == first + 1
            assert 0.6 - 1e-9 <= part[6] / whole[name, 6] <= 0.9 + 1e-9
            npt.assert_array_equal(all_of_it, whole[name])
        assert_same_graph(steps[-1].truth, graph)


def test_noise_is_averaged_out_while_a_plane_is_seen(floors):
    seen = RobotConfig(position_noise=0.05, heading_noise=2.0)
    first, last = [], []
    for index, graph in enumerate(floors[:7]):
        for name, each in told(replay(graph, ReplayConfig(seen, (6, 6)), 0, index)).items():
            if len(each) >= 4:
                first.append(each[0][1] - table(graph)[name])
                last.append(each[-1][1] - table(graph)[name])
    spread = [np.std(each, axis=0) for each in (first, last)]
    npt.assert_allclose(spread[0][:2], 0.05, rtol=0.2)
    assert (spread[1][[0, 1, 3, 4]] < 0.55 * spread[0][[0, 1, 3, 4]]).all()


def test_planes_on_one_line_are_mapped_apart_and_then_taken_for_one():
    graph = row_of_planes(3.0, 2.0, 4.0)  # two lines of three planes each
    steps = replay(graph, ReplayConfig(RobotConfig(merged=1.0)), 0, 0)
    merged = [pair for step in steps for pair in step.changes.merged]
    assert len(merged) == 4
    known = set()
    came = {name: each[0][0] for name, each in told(steps).items()}
    for step in steps:
        assert all({*pair} <= known for pair in step.changes.merged)
        assert all(came[heir] <= came[gone] for gone, heir in step.changes.merged)
        assert {heir for _, heir in step.changes.merged} <= {*step.changes.ids}
        known = {*step.ids}
    truth = steps[-1].truth
    assert np.sort(observed_of(truth).nodes.width)[-2:].tolist() == pytest.approx([9.4, 9.4])
    assert (truth.nodes.label == ROOM).sum() == 3
    wide = np.flatnonzero(truth.nodes.width > 9)
    assert [sum(part == row for part, _ in parts_first(truth).tolist()) for row in wide] == [3, 3]


def test_clutter_comes_and_goes_and_belongs_to_nothing(floors):
    config = ReplayConfig(RobotConfig(clutter=0.5), clutter_stays=(1, 2))
    came = went = 0
    for index, graph in enumerate(floors[:6]):
        real, lives = int(graph.nodes.observed.sum()), {}
        steps = replay(graph, config, 0, index)
        for number, step in enumerate(steps):
            for row in np.flatnonzero(np.array(step.ids) >= real).tolist():
                lives.setdefault(step.ids[row], []).append(number)
                assert row not in parts_first(step.truth)
            went += len(step.changes.removed)
        came += len(lives)
        assert all(numbers[-1] - numbers[0] < 2 for numbers in lives.values())
    assert came > 40
    assert 0.8 * came < went <= came


def test_a_loop_that_closes_moves_what_was_mapped_since_half_of_the_way(cities):
    config = ReplayConfig(drift=0.02, turning=0.1)
    for index, graph in enumerate(cities[1:3]):
        steps, whole, room_of = replay(graph, config, 0, index), table(graph), rooms_of(graph)
        off = {
            name: np.linalg.norm(each[0][1][:2] - whole[name, :2])
            for name, each in told(steps).items()
        }
        moved = {name for name, distance in off.items() if distance > 1e-9}
        assert 0.2 < len(moved) / len(off) < 0.8
        assert max(off.values()) > 0.3
        closing = max(number for number, step in enumerate(steps) if step.changes.ids)
        assert {*steps[closing].changes.ids} == moved
        assert_same_graph(steps[closing].truth, graph)
        assert_same_graph(steps[-1].truth, graph)
        before = steps[closing - 1].truth
        for room in set(room_of.values()):  # each is moved as it is, and so is its truth
            rows = [row for row in sorted(room_of) if room_of[row] == room]
            place = len(whole) + [*steps[closing].rows].index(room)
            here = np.concatenate([before.nodes.position[rows], before.nodes.position[[place]]])
            there = graph.nodes.position[[*rows, room]]
            apart = [np.linalg.norm(p[:, None] - p, axis=-1) for p in (here, there)]
            npt.assert_allclose(*apart, atol=1e-9)


def test_a_wall_that_is_taken_down_makes_one_room_of_two(floors):
    for index, graph in enumerate(floors[:4]):
        steps = replay(graph, ReplayConfig(taken_down=1), 0, index)
        gone = [name for step in steps for name in step.changes.removed]
        if not gone:  # no wall has two planes between two rooms that keep two each
            assert_same_graph(steps[-1].truth, graph)
            continue
        (wall,) = {
            whole
            for part, whole in parts_first(graph).tolist()
            if part in gone and graph.nodes.label[whole] == WALL
        }
        one, other = sorted({rooms_of(graph)[name] for name in gone})
        removing = [bool(step.changes.removed) for step in steps].index(True)
        before, after = steps[removing - 1], steps[-1]
        assert {wall, one, other} <= {*before.rows}
        assert {*after.rows} == {*before.rows} - {wall, other}
        parts = {
            after.ids[part]
            for part, whole in parts_first(after.truth).tolist()
            if part < len(after.ids) and whole == len(after.ids) + [*after.rows].index(one)
        }
        both = {name for name, room in rooms_of(graph).items() if room in (one, other)}
        assert parts == both - {*gone}


def test_planes_of_a_wall_that_goes_are_taken_for_no_others():
    """Two rows of two rooms: the walls of both are on one line."""
    row = row_of_planes(3.0, 3.0)
    nodes, count = row.nodes, len(row.nodes.label)
    position = np.concatenate([nodes.position, np.add(nodes.position, [0.0, 4.2, 0.0])])
    twice = [np.concatenate([each, each]) for each in (nodes.label, nodes.normal, nodes.width)]
    pairs = np.concatenate([parts_first(row), parts_first(row) + count])
    graph = make_graph(twice[0], position, *twice[1:], part_of=pairs)
    for taken_down, on_other_lines in ((0, 0), (1, 2)):
        config = ReplayConfig(RobotConfig(merged=1.0), taken_down=taken_down)
        steps = replay(graph, config, 0, 0)
        assert sum(len(step.changes.removed) for step in steps) == on_other_lines
        assert len(steps[-1].ids) == 8  # four lines of two rooms, four of two rows


def test_a_wall_that_is_built_makes_two_rooms_of_one(floors):
    counts = []
    for index, graph in enumerate(floors[:4]):
        steps = replay(graph, ReplayConfig(built=1), 0, index)
        assert_same_graph(steps[-1].truth, graph)
        building = max(number for number, step in enumerate(steps) if step.changes.ids)
        counts.append(len(steps[building].rows) - len(steps[building - 1].rows))
    assert set(counts) == {2}  # the wall and a room


def test_a_part_of_the_rooms_may_not_be_visited(floors):
    for index, graph in enumerate(floors[:4]):
        steps = replay(graph, ReplayConfig(RobotConfig(unvisited=0.5)), 0, index)
        assert (steps[-1].truth.nodes.label == ROOM).sum() < (graph.nodes.label == ROOM).sum()


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"steps_a_room": (1, 3)}, r"steps_a_room is \(1, 3\), expected 2 <= least <= greatest"),
        ({"clutter_stays": (5, 4)}, r"clutter_stays is \(5, 4\), expected 1 <= least <= greatest"),
        ({"drift": -0.1}, r"drift is -0\.1, expected zero or more"),
        ({"turning": np.inf}, r"turning is inf, expected zero or more"),
        ({"built": -1}, r"built is -1, expected zero or more"),
    ],
)
def test_settings_that_nothing_can_be_drawn_with_are_refused(wrong, sentence):
    with pytest.raises(ValueError, match=sentence):
        ReplayConfig(**wrong)


def test_graphs_that_cannot_be_driven_through_are_refused(floors):
    with pytest.raises(ValueError, match=r"graph 7: its concepts are .*, expected the paper's"):
        replay(own_world(), ReplayConfig(), 0, 7)
    for graph, seen in (
        (floors[0], RobotConfig(missing=1.0)),
        (subgraph(floors[0], floors[0].nodes.label <= WALL), RobotConfig()),
    ):
        with pytest.raises(ValueError, match="graph 3: nothing is seen of it, expected planes of"):
            replay(graph, ReplayConfig(seen), 0, 3)


def test_every_replay_can_be_asked_for_by_name():
    assert get_args(get_type_hints(data.replay)["how"]) == (*REPLAYS,)
    assert dataclasses.replace(REPLAYS["loop"], drift=0.0, turning=0.0) == DRIVE
