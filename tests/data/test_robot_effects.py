"""What a robot does not see as it is, effect by effect."""

import dataclasses

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import synthetic
from sg3d_jax.data.robot import RobotConfig, view
from sg3d_jax.scene.graph import observed_of, parts_first, subgraph
from sg3d_jax.scene.ontology import FLOOR, PLANE, ROOM
from tests.seen_rooms import S_F, assert_same_graph, ends, row_of_planes, views, wholes


def test_missing_planes_leave_the_others_as_they_are(floors):
    seen = views(floors, RobotConfig(missing=0.2))
    for each in seen:
        rows = each.stretches.plane
        for mine, theirs in zip(
            observed_of(each.graph).nodes, subgraph(each.complete, rows).nodes, strict=True
        ):
            npt.assert_array_equal(mine, theirs)
    kept = sum(len(each.stretches.plane) for each in seen)
    total = sum(int(each.complete.nodes.observed.sum()) for each in seen)
    assert abs(1 - kept / total - 0.2) < 0.04


@pytest.mark.parametrize("both_ends", [0.0, 1.0])
def test_a_shortened_plane_loses_its_share_at_one_end_or_both(both_ends, floors):
    config = RobotConfig(shortened=0.5, shortened_by=(0.1, 0.4), both_ends=both_ends)
    short, lost_ends = [], []
    for each in views(floors, config):
        before, after = ends(each.complete), ends(each.graph)
        length = np.linalg.norm(before[:, 1] - before[:, 0], axis=1)
        lost = np.linalg.norm(after - before, axis=2)  # at either end
        npt.assert_allclose(
            length - lost.sum(axis=1), observed_of(each.graph).nodes.width, atol=1e-9
        )
        share = lost.sum(axis=1) / length
        short += share[share > 1e-9].tolist()
        lost_ends += (lost[share > 1e-9] > 1e-9).sum(axis=1).tolist()
        npt.assert_array_equal(wholes(each.graph), wholes(each.complete))
    total = sum(int(graph.nodes.observed.sum()) for graph in floors)
    assert abs(len(short) / total - 0.5) < 0.08
    assert 0.1 <= min(short) < 0.12
    assert 0.38 < max(short) <= 0.4
    assert set(lost_ends) == {1 + both_ends}


def is_one_line(nodes, segments, one, other, gap=1.0):
    """Whether two planes lie on one line with a small gap, by their end points."""
    a, b = segments[[one, other]]
    normals = nodes.normal[[one, other], :2]
    angle = np.degrees(np.arccos(np.clip(normals[0] @ normals[1], -1, 1)))
    off = max(abs((b.mean(axis=0) - a.mean(axis=0)) @ normal) for normal in normals)
    along = (a[1] - a[0]) / np.linalg.norm(a[1] - a[0])
    (low, high), (first, last) = np.sort(a @ along), np.sort(b @ along)
    level = abs(nodes.position[one, 2] - nodes.position[other, 2]) <= 0.5
    return angle <= 1 and off <= 0.05 and max(first - high, low - last) < gap and level


def test_merged_planes_are_those_on_one_line_and_have_the_edges_of_all(floors, cities):
    merged_planes = 0
    for each in views([*floors[:10], cities[0]], RobotConfig(merged=1.0)):
        graph, segments = each.complete, ends(each.complete)
        group = list(range(len(segments)))
        for one in range(len(group)):
            for other in range(one):
                if group[one] != group[other] and is_one_line(graph.nodes, segments, one, other):
                    group = [group[one] if g == group[other] else g for g in group]
        expected = {frozenset(i for i, g in enumerate(group) if g == name) for name in set(group)}
        seen, plane = each.stretches.seen, each.stretches.plane
        held = [frozenset(plane[seen == row].tolist()) for row in np.unique(seen)]
        assert set(held) == expected
        kept = {tuple(place) for place in each.graph.nodes.position.tolist()}
        before, after = wholes(graph), wholes(each.graph)
        for row, members in enumerate(held):
            assert after[row] == set().union(*(before[i] for i in members)) & kept
            points = segments[sorted(members)].reshape(-1, 2)
            start, end = ends(each.graph)[row]
            place = (points - start) @ (end - start) / np.linalg.norm(end - start)
            npt.assert_allclose(
                [place.min(), place.max()], [0, each.graph.nodes.width[row]], atol=1e-9
            )
            off = (points - start) @ each.graph.nodes.normal[row, :2]
            assert np.abs(off).max() < 0.1
            merged_planes += len(members) > 1
    assert merged_planes > 20


