import inspect
from itertools import pairwise
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.scene.graph import PackedGraph, SceneGraph, make_graph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PLANE, PROXIMITY, ROOM, WALL
from sg3d_jax.scene.padding import (
    EDGES_PER_NODE,
    NODE_CAPACITIES,
    Block,
    Capacity,
    append_block,
    bucket,
    centre_of_observed,
    masked,
    moved_by,
    pack,
    pad,
    part_of_adjacency,
    stack,
    unpad,
    unpad_all,
    without_proximity,
)
from tests.own_world import ONTOLOGY, own_world
from tests.unchecked import unchecked

CAPACITY = Capacity(16, 256)
BLOCK_CAPACITY = 4


class Named(NamedTuple):
    """What has a graph and is none."""

    graph: SceneGraph


def random_graph(seed, num_nodes=9):
    """A graph of mixed labels and edges, float32 values so that padding loses nothing."""
    rng = np.random.default_rng(seed)
    label = rng.choice([PLANE, WALL, ROOM], num_nodes)
    position, normal = rng.normal(size=(2, num_nodes, 3)).astype(np.float32)
    width = rng.uniform(1, 3, num_nodes).astype(np.float32)
    pairs = np.argwhere(np.triu(rng.random((num_nodes, num_nodes)) < 0.4, 1))
    part_of, proximity = np.split(rng.permutation(pairs), [len(pairs) // 2])
    return make_graph(label, position, normal, width, part_of, proximity)


def random_block(seed, num_new):
    """A block with edges everywhere, also at padding, which must be ignored."""
    rng = np.random.default_rng(seed)
    inside = np.triu(rng.random((BLOCK_CAPACITY, BLOCK_CAPACITY)) < 0.5, 1)
    across = rng.random((BLOCK_CAPACITY, CAPACITY.nodes)) < 0.4
    return Block(
        label=rng.choice([WALL, ROOM, FLOOR], BLOCK_CAPACITY).astype(np.int32),
        position=rng.normal(size=(BLOCK_CAPACITY, 3)).astype(np.float32),
        edges=np.concatenate([inside | inside.T, across], axis=1),
        mask=np.arange(BLOCK_CAPACITY) < num_new,
    )


append = jax.jit(append_block)
mask_compiled = jax.jit(masked)
pack_compiled = jax.jit(pack)
drop_proximity = jax.jit(without_proximity)


def on_host(tree):
    return jax.tree.map(np.asarray, tree)


def on_device(graph, capacity=CAPACITY):
    return jax.tree.map(jnp.asarray, pad(graph, capacity))


def append_by_loop(graph, block):
    """What append_block should do, on host graphs, one edge after the other."""
    num_old, num_new = len(graph.nodes.label), int(block.mask.sum())
    pairs = undirected_edges(graph, PART_OF).tolist()
    for new in range(num_new):
        for other in range(new):
            if block.edges[new, other]:
                pairs.append([num_old + new, num_old + other])
        for old in range(num_old):
            if block.edges[new, BLOCK_CAPACITY + old]:
                pairs.append([num_old + new, old])
    nothing = np.zeros(num_new)
    return make_graph(
        np.concatenate([graph.nodes.label, block.label[:num_new]]),
        np.concatenate([graph.nodes.position, block.position[:num_new]]),
        np.concatenate([graph.nodes.normal, nothing[:, None] * np.ones(3)]),
        np.concatenate([graph.nodes.width, nothing]),
        pairs,
        undirected_edges(graph, PROXIMITY),
    )


def assert_same_graph(left, right):
    chex.assert_trees_all_equal(left.nodes, right.nodes)
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(undirected_edges(left, relation), undirected_edges(right, relation))


@given(seed=st.integers(0, 2**32 - 1), num_nodes=st.integers(1, 12))
@settings(deadline=None, max_examples=40)
def test_unpadding_undoes_padding(seed, num_nodes):
    graph = random_graph(seed, num_nodes)
    assert_same_graph(unpad(pad(graph, Capacity(16, 160))), graph)


def test_padding_is_zero_and_masked():
    graph = random_graph(0)
    padded = pad(graph, CAPACITY)
    num_nodes, num_edges = len(graph.nodes.label), len(graph.senders)
    for field in padded.nodes:
        assert not np.any(field[num_nodes:])
    assert not np.any(padded.edges.mask[num_edges:])
    assert not np.any(padded.senders[num_edges:])
    npt.assert_array_equal(padded.n_node, [num_nodes, CAPACITY.nodes - num_nodes])
    assert padded.nodes.position.dtype == np.float64  # float32 is the device's, which takes it over
    assert on_device(graph).nodes.position.dtype == np.float32


def test_a_graph_may_fill_its_capacity():
    graph = random_graph(1)
    exact = Capacity(len(graph.nodes.label), len(graph.senders))
    assert_same_graph(unpad(pad(graph, exact)), graph)


def test_a_graph_without_padding_is_unpadded_as_it_is():
    graph = random_graph(0)
    padded = pad(graph, Capacity(16, 160))
    first, second = unpad_all(one for one in (graph, padded))
    assert first is graph
    assert_same_graph(second, graph)


def test_what_cannot_be_padded_or_unpadded_is_refused():
    graph = random_graph(0)
    refusals = (
        (lambda: unpad(stack([graph] * 2, CAPACITY)), r"of the shape \(2,\), expected one of them"),
        (lambda: unpad(Named(graph)), "got Named, expected a scene graph, such as its `graph`$"),
        (lambda: unpad_all([3]), "got int, expected a scene graph$"),
        (lambda: unpad_all(graph), "got one scene graph, expected a list of them"),
        (lambda: stack([], CAPACITY), "no graphs to stack, expected at least one"),
    )
    for call, sentence in refusals:
        with unchecked(), pytest.raises(ValueError, match=sentence):
            call()


@pytest.mark.parametrize(("fewer_nodes", "fewer_edges"), [(1, 0), (0, 1)])
def test_a_graph_that_does_not_fit_is_refused(fewer_nodes, fewer_edges):
    graph = random_graph(1)
    nodes, edges = len(graph.nodes.label) - fewer_nodes, len(graph.senders) - fewer_edges
    with pytest.raises(ValueError, match="does not fit"):
        pad(graph, Capacity(nodes, edges))


@pytest.mark.parametrize("nodes", NODE_CAPACITIES)
def test_bucket_holds_exactly_its_capacity(nodes):
    assert bucket(nodes).nodes == nodes
    assert bucket(nodes, EDGES_PER_NODE * nodes).nodes == nodes


@pytest.mark.parametrize(("smaller", "larger"), [*pairwise(NODE_CAPACITIES)])
def test_bucket_grows_by_one_node_or_edge_too_many(smaller, larger):
    assert bucket(smaller + 1).nodes == larger
    assert bucket(1, EDGES_PER_NODE * smaller + 1).nodes == larger


@pytest.mark.parametrize("size", [(NODE_CAPACITIES[-1] + 1, 0), (1, 10**6)])
def test_bucket_refuses_what_no_capacity_holds(size):
    with pytest.raises(ValueError, match="exceeds the largest capacity"):
        bucket(*size)


@given(
    seed=st.integers(0, 2**32 - 1),
    num_old=st.integers(1, 9),
    num_new=st.integers(0, BLOCK_CAPACITY),
)
@settings(deadline=None, max_examples=30)
def test_appending_agrees_with_a_loop_over_pairs(seed, num_old, num_new):
    graph = random_graph(seed, num_old)
    block = random_block(seed + 1, num_new)
    grown, fitted = append(on_device(graph), block)
    expected = append_by_loop(graph, block)
    assert bool(fitted)
    assert_same_graph(unpad(grown), expected)
    num_nodes, num_edges = num_old + num_new, len(expected.senders)
    assert grown.n_node.tolist() == [num_nodes, CAPACITY.nodes - num_nodes]
    assert grown.n_edge.tolist() == [num_edges, CAPACITY.edges - num_edges]


def test_appending_leaves_old_nodes_bit_identical():
    before = on_device(random_graph(5))
    after, _ = append(before, random_block(6, 3))
    for old, new in zip(on_host(before.nodes), on_host(after.nodes), strict=True):
        npt.assert_array_equal(new[:9], old[:9])


def test_blocks_can_be_appended_one_after_another():
    graph = random_graph(7, 5)
    expected, grown = graph, on_device(graph)
    for seed in range(3):
        block = random_block(seed, 2)
        expected = append_by_loop(expected, block)
        grown, fitted = append(grown, block)
        assert bool(fitted)
    assert_same_graph(unpad(grown), expected)


def test_appending_reports_what_does_not_fit():
    graph, block = random_graph(8), random_block(9, BLOCK_CAPACITY)
    whole = append_by_loop(graph, block)
    nodes, edges = len(whole.nodes.label), len(whole.senders)
    for less in ((0, 0), (1, 0), (0, 1)):
        capacity = Capacity(nodes - less[0], edges - less[1])
        narrow = block._replace(edges=block.edges[:, : BLOCK_CAPACITY + capacity.nodes])
        _, fitted = append(on_device(graph, capacity), narrow)
        assert bool(fitted) == (less == (0, 0))


def test_appending_a_batch_agrees_with_a_loop_and_compiles_once():
    graphs = [random_graph(seed, 4 + seed) for seed in range(4)]
    blocks = [random_block(seed, seed) for seed in range(4)]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *blocks)
    append_all = jax.jit(jax.vmap(chex.assert_max_traces(append_block, n=1)))
    grown, fitted = append_all(stack(graphs, CAPACITY), stacked)
    assert fitted.shape == (4,)
    grown = on_host(grown)
    for index, (graph, block) in enumerate(zip(graphs, blocks, strict=True)):
        one = jax.tree.map(lambda leaf, index=index: leaf[index], grown)
        chex.assert_trees_all_equal(one, append(on_device(graph), block)[0])
    append_all(stack(graphs[::-1], CAPACITY), stacked)


def test_part_of_adjacency_is_the_dense_form_of_the_edges():
    graph = random_graph(10)
    adjacency = np.asarray(jax.jit(part_of_adjacency)(on_device(graph)))
    npt.assert_array_equal(np.argwhere(np.triu(adjacency)), undirected_edges(graph, PART_OF))
    npt.assert_array_equal(adjacency, adjacency.T)


def test_dropping_proximity_keeps_part_of_edges():
    graph = random_graph(11)
    kept = drop_proximity(on_device(graph))
    assert len(undirected_edges(graph, PROXIMITY)) > 0
    assert len(undirected_edges(kept, PROXIMITY)) == 0
    npt.assert_array_equal(undirected_edges(kept, PART_OF), undirected_edges(graph, PART_OF))


def with_holes(seed, num_nodes=9):
    """A padded graph that has lost some nodes, with their edges, and some of the other edges."""
    graph, rng = pad(random_graph(seed, num_nodes), CAPACITY), np.random.default_rng(seed)
    nodes = graph.nodes.mask & (rng.random(CAPACITY.nodes) < 0.6)
    kept = nodes[graph.senders] & nodes[graph.receivers]
    lost = rng.random((CAPACITY.nodes, CAPACITY.nodes)) < 0.3  # in both directions
    lost = (lost | lost.T)[graph.senders, graph.receivers]
    return mask_compiled(graph, nodes, graph.edges.mask & kept & ~lost)


def packed_by_loop(graph):
    """What pack should do, one slot after the other."""
    graph = on_host(graph)
    packed = jax.tree.map(np.zeros_like, graph)
    place = {}
    for slot in np.flatnonzero(graph.nodes.mask).tolist():
        for new, old in zip(packed.nodes, graph.nodes, strict=True):
            new[len(place)] = old[slot]
        place[slot] = len(place)
    for rank, slot in enumerate(np.flatnonzero(graph.edges.mask).tolist()):
        packed.edges.relation[rank] = graph.edges.relation[slot]
        packed.edges.mask[rank] = True
        packed.senders[rank] = place[int(graph.senders[slot])]
        packed.receivers[rank] = place[int(graph.receivers[slot])]
    packed.n_node[:] = len(place), CAPACITY.nodes - len(place)
    num_edges = int(graph.edges.mask.sum())
    packed.n_edge[:] = num_edges, CAPACITY.edges - num_edges
    return packed


@given(seed=st.integers(0, 2**32 - 1), num_nodes=st.integers(1, 16))
@settings(deadline=None, max_examples=40)
def test_packing_agrees_with_a_loop_over_slots(seed, num_nodes):
    holey = with_holes(seed, num_nodes)
    found, expected = pack_compiled(holey), packed_by_loop(holey)
    assert type(found) is PackedGraph
    for new, wanted in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        npt.assert_array_equal(new, wanted)
    for new, old in zip(jax.tree.leaves(found), jax.tree.leaves(holey), strict=True):
        assert new.dtype == old.dtype
    assert_same_graph(unpad(found), unpad(holey))


def test_packing_a_batch_agrees_with_a_loop_and_compiles_once():
    graphs = [with_holes(seed, 4 + seed) for seed in range(4)]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *graphs)
    pack_all = jax.jit(jax.vmap(chex.assert_max_traces(pack, n=1)))
    packed = pack_all(stacked)
    assert type(packed) is PackedGraph
    packed = on_host(packed)
    for index, graph in enumerate(graphs):
        one = jax.tree.map(lambda leaf, index=index: leaf[index], packed)
        chex.assert_trees_all_equal(one, pack_compiled(graph))
    pack_all(jax.tree.map(lambda leaf: leaf[::-1], stacked))


