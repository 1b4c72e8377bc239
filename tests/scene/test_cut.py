import dataclasses
import gzip
import json
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.synthetic import S_C, S_F, make_scene
from sg3d_jax.io.json import graph_from_dict
from sg3d_jax.scene.cut import CUTS, cut_observed, joined, of_pieces
from sg3d_jax.scene.graph import (
    extended,
    make_graph,
    observed_of,
    parts_first,
    subgraph,
    undirected_edges,
)
from sg3d_jax.scene.ontology import (
    FLOOR,
    PAPER_ONTOLOGY,
    PART_OF,
    PLANE,
    PROXIMITY,
    ROOM,
    WALL,
)
from tests.own_world import DEPTH, NUM_OBSERVED, NUM_PLANES, ROOMS, own_world

RECORDINGS = Path(__file__).parents[3] / "shared" / "data" / "s_graphs_logs.jsonl.gz"
TRUE_WIDTHS = dataclasses.replace(S_F, stale_width=False)
MERGED_GAP = 0.5  # metres; walls of S-F are thinner


def planes(*rows):
    """Planes from (x, y, angle of the normal in degrees, width[, z])."""
    x, y, angle, width, z = np.array([(*row, 1.2)[:5] for row in rows], float).T
    angle = np.radians(angle)
    normal = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(x))], -1).round(15)
    return make_graph([PLANE] * len(x), np.stack([x, y, z], -1), normal, width)


def line_of_wall(*others):
    """Row 0: 10 m of wall along x from 0 to 10 m, its front towards +y; then others."""
    return planes((5, 0, 90, 10), *others)


def face(x, looks, near=0.0, far=4.0, z=1.2):
    """One face of a wall across, at x, that looks to -x or +x and goes from y to y."""
    return (x, (near + far) / 2, 0 if looks > 0 else 180, far - near, z)


def wall(x, thickness=0.2, **extent):
    """Both faces of a wall across, its middle at x."""
    return [face(x - thickness / 2, -1, **extent), face(x + thickness / 2, 1, **extent)]


def room(overhang=0.0, side=4.0):
    """A square room from 0 to `side` metres whose planes go beyond its corners at both ends."""
    half, width = side / 2, side + 2 * overhang
    sides = [(half, 0, 90), (side, half, 180), (half, side, 270), (0, half, 0)]
    return [(*each, width) for each in sides]


def grid(*ends):
    """Rooms side by side and one behind the other; what lies on one line is one plane.

    Args:
      *ends: (from, to) of the rooms, metres, along x and along y alike.
    """
    low, high = ends[0][0], ends[-1][1]
    lines = [(at, angle) for pair in ends for at, angle in zip(pair, (90, 270), strict=True)]
    along_x = [((low + high) / 2, at, angle, high - low) for at, angle in lines]
    return planes(*along_x, *((y, x, 90 - angle, width) for x, y, angle, width in along_x))


def shrunk(graph, share):
    """Shrinks a storey about its middle, but not its widths, as in the published cities."""
    position = graph.nodes.position.copy()
    middle = (position[:, :2].min(axis=0) + position[:, :2].max(axis=0)) / 2
    position[:, :2] = middle + share * (position[:, :2] - middle)
    return graph._replace(nodes=graph.nodes._replace(position=position))


def stretches(graph, pieces, row=0):
    """From where to where each piece of a plane goes, metres along x."""
    own = pieces.owner == row
    x, half = pieces.position[own, 0], pieces.width[own] / 2
    return np.sort(np.stack([x - half, x + half], -1), axis=0)


def cut_at(*others):
    graph = line_of_wall(*others)
    return stretches(graph, cut_observed(graph))