@pytest.mark.parametrize(
    ("gap", "shift", "height", "turn", "num_planes"),
    [
        (0.9, 0.0, 0.0, 0.0, 6),
        (1.1, 0.0, 0.0, 0.0, 8),
        (0.9, 0.04, 0.0, 0.0, 6),
        (0.9, 0.06, 0.0, 0.0, 8),
        (0.9, 0.0, 0.4, 0.0, 6),
        (0.9, 0.0, 0.6, 0.0, 8),
        (0.9, 0.0, 0.0, 0.010, 6),
        (0.9, 0.0, 0.0, 0.017, 8),  # the line of the second passes the first one 6 cm off
        (-1.0, 0.0, 0.0, 0.018, 8),  # 1.03 degrees
    ],
)
@pytest.mark.parametrize("turned", [slice(2, 4), slice(6, 8)])
def test_a_wide_gap_or_a_step_is_not_overlooked(gap, shift, height, turn, num_planes, turned):
    graph = row_of_planes(3.0, 2.0, thickness=gap)
    graph.nodes.position[4:8, 1:] += [shift, height]
    graph.nodes.normal[turned, :2] = [[-np.sin(turn), np.cos(turn)], [np.sin(turn), -np.cos(turn)]]
    seen = view(graph, RobotConfig(merged=1.0), 0, 0).graph
    assert (seen.nodes.label == PLANE).sum() == num_planes


def test_a_merged_plane_faces_as_its_widest_does_and_lies_amid_them():
    graph = row_of_planes(3.0, 2.0)
    graph.nodes.position[6] += [0, 0.04, 0.3]  # the lower side of the narrow room
    graph.nodes.normal[6, :2] = [np.sin(-0.01), np.cos(0.01)]
    seen = view(graph, RobotConfig(merged=1.0), 0, 0)
    (row,) = seen.stretches.seen[seen.stretches.plane == 6]
    npt.assert_allclose(seen.graph.nodes.normal[row], graph.nodes.normal[2])
    npt.assert_allclose(seen.graph.nodes.position[row], [2.6, 0.02, 0.15], atol=1e-9)


def test_a_share_of_the_gaps_is_overlooked(floors):
    def num_planes(share):
        return sum(len(ends(each.graph)) for each in views(floors, RobotConfig(merged=share)))

    assert num_planes(0.0) > num_planes(0.3) > num_planes(0.7) > num_planes(1.0)


def test_a_split_plane_is_two_parts_with_its_edges_and_a_gap_between(floors):
    config = RobotConfig(split=0.3, split_gap=(0.4, 0.8))
    num_split = num_long = 0
    for each in views(floors, config):
        before, after = wholes(each.complete), wholes(each.graph)
        for plane, (start, end) in enumerate(ends(each.complete)):
            rows = each.stretches.seen[each.stretches.plane == plane]
            length = np.linalg.norm(end - start)
            place = (ends(each.graph)[rows] - start) @ (end - start) / length
            npt.assert_allclose([place[0, 0], place[-1, -1]], [0, length], atol=1e-9)
            assert all(after[row] == before[plane] for row in rows)
            num_long += length >= 1.2
            if len(rows) == 2:
                num_split += 1
                assert np.array_equal(np.diff(rows), [1])
                assert 0.4 - 1e-9 <= place[1, 0] - place[0, 1] <= 0.8 + 1e-9
                assert (place[:, 1] - place[:, 0]).min() >= 0.2 - 1e-9
    assert abs(num_split / num_long - 0.3) < 0.07


def test_a_plane_is_seen_where_the_stretches_of_a_view_say(floors):
    config = RobotConfig(merged=1.0, split=0.5, doubled=0.3, doubled_offset=(0.0, 0.0))
    slivers = 0
    for each in views(floors, config):
        nodes, (seen, plane, low, high) = each.graph.nodes, each.stretches
        assert (np.diff(seen) >= 0).all()
        along = np.stack([-nodes.normal[seen, 1], nodes.normal[seen, 0]], axis=1)
        start, end = (nodes.position[seen, :2] + at[:, None] * along for at in (low, high))
        whole = ends(each.complete)[plane]
        length = np.linalg.norm(whole[:, 1] - whole[:, 0], axis=1)
        for point in (start, end):  # between the ends of the plane, so the detour is none
            detour = np.linalg.norm(whole - point[:, None], axis=2).sum(axis=1) - length
            npt.assert_allclose(detour, 0, atol=1e-2)
        assert (np.abs([low, high]) <= nodes.width[seen] / 2 + 1e-9).all()
        assert (high - low >= np.minimum(0.1, length / 2) - 1e-9).all()
        slivers += (high - low < 0.3).sum()
    assert slivers