def test_packing_a_packed_graph_changes_nothing():
    graph = on_device(random_graph(3))
    chex.assert_trees_all_equal(pack_compiled(graph), graph)


@given(seed=st.integers(0, 2**32 - 1), num_new=st.integers(0, BLOCK_CAPACITY))
@settings(deadline=None, max_examples=20)
def test_appending_after_packing_keeps_every_node(seed, num_new):
    holey, block = with_holes(seed), random_block(seed + 1, num_new)
    packed = pack_compiled(holey)
    # The block's edges to old nodes name slots: those of the packed graph.
    grown, fitted = append(packed, block)
    assert bool(fitted)
    assert_same_graph(unpad(grown), append_by_loop(unpad(holey), block))


@pytest.mark.parametrize(
    "holey",
    [
        lambda: with_holes(5),
        lambda: drop_proximity(on_device(random_graph(5))),
        lambda: random_graph(5),
        lambda: jax.tree.map(lambda leaf: leaf, SceneGraph(*on_device(random_graph(5)))),
    ],
    ids=["masked", "without proximity", "unpadded", "of no known order"],
)
def test_a_graph_that_is_not_packed_is_not_appended_to(holey):
    own_check = inspect.unwrap(append_block)  # the tests' type checker would be first to refuse
    for append_any in (own_check, jax.jit(own_check)):
        with pytest.raises(TypeError, match="only a PackedGraph can be appended to"):
            append_any(holey(), random_block(6, 2))


