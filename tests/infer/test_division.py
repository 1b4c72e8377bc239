"""Whether one wall against several rooms is one or several is decided once a scene, by all."""

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.infer.consensus import Version, consensus
from sg3d_jax.infer.division import divided_alike, exchanged
from sg3d_jax.metrics.structure import exact_structure
from sg3d_jax.scene.ontology import WALL
from tests.drawn_rooms import drawn
from tests.two_rooms import NUM_PLANES

A, B, C, D = (0, 1), (2, 3), (4, 5), (6, 7)
FINE = [(0, 2), (0, 4), (1, 3), (1, 6)], [(0, 2, 4), (1, 3), (1, 6)]
COARSE = [(0, 2, 4), (1, 3, 6)], [(0, 2), (0, 4), (1, 3, 6)]


@pytest.mark.parametrize(("truth", "other"), [FINE, COARSE], ids=["finely", "coarsely"])
def test_a_wall_that_most_divide_otherwise_than_the_scene_is_as_in_the_scene(truth, other):
    right, wrong = drawn(A, B, C, D, walls=truth), drawn(A, B, C, D, walls=other, at=6.0)
    assert exact_structure(consensus([wrong, wrong, right], NUM_PLANES)[0], wrong)
    made = divided_alike([wrong, right, wrong], NUM_PLANES)
    assert made[1] is right
    for graph in made:
        assert exact_structure(graph, right)
    label, x = made[0].nodes.label, made[0].nodes.position[:, 0]
    assert np.all(x[NUM_PLANES:][label[NUM_PLANES:] != WALL] == 6.0)
    # New walls stand where others have them.
    npt.assert_array_equal(x[len(x) - len({*truth} - {*other}) :], 0.0)


def test_what_is_given_and_graphs_that_are_alike_are_left_as_they_are():
    truth, other = (drawn(A, B, C, D, walls=walls) for walls in FINE)
    assert divided_alike([truth, truth], NUM_PLANES) == [truth, truth]
    assert divided_alike([other], NUM_PLANES) == [other]
    both = drawn(A, B, C, D, walls=[(0, 2, 4), (0, 2), (0, 4), (1, 3), (1, 6)])
    (made,) = divided_alike([both], NUM_PLANES)
    assert made is both
    given = drawn(A, B, walls=FINE[1]), drawn(A, B, walls=FINE[1], at=1.0)
    for graph, made in zip(given, divided_alike(given, len(given[0].nodes.label)), strict=True):
        assert made is graph


def wall(*planes, row=-1):
    return Version(row, frozenset(planes))


# A wall between one room and two others: one, or two; here, and elsewhere in the scene.
LUMP, PAIRS = {wall(0, 1, 2)}, {wall(0, 1), wall(0, 2)}
LUMP_THERE, PAIRS_THERE = {wall(3, 4, 5)}, {wall(3, 4), wall(3, 5)}
APART = {plane: plane for plane in range(10)}  # each plane is on a side of its own


def test_walls_are_divided_as_most_of_the_scene_is():
    fine, coarse = PAIRS | PAIRS_THERE, LUMP | LUMP_THERE
    lumped, divided = LUMP | PAIRS_THERE, PAIRS | LUMP_THERE
    assert exchanged([lumped, lumped, fine], [APART] * 3, 2) == [fine] * 3
    assert exchanged([divided, divided, coarse], [APART] * 3, 2) == [coarse] * 3
    wider = {wall(0, 1, 2, 6)} | LUMP_THERE
    assert exchanged([divided, wider, wider, coarse], [APART] * 4, 2)[0] == wider


def test_coarsely_has_to_be_said_half_as_often_again():
    assert exchanged([LUMP, PAIRS], [APART] * 2, 2) == [PAIRS] * 2
    assert exchanged([LUMP, LUMP, LUMP, PAIRS, PAIRS], [APART] * 5, 2) == [PAIRS] * 5
    assert exchanged([LUMP, LUMP, PAIRS], [APART] * 3, 2) == [LUMP] * 3


def test_what_a_wall_is_divided_into_is_divided_again():
    whole, half = {wall(0, 1, 2, 3)}, {wall(0, 1, 2), wall(0, 3)}
    fine = PAIRS | {wall(0, 3)}
    made = exchanged([whole, half, fine | PAIRS_THERE], [APART] * 3, 2)
    assert made == [fine, fine, fine | PAIRS_THERE]


def test_a_wall_is_divided_into_as_few_as_another_has_that_leave_no_plane():
    twice = PAIRS | {wall(0, 1, row=-2)}
    part = {wall(0, 1)} | PAIRS_THERE
    assert exchanged([LUMP, twice, twice, part, PAIRS], [APART] * 5, 2)[0] == PAIRS


def test_two_planes_of_one_room_and_planes_of_none_say_nothing():
    beside = [LUMP, PAIRS | PAIRS_THERE, PAIRS]
    for here in ({0: 0, 1: 9, 2: 9}, {0: 0, 1: 1}, {}):
        sides = here | dict.fromkeys((3, 4, 5), 7)
        assert exchanged(beside, [sides] * 3, 2) == beside
    fine = {0: 0, 1: 9, 2: 9, 3: 3, 4: 4, 5: 5}  # the scene is, but this wall has two sides
    assert exchanged(beside, [fine] * 3, 2)[0] == LUMP


def test_walls_that_are_given_are_not_exchanged_and_no_others_get_them():
    given = {wall(0, 1, 2, row=8)}
    assert exchanged([given, PAIRS, PAIRS], [APART] * 3, 2)[0] == given
    one_given = {wall(0, 1, row=8), wall(0, 2)}
    assert exchanged([one_given, LUMP, LUMP], [APART] * 3, 2)[0] == one_given
    assert exchanged([LUMP, one_given | PAIRS_THERE], [APART] * 2, 2)[0] == LUMP
    coarse = given | LUMP_THERE | {wall(6, 7, 9)}
    assert exchanged([PAIRS, coarse, coarse], [APART] * 3, 2)[0] == PAIRS