def as_one(graph):
    """What a robot takes for one plane: planes on one line, looking one way, with small gaps.

    Returns:
      The planes, and of each the rooms in its order: (from, to, room), metres along x or y.
    """
    seen, room = observed_of(graph).nodes, np.full(len(graph.nodes.label), -1)
    pairs = parts_first(graph)
    of_room = graph.nodes.label[pairs[:, 1]] == ROOM
    room[pairs[of_room, 0]] = pairs[of_room, 1]
    rows, truth = [], []
    angle = np.round(np.degrees(np.arctan2(seen.normal[:, 1], seen.normal[:, 0])))
    axis = (np.abs(seen.normal[:, 0]) > 0.5).astype(int)  # along y, if it looks along x
    line = np.round(seen.position[np.arange(len(axis)), 1 - axis], 2)
    along = seen.position[np.arange(len(axis)), axis]
    for key in sorted(set(zip(angle % 360, line, strict=True))):
        mine = np.flatnonzero((angle % 360 == key[0]) & (line == key[1]))
        low = (along - seen.width / 2)[mine]
        mine, low = mine[np.argsort(low)], np.sort(low)
        high = low + seen.width[mine]
        for part in np.split(
            np.arange(len(mine)), np.flatnonzero(low[1:] - high[:-1] > MERGED_GAP) + 1
        ):
            middle, width = (low[part[0]] + high[part[-1]]) / 2, high[part[-1]] - low[part[0]]
            x, y = (middle, key[1]) if axis[mine[0]] == 0 else (key[1], middle)
            rows.append((x, y, key[0], width))
            truth.append(list(zip(low[part], high[part], room[mine[part]], strict=True)))
    return planes(*rows), truth


def test_a_plane_of_three_rooms_is_cut_into_their_widths():
    npt.assert_allclose(
        cut_at(*wall(3, 0.2), *wall(7, 0.4)), [[0, 2.9], [3.1, 6.8], [7.2, 10]], atol=1e-12
    )


def test_pieces_lie_on_their_plane_in_its_order_and_uncut_ones_are_bit_for_bit():
    graph = line_of_wall(*wall(3.3, 0.17), *wall(7.1, 0.33))
    nodes, pieces = graph.nodes, cut_observed(graph)
    npt.assert_array_equal(pieces.owner, [0, 0, 0, 1, 2, 3, 4])
    assert (np.diff(pieces.position[:3, 0]) < 0).all()  # from right to left as it looks
    npt.assert_allclose(pieces.position[:3, 1:], [[0, 1.2]] * 3, atol=1e-12)
    npt.assert_array_equal(pieces.position[3:], nodes.position[1:])
    npt.assert_array_equal(pieces.width[3:], nodes.width[1:])


@pytest.mark.parametrize("looks", [-1, 1])
def test_a_wall_of_which_one_face_was_seen_cuts_at_that_face(looks):
    npt.assert_allclose(cut_at(face(4, looks)), [[0, 4], [4, 10]], atol=1e-12)


