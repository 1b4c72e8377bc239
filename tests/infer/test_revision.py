"""What a map takes over of a draw, on made draws."""

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.infer.region import Region, whole_region
from sg3d_jax.infer.revision import (
    Map,
    followed,
    pruned,
    revised,
    without,
)
from sg3d_jax.scene.graph import SceneGraph, make_graph, part_of_matrix, parts_first, subgraph
from sg3d_jax.scene.ontology import (
    BUILDING,
    CITY,
    FLOOR,
    PAPER_ONTOLOGY,
    PLANE,
    ROOM,
    WALL,
    Concept,
    Ontology,
    Rule,
)
from tests.drawn_rooms import drawn
from tests.made_map import known_as
from tests.two_rooms import two_rooms

WEST, EAST = (0, 1, 2, 3), (4, 5, 6, 7)
BOTH = drawn(WEST, EAST, walls=[(1, 4)])  # planes, rooms 8 and 9, wall 10, floor 11


def redrawn(known: Map, graph: SceneGraph, **options) -> Map:
    """Returns a map after a draw of the whole of it; what is firm is among what was drawn on."""
    region = whole_region(known.graph, known.tracks.firm)
    return revised(known, region, graph, update=2, next_id=100, **options)


def wholes(known: Map) -> dict[int, tuple[int, set[int]]]:
    """Returns the label and the parts of each grown node, by ids; planes by their rows."""
    number, label = known.tracks.id, known.graph.nodes.label
    found = {int(one): (int(kind), set()) for one, kind in zip(number, label, strict=True)}
    for part, whole in parts_first(known.graph).tolist():
        name = part if number[part] < 0 else ("grown", int(number[part]))
        found[int(number[whole])][1].add(name)
    found.pop(-1)
    return found


def test_a_draw_that_agrees__changes_nothing_but_what_is_known_of_it():
    known = known_as(BOTH, due=(0,), astray=1)
    after = redrawn(known, drawn(EAST, WEST, walls=[(1, 4)], at=3.0))
    assert wholes(after) == wholes(known)
    npt.assert_array_equal(after.graph.nodes.position, BOTH.nodes.position)
    assert (after.tracks.drawn[8:] == 2).all()
    assert (after.tracks.held[8:] == 2).all()
    assert (after.tracks.born[8:] == 1).all()
    assert not after.tracks.astray[:8, [WALL, ROOM]].any()


@pytest.mark.parametrize("is_piece", [True, False])
def test_a_whole_that_gets_another_piece_of_what_it_has__has_not_changed(is_piece):
    known, draw = known_as(drawn(WEST, EAST[1:]), due=[4]), drawn(WEST, EAST, at=3.0)
    piece_of = np.array([*range(4), 5 if is_piece else 4, 5, 6, 7])
    after = redrawn(known, draw, piece_of=piece_of)
    assert wholes(after)[1] == (ROOM, {*EAST})
    assert after.graph.nodes.position[9, 0] == (0.0 if is_piece else 3.0)
    assert after.tracks.held[9] == (2 if is_piece else 1)


def test_where_a_map_is_thought_over__places_become_the_mean_of_all_draws():
    known, there = known_as(BOTH), BOTH.nodes.position
    for number, x in ((2, 3.0), (3, 6.0)):
        known = redrawn(known, drawn(EAST, WEST, walls=[(1, 4)], at=x))
        there = there + (np.arange(12) >= 8)[:, None] * ([x, 0, 0] - there) / number
        npt.assert_allclose(known.graph.nodes.position, there)
    firm = known_as(BOTH, firm=(8,))
    after = redrawn(firm, drawn(EAST, WEST, walls=[(1, 4)], at=3.0))
    npt.assert_array_equal(after.graph.nodes.position[8], BOTH.nodes.position[8])


