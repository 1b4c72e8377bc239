import chex
import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import pytest
from scipy.spatial import cKDTree

from sg3d_jax.scene.graph import PackedGraph, make_graph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.padding import Capacity, pad, stack
from sg3d_jax.scene.proximity import connect_observed, nearest_neighbours
from tests.own_world import PILLAR, own_world
from tests.own_world import PLANE as OWN_PLANE

CAPACITY = Capacity(64, 1024)


def scattered_planes(num_planes, seed=0, num_rooms=0):
    """Planes at random places, with rooms between them that must not be connected."""
    rng = np.random.default_rng(seed)
    size = num_planes + num_rooms
    label = rng.permutation([PLANE] * num_planes + [ROOM] * num_rooms)
    angle = rng.uniform(0, 2 * np.pi, size)
    normal = np.stack([np.cos(angle), np.sin(angle), np.zeros(size)], -1)
    planes = label == PLANE
    return make_graph(
        label,
        rng.uniform(-10, 10, (size, 3)),
        normal * planes[:, None],
        rng.uniform(1, 3, size) * planes,
        part_of=[],
    )


neighbours = jax.jit(nearest_neighbours, static_argnames="k")
connect_compiled = jax.jit(connect_observed, static_argnames="k")


def connect(padded, **options):
    return jax.tree.map(np.asarray, connect_compiled(padded, **options))


def on_device(graph, capacity):
    return jax.tree.map(jnp.asarray, pad(graph, capacity))


def neighbours_by_tree(position, k):
    """The union of the k nearest, by scipy; every pair if there are no more than k + 1."""
    size = len(position)
    near = min(k + 1, size)
    _, nearest = cKDTree(position).query(position, near)
    directed = np.zeros((size, size), bool)
    directed[np.arange(size)[:, None], nearest.reshape(size, near)] = True
    return (directed | directed.T) & ~np.eye(size, dtype=bool)


@pytest.mark.parametrize("num_planes", [1, 2, 5, 11, 12, 13, 30, 60])
@pytest.mark.parametrize("num_rooms", [0, 4])
def test_connects_the_union_of_ten_nearest_planes(num_planes, num_rooms):
    graph = scattered_planes(num_planes, seed=num_planes, num_rooms=num_rooms)
    connected = connect(on_device(graph, CAPACITY))
    rows = np.flatnonzero(graph.nodes.label == PLANE)
    expected = neighbours_by_tree(graph.nodes.position[rows], 10)
    found = undirected_edges(connected, PROXIMITY)
    npt.assert_array_equal(found, rows[np.argwhere(np.triu(expected))])
    assert int(connected.n_edge[0]) == expected.sum() == int(connected.edges.mask.sum())


def test_eleven_planes_are_all_connected():
    connected = connect(on_device(scattered_planes(11), CAPACITY))
    assert int(connected.n_edge[0]) == 11 * 10


def test_edges_fill_the_first_slots_and_padding_stays_padding():
    connected = connect(on_device(scattered_planes(12), CAPACITY))
    count = int(connected.n_edge[0])
    npt.assert_array_equal(connected.edges.mask, np.arange(CAPACITY.edges) < count)
    assert not np.any(connected.senders[count:])
    npt.assert_array_equal(connected.n_edge, [count, CAPACITY.edges - count])
    assert connected.senders.dtype == connected.edges.relation.dtype == np.int32


def test_too_many_edges_are_reported_by_the_count():
    connected = connect(on_device(scattered_planes(11), Capacity(16, 50)))
    assert int(connected.n_edge[0]) == 110
    assert np.all(connected.edges.mask)


def test_part_of_edges_stay_and_old_proximity_edges_go():
    scene = make_graph(
        [PLANE, PLANE, ROOM, PLANE],
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]],
        [[1, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0]],
        [1, 1, 0, 1],
        part_of=[[0, 2], [2, 3]],
        proximity=[[0, 3]],
    )
    connected = connect(on_device(scene, CAPACITY), k=1)
    npt.assert_array_equal(undirected_edges(connected, PART_OF), [[0, 2], [2, 3]])
    npt.assert_array_equal(undirected_edges(connected, PROXIMITY), [[0, 1], [1, 3]])
    assert int(connected.n_edge[0]) == 8
    npt.assert_array_equal(connected.edges.mask, np.arange(CAPACITY.edges) < 8)


def test_order_of_the_planes_does_not_matter():
    position = np.random.default_rng(3).uniform(size=(40, 3)).astype(np.float32)
    order = np.random.default_rng(4).permutation(40)
    mask = np.arange(40) % 5 > 0
    adjacency = np.asarray(neighbours(position, mask))
    permuted = neighbours(position[order], mask[order])
    npt.assert_array_equal(permuted, adjacency[np.ix_(order, order)])


def test_capacity_does_not_matter():
    graph = scattered_planes(20)
    small, large = (connect(on_device(graph, Capacity(n, 16 * n))) for n in (24, 48))
    npt.assert_array_equal(undirected_edges(small, PROXIMITY), undirected_edges(large, PROXIMITY))


def test_batch_agrees_with_loop_and_compiles_once():
    graphs = [scattered_planes(size, seed=size, num_rooms=2) for size in (2, 9, 14, 30)]
    connect_all = jax.jit(jax.vmap(chex.assert_max_traces(connect_observed, n=1)))
    batch = jax.tree.map(np.asarray, connect_all(stack(graphs, CAPACITY)))
    for index, graph in enumerate(graphs):
        one = jax.tree.map(lambda leaf, index=index: leaf[index], batch)
        chex.assert_trees_all_equal(one, connect(on_device(graph, CAPACITY)))
    connect_all(stack(graphs[::-1], CAPACITY))


def test_coincident_planes_are_neighbours_of_each_other_not_of_themselves():
    adjacency = np.asarray(neighbours(np.zeros((4, 3), "f"), np.ones(4, bool), k=1))
    assert not adjacency.diagonal().any()
    assert adjacency.sum(axis=1).min() >= 1


def test_what_is_observed_is_connected_to_its_own_kind_and_to_a_few_others():
    world = own_world()
    connected = connect(on_device(world, CAPACITY), k=4)
    label, position = world.nodes.label, world.nodes.position
    expected = set()
    for node in np.flatnonzero(np.isin(label, [OWN_PLANE, PILLAR])):
        for others, most in (
            (label == label[node], 4),
            (label == PILLAR + OWN_PLANE - label[node], 3),
        ):
            others = np.setdiff1d(np.flatnonzero(others), node)
            distance = np.linalg.norm(position[others] - position[node], axis=1)
            near = others[np.argsort(distance, kind="stable")[:most]]
            expected |= {(min(node, other), max(node, other)) for other in near}
    found = undirected_edges(connected, PROXIMITY)
    npt.assert_array_equal(found, sorted(expected))
    npt.assert_array_equal(undirected_edges(connected, PART_OF), undirected_edges(world, PART_OF))
    assert type(connected) is PackedGraph