@pytest.mark.parametrize(
    ("others", "num_pieces"),
    [
        (wall(4, far=3.0, near=0.9), 2),  # hidden where it meets the plane
        (wall(4, far=3.0, near=1.1), 1),
        (wall(4, far=0.8, near=0.3), 2),
        (wall(4, far=0.8, near=0.4), 1),  # more is missing than two thirds of what is seen
        (wall(4, far=8.0, near=1.1), 2),  # long ones may end farther away
        (wall(4, near=-3.0, far=2.0), 2),  # goes through
        (wall(4, near=-3.0, far=0.0), 1),  # at its back
        (wall(4, near=0.0, far=0.35), 1),  # a jamb
        (wall(4, near=0.2, far=0.55), 1),
        (wall(4, z=4.2), 1),  # upstairs
        (wall(4, z=1.8), 2),
        ([(5, 0.1, 90, 8)], 1),  # the same plane, seen twice
        ([(5, -0.2, 270, 10)], 1),  # its back
        (wall(0.2), 1),  # too near to an end to leave a piece
        (wall(9.8), 1),
        (wall(4, thickness=0.9), 2),  # a shaft
        (wall(4, thickness=1.1), 3),  # rather a narrow room
        ([*wall(3), *wall(4)], 3),  # a narrow room with its own faces
        ([*wall(3.98), *wall(4.02)], 2),  # one wall, seen twice
        ([*wall(3), *wall(7, near=0.5), (5, 3, 270, 3)], 3),
        ([face(4, -1), face(4, 1), face(4.9, 1)], 3),  # in whatever order
        # They end at a corner, or behind what stands before the plane.
        ([face(4, 1, near=0.6), (6, 0.6, 90, 4)], 1),
        ([face(4, 1, near=0.6), (2, 0.6, 270, 4)], 1),
        ([*wall(4, near=0.6), (5, 0.5, 270, 3)], 1),
        ([face(4, 1, near=0.6), (6.5, 0.6, 90, 4)], 2),  # too far away for a corner
        ([*wall(4, near=0.25), (5, 0.2, 270, 3)], 1),
        ([*wall(4, near=0.25), (5, 0.2, 90, 8)], 2),  # the same plane, seen twice
        ([*wall(4, near=0.6), (5, 4, 270, 10)], 2),  # the other side of the rooms
        ([*wall(4, near=0.6), (5, 0.5, 270, 3, 4.2)], 2),  # upstairs
        ([*wall(4, near=0.6), (7, 0.5, 270, 3)], 2),  # elsewhere
        ([face(8.8, -1, near=0.8)], 2),
        ([face(8.8, -1, near=0.8), (9.15, 0.4, 221, 1.06)], 1),  # an oblique corner
        # Little is left at an end: the plane is too wide, or something closes what is left.
        (wall(9.2), 1),
        (wall(8.8), 2),
        (wall(0.8), 1),
        ([*wall(9.2), face(9.8, -1)], 2),
        ([*wall(0.8), face(0.2, 1)], 2),
        ([*wall(9.2), face(0, 1)], 1),  # closes the other end
        ([*wall(9.2), face(10, 1)], 1),  # looks away
        ([*wall(9.2), face(10, -1, near=1.1, far=4)], 1),  # too far away
        ([*wall(9.2), face(10, -1, near=-3.0, far=-0.1)], 1),  # behind
    ],
)
def test_what_meets_a_plane_and_what_does_not(others, num_pieces):
    assert len(cut_at(*others)) == num_pieces


def test_an_oblique_wall_cuts_where_its_line_meets_the_plane():
    # From (4, 0.5) upwards at 60 degrees to the plane: its line comes down at 4 - 0.5 / tan 60.
    along = np.array([np.cos(np.pi / 3), np.sin(np.pi / 3)])
    x, y = np.array([4, 0.5]) + 1.5 * along
    meets = 4 - 0.5 / np.tan(np.pi / 3)
    npt.assert_allclose(cut_at((x, y, 150, 3)), [[0, meets], [meets, 10]], atol=1e-12)


@pytest.mark.parametrize(
    ("later", "again"),
    [
        ((5, 0.01, 90, 10), True),
        ((3, -0.015, 90.3, 2, 2.0), True),  # part of it, and not as high
        ((5, 0.01, 90, 10.2), True),  # ends a little beyond
        ((9.5, 0.01, 90, 2), False),  # goes on
        ((5, 0.03, 90, 10), False),  # aside
        ((5, 0.01, 91, 10), False),  # turned
        ((5, -0.01, 270, 10), False),  # looks the other way
        ((5, 0.01, 90, 10, 2.8), False),  # of the next storey
        ((5, 0.0, 90, 8), False),  # drawn on the same line
    ],
)
def test_what_shows_again_what_a_plane_before_it_does_has_no_piece(later, again):
    others = wall(4)
    pieces = cut_observed(line_of_wall(*others, later))
    if again:
        alone = cut_observed(line_of_wall(*others))
        assert alone.owner.tolist() == [0, 0, 1, 2]
        for found, expected in zip(pieces, alone, strict=True):
            npt.assert_array_equal(found, expected)
    else:
        assert 3 in pieces.owner
    turned_round = cut_observed(planes(later, *others, (5, 0, 90, 10)))
    assert 0 in turned_round.owner
    assert (3 in turned_round.owner) == (not again or later[3] < 9)  # less shows not the whole