def test_a_draw_that_differs__is_taken_over_the_second_time_in_a_row():
    other = drawn((*WEST, 4), EAST[1:], walls=[(1, 4)], at=3.0)
    once = redrawn(known_as(BOTH), other)
    assert wholes(once) == wholes(known_as(BOTH))
    assert once.tracks.held[8:].tolist() == [1, 1, 2, 2]
    assert once.tracks.astray[4].tolist() == [0, 0, 1, 0, 0, 0]
    twice = redrawn(once, other)
    assert wholes(twice)[0] == (ROOM, {*WEST, 4})
    assert wholes(twice)[1] == (ROOM, {*EAST[1:]})
    assert twice.tracks.drawn[8:].tolist() == [1, 1, 3, 3]
    npt.assert_array_equal(twice.graph.nodes.position[8:10, 0], 3.0)
    assert not twice.tracks.astray.any()


def test_what_is_due__is_as_drawn_at_once():
    after = redrawn(known_as(BOTH, due=[4]), drawn((*WEST, 4), EAST[1:], walls=[(1, 4)]))
    assert wholes(after)[0] == (ROOM, {*WEST, 4})
    assert not after.tracks.due.any()


def test_parts_of_wholes_that_are_due__are_as_drawn_at_once():
    after = redrawn(known_as(BOTH, due=[9]), drawn((*WEST, 4), EAST[1:]))
    assert wholes(after)[0] == (ROOM, {*WEST, 4})
    assert wholes(after)[2] == (WALL, {1, 4})


def test_what_is_nowhere__is_as_drawn_at_once():
    after = redrawn(known_as(drawn(WEST, EAST[1:])), drawn(WEST, EAST))
    assert wholes(after)[1] == (ROOM, {*EAST})


@pytest.mark.parametrize(
    ("due", "held", "waits"), [([4], 2, 1), ([4], 1, 0), ([4, 5], 2, 0), ([], 2, 0)]
)
def test_what_is_new__waits_to_be_drawn_again_in_what_has_settled(due, held, waits):
    known, draw = known_as(drawn(WEST, EAST[1:]), due=due), drawn(WEST, EAST)
    known = known._replace(tracks=known.tracks._replace(held=known.tracks.held * held))
    for _ in range(waits):
        known = redrawn(known, draw)
        assert wholes(known)[1] == (ROOM, {*EAST[1:]})
        assert np.flatnonzero(known.tracks.due).tolist() == [4]
    known = redrawn(known, draw)
    assert wholes(known)[1] == (ROOM, {*EAST})
    assert not known.tracks.due.any()


def test_what_is_drawn_nowhere__stays_where_it_is_at_first():
    known = known_as(BOTH, due=[*EAST])
    once = redrawn(known, drawn(WEST))
    assert wholes(once) == wholes(known)
    assert wholes(redrawn(once, drawn(WEST))) == {
        0: (ROOM, {*WEST}),
        3: (FLOOR, {("grown", 0)}),
    }


def test_a_drawn_whole__goes_on_as_the_one_that_it_shares_most_with():
    after = redrawn(known_as(BOTH, due=range(8)), drawn((0, 1), (2, 3, *EAST)))
    assert wholes(after)[1] == (ROOM, {2, 3, *EAST})
    assert wholes(after)[0] == (ROOM, {0, 1})
    after = redrawn(known_as(BOTH, due=range(8)), drawn((0, 1, 4), (2, 3), EAST[1:]))
    new = wholes(after)
    assert new[0][1] in ({0, 1, 4}, {2, 3})
    assert {frozenset(new[one][1]) for one in (0, 1, 100)} == {
        frozenset(parts) for parts in ((0, 1, 4), (2, 3), EAST[1:])
    }
    assert after.tracks.born[after.tracks.id == 100].tolist() == [2]


def test_what_is_firm__keeps_its_parts_and_they_have_no_other():
    known = known_as(BOTH, firm=[8], due=range(8))
    given = subgraph(BOTH, [*range(8), 8])
    pairs = [*parts_first(given).tolist(), *((plane, 9) for plane in range(8)), (9, 10), (8, 10)]
    label = [PLANE] * 8 + [ROOM, ROOM, FLOOR]
    position = np.pad(given.nodes.position, [(0, 2), (0, 0)])
    after = redrawn(known, make_graph(label, position, part_of=pairs))
    assert wholes(after)[0] == (ROOM, {*WEST})
    assert wholes(after)[1] == (ROOM, {*EAST})