def test_a_doubled_plane_is_a_little_in_front_or_behind_with_the_same_edges(floors):
    sides = set()
    for each in views(floors, RobotConfig(doubled=0.3)):
        before, after = wholes(each.complete), wholes(each.graph)
        for plane, (start, end) in enumerate(ends(each.complete)):
            first, *copies = each.stretches.seen[each.stretches.plane == plane].tolist()
            npt.assert_array_equal(ends(each.graph)[first], [start, end])
            for copy in copies:
                off = (ends(each.graph)[copy] - start) @ each.complete.nodes.normal[plane, :2]
                assert 0.02 <= abs(off[0]) <= 0.1
                npt.assert_allclose(off[0], off[1], atol=1e-9)
                sides.add(bool(off[0] > 0))
                share = each.graph.nodes.width[copy] / np.linalg.norm(end - start)
                assert 0.4 <= share <= 1
                assert after[copy] == before[plane]
    assert sides == {False, True}


def test_noise_is_as_large_as_it_says(floors):
    config = RobotConfig(position_noise=0.05, heading_noise=3.0, height_noise=0.3)
    moves, turns, widths = [], [], []
    for each in views(floors, config):
        one, other = observed_of(each.complete).nodes, observed_of(each.graph).nodes
        moves.append(other.position - one.position)
        cross = one.normal[:, 0] * other.normal[:, 1] - one.normal[:, 1] * other.normal[:, 0]
        turns.append(np.degrees(np.arcsin(cross)))
        widths.append(one.width)
        npt.assert_allclose(np.linalg.norm(other.normal, axis=1), 1, atol=1e-12)
        npt.assert_array_equal(wholes(each.graph), wholes(each.complete))
    moves, turns, widths = (np.concatenate(each) for each in (moves, turns, widths))
    npt.assert_allclose(moves.std(axis=0), [0.05, 0.05, 0.3], rtol=0.15)
    npt.assert_allclose(np.abs(moves.mean(axis=0)), 0, atol=0.04)
    wide = widths > 4
    npt.assert_allclose(turns[~wide].std(), 3.0, rtol=0.15)
    npt.assert_allclose((turns * widths)[wide].std(), 12.0, rtol=0.25)  # their ends stray alike


def test_clutter_is_short_belongs_to_nothing_and_lies_inside_the_floor(floors):
    num_clutter = 0
    for each in views(floors, RobotConfig(clutter=0.5)):
        real = int(each.complete.nodes.observed.sum())
        planes = observed_of(each.graph)
        clutter = np.arange(real, len(planes.nodes.label))
        assert_same_graph(subgraph(planes, np.arange(real)), observed_of(each.complete))
        assert not np.isin(clutter, parts_first(each.graph)).any()
        assert ((planes.nodes.width[clutter] >= 0.2) & (planes.nodes.width[clutter] <= 1.2)).all()
        corners = ends(each.complete).reshape(-1, 2)
        inside = planes.nodes.position[clutter, :2]
        assert ((inside > corners.min(axis=0)) & (inside < corners.max(axis=0))).all()
        num_clutter += len(clutter)
    total = sum(int(graph.nodes.observed.sum()) for graph in floors)
    assert abs(num_clutter / total - 0.5) < 0.1


def test_rooms_that_the_robot_has_not_been_in_are_unseen_and_the_others_whole(cities):
    for each in views(cities, RobotConfig(unvisited=0.4)):
        graph = each.complete
        room_of = {p: w for p, w in parts_first(graph).tolist() if graph.nodes.label[w] == ROOM}
        seen = {room_of[plane] for plane in each.stretches.plane.tolist()}
        rooms = np.flatnonzero(graph.nodes.label == ROOM)
        assert len(seen) == round(0.6 * len(rooms))
        expected = [plane for plane, room in room_of.items() if room in seen]
        npt.assert_array_equal(each.stretches.plane, sorted(expected))


def test_the_robot_has_been_in_rooms_near_one_another():
    graph = row_of_planes(*[3.0] * 12)
    spread = []
    for index in range(40):
        seen = view(graph, RobotConfig(unvisited=0.75), 0, index).graph
        spread.append(seen.nodes.position[seen.nodes.label == ROOM, 0].std() / 3.2)
    assert len(set(spread)) > 3
    assert np.mean(spread) < 1.5  # three in a row have 0.8, any three of twelve 2.7


def test_the_robot_seldom_takes_the_stairs_before_it_has_seen_a_storey():
    graphs = [
        synthetic.make_scene(dataclasses.replace(synthetic.S_B, floor=S_F), 0, index)
        for index in range(30)
    ]
    one_storey = [
        (each.graph.nodes.label == FLOOR).sum() == 1
        for each in views(graphs, RobotConfig(unvisited=0.5))
        if (each.complete.nodes.label == ROOM).sum() > 4
    ]
    assert np.mean(one_storey) > 0.7