def test_a_window_in_a_plane_is_not_the_plane_seen_again():
    plane = PAPER_ONTOLOGY.concepts[PLANE]
    window = dataclasses.replace(plane, name="window", letter="x", layer="WINDOWS")
    concepts = (plane, window, *PAPER_ONTOLOGY.concepts[1:])
    ontology = dataclasses.replace(PAPER_ONTOLOGY, concepts=concepts)
    given = line_of_wall((5, 0.01, 90, 1))
    for label, owners in ((0, [0]), (1, [0, 1])):
        nodes = given.nodes
        fields = nodes.position, nodes.normal, nodes.width
        graph = make_graph([0, label], *fields, ontology=ontology)
        assert cut_observed(graph).owner.tolist() == owners


def test_whole_floors_are_left_bit_for_bit():
    for index in range(40):
        given = observed_of(make_scene(TRUE_WIDTHS, 0, index))
        pieces = cut_observed(given)
        npt.assert_array_equal(pieces.owner, np.arange(len(given.nodes.label)))
        npt.assert_array_equal(pieces.position, given.nodes.position)
        npt.assert_array_equal(pieces.width, given.nodes.width)


def test_planes_that_were_measured_too_wide_are_seldom_cut():
    rng, cut = np.random.default_rng(0), []
    for index in range(40):
        given = observed_of(make_scene(TRUE_WIDTHS, 0, index))
        width = given.nodes.width * rng.uniform(1, 1.2, len(given.nodes.width))
        too_wide = given._replace(nodes=given.nodes._replace(width=width))
        cut += (np.bincount(cut_observed(too_wide).owner) > 1).tolist()
    assert np.mean(cut) < 0.02


def test_planes_that_a_robot_takes_for_one_are_cut_into_the_rooms_they_bound():
    wanted = found = 0
    for index in range(40):
        merged, truth = as_one(make_scene(TRUE_WIDTHS, 0, index))
        owner, position, width = cut_observed(merged)
        for row, rooms in enumerate(truth):
            axis = int(np.abs(merged.nodes.normal[row, 0]) > 0.5)
            middle, half = position[owner == row, axis], width[owner == row] / 2
            expected = [
                (min(low for low, _, room in rooms if room == each), each)
                for each in dict.fromkeys(room for _, _, room in rooms)
            ]
            starts = np.array([low for low, _ in expected])
            near = np.abs(np.sort(middle - half)[:, None] - starts) < 0.01
            wanted += len(starts)
            found += near.any(axis=0).sum()
            assert len(middle) <= len(rooms)
    assert wanted > 700
    assert found / wanted > 0.995


@pytest.mark.parametrize("share", [0.95, 0.8, 0.55])
def test_a_storey_that_was_shrunk_but_kept_its_widths_is_left_whole(share):
    num_planes = num_pieces = 0
    for index in range(20):
        given = shrunk(observed_of(make_scene(TRUE_WIDTHS, 0, index)), share)
        num_planes += len(given.nodes.label)
        num_pieces += len(cut_observed(given).owner)
    assert num_planes > 300
    assert num_pieces == num_planes


def test_published_cities_are_left_nearly_whole():
    given = [observed_of(make_scene(S_C, 0, index)) for index in range(20)]
    num_planes = sum(len(city.nodes.label) for city in given)
    assert sum(len(cut_observed(city).owner) for city in given) <= 1.001 * num_planes


def test_a_storey_that_was_shrunk_says_nothing_of_another():
    for index in range(5):
        below, _ = as_one(make_scene(TRUE_WIDTHS, 0, index))
        above = shrunk(observed_of(make_scene(TRUE_WIDTHS, 1, index)), 0.7).nodes
        up, alone = above.position + np.array([0, 0, 3]), cut_observed(below)
        both = make_graph(
            np.concatenate([below.nodes.label, above.label]),
            np.concatenate([below.nodes.position, up]),
            np.concatenate([below.nodes.normal, above.normal]),
            np.concatenate([below.nodes.width, above.width]),
        )
        pieces = cut_observed(both)
        num_below, num_pieces = len(below.nodes.label), len(alone.owner)
        assert num_pieces > num_below
        npt.assert_array_equal(pieces.position[:num_pieces], alone.position)
        npt.assert_array_equal(pieces.owner[num_pieces:], num_below + np.arange(len(above.label)))