def test_a_firm_whole_that_was_not_given__takes_what_is_drawn_of_it_and_gives_nothing():
    known = known_as(drawn(WEST, EAST, floors=[[0], [1]]), firm=[10])
    draw = drawn(WEST, EAST, floors=[[1], [0]])
    for _ in range(3):
        known = redrawn(known, draw)
    assert wholes(known)[2] == (FLOOR, {("grown", 0)})
    some = known_as(subgraph(BOTH, [*range(9), 11]), firm=[9])
    after = redrawn(some, drawn(WEST, EAST))
    assert wholes(after)[1] == (FLOOR, {("grown", 0), ("grown", 100)})


def test_a_firm_whole__keeps_parts_that_may_have_several():
    ontology = Ontology(
        (
            Concept("plane", "#111111", "p", "PLANES", observed=True),
            Concept("room", "#222222", "R", "ROOMS"),
            Concept("zone", "#333333", "Z", "ZONES"),
            Concept("floor", "#444444", "F", "FLOORS"),
        ),
        (Rule("plane", "room"), Rule("room", "zone", single=False), Rule("room", "floor")),
    )

    def over(*zones):
        label = [0, 0, 1, 1] + [2] * len(zones)
        pairs = [(2 + room, 4 + row) for row, rooms in enumerate(zones) for room in rooms]
        position = np.zeros((len(label), 3))
        return make_graph(label, position, part_of=[(0, 2), (1, 3), *pairs], ontology=ontology)

    known = known_as(over([0], [0, 1]), firm=[4])
    for _ in range(3):
        known = redrawn(known, over([0, 1]))
    assert wholes(known)[2] == (2, {("grown", 0)})
    assert wholes(known)[3] == (2, {("grown", 0), ("grown", 1)})


def test_there_is_one_top_however_far_away_another_is_drawn():
    label = [PLANE] * 8 + [ROOM, FLOOR, BUILDING, CITY]
    chain = [(8, 9), (9, 10), (10, 11)]
    position = np.zeros((12, 3))
    graph = make_graph(label, position, part_of=[*((plane, 8) for plane in WEST), *chain])
    region = Region(np.array(EAST), np.arange(12) >= 9)
    pairs = [*((plane, 4) for plane in range(4)), *((row, row + 1) for row in range(4, 7))]
    draw = make_graph([PLANE] * 4 + label[8:], position[:8], part_of=pairs)
    after = wholes(revised(known_as(graph, due=EAST), region, draw, 2, 100))
    assert [kind for kind, _ in after.values()].count(CITY) == 1
    assert after[3] == (CITY, {("grown", 2), ("grown", 102)})


def test_a_whole_that_reaches_beyond_the_region__is_not_where_it_was_drawn():
    graph = drawn((0, 1), (2, 3))  # planes, rooms 8 and 9, floor 10
    region = Region(np.array([*range(2, 8), 9]), np.arange(11) == 10)
    given = subgraph(graph, region.rows)
    pairs = [*parts_first(given).tolist(), *((plane, 7) for plane in range(2, 6)), (6, 8), (7, 8)]
    position = np.concatenate([given.nodes.position, [[6.0, 0, 0], [50.0, 0, 0]]])
    draw = make_graph([*given.nodes.label, ROOM, FLOOR], position, part_of=pairs)
    after = revised(known_as(graph, due=EAST), region, draw, 2, 100)
    assert wholes(after)[2] == (FLOOR, {("grown", 0), ("grown", 1), ("grown", 100)})
    shift = after.graph.nodes.position[10] - graph.nodes.position[10]
    npt.assert_allclose(shift, [2.0, 0, 0])  # as the middle of its rooms has