def test_what_pads_is_packed_and_what_masks_is_not():
    graph = random_graph(2)
    device = on_device(graph)
    assert type(pad(graph, CAPACITY)) is type(stack([graph] * 2, CAPACITY)) is PackedGraph
    assert type(append(device, random_block(3, 2))[0]) is PackedGraph
    assert type(jax.jit(lambda graph: graph)(device)) is PackedGraph
    assert type(mask_compiled(device, device.nodes.mask, device.edges.mask)) is SceneGraph
    assert type(drop_proximity(device)) is SceneGraph
    assert type(unpad(device)) is type(graph) is SceneGraph


def test_masked_nodes_are_not_observed_and_counts_follow_the_masks():
    graph = pad(random_graph(12), CAPACITY)
    keep = graph.nodes.mask & (np.arange(CAPACITY.nodes) % 3 != 1)
    edges = graph.edges.mask & (np.arange(CAPACITY.edges) % 2 == 0)
    found = on_host(mask_compiled(graph, keep, edges))
    is_plane = graph.nodes.label == PLANE
    npt.assert_array_equal(found.nodes.observed, keep & is_plane)
    assert 0 < found.nodes.observed.sum() < graph.nodes.observed.sum()
    npt.assert_array_equal(found.nodes.mask, keep)
    npt.assert_array_equal(found.n_node, [keep.sum(), (~keep).sum()])
    npt.assert_array_equal(found.n_edge, [edges.sum(), (~edges).sum()])