@pytest.mark.parametrize(
    ("others", "num_cut"),
    [
        ([], 0),
        ([face(-0.5, 1, near=0.0, far=1.0)], 0),  # what is too short to cross anything
        ([face(5.2, -1, near=-2.0, far=2.0)], 0),  # what an overhang comes to
        ([face(4.5, -1, near=-3.0, far=2.0)], 0),  # what goes through one, and so on
        ([face(4.5, -1, near=-3, far=2), (6.5, -2, 90, 5), face(7, -1, near=-4, far=0)], 0),
        ([face(4.5, -1, near=-3.0, far=2.0, z=4.2)], 0),
        ([(5, 30, 180, 2), (30, 5, 270, 2)], 0),  # it ends in line with something, but not at it
        ([(20, 0, 90, 10), face(18, -1)], 1),  # elsewhere
    ],
)
def test_what_overhangs_is_not_cut_nor_is_what_hangs_together_with_it(others, num_cut):
    pieces = cut_observed(planes(*room(overhang=1.0), *others))
    assert len(pieces.owner) == 4 + len(others) + num_cut


BESIDE = (2.02, 0, 90, 6)  # the first side of the room, a little beside its middle


@pytest.mark.parametrize(
    ("sides", "num_cut"),
    [
        (room(overhang=1.0), 0),
        ([BESIDE, *room(overhang=1.0)[1:]], 0),  # three sides tell
        ([BESIDE, *room(overhang=1.0)[1:2], (2.02, 4, 270, 6), *room(overhang=1.0)[3:]], 8),
        ([(2, 0, 90, 6.1), (4, 2, 180, 6), (2, 4, 270, 6.1), (0, 2, 0, 6)], 8),  # other shares
        (room(overhang=1.0)[:2], 2),  # at one end only
        (room(overhang=1.0)[:3], 0),
        ([(2, 0, 90, 6), (4, 2, 180, 6), (4.6, 2, 180, 6 / 1.3), (0, 2, 0, 6)], 0),  # one between
        ([(2, 0, 90, 6), (0, 2, 180, 6), (4, 2, 0, 6)], 4),  # no room, but a wall as thick
        ([(2, 0, 90, 6), (4, 2, 180, 6), (4.005, 2.005, 179, 6.01)], 3),  # one side, seen twice
        ([*room(overhang=-0.3), face(2, 1, far=2)], 1),  # they end before the corners
    ],
)
def test_an_overhang_is_even_and_goes_beyond_the_corners_of_a_room(sides, num_cut):
    assert len(cut_observed(planes(*sides)).owner) == len(sides) + num_cut


@pytest.mark.parametrize("ends", [((0, 3), (3.2, 6.2), (6.4, 9.4)), ((0, 2), (2.3, 7), (7.3, 9.3))])
def test_lines_of_wall_that_cross_evenly_are_cut_where_they_end_at_something(ends):
    given = grid(*ends)
    pieces = cut_observed(given)
    npt.assert_array_equal(np.bincount(pieces.owner), 3)
    for row in range(6):
        npt.assert_allclose(stretches(given, pieces, row), ends, atol=1e-12)


def turned(graph, angle, shift):
    rotation = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    return graph._replace(
        nodes=graph.nodes._replace(
            position=graph.nodes.position @ rotation.T + shift,
            normal=graph.nodes.normal @ rotation.T,
        )
    )


@pytest.mark.parametrize("index", range(4))
def test_moving_the_planes_moves_the_pieces(index):
    merged, _ = as_one(make_scene(TRUE_WIDTHS, 1, index))
    shift = np.array([300.0, -2000.0, 12.0])
    pieces, moved = cut_observed(merged), cut_observed(turned(merged, 0.7, shift))
    npt.assert_array_equal(moved.owner, pieces.owner)
    npt.assert_allclose(moved.width, pieces.width, atol=1e-9)
    there = of_pieces(turned(merged, 0.7, shift), moved).nodes.position
    npt.assert_allclose(
        there, turned(of_pieces(merged, pieces), 0.7, shift).nodes.position, atol=1e-9
    )


