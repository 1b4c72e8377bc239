import itertools

import networkx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.baselines.edge_clusters import (
    rooms_by_communities,
    rooms_by_cycles,
    with_rooms_and_walls,
)
from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.scene.graph import observed_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PLANE, ROOM, WALL
from sg3d_jax.scene.validate import validate_graph
from tests.two_rooms import NUM_PLANES, two_rooms

NO_PAIRS = np.zeros((0, 2), np.int32)
PLANES = observed_of(two_rooms())


@st.composite
def some_pairs(draw, most=9):
    """Draws the pairs of a random graph."""
    number = draw(st.integers(2, most))
    every = list(itertools.combinations(range(number), 2))
    return pairs(draw(st.sets(st.sampled_from(every))))


def pairs(*groups):
    return np.array(sorted(itertools.chain(*groups)), np.int32).reshape(-1, 2)


def clique(*planes):
    return list(itertools.combinations(planes, 2))


def rooms_by_enumeration(chosen):
    """The published rule: count the directed cycles through each set of planes, take the most."""
    graph, rooms = networkx.DiGraph(), []
    graph.add_edges_from([*chosen.tolist(), *chosen[:, ::-1].tolist()])
    for length in (4, 3):
        cycles = networkx.simple_cycles(graph, length_bound=4)
        found = [tuple(sorted(cycle)) for cycle in cycles if len(cycle) == length]
        for planes in sorted(set(found), key=lambda planes: (-found.count(planes), planes)):
            if graph.nodes >= set(planes):
                rooms.append(planes)
                graph.remove_nodes_from(planes)
    return rooms


@settings(deadline=None, max_examples=100)
@given(some_pairs(7))
def test_rooms_by_cycles__are_those_of_counting_all_cycles(chosen):
    assert rooms_by_cycles(chosen) == rooms_by_enumeration(chosen)


def test_four_planes_that_are_all_paired__go_before_a_cycle_of_four():
    square = [(0, 1), (1, 2), (2, 3), (0, 3)]
    assert rooms_by_cycles(pairs(square, clique(3, 4, 5, 6))) == [(3, 4, 5, 6)]


def test_four_planes__go_before_three():
    assert rooms_by_cycles(pairs([(0, 1), (0, 2), (1, 2)], clique(2, 3, 4, 5))) == [(2, 3, 4, 5)]
    found = rooms_by_cycles(pairs(clique(0, 1, 2), clique(3, 4, 5, 6)))
    assert found == [(3, 4, 5, 6), (0, 1, 2)]


def test_a_room_of_six_planes__falls_apart_by_cycles_and_not_by_communities():
    six = pairs(clique(*range(6)))
    assert rooms_by_cycles(six) == [(0, 1, 2, 3)]
    assert rooms_by_communities(six, np.ones(15)) == [tuple(range(6))]


def greedy_modularity(chosen, weight):
    """Merges the connected pair of communities that gains most, as long as none loses."""
    parts = [{node} for node in sorted(set(chosen.ravel().tolist()))]

    def between(one, other):
        ends = [(a in one and b in other) or (a in other and b in one) for a, b in chosen.tolist()]
        return weight[np.array(ends)].sum()

    def gain(one, other):
        of_one, of_other = (
            sum(np.isin(chosen, list(part)).sum(axis=1) * weight) for part in (one, other)
        )
        return between(one, other) / weight.sum() - of_one * of_other / (2 * weight.sum() ** 2)

    while True:
        touching = [pair for pair in itertools.combinations(parts, 2) if between(*pair) > 0]
        if not touching or max(gain(*pair) for pair in touching) < 0:
            return sorted(tuple(sorted(part)) for part in parts if len(part) > 1)
        one, other = max(touching, key=lambda pair: gain(*pair))
        parts = [part for part in parts if part not in (one, other)] + [one | other]


@settings(deadline=None, max_examples=60)
@given(some_pairs(), st.integers(0, 10**6))
def test_rooms_by_communities__are_those_of_merging_by_brute_force(chosen, seed):
    weight = np.random.default_rng(seed).uniform(0.1, 1, len(chosen))  # no two gains are the same
    assert rooms_by_communities(chosen, weight) == greedy_modularity(chosen, weight)


def test_certain_pairs_hold_together__where_uncertain_ones_do_not():
    chain = pairs([(0, 1), (1, 2), (2, 3)])
    assert rooms_by_communities(chain, np.array([1, 0.1, 1])) == [(0, 1), (2, 3)]
    assert rooms_by_communities(chain, np.array([0.1, 1, 0.1])) == [(0, 1, 2, 3)]


def test_pairs_without_certainty__make_no_room():
    assert rooms_by_communities(pairs(clique(0, 1, 2, 3)), np.zeros(6)) == []


def test_without_pairs__there_are_no_rooms():
    assert rooms_by_cycles(NO_PAIRS) == []
    assert rooms_by_communities(NO_PAIRS, np.zeros(0)) == []


def test_communities__do_not_depend_on_the_order_of_the_pairs():
    chosen = pairs(clique(0, 1, 2, 3), clique(3, 4, 5), clique(5, 6, 7))
    expected = rooms_by_communities(chosen, np.ones(len(chosen)))
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(len(chosen))
        assert rooms_by_communities(chosen[order], np.ones(len(chosen))) == expected


def test_graph__has_planes_then_walls_in_the_middle_of_their_planes_then_rooms():
    walls, offset = np.array([(1, 4), (1, 6)]), np.array([[0.5, -0.25]])
    graph = with_rooms_and_walls(PLANES, [(0, 1, 2, 3)], walls, offset)
    validate_graph(graph, "made")
    position = PLANES.nodes.position
    assert graph.nodes.label.tolist() == [PLANE] * NUM_PLANES + [WALL, WALL, ROOM]
    np.testing.assert_array_equal(graph.nodes.position[:NUM_PLANES], position)
    np.testing.assert_allclose(graph.nodes.position[8], (position[1] + position[4]) / 2)
    middle = position[:4].mean(axis=0) + np.array([0.5, -0.25, 0])
    np.testing.assert_allclose(graph.nodes.position[10], middle)
    expected = [(0, 10), (1, 8), (1, 9), (1, 10), (2, 10), (3, 10), (4, 8), (6, 9)]
    np.testing.assert_array_equal(undirected_edges(graph, PART_OF), expected)


def test_planes_without_rooms_and_walls__are_a_graph_that_can_be_scored():
    graph = with_rooms_and_walls(PLANES, [], NO_PAIRS, np.zeros((0, 2)))
    validate_graph(graph, "made")
    assert len(graph.senders) == 0
    score = fgw_pairs([graph], [two_rooms()])
    assert 0 < score.value[0] < 1
