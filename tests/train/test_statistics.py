"""Statistics, against a count by numpy on the same cuts."""

import functools

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.fill.protocol import Statistics
from sg3d_jax.flagg.step import FlaggConfig, cut_graph
from sg3d_jax.train import statistics
from sg3d_jax.train.dataset import stack_by_size
from sg3d_jax.train.statistics import CUTS_A_GRAPH, statistics_of
from tests.tiny_run import small_floors

CUT = functools.partial(cut_graph, FlaggConfig(coins=(1, 4)))


@pytest.fixture(scope="module")
def floors():
    return small_floors()[:8]


@pytest.fixture(scope="module")
def stacks(floors):
    sizes = sorted(len(graph.nodes.label) for graph in floors)
    return stack_by_size(floors, (sizes[3], sizes[-1]))


def test_statistics_are_those_that_numpy_counts_on_the_same_cuts(stacks):
    counted = statistics_of(CUT, stacks[:1])
    expected = count_with_numpy(stacks[0], jax.random.split(jax.random.key(0), 1)[0])
    for one, other in zip(counted, expected, strict=True):
        npt.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


def test_every_graph_counts_the_same_whatever_its_bucket(floors, stacks, monkeypatch):
    mean = lambda cuts: Statistics(*[cuts.astype(float).mean()] * len(Statistics._fields))
    monkeypatch.setattr(statistics, "count_statistics", mean)
    expected = np.mean([len(graph.nodes.label) for graph in floors])
    npt.assert_allclose(
        statistics_of(lambda key, graph: graph.n_node[0], stacks), expected, rtol=1e-6
    )


def count_with_numpy(graphs, key):
    def several(key, graph):
        return jax.vmap(lambda key: CUT(key, graph))(jax.random.split(key, CUTS_A_GRAPH))

    keys = jax.random.split(key, graphs.n_node.shape[0])
    cuts = jax.tree.map(np.asarray, jax.jit(jax.vmap(several))(keys, graphs))
    label, inside, across, length, offset = np.zeros(6), [], [], [], []
    for graph in range(len(cuts.complete)):
        for draw in range(CUTS_A_GRAPH):
            block = jax.tree.map(lambda leaf, at=(graph, draw): leaf[at], cuts.block)
            old = jax.tree.map(lambda leaf, at=(graph, draw): leaf[at], cuts.survivors.nodes)
            position = np.concatenate([block.position, old.position]).astype(float)
            for row in np.flatnonzero(block.mask):
                label[block.label[row]] += 1
                offset.append(block.position[row] - old.position[old.mask].mean(axis=0))
                others = [*range(row), *(len(block.mask) + np.flatnonzero(old.mask))]
                for other in others:
                    is_edge = bool(block.edges[row, other])
                    (inside if other < row else across).append(is_edge)
                    if is_edge:
                        length.append(np.linalg.norm(position[row] - position[other]))
    shares = [np.array([1 - np.mean(edges), np.mean(edges)]) for edges in (inside, across)]
    return (
        label / label.sum(),
        *shares,
        np.mean(length),
        np.std(length) + 1e-3,
        (np.sqrt(np.mean(np.square(offset))) + 1e-3),
    )
