"""The candidate that is kept has what the others have, and breaks no rule if any does not."""

import pytest

from sg3d_jax.infer.candidates import are_settled, most_agreeing, num_flaws
from sg3d_jax.scene.graph import subgraph
from tests.drawn_rooms import drawn, with_pairs
from tests.own_world import own_world
from tests.two_rooms import NUM_PLANES, two_rooms

WEST, EAST = (0, 1, 2, 3), (4, 5, 6, 7)
RIGHT = drawn(WEST, EAST)


def test_what_most_have_is_chosen_wherever_it_stands():
    one, other = drawn((0, 1, 2), (3, 4, 5, 6, 7)), drawn(WEST, (4, 5), (6, 7))
    for turn in range(4):
        graphs = [RIGHT, one, other, RIGHT]
        turned = graphs[turn:] + graphs[:turn]
        assert turned[most_agreeing(turned, NUM_PLANES)] is RIGHT


def test_the_first_is_chosen_where_there_is_no_choice():
    assert most_agreeing([RIGHT], NUM_PLANES) == 0
    assert most_agreeing([RIGHT, two_rooms(), RIGHT], NUM_PLANES) == 0
    alone = subgraph(RIGHT, range(NUM_PLANES))
    assert most_agreeing([alone, alone], NUM_PLANES) == 0


def test_what_was_given_does_not_count():
    """The west room is given. With it, the first would have 3/4 in common, and the last 13/20."""
    rooms = [
        [(4,)],
        [(4,), (5,), (4, 5), (5, 7), (6, 7), (4, 5, 6)],
        [(5,), (6,), (7,), (4, 6), (4, 7), (5, 6)],
        [(5,), (6,), (7,), (4, 5)],
    ]
    graphs = [
        subgraph(drawn(WEST, *of_graph), range(NUM_PLANES + 1 + len(of_graph)))
        for of_graph in rooms
    ]
    assert most_agreeing(graphs, NUM_PLANES + 1) == 3
    assert most_agreeing(graphs, NUM_PLANES) == 0


def test_a_broken_rule_outweighs_agreement():
    west, top = NUM_PLANES, NUM_PLANES + 3
    broken = with_pairs(drawn(WEST, EAST, floors=[(0,), (1,)]), new=[(west, top)])  # on two floors
    wrong = drawn((0, 1, 2), (3, 4, 5, 6, 7), floors=[(0,), (1,)])
    assert most_agreeing([broken, broken, wrong], NUM_PLANES) == 2
    assert most_agreeing([wrong, broken], NUM_PLANES) == 0
    assert most_agreeing([broken, broken], NUM_PLANES) == 0


def test_flaws_are_counted_and_neither_clutter_nor_what_was_cut_is_one():
    west, east, top = NUM_PLANES, NUM_PLANES + 1, NUM_PLANES + 2
    assert num_flaws(RIGHT) == num_flaws(two_rooms()) == num_flaws(own_world()) == 0
    assert num_flaws(with_pairs(RIGHT, new=[(0, top), (1, top)])) == 2  # planes of a floor
    assert num_flaws(with_pairs(RIGHT, lost=[(east, top)])) == 1
    storeys = drawn(WEST, EAST, floors=[(0,), (1,)])
    assert num_flaws(with_pairs(storeys, new=[(west, top), (east, top - 1)])) == 1
    assert num_flaws(drawn((0, 1, 2), EAST)) == 0  # a plane of no room
    assert num_flaws(with_pairs(RIGHT, new=[(0, east)])) == 0  # a plane of two


def test_candidates_are_settled_once_more_than_half_are_alike():
    other, third = drawn((0, 1, 2), (3, 4, 5, 6, 7)), drawn(WEST, (4, 5), (6, 7))
    moved = drawn(EAST, WEST, at=2.0)  # the same, in another order and elsewhere
    for graphs, settled in (
        ([RIGHT], False),  # one alone tells nothing
        ([RIGHT, moved], True),
        ([RIGHT, other], False),
        ([RIGHT, other, moved, third], False),
        ([RIGHT, other, moved, RIGHT], True),
    ):
        assert are_settled(graphs, NUM_PLANES) == settled


def test_a_scene_without_candidates_is_refused():
    with pytest.raises(ValueError, match="a scene has no candidates, expected at least one"):
        most_agreeing([], NUM_PLANES)
