from typing import Final

import jax
import networkx as nx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.metrics.gin import GIN, HIDDEN, NUM_LAYERS, gin_embedding, init_gin

CAPACITY: Final = 12
GIN_OF_SEED_0: Final = jax.tree.map(np.asarray, jax.jit(init_gin)(jax.random.key(0)))

embed = jax.jit(gin_embedding)


def padded(graph: nx.Graph, capacity: int = CAPACITY) -> tuple[np.ndarray, np.ndarray]:
    count = graph.number_of_nodes()
    adjacency = np.zeros((capacity, capacity), bool)
    adjacency[:count, :count] = nx.to_numpy_array(graph) > 0
    return adjacency, np.arange(capacity) < count


def embedding_by_neighbours(gin: GIN, graph: nx.Graph) -> np.ndarray:
    """The formula of Xu et al. node by node, in float64."""
    bidirected = graph.to_directed()
    hidden = {
        node: np.array([bidirected.in_degree(node) + bidirected.out_degree(node)], float)
        for node in graph
    }
    pooled = []
    for inner, outer in gin:
        sums = {node: hidden[node] + sum(hidden[i] for i in graph[node]) for node in graph}
        for weight, bias in (inner, outer):
            sums = {
                node: np.maximum(value @ np.asarray(weight, float) + np.asarray(bias, float), 0)
                for node, value in sums.items()
            }
        hidden = sums
        pooled.append(sum(hidden.values()))
    return np.concatenate(pooled)


random_graphs = st.builds(
    lambda count, p, seed: nx.gnp_random_graph(count, p, seed=seed),
    st.integers(1, CAPACITY),
    st.sampled_from([0.0, 0.15, 0.5, 1.0]),
    st.integers(0, 1000),
)


@given(random_graphs)
@settings(deadline=None, max_examples=30)
def test_embedding__is_the_formula_applied_node_by_node(graph):
    found = embed(GIN_OF_SEED_0, *padded(graph))
    expected = embedding_by_neighbours(GIN_OF_SEED_0, graph)
    assert found.shape == (NUM_LAYERS * HIDDEN,)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


@given(random_graphs, st.randoms(use_true_random=False))
@settings(deadline=None, max_examples=20)
def test_embedding__ignores_padding_and_the_order_of_nodes(graph, random):
    names = list(graph)
    random.shuffle(names)
    shuffled = nx.Graph()
    shuffled.add_nodes_from(names)
    shuffled.add_edges_from(graph.edges)
    found = embed(GIN_OF_SEED_0, *padded(graph))
    for other in (padded(shuffled), padded(graph, CAPACITY + 4)):
        np.testing.assert_allclose(embed(GIN_OF_SEED_0, *other), found, rtol=1e-4, atol=1e-4)


def test_embedding__tells_a_path_from_a_star():
    path, star = (embed(GIN_OF_SEED_0, *padded(g)) for g in (nx.path_graph(6), nx.star_graph(5)))
    assert np.abs(np.asarray(path) - np.asarray(star)).max() > 1


def test_weights_are_orthogonal_and_biases_within_their_bound():
    (first, *_), (second, *_) = GIN_OF_SEED_0
    np.testing.assert_allclose(first.weight @ first.weight.T, np.eye(1), atol=1e-5)
    np.testing.assert_allclose(second.weight @ second.weight.T, np.eye(HIDDEN), atol=1e-5)
    assert 0.8 < np.abs(first.bias).max() <= 1
    assert 0.8 < np.abs(second.bias).max() * HIDDEN**0.5 <= 1


def test_networks__are_those_of_their_key():
    again, other = (jax.jit(init_gin)(jax.random.key(seed)) for seed in (0, 1))
    jax.tree.map(np.testing.assert_array_equal, again, GIN_OF_SEED_0)
    weights = (np.asarray(gin[1].inner.weight) for gin in (other, again))
    assert np.abs(np.subtract(*weights)).max() > 0.1
