import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.flagg.blocks import fewest_coins
from sg3d_jax.flagg.removal import (
    check_one_shot,
    draw_continuations,
    draw_cut,
    one_shot_capacity,
    one_shot_cut,
)
from sg3d_jax.scene.ontology import PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.graph import undirected_edges
from sg3d_jax.scene.padding import part_of_adjacency
from tests.two_rooms import NUM_PLANES, on_device, two_rooms, with_garbage

COINS = (1, 2)
SCENE = two_rooms()
NUM_HIGH = len(SCENE.nodes.label) - NUM_PLANES
TRUTH = np.asarray(part_of_adjacency(on_device(SCENE)))
NEAR = undirected_edges(SCENE, PROXIMITY)
cut_graph = jax.jit(jax.vmap(lambda graph, key: draw_cut(graph, key, COINS), (None, 0)))


@pytest.fixture(scope="module")
def cuts():
    keys = jax.random.split(jax.random.key(0), 600)
    return jax.tree.map(np.asarray, cut_graph(on_device(SCENE), keys))


def each(cuts):
    for index in range(len(cuts.complete)):
        yield jax.tree.map(lambda leaf, i=index: leaf[i], cuts)


def each_block(blocks):
    for index in range(len(blocks.mask)):
        yield jax.tree.map(lambda leaf, i=index: np.asarray(leaf)[i], blocks)


def find(position):
    """The slot of the node of the scene at this place."""
    offset = np.abs(SCENE.nodes.position - position).max(axis=-1)
    return int(np.argmin(offset))


def test_planes__survive_untouched_with_all_their_proximity_edges(cuts):
    label, position, normal, width, _ = on_device(SCENE).nodes
    nodes = cuts.survivors.nodes
    assert nodes.mask[:, :NUM_PLANES].all()
    for found, given in zip(nodes[:4], (label, position, normal, width), strict=True):
        np.testing.assert_array_equal(found, np.broadcast_to(given, found.shape))
    for cut in each(cuts):
        np.testing.assert_array_equal(undirected_edges(cut.survivors, PROXIMITY), NEAR)
        assert not (cut.block.label[cut.block.mask] == PLANE).any()


def test_survivors__keep_exactly_the_edges_among_them(cuts):
    adjacency = np.asarray(jax.vmap(part_of_adjacency)(cuts.survivors))
    for cut, found in zip(each(cuts), adjacency, strict=True):
        mask = cut.survivors.nodes.mask
        np.testing.assert_array_equal(found, TRUTH & mask[:, None] & mask[None])
        assert cut.survivors.n_node[0] == mask.sum()
        assert cut.survivors.n_edge[0] == cut.survivors.edges.mask.sum()


def test_blocks__have_the_labels_places_and_edges_of_the_nodes_they_hold(cuts):
    capacity = max(COINS)
    for cut in each(cuts):
        block, old = cut.block, cut.survivors.nodes.mask
        slots = [find(position) for position in block.position[block.mask]]
        assert not old[slots].any()
        np.testing.assert_array_equal(block.label[block.mask], SCENE.nodes.label[slots])
        expected = np.zeros_like(block.edges)
        size = len(slots)
        expected[:size, :size] = TRUTH[np.ix_(slots, slots)]
        expected[:size, capacity:] = TRUTH[slots] & old
        np.testing.assert_array_equal(block.edges, expected)
        assert size == 0 or size in COINS


def test_layers__come_one_after_the_other(cuts):
    for cut in each(cuts):
        kept = SCENE.nodes.label[cut.survivors.nodes.mask[:12]]
        gone = SCENE.nodes.label[~cut.survivors.nodes.mask[:12]]
        assert len(gone) == 0 or kept.max() <= gone.min()
        if cut.has_block:
            assert cut.block.label[cut.block.mask].min() == gone.min()


def test_flags__say_what_is_there(cuts):
    inserted = cuts.survivors.nodes.mask.sum(axis=-1) - NUM_PLANES
    np.testing.assert_array_equal(cuts.inserted, inserted > 0)
    np.testing.assert_array_equal(cuts.complete, inserted == NUM_HIGH)
    np.testing.assert_array_equal(cuts.has_block, ~cuts.complete)
    np.testing.assert_array_equal(cuts.block.mask.any(axis=-1), cuts.has_block)


def test_targets_of_insert__are_the_change_of_what_is_missing(cuts):
    missing = NUM_HIGH + NUM_PLANES - cuts.survivors.nodes.mask.sum(axis=-1)
    change = fewest_coins(COINS, NUM_HIGH)[missing]
    expected = change / np.maximum(change.sum(axis=-1, keepdims=True), 1)
    np.testing.assert_allclose(cuts.insert_probs, expected)


def test_steps__are_uniform_over_the_graphs_of_a_trajectory(cuts):
    """Four nodes in blocks of two: planes, half, and all."""
    inserted = cuts.survivors.nodes.mask.sum(axis=-1) - NUM_PLANES
    frequencies = np.bincount(inserted, minlength=NUM_HIGH + 1) / len(inserted)
    np.testing.assert_allclose(frequencies, [1 / 3, 0, 1 / 3, 0, 1 / 3], atol=0.06)


def test_survivors_and_block__make_the_graph_of_the_next_step(cuts):
    """What is missing after the block is what the survivors and the block do not hold."""
    for cut in each(cuts):
        slots = [find(position) for position in cut.block.position[cut.block.mask]]
        after = cut.survivors.nodes.mask.copy()
        after[slots] = True
        rebuilt = TRUTH & cut.survivors.nodes.mask[:, None] & cut.survivors.nodes.mask[None]
        for row, slot in enumerate(slots):
            rebuilt[slot] |= cut.block.edges[row, max(COINS) :]
            rebuilt[slot, slots] |= cut.block.edges[row, : len(slots)]
        np.testing.assert_array_equal(rebuilt | rebuilt.T, TRUTH & after[:, None] & after[None])


