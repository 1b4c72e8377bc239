from typing import Final

import jax
import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.metrics.descriptors import (
    clustering_histogram,
    degree_histogram,
    normalised_laplacian,
    spectrum_histogram,
)

CAPACITY: Final = 12


def padded(graph: nx.Graph, capacity: int = CAPACITY) -> tuple[np.ndarray, np.ndarray]:
    count = graph.number_of_nodes()
    adjacency = np.zeros((capacity, capacity), bool)
    adjacency[:count, :count] = nx.to_numpy_array(graph) > 0
    return adjacency, np.arange(capacity) < count


def described(adjacency: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, ...]:
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, _described(adjacency, mask))


@jax.jit
def _described(adjacency, mask):
    return (
        degree_histogram(adjacency, mask, CAPACITY),
        clustering_histogram(adjacency, mask),
        spectrum_histogram(adjacency, mask),
    )


def of_networkx(graph: nx.Graph) -> tuple[np.ndarray, ...]:
    """As FLAGG's code counts, but for eigenvalues that rounding puts above 2."""
    degree = np.zeros(CAPACITY)
    counts = nx.degree_histogram(graph)
    degree[: len(counts)] = counts
    clustering, _ = np.histogram(list(nx.clustering(graph).values()), 100, (0.0, 1.0))
    eigenvalues = np.linalg.eigvalsh(nx.normalized_laplacian_matrix(graph).toarray())
    spectrum, _ = np.histogram(np.minimum(eigenvalues, 2.0), 200, (-1e-5, 2.0))
    return tuple(counts / counts.sum() for counts in (degree, clustering, spectrum))


random_graphs = st.builds(
    lambda count, p, seed: nx.gnp_random_graph(count, p, seed=seed),
    st.integers(1, CAPACITY),
    st.sampled_from([0.0, 0.15, 0.3, 0.6, 1.0]),
    st.integers(0, 1000),
)


@given(random_graphs)
@settings(deadline=None, max_examples=50)
def test_histograms__are_those_of_networkx_and_numpy(graph):
    for found, expected in zip(described(*padded(graph)), of_networkx(graph), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(
    "graph",
    [
        nx.star_graph(11),
        nx.path_graph(12),
        nx.cycle_graph(12),
        nx.balanced_tree(2, 2),
        nx.complete_bipartite_graph(4, 6),
        nx.complete_graph(9),
        nx.empty_graph(5),
        nx.empty_graph(1),
        nx.disjoint_union(nx.star_graph(4), nx.empty_graph(3)),
    ],
    ids=str,
)
def test_histograms__of_graphs_whose_eigenvalues_repeat_or_vanish(graph):
    for found, expected in zip(described(*padded(graph)), of_networkx(graph), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


@given(random_graphs, st.integers(0, 1000))
@settings(deadline=None, max_examples=30)
def test_histograms__do_not_depend_on_the_order_of_nodes(graph, seed):
    adjacency, mask = padded(graph)
    order = np.random.default_rng(seed).permutation(CAPACITY)
    shuffled = described(adjacency[order][:, order], mask[order])
    for found, expected in zip(shuffled, described(adjacency, mask), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


@given(random_graphs)
@settings(deadline=None, max_examples=20)
def test_histograms__do_not_depend_on_padding(graph):
    more = described(*padded(graph, CAPACITY + 4))
    for found, expected in zip(more, described(*padded(graph)), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_coefficient_of_0_7__falls_where_numpy_has_it():
    graph = nx.complete_graph(6)
    graph.remove_edges_from([(1, 2), (2, 3), (3, 4)])  # 7 of the 10 pairs around node 0 are left
    assert nx.clustering(graph, 0) == 0.7
    found = described(*padded(graph))[1]
    np.testing.assert_allclose(found, of_networkx(graph)[1], atol=1e-12)


def test_a_graph_without_nodes__is_all_zeros():
    for histogram in described(*padded(nx.empty_graph(0))):
        assert not histogram.any()


def test_laplacian__is_that_of_networkx():
    graph = nx.lollipop_graph(4, 3)
    graph.add_node(7)
    expected = nx.normalized_laplacian_matrix(graph).toarray()
    found = jax.jit(normalised_laplacian)(padded(graph, 8)[0])
    np.testing.assert_allclose(found, expected, atol=1e-6)
