import jax
import networkx as nx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.metrics.shortest_path import hop_distances, part_of_hops
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import FLOOR, PLANE, ROOM
from sg3d_jax.scene.padding import Capacity, pad

CAPACITY = 12


def hops_of_networkx(graph: nx.Graph) -> np.ndarray:
    count = graph.number_of_nodes()
    hops = np.full((count, count), -1)
    for source, lengths in nx.all_pairs_shortest_path_length(graph):
        hops[source, list(lengths)] = list(lengths.values())
    return np.where(hops < 0, 1 + hops.max(), hops)


def padded(graph: nx.Graph) -> tuple[np.ndarray, np.ndarray]:
    count = graph.number_of_nodes()
    adjacency = np.zeros((CAPACITY, CAPACITY), bool)
    adjacency[:count, :count] = nx.to_numpy_array(graph, nodelist=range(count)) > 0
    return adjacency, np.arange(CAPACITY) < count


find_hops = jax.jit(hop_distances)
batched_hops = jax.jit(jax.vmap(hop_distances))


@given(
    st.lists(st.tuples(st.integers(1, CAPACITY), st.floats(0, 0.4)), min_size=3, max_size=3),
    st.integers(0, 1000),
)
@settings(deadline=None, max_examples=30)
def test_hops__are_those_of_networkx_in_a_batch_of_unequal_graphs(sizes, seed):
    graphs = [nx.gnp_random_graph(size, p, seed=seed) for size, p in sizes]
    adjacency, mask = (np.stack(field) for field in zip(*map(padded, graphs), strict=True))
    found = np.asarray(batched_hops(adjacency, mask))
    for graph, hops in zip(graphs, found, strict=True):
        count = graph.number_of_nodes()
        np.testing.assert_array_equal(hops[:count, :count], hops_of_networkx(graph))
        assert not hops[count:].any()
        assert not hops[:, count:].any()


def test_unconnected_nodes_are_one_hop_further_than_the_longest_path_that_is_left():
    for cuts, expected in (((2,), 3), ((1, 3), 2), ((0, 1, 2, 3), 1)):
        path = nx.path_graph(5)
        path.remove_edges_from([(cut, cut + 1) for cut in cuts])
        assert np.asarray(find_hops(*padded(path)))[0, 4] == expected


def test_longest_possible_path():
    hops = np.asarray(find_hops(*padded(nx.path_graph(CAPACITY))))
    assert hops[0, -1] == CAPACITY - 1


def test_paths_longer_than_the_exponents_of_float32_reach():
    # 10 bits a hop: 23 hops in one product, then in steps of 23.
    count = 520
    ends = np.arange(count)
    adjacency = np.abs(ends[:, None] - ends[None, :]) == 1
    hops = find_hops(adjacency, np.ones(count, bool))
    np.testing.assert_array_equal(hops, np.abs(ends[:, None] - ends[None, :]))


def test_ties_between_many_shortest_paths_do_not_shorten_them():
    # All of the middle layer lies between both ends: the sum of the most terms there can be.
    is_end = np.arange(1023) < 2
    adjacency = is_end[:, None] != is_end[None]
    hops = find_hops(adjacency, np.ones(1023, bool))
    expected = np.where(adjacency, 1, 2) - 2 * np.eye(1023, dtype=int)
    np.testing.assert_array_equal(hops, expected)


def test_proximity_edges_are_no_path():
    graph = make_graph(
        [PLANE, PLANE, ROOM, FLOOR],
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros(4),
        part_of=[[0, 2], [2, 3]],
        proximity=[[0, 1]],
    )
    hops = np.asarray(jax.jit(part_of_hops)(pad(graph, Capacity(5, 8))))
    np.testing.assert_array_equal(hops[0], [0, 3, 1, 2, 0])