def test_what_is_outside_of_the_region__stays():
    known = known_as(BOTH, due=[4])
    region = Region(np.array([*range(4, 8), 10]), np.isin(np.arange(12), [9, 11]))
    part = subgraph(known.graph, region.rows)
    label = [*part.nodes.label, ROOM, FLOOR]
    position = np.pad(part.nodes.position, [(0, 2), (0, 0)])
    pairs = [*parts_first(part).tolist(), (0, 5), (1, 5), (5, 6)]
    draw = make_graph(label, position, part_of=pairs)
    after = revised(known, region, draw, 2, 100)
    assert wholes(after)[0] == (ROOM, {*WEST})
    assert wholes(after)[3] == (FLOOR, {("grown", 0), ("grown", 1)})
    assert wholes(after)[1] == (ROOM, {*EAST})  # of which two were drawn nowhere, once
    npt.assert_array_equal(after.graph.nodes.position[8], BOTH.nodes.position[8])
    assert after.tracks.drawn[8:].tolist() == [1, 2, 1, 2]


def test_what_is_banned__does_not_come():
    asked = []

    def is_banned(label, observed):
        asked.append((label, observed))
        return (label, observed) == (ROOM, {*WEST})

    empty = known_as(subgraph(BOTH, range(8)), due=range(8))
    after = redrawn(empty, drawn(WEST, EAST), is_banned=is_banned)
    assert [kind for kind, _ in wholes(after).values()] == [ROOM, FLOOR]
    assert (ROOM, {*EAST}) in wholes(after).values()
    assert (FLOOR, frozenset(EAST)) in asked
    # Who would have been part of it stays where it is.
    known = known_as(drawn((0, 1), (2, 3, *EAST)), due=range(8))
    after = redrawn(known, drawn(WEST, EAST), is_banned=is_banned)
    assert wholes(after)[0] == (ROOM, {0, 1})
    # Nor by what another loses.
    known = known_as(drawn((*WEST, 4), EAST[1:]), due=[4])
    after = redrawn(known, drawn(WEST, EAST), is_banned=is_banned)
    assert (ROOM, {*WEST}) not in wholes(after).values()


def test_wholes_without_parts__go_unless_they_are_firm():
    graph = subgraph(BOTH, range(12), edges=False)
    assert wholes(pruned(known_as(graph))) == {}
    assert [*wholes(pruned(known_as(graph, firm=[9])))] == [1]
    assert pruned(known := known_as(BOTH)) is known


def test_nodes_that_are_taken_out__take_their_edges_along():
    left = without(known_as(BOTH), [8])
    assert wholes(left)[3] == (FLOOR, {("grown", 1)})
    assert len(left.tracks.id) == 11


@pytest.mark.parametrize("concept", [FLOOR, BUILDING])
def test_wholes__follow_the_middle_of_their_parts_or_stand_above(concept):
    graph = two_rooms()
    label = np.array([*graph.nodes.label])
    label[11] = concept
    part_of, before = part_of_matrix(graph), graph.nodes.position
    moved = before.copy()
    moved[9] += [1.0, 2.0, 3.0]
    which = np.isin(np.arange(12), [11])
    after = followed(before, moved, part_of, part_of, label, PAPER_ONTOLOGY, which)
    highest = moved[9:11, 2].max() - before[9:11, 2].max()
    rise = highest if PAPER_ONTOLOGY.is_above[concept] else 1.5
    npt.assert_allclose(after[11] - before[11], [0.5, 1.0, rise])
    npt.assert_array_equal(after[:11], moved[:11])
    fewer = part_of & (np.arange(12) != 10)[:, None]
    after = followed(before, before, part_of, fewer, label, PAPER_ONTOLOGY, which)
    npt.assert_allclose((after - before)[11, :2], (before[9] - before[10])[:2] / 2)
    still = followed(before, before, part_of, part_of, label, PAPER_ONTOLOGY, which)
    npt.assert_array_equal(still, before, strict=True)
