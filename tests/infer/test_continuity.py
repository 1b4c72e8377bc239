"""Which pieces are those of before, and what goes along with them."""

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.infer.continuity import APART, GREW, KEPT, Seen, carried
from sg3d_jax.infer.revision import Map
from sg3d_jax.scene.cut import cut_observed, of_pieces
from sg3d_jax.scene.graph import extended, make_graph, observed_of, parts_first
from sg3d_jax.scene.ontology import FLOOR, PLANE, ROOM
from tests.made_map import known_as
from tests.two_rooms import moved, two_rooms

PLANES = observed_of(two_rooms())


def seen(planes, ids=None) -> Seen:
    ids = tuple(range(len(planes.nodes.label))) if ids is None else ids
    return Seen(planes, ids, cut_observed(planes))


def over(before: Seen, *wholes: tuple[int, ...]) -> Map:
    """Returns the map of rooms over pieces, and of their floor."""
    graph, count = of_pieces(before.graph, before.pieces), len(before.pieces.owner)
    places = [graph.nodes.position[[*parts]].mean(axis=0) for parts in wholes]
    pairs = [(part, count + row) for row, parts in enumerate(wholes) for part in parts]
    pairs += [(count + row, count + len(wholes)) for row in range(len(wholes))]
    label = [ROOM] * len(wholes) + [FLOOR]
    return known_as(extended(graph, label, [*places, np.mean(places, axis=0)], pairs))


def carry(known: Map, before: Seen, now: Seen, **heir) -> Map:
    return carried(known, before, now, of_pieces(now.graph, now.pieces), heir.get("heir", {}))


ROOMS = over(seen(PLANES), range(4), range(4, 8))


def changed(**fields):
    return PLANES._replace(nodes=PLANES.nodes._replace(**fields))


def wider(row: int, by: float, along: float = 0.0):
    """Returns the planes, one of them wider, and with its middle farther along the y axis."""
    width, position = np.array(PLANES.nodes.width), np.array(PLANES.nodes.position)
    width[row] += by
    position[row, 1] += along
    return changed(width=width, position=position)


def test_what_stays__is_kept_bit_for_bit():
    after = carry(ROOMS, seen(PLANES), seen(PLANES))
    for mine, other in zip(after.graph.nodes, ROOMS.graph.nodes, strict=True):
        npt.assert_array_equal(mine, other)
    for mine, other in zip(after.tracks, ROOMS.tracks, strict=True):
        npt.assert_array_equal(mine, other, strict=True)


@pytest.mark.parametrize("angle", [0.3, -0.7])
def test_all_that_moves_as_one__is_as_it_was(angle):
    now = moved(wider(1, KEPT / 2), angle, (100.0, -50.0, 2.0))
    after = carry(ROOMS, seen(PLANES), seen(now))
    expected = moved(ROOMS.graph, angle, (100.0, -50.0, 2.0)).nodes.position
    npt.assert_allclose(after.graph.nodes.position, expected, rtol=0, atol=1e-12)
    assert not after.tracks.due.any()


def test_what_turns_far__is_another():
    after = carry(ROOMS, seen(PLANES), seen(moved(PLANES, 1.0)))
    assert after.tracks.due[:8].all()
    npt.assert_array_equal(after.graph.nodes.position[8:], ROOMS.graph.nodes.position[8:])


@pytest.mark.parametrize("by", [KEPT / 2, GREW - 0.01, GREW + 0.02, -GREW - 0.02])
def test_what_grows_or_shrinks_at_one_end__is_another_beyond_a_limit(by):
    before, now = seen(PLANES), seen(wider(1, by, by / 2))
    after = carry(ROOMS, before, now)
    due = np.flatnonzero(after.tracks.due)
    assert now.pieces.owner[due].tolist() == [1] * (abs(by) > GREW)


def test_what_is_due__is_so_until_it_is_drawn():
    before, now = seen(PLANES), seen(wider(1, -0.5, -0.25))
    after = carry(carry(ROOMS, before, now), now, before)
    assert np.flatnonzero(after.tracks.due).tolist() == [1]


def test_growth__adds_up_until_it_is_drawn_and_shrinks_back():
    known, before = ROOMS, seen(PLANES)
    for total in (0.2, 0.0, 0.2, 0.4):
        now = seen(wider(1, total, total / 2))
        known, before = carry(known, before, now), now
        assert known.tracks.due[1] == (total > GREW)
    npt.assert_array_equal(known.tracks.grew, 0)


@pytest.mark.parametrize("way", [APART, 3 * APART])
def test_parts_that_move_apart__make_their_whole_due(way):
    position = np.array(PLANES.nodes.position)
    position[0, 0] -= way
    after = carry(ROOMS, seen(PLANES), seen(changed(position=position)))
    assert np.flatnonzero(after.tracks.due).tolist() == ([8] if 0.75 * way > APART else [])
    shift = after.graph.nodes.position[8:] - ROOMS.graph.nodes.position[8:]
    npt.assert_allclose(shift[:, 0], [-way / 4, 0, -way / 8], atol=1e-12)


