"""Statistics, against a count by numpy on the same cuts."""

import functools

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.baselines.midi_oracle import one_shot_cut
from sg3d_jax.flagg.step import FlaggConfig, cut_graph
from sg3d_jax.scene.graph import extended, observed_of, undirected_edges
from sg3d_jax.scene.ontology import BUILDING, PART_OF
from sg3d_jax.train.dataset import stack_by_size
from sg3d_jax.train.statistics import CUTS_A_GRAPH, shares_of, statistics_of
from tests.tiny_run import NODES, small_floors
from tests.two_rooms import two_rooms

CUT = functools.partial(cut_graph, FlaggConfig(coins=(1, 4)))
ONE_SHOT = lambda key, graph: one_shot_cut(graph)


def test_statistics_are_those_that_numpy_counts_on_the_same_cuts():
    (floors,) = stack_by_size(small_floors()[:4], (NODES,))
    counted = statistics_of(CUT, [floors])
    expected = count_with_numpy(floors)
    for one, other in zip(counted[1:], expected, strict=True):
        npt.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


def test_labels_are_counted_exactly_however_rare_they_are():
    common, rare = two_rooms(), _with_a_building(two_rooms())
    stacks = stack_by_size([common] * 30 + [rare], (16,))
    counted = statistics_of(CUT, stacks, cuts_a_graph=1)
    grown = np.array([0, 1, 2, 1, 0, 0]) / 4, np.array([0, 1, 2, 1, 1, 0]) / 5
    npt.assert_allclose(counted.label, (30 * grown[0] + grown[1]) / 31, rtol=1e-12)
    assert counted.label[BUILDING] > 0


def test_buckets_weigh_as_in_training_and_spreads_are_pooled():
    small = [two_rooms()] * 8
    large = [_stretched(two_rooms(), 10.0)] * 2
    stacks = [*stack_by_size(small, (16,)), *stack_by_size(large, (24,))]
    counted = statistics_of(ONE_SHOT, stacks, cuts_a_graph=1)
    shares = shares_of(stacks)
    npt.assert_allclose(shares, [0.8, 0.2])
    offsets, lengths = (np.array([one, 10 * one]) for one in _root_mean_squares(two_rooms()))
    pooled, mean_square = np.sqrt(shares @ offsets**2), shares @ lengths**2
    npt.assert_allclose(counted.position_std, pooled + 1e-3, rtol=1e-5)
    mean = shares @ (np.array([1, 10]) * _lengths(two_rooms()).mean())
    npt.assert_allclose(counted.distance_mean, mean, rtol=1e-5)
    npt.assert_allclose(counted.distance_std, np.sqrt(mean_square - mean**2) + 1e-3, rtol=1e-5)
    assert counted.position_std > 1.5 * (shares @ offsets)  # what averaging them would give


def test_a_set_without_anything_to_grow_is_refused():
    with pytest.raises(ValueError, match="no training graph has a node beside its planes"):
        statistics_of(ONE_SHOT, stack_by_size([observed_of(two_rooms())], (16,)))


def _with_a_building(graph):
    return extended(graph, [BUILDING], np.zeros((1, 3)), [[11, 12]])


def _stretched(graph, factor):
    """Scales positions about the mean of the planes."""
    middle = graph.nodes.position[graph.nodes.observed].mean(axis=0)
    position = middle + factor * (graph.nodes.position - middle)
    return graph._replace(nodes=graph.nodes._replace(position=position))


def _lengths(graph):
    pairs = undirected_edges(graph, PART_OF)
    return np.linalg.norm(np.subtract(*graph.nodes.position[pairs.T]), axis=-1)


def _root_mean_squares(graph):
    """Returns those of the offsets of new nodes, a coordinate, and of their edges."""
    nodes = graph.nodes
    middle = nodes.position[nodes.observed].mean(axis=0)
    offsets = nodes.position[~nodes.observed] - middle
    return np.sqrt(np.mean(offsets**2)), np.sqrt(np.mean(_lengths(graph) ** 2))


@jax.jit
def cuts_of(graphs):
    """Draws the cuts on which the statistics are counted."""

    def several(key, graph):
        return jax.vmap(lambda key: CUT(key, graph))(jax.random.split(key, CUTS_A_GRAPH))

    [key] = jax.random.split(jax.random.key(0), 1)
    return jax.vmap(several)(jax.random.split(key, graphs.n_node.shape[0]), graphs)


def count_with_numpy(graphs):
    cuts = jax.tree.map(np.asarray, cuts_of(graphs))
    inside, across, length, offset = [], [], [], []
    for graph in range(len(cuts.complete)):
        for draw in range(CUTS_A_GRAPH):
            block = jax.tree.map(lambda leaf, at=(graph, draw): leaf[at], cuts.block)
            old = jax.tree.map(lambda leaf, at=(graph, draw): leaf[at], cuts.survivors.nodes)
            position = np.concatenate([block.position, old.position]).astype(float)
            for row in np.flatnonzero(block.mask):
                offset.append(block.position[row] - old.position[old.mask].mean(axis=0))
                others = [*range(row), *(len(block.mask) + np.flatnonzero(old.mask))]
                for other in others:
                    is_edge = bool(block.edges[row, other])
                    (inside if other < row else across).append(is_edge)
                    if is_edge:
                        length.append(np.linalg.norm(position[row] - position[other]))
    shares = [np.array([1 - np.mean(edges), np.mean(edges)]) for edges in (inside, across)]
    return (
        *shares,
        np.mean(length),
        np.std(length) + 1e-3,
        (np.sqrt(np.mean(np.square(offset))) + 1e-3),
        np.sum(across) / len(offset),
    )
