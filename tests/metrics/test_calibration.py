"""Right is what the truth has over the same planes; the error is that of a plain loop over bins."""

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.metrics.calibration import (
    calibration,
    correct_edges,
    correct_nodes,
    identities,
    observed_below,
    reliability,
)
from sg3d_jax.metrics.structure import exact_structure
from sg3d_jax.scene.graph import parts_first, subgraph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF
from sg3d_jax.scene.padding import Capacity, pad
from tests.drawn_rooms import with_pairs
from tests.own_world import own_world
from tests.two_rooms import NUM_PLANES, reordered, two_rooms

WALL, WEST, EAST, TOP = 8, 9, 10, 11


def error_of_loop(confidence, correct, bins):
    """The expected calibration error, a number at a time."""
    error = 0.0
    for index in range(bins):
        inside = [
            (one, right)
            for one, right in zip(confidence, correct, strict=True)
            if index / bins <= one < (index + 1) / bins or (index == bins - 1 and one == 1)
        ]
        if inside:
            gap = sum(one for one, _ in inside) - sum(right for _, right in inside)
            error += abs(gap) / len(confidence)
    return error


@pytest.mark.parametrize("bins", [1, 8, 10])
@pytest.mark.parametrize("seed", range(3))
def test_the_error_is_that_of_a_loop(bins, seed):
    rng = np.random.default_rng(seed)
    confidence = np.concatenate([rng.random(200) ** 0.3, [0.0, 1.0, 0.5]])
    correct = rng.random(203) < confidence**2
    found = reliability(confidence, correct, bins)
    npt.assert_allclose(found.error, error_of_loop(confidence, correct, bins), atol=1e-12)
    assert found.count.sum() == 203
    npt.assert_allclose(found.count @ found.confidence, confidence.sum())
    npt.assert_allclose(found.count @ found.correct, correct.sum())


def test_who_is_as_sure_as_right_has_no_error():
    confidence = np.repeat([0.25, 0.75, 1.0], 4)
    correct = np.array([1, 0, 0, 0, 1, 1, 1, 0, 1, 1, 1, 1], bool)
    assert reliability(confidence, correct).error == 0
    assert reliability(np.ones(4), np.array([1, 0, 1, 0], bool)).error == 0.5
    assert reliability(np.zeros(0), np.zeros(0, bool)).error == 0


def test_what_is_no_confidence_is_refused():
    with pytest.raises(ValueError, match="not between 0 and 1"):
        reliability(np.array([0.5, np.nan]), np.ones(2, bool))
    with pytest.raises(ValueError, match="not between 0 and 1"):
        reliability(np.array([1.5]), np.ones(1, bool))
    with pytest.raises(ValueError, match=r"shape \(2,\) and correct \(1,\), expected the same"):
        reliability(np.ones(2), np.ones(1, bool))


@pytest.mark.parametrize("name", ["s-f", "s-c"])
def test_the_truth_is_right_in_any_order(name):
    for graph in registry.make(name, 3):
        observed = int(graph.nodes.observed.sum())
        order = np.r_[:observed, np.arange(len(graph.nodes.label))[: observed - 1 : -1]]
        for made in (graph, reordered(graph, order)):
            assert correct_nodes(made, graph).all()
            assert correct_edges(made, graph).all()


def test_what_is_observed_is_below_its_whole_and_whatever_that_is_part_of():
    below = observed_below(two_rooms())
    npt.assert_array_equal(below[:NUM_PLANES], np.eye(NUM_PLANES, dtype=bool))
    npt.assert_array_equal(np.flatnonzero(below[WALL]), [1, 4])
    npt.assert_array_equal(np.flatnonzero(below[EAST]), [4, 5, 6, 7])
    assert below[TOP].all()
    world = own_world()
    assert observed_below(world)[-1].sum() == 14  # twelve planes and two pillars
    nothing = subgraph(two_rooms(), [WALL, EAST])
    npt.assert_array_equal(observed_below(nothing), np.zeros((2, 0), bool))
    assert identities(nothing) == [(1, 0, 0), (2, 0, 0)]
    npt.assert_array_equal(observed_below(subgraph(nothing, [])), np.zeros((0, 0), bool))


def test_a_node_without_one_of_its_planes_is_wrong_with_all_above_it():
    made = with_pairs(two_rooms(), lost=[(7, EAST)])
    assert np.flatnonzero(~correct_nodes(made, two_rooms())).tolist() == [EAST, TOP]
    wrong = parts_first(made)[~correct_edges(made, two_rooms())].tolist()
    assert wrong == [[4, EAST], [5, EAST], [6, EAST], [WEST, TOP], [EAST, TOP]]


def test_planes_say_which_room_it_is_and_a_pillar_next_door_is_a_wrong_edge():
    world = own_world()
    made = with_pairs(world, lost=[(12, 15)], new=[(12, 16)])
    assert correct_nodes(made, world).all()
    assert parts_first(made)[~correct_edges(made, world)].tolist() == [[12, 16]]
    bare = with_pairs(world, lost=[(plane, 15) for plane in range(4)])  # the pillar alone is left
    wrong = np.flatnonzero(~correct_nodes(bare, world)).tolist()
    assert wrong == [15, 18, 20]


def test_an_edge_between_right_nodes_may_be_wrong():
    """The floor is over all planes still if it is part of them itself."""
    made = with_pairs(two_rooms(), lost=[(WEST, TOP)], new=[(plane, TOP) for plane in range(4)])
    assert correct_nodes(made, two_rooms()).all()
    wrong = parts_first(made)[~correct_edges(made, two_rooms())].tolist()
    assert wrong == [[plane, TOP] for plane in range(4)]


def test_a_repeated_node_is_right_once():
    again = subgraph(two_rooms(), [*range(12), WALL])  # its edges are those of the last row
    twice = with_pairs(again, new=[(1, WALL), (4, WALL)])
    assert np.flatnonzero(~correct_nodes(twice, two_rooms())).tolist() == [12]
    assert correct_nodes(twice, twice).all()
    assert len({*identities(twice)}) == 13


@pytest.mark.parametrize("seed", range(20))
def test_right_all_over_is_exact(seed):
    rng, truth = np.random.default_rng(seed), two_rooms()
    pairs = undirected_edges(truth, PART_OF)
    lost = pairs[rng.random(len(pairs)) < 0.05]
    made = with_pairs(truth, lost=[tuple(pair) for pair in lost.tolist()])
    right = correct_nodes(made, truth).all() and correct_nodes(truth, made).all()
    right = right and correct_edges(made, truth).all() and correct_edges(truth, made).all()
    assert right == exact_structure(made, truth)


def test_several_graphs_are_one_list_and_what_is_observed_does_not_count():
    truth, wrong = two_rooms(), with_pairs(two_rooms(), lost=[(7, EAST)])
    sure = np.linspace(0.05, 0.95, 12)
    nodes = [sure, sure[::-1]]
    edges = [np.full(len(parts_first(graph)), 0.75) for graph in (truth, wrong)]
    padded = pad(truth, Capacity(16, 192))
    found = calibration([padded, wrong], [truth, padded], nodes, edges)
    assert found["nodes"].count.sum() == 8
    sure, right = np.concatenate([row[NUM_PLANES:] for row in nodes]), [1, 1, 1, 1, 1, 1, 0, 0]
    npt.assert_allclose(found["nodes"].error, error_of_loop(sure, right, 10), atol=1e-12)
    assert found["edges"].count[7] == 23
    npt.assert_allclose(found["edges"].correct[7], 18 / 23)