def test_a_whole_that_loses_a_part__is_due_and_one_that_loses_all_is_gone():
    few = make_graph([PLANE] * 3, *(field[[0, 1, 3]] for field in PLANES.nodes[1:4]))
    after = carry(ROOMS, seen(PLANES), seen(few, (0, 1, 3)))
    assert after.graph.nodes.label.tolist() == [PLANE] * 3 + [ROOM, FLOOR]
    assert after.tracks.due.tolist() == [False] * 3 + [True, False]
    assert after.tracks.id.tolist() == [-1] * 3 + [0, 2]
    npt.assert_array_equal(parts_first(after.graph), [(0, 3), (1, 3), (2, 3), (3, 4)])


def test_what_is_firm__stays_and_is_never_due():
    firm = ROOMS.tracks._replace(firm=np.isin(np.arange(11), [9, 10]))
    few = make_graph([PLANE] * 4, *(field[:4] for field in PLANES.nodes[1:4]))
    after = carry(Map(ROOMS.graph, firm), seen(PLANES), seen(few))
    assert after.tracks.id[4:].tolist() == [0, 1, 2]
    assert not after.tracks.due.any()


def test_what_is_merged_into_another__goes_on_as_that():
    ids = (0, 1, 2, 3, 4, 5, 6, 8)  # the last is a new one, with which 7 was merged
    after = carry(ROOMS, seen(PLANES), seen(PLANES, ids), heir={7: 8})
    assert not after.tracks.due.any()
    assert len(parts_first(after.graph)) == 10
    after = carry(ROOMS, seen(PLANES), seen(PLANES, ids))
    assert np.flatnonzero(after.tracks.due).tolist() == [7, 9]


def test_what_another_is_merged_into__is_what_it_was():
    rest = make_graph([PLANE] * 7, *(field[1:] for field in PLANES.nodes[1:4]))
    after = carry(ROOMS, seen(PLANES), seen(rest, (*range(1, 8),)), heir={0: 1})
    assert np.flatnonzero(after.tracks.due).tolist() == [7]  # the room, which has a plane less


def shared(reach: float):
    """Returns seven planes; the third lies along both rooms, and as far beyond them."""
    position, width = np.array(PLANES.nodes.position), np.array(PLANES.nodes.width)
    position[[4, 5], 1] = 1.5
    position[2, 0], width[2] = 4.5 + reach / 2, 9.0 + reach
    rows = [0, 1, 2, 3, 4, 5, 7]
    fields = (position[rows], PLANES.nodes.normal[rows], width[rows])
    return make_graph([PLANE] * 7, *fields)


def test_pieces__are_those_that_lie_where_they_did_however_the_plane_grows():
    before, now = seen(shared(0.0)), seen(shared(2.0))
    assert before.pieces.owner.tolist() == [0, 1, 2, 2, 3, 4, 5, 6]
    assert now.pieces.owner.tolist() == [0, 1, 2, 2, 2, 3, 4, 5, 6]
    known = over(before, (0, 1, 3, 4), (2, 5, 6, 7))
    after = carry(known, before, now)
    assert np.flatnonzero(after.tracks.due).tolist() == [2]  # what was not there before
    npt.assert_array_equal(after.graph.nodes.position[9:], known.graph.nodes.position[8:])
    pairs = {tuple(pair) for pair in parts_first(after.graph).tolist()}
    assert {(0, 9), (1, 9), (4, 9), (5, 9), (3, 10), (6, 10), (7, 10), (8, 10)} < pairs


def test_pieces_of_a_plane_that_moves__go_along():
    before, now = seen(shared(0.0)), seen(moved(shared(0.0), 0.5, (9.0, 2.0, 0.0)))
    known = over(before, (0, 1, 3, 4), (2, 5, 6, 7))
    after = carry(known, before, now)
    assert not after.tracks.due.any()
    expected = moved(known.graph, 0.5, (9.0, 2.0, 0.0)).nodes.position
    npt.assert_allclose(after.graph.nodes.position, expected, rtol=0, atol=1e-9)


def test_a_plane_that_is_but_cut_elsewhere__has_not_moved():
    before, position = seen(shared(0.0)), np.array(shared(0.0).nodes.position)
    position[4, 0] += 0.1  # what ends the first piece of the third
    now = seen(before.graph._replace(nodes=before.graph.nodes._replace(position=position)))
    pieces = [of_pieces(one.graph, one.pieces).nodes.position for one in (before, now)]
    assert (pieces[0] != pieces[1]).any(axis=1).nonzero()[0].tolist() == [2, 5]
    known = over(before, (0, 1, 3, 4), (2, 6, 7))
    after = carry(known, before, now)
    npt.assert_array_equal(after.graph.nodes.position[8:], known.graph.nodes.position[8:])
    assert not after.tracks.due[8:].any()


def test_what_is_new__is_due_and_has_no_past():
    few = make_graph([PLANE] * 7, *(field[:7] for field in PLANES.nodes[1:4]))
    before = seen(few)
    after = carry(over(before, range(4), range(4, 7)), before, seen(PLANES))
    assert np.flatnonzero(after.tracks.due).tolist() == [7]
    assert after.tracks.id.tolist() == [-1] * 8 + [0, 1, 2]
    assert not after.tracks.astray[7].any()