@pytest.mark.parametrize("index", range(4))
def test_the_order_of_the_planes_does_not_matter(index):
    merged, _ = as_one(make_scene(TRUE_WIDTHS, 2, index))
    order = np.random.default_rng(index).permutation(len(merged.nodes.label))
    pieces, permuted = cut_observed(merged), cut_observed(subgraph(merged, order))
    assert len(pieces.owner) > len(order)
    back = np.argsort(order[permuted.owner], kind="stable")
    npt.assert_array_equal(order[permuted.owner][back], pieces.owner)
    npt.assert_allclose(permuted.position[back], pieces.position, atol=1e-12)


def test_every_piece_is_as_wide_as_the_rules_say():
    rng = np.random.default_rng(0)
    for _ in range(20):
        scattered = planes(
            *zip(
                rng.uniform(0, 12, 60),
                rng.uniform(0, 12, 60),
                rng.choice([0, 90, 180, 270], 60) + rng.normal(0, 3, 60),
                rng.uniform(0.2, 8, 60),
                strict=True,
            )
        )
        pieces = cut_observed(scattered)
        parts = np.bincount(pieces.owner)[pieces.owner] > 1
        assert parts.sum() > 20
        assert pieces.width[parts].min() >= CUTS.least - 1e-12


def test_a_graph_of_pieces_has_them_in_front_and_keeps_all_other_nodes():
    scene = line_of_wall(*wall(4))
    scene = extended(scene, [ROOM, FLOOR], [[2, 2, 1], [2, 2, 0]], [[1, 3], [3, 4]])
    mixed = subgraph(scene, [3, 0, 1, 4, 2])  # room, line of wall, faces before and behind a floor
    pieces = cut_observed(mixed)
    npt.assert_array_equal(pieces.owner, [1, 1, 2, 4])
    cut = of_pieces(mixed, pieces)
    npt.assert_array_equal(cut.nodes.label, [PLANE] * 4 + [ROOM, FLOOR])
    npt.assert_array_equal(cut.nodes.normal[:4], mixed.nodes.normal[[1, 1, 2, 4]])
    npt.assert_array_equal(cut.nodes.position[4:], mixed.nodes.position[[0, 3]])
    npt.assert_allclose(cut.nodes.width, [5.9, 3.9, 4, 4, 0, 0], atol=1e-12)
    npt.assert_array_equal(undirected_edges(cut, PART_OF), [[2, 4], [4, 5]])


def test_a_plane_that_is_part_of_something_was_not_seen_again():
    given = line_of_wall((5, 0.01, 90, 8))
    known = extended(given, [ROOM], np.zeros((1, 3)), [[1, 2]])
    assert cut_observed(given).owner.tolist() == [0]
    assert cut_observed(known).owner.tolist() == [0, 1]


def test_a_plane_that_is_part_of_something_is_not_cut_but_cuts_others():
    scene = line_of_wall(*wall(4))
    assert len(cut_observed(extended(scene, [ROOM], [[2, 2, 1]], [[1, 3], [2, 3]])).owner) == 4
    assert len(cut_observed(extended(scene, [ROOM], [[2, 2, 1]], [[0, 3]])).owner) == 3