def test_cut__does_not_depend_on_what_is_in_the_padding(cuts):
    keys = jax.random.split(jax.random.key(0), 600)
    spoilt = cut_graph(with_garbage(on_device(SCENE), 0), keys)
    for found, expected in zip(spoilt[1:], cuts[1:], strict=True):
        jax.tree.map(np.testing.assert_array_equal, found, expected)
    for mask in ("nodes", "edges"):
        found, expected = (getattr(cut.survivors, mask).mask for cut in (spoilt, cuts))
        np.testing.assert_array_equal(found, expected)


def test_a_graph_of_planes_only__is_complete_and_has_no_block():
    label = jnp.zeros_like(on_device(SCENE).nodes.label)
    graph = on_device(SCENE)
    planes = graph._replace(nodes=graph.nodes._replace(label=label))
    cut = cut_graph(planes, jax.random.split(jax.random.key(1), 3))
    assert cut.complete.all()
    assert not cut.has_block.any()
    assert not cut.inserted.any()
    assert not cut.insert_probs.any()


def test_continuations__are_drawn_as_the_blocks_of_cuts_with_the_same_survivors():
    """One node at a time: each missing node of the next layer is as likely as another."""
    graph = on_device(SCENE)

    @jax.jit
    def draw(key):
        key_cut, key_blocks = jax.random.split(key)
        cut = draw_cut(graph, key_cut, (1,))
        return cut, draw_continuations(graph, cut, key_blocks, 64)

    seen = set()
    for seed in range(20):
        cut, blocks = jax.tree.map(np.asarray, draw(jax.random.key(seed)))
        old = cut.survivors.nodes.mask
        missing = [slot for slot in range(len(SCENE.nodes.label)) if not old[slot]]
        assert (blocks.mask == cut.has_block).all()
        if not missing:
            continue
        label = SCENE.nodes.label[missing].min()
        nexts = [slot for slot in missing if SCENE.nodes.label[slot] == label]
        slots = np.array([find(position[0]) for position in blocks.position])
        assert set(slots) == set(nexts)
        np.testing.assert_allclose(np.bincount(slots)[nexts] / 64, 1 / len(nexts), atol=0.25)
        np.testing.assert_array_equal(blocks.label[:, 0], SCENE.nodes.label[slots])
        np.testing.assert_array_equal(blocks.edges[:, 0, 1:], TRUTH[slots] & old)
        assert not blocks.edges[:, 0, 0].any()
        seen.add((label, len(nexts)))
    assert {count for _, count in seen} >= {1, 2}


def test_continuations__are_blocks_as_large_as_that_of_the_cut():
    graph = on_device(SCENE)
    draw = jax.jit(
        lambda key: (
            cut := draw_cut(graph, key, COINS),
            draw_continuations(graph, cut, jax.random.fold_in(key, 1), 3),
        )
    )
    for seed in range(6):
        cut, blocks = draw(jax.random.key(seed))
        np.testing.assert_array_equal(blocks.mask, np.broadcast_to(cut.block.mask, (3, 2)))
        inner = blocks.edges[:, :, :2]
        np.testing.assert_array_equal(inner, np.swapaxes(inner, 1, 2))
        for block in each_block(blocks):
            slots = [find(position) for position in block.position[block.mask]]
            assert len(set(slots)) == len(slots)


def test_one_shot__leaves_the_planes_and_takes_all_else_as_one_block():
    graph = on_device(SCENE)
    cut = jax.tree.map(np.asarray, jax.jit(one_shot_cut)(graph))
    num_nodes, num_block = len(graph.nodes.mask), one_shot_capacity(len(graph.nodes.mask))
    np.testing.assert_array_equal(cut.survivors.nodes.mask, np.arange(num_nodes) < NUM_PLANES)
    np.testing.assert_array_equal(undirected_edges(cut.survivors, PROXIMITY), NEAR)
    assert not part_of_adjacency(cut.survivors).any()
    assert len(cut.block.mask) == num_block
    np.testing.assert_array_equal(np.flatnonzero(cut.block.mask), range(NUM_HIGH))
    high = slice(NUM_PLANES, NUM_PLANES + NUM_HIGH)
    np.testing.assert_array_equal(cut.block.label[:NUM_HIGH], SCENE.nodes.label[high])
    np.testing.assert_allclose(cut.block.position[:NUM_HIGH], SCENE.nodes.position[high], rtol=1e-6)
    expected = np.concatenate([TRUTH[high, high], TRUTH[high, :NUM_PLANES]], axis=1)
    found = np.delete(cut.block.edges[:NUM_HIGH], np.s_[NUM_HIGH:num_block], axis=1)
    np.testing.assert_array_equal(found[:, : NUM_HIGH + NUM_PLANES], expected)
    assert cut.block.edges.sum() == expected.sum()


def test_one_shot__is_refused_where_a_bucket_has_no_room():
    graphs = jax.tree.map(lambda leaf: leaf[None], on_device(SCENE))
    check_one_shot([graphs])
    label = jnp.where(jnp.arange(graphs.nodes.label.shape[1])[None] < 3, PLANE, ROOM)
    crowded = graphs._replace(nodes=graphs.nodes._replace(label=label))
    with pytest.raises(
        ValueError, match="bucket of 16 nodes has 9 that are not planes, expected at"
    ):
        check_one_shot([graphs, crowded])
