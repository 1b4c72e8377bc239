"""What is summed up of a cut, against a loop over its nodes and pairs."""

import functools

import jax
import numpy as np
import pytest

from sg3d_jax.fill.protocol import Statistics
from sg3d_jax.flagg.removal import Cut, draw_cut
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.train.statistics import statistics_of
from tests.two_rooms import on_device, two_rooms

NUM_BLOCK, NUM_CUTS = 4, 40


def statistics(coins: tuple[int, ...]) -> Statistics:
    """Counts the statistics of one graph."""
    graphs = jax.tree.map(lambda leaf: np.asarray(leaf)[None], on_device(two_rooms()))
    return statistics_of(functools.partial(cut_graph, coins), [graphs], NUM_CUTS)


def cut_graph(coins, key, graph):
    return draw_cut(graph, key, coins)


@jax.jit
def cuts_of(graph) -> Cut:
    """Draws the cuts on which the statistics are counted, with blocks of one node or four."""
    [key] = jax.random.split(jax.random.split(jax.random.key(0), 1)[0], 1)
    draw = jax.vmap(functools.partial(cut_graph, (1, NUM_BLOCK)), (0, None))
    return draw(jax.random.split(key, NUM_CUTS), graph)


@pytest.fixture(scope="module")
def counted() -> tuple[Statistics, Cut]:
    cuts = jax.tree.map(np.asarray, cuts_of(on_device(two_rooms())))
    return statistics((1, NUM_BLOCK)), cuts


def count_by_loops(cuts: Cut) -> tuple[list, list, list, list]:
    """Whether pairs inside and across are linked, lengths of links, offsets of nodes."""
    inside, across, length, offset = [], [], [], []
    for index in range(len(cuts.complete)):
        block, graph = jax.tree.map(lambda leaf, i=index: leaf[i], (cuts.block, cuts.survivors))
        old = graph.nodes
        for new in np.flatnonzero(block.mask):
            offset.append(block.position[new] - old.position[old.mask].mean(axis=0))
            pairs = [(inside, new, other, block.position[other]) for other in range(new)]
            for token in np.flatnonzero(old.mask):
                pairs.append((across, new, NUM_BLOCK + token, old.position[token]))
            for kind, row, column, end in pairs:
                kind.append(block.edges[row, column])
                if kind[-1]:
                    length.append(np.linalg.norm(block.position[row] - end))
    return inside, across, length, offset


def test_statistics__are_those_of_a_loop_over_pairs(counted):
    found, cuts = counted
    inside, across, length, offset = count_by_loops(cuts)
    np.testing.assert_allclose(found.block_edge[1], np.mean(inside), rtol=1e-5)
    np.testing.assert_allclose(found.cross_edge[1], np.mean(across), rtol=1e-5)
    np.testing.assert_allclose(found.distance_mean, np.mean(length), rtol=1e-5)
    np.testing.assert_allclose(found.distance_std, np.std(length) + 1e-3, rtol=1e-4)
    spread = np.sqrt(np.mean(np.square(offset)))
    np.testing.assert_allclose(found.position_std, spread + 1e-3, rtol=1e-4)
    np.testing.assert_allclose(found.cross_degree, np.sum(across) / len(offset), rtol=1e-5)
    assert 0 < np.mean(inside) < 1
    for marginal in found[:3]:
        np.testing.assert_allclose(np.sum(marginal), 1, rtol=1e-6)


def test_labels__are_those_of_the_graph_whatever_the_cuts_hold(counted):
    """A wall, two rooms and a floor."""
    np.testing.assert_allclose(counted[0].label, [0, 1 / 4, 2 / 4, 1 / 4, 0, 0], rtol=1e-6)
    assert counted[0].label[PLANE] == 0


def test_statistics__without_any_pair_inside_a_block_are_finite():
    found = statistics((1,))
    np.testing.assert_array_equal(found.block_edge, [1, 0])
    assert all(np.isfinite(field).all() for field in found)