def test_joining_gives_the_edges_of_the_pieces_to_the_planes_each_once():
    given = extended(line_of_wall(*wall(4)), [ROOM], [[9, 9, 1]], [])
    pieces = cut_observed(given)
    cut = of_pieces(given, pieces)  # rows: two pieces, two faces, the room that was known
    grown = extended(
        cut,
        [WALL, ROOM, ROOM],
        [[4, 2, 1], [2, 2, 1], [7, 2, 1]],
        [[2, 5], [3, 5], [0, 6], [2, 6], [1, 7], [3, 7], [0, 5], [1, 5]],
    )
    whole = joined(grown, pieces, given)
    for name, array in given.nodes._asdict().items():
        npt.assert_array_equal(getattr(whole.nodes, name)[:4], array)
        npt.assert_array_equal(getattr(whole.nodes, name)[4:], getattr(grown.nodes, name)[5:])
    expected = [[0, 4], [0, 5], [0, 6], [1, 4], [1, 5], [2, 4], [2, 6]]
    npt.assert_array_equal(undirected_edges(whole, PART_OF), expected)


def test_what_is_whole_comes_back_as_it_was():
    world = own_world()
    for given in (world, observed_of(world), make_graph([], [])):
        pieces = cut_observed(given)
        whole = joined(of_pieces(given, pieces), pieces, given)
        for name, array in given.nodes._asdict().items():
            npt.assert_array_equal(getattr(whole.nodes, name), array)
        npt.assert_array_equal(undirected_edges(whole, PART_OF), undirected_edges(given, PART_OF))
        assert len(undirected_edges(whole, PROXIMITY)) == 0
        assert whole.globals == given.globals


def test_only_what_is_observed_and_has_normal_and_width_is_cut():
    world = observed_of(own_world())
    nodes = world.nodes
    position, width = nodes.position.copy(), nodes.width.copy()
    (left, _), (_, right) = ROOMS[0], ROOMS[-1]
    position[2, 0], width[2] = (left + right) / 2, right - left  # one side of all three rooms
    across = [1, 4, 5, 8]
    position[across, 1], width[across] = DEPTH / 2 + 0.3, DEPTH - 0.6  # which is not met
    world = world._replace(nodes=nodes._replace(position=position, width=width))
    pieces = cut_observed(world)
    npt.assert_array_equal(np.bincount(pieces.owner), np.where(np.arange(NUM_OBSERVED) == 2, 3, 1))
    npt.assert_allclose(stretches(world, pieces, 2), ROOMS, atol=1e-12)
    npt.assert_array_equal(pieces.position[-2:], nodes.position[NUM_PLANES:])
    assert len(cut_observed(subgraph(world, [2, 12, 13])).owner) == 3


@pytest.mark.skipif(not RECORDINGS.exists(), reason="the recordings are not at hand")
def test_planes_of_recordings_are_cut_where_rooms_of_s_graphs_end():
    lines = gzip.decompress(RECORDINGS.read_bytes()).decode().splitlines()
    graphs = [graph_from_dict(json.loads(line)) for line in lines]
    shares = [share for graph in graphs for share in _room_shares(graph)]
    assert len(shares) == 26  # rooms along planes that bound several
    assert np.sum(np.array(shares) > 0.9) >= 23


def _room_shares(graph):
    """How well a piece agrees with each room along each plane of several: intersection over union.

    A room reaches from one to the other of its planes across.
    """
    given, pairs = observed_of(graph), parts_first(graph)
    pairs = pairs[graph.nodes.label[pairs[:, 1]] == ROOM]
    pieces, nodes = cut_observed(given), given.nodes
    for plane in np.flatnonzero(np.bincount(pairs[:, 0]) > 1):
        along = np.array([-nodes.normal[plane, 1], nodes.normal[plane, 0], 0])
        own = pieces.owner == plane
        middle = (pieces.position[own] - nodes.position[plane]) @ along
        half = nodes.width[plane] / 2
        for room in pairs[pairs[:, 0] == plane, 1]:
            others = pairs[pairs[:, 1] == room, 0]
            across = others[np.abs(nodes.normal[others] @ nodes.normal[plane]) < 0.5]
            ends = np.clip((nodes.position[across] - nodes.position[plane]) @ along, -half, half)
            low, high = middle - pieces.width[own] / 2, middle + pieces.width[own] / 2
            common = np.minimum(high, ends.max()) - np.maximum(low, ends.min())
            yield (common / (np.maximum(high, ends.max()) - np.minimum(low, ends.min()))).max()