def test_padding_and_what_is_appended_are_not_observed():
    grown, _ = append(on_device(random_graph(13)), random_block(14, 3))
    is_plane = (np.asarray(grown.nodes.label) == PLANE) & (np.arange(CAPACITY.nodes) < 9)
    npt.assert_array_equal(grown.nodes.observed, is_plane)


def test_the_ontology_goes_along():
    world = own_world()
    capacity = Capacity(32, 256)
    for graph in (
        pad(world, capacity),
        stack([world], capacity),
        pack_compiled(pad(world, capacity)),
    ):
        assert graph.globals is ONTOLOGY
    assert_same_graph(unpad(pad(world, capacity)), world)


def test_centre_of_observed_is_zero_where_nothing_is_observed():
    npt.assert_array_equal(centre_of_observed(make_graph([ROOM], [[9, 9, 9]])), np.zeros(3))


def test_moving_leaves_padding_at_zero_and_rounds_nothing():
    graph, offset = random_graph(1), np.array([5e5, 5e6, 1.0])
    far = moved_by(pad(graph, CAPACITY), offset)
    npt.assert_array_equal(far.nodes.position[:9], graph.nodes.position + offset)
    assert not far.nodes.position[9:].any()
    npt.assert_allclose(centre_of_observed(far), centre_of_observed(graph) + offset, rtol=1e-15)
    back = moved_by(far, -centre_of_observed(far))
    npt.assert_allclose(centre_of_observed(back), 0, atol=1e-8)


def test_centre_of_observed_ignores_other_nodes():
    graph = make_graph(
        [PLANE, ROOM, PLANE], [[0, 0, 0], [9, 9, 9], [2, 4, 6]], np.zeros((3, 3)), np.ones(3), []
    )
    npt.assert_array_equal(centre_of_observed(graph), [1, 2, 3])
