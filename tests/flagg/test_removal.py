import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.flagg.blocks import fewest_coins
from sg3d_jax.flagg.removal import draw_continuations, draw_cut, draw_missing, extract_block
from sg3d_jax.scene.graph import make_graph, undirected_edges
from sg3d_jax.scene.ontology import PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.padding import Capacity, part_of_adjacency
from tests import own_world
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
    whole, nodes = on_device(SCENE).nodes, cuts.survivors.nodes
    assert nodes.mask[:, :NUM_PLANES].all()
    for name in ("label", "position", "normal", "width", "observed"):
        found, given = getattr(nodes, name), getattr(whole, name)
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
    graph = on_device(SCENE)
    label = jnp.zeros_like(graph.nodes.label)
    nodes = graph.nodes._replace(label=label, observed=graph.nodes.mask)
    planes = graph._replace(nodes=nodes)
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


def test_extracted_blocks__hold_the_nodes_of_their_ranks_and_what_comes_before():
    graph = on_device(SCENE)
    rank = jnp.where(graph.nodes.observed, -1, 3 - (jnp.arange(16) - NUM_PLANES))
    rank = jnp.where(graph.nodes.mask, rank, 16)  # the floor first, the wall last
    block = extract_block(graph, rank, jnp.asarray(1), jnp.asarray(2), 3)
    np.testing.assert_array_equal(block.mask, [True, True, False])
    np.testing.assert_array_equal(block.label[:2], SCENE.nodes.label[[10, 9]])
    np.testing.assert_allclose(block.position[:2], SCENE.nodes.position[[10, 9]], rtol=1e-6)
    before = np.arange(16) != 8
    before[9:11] = False  # the block itself
    np.testing.assert_array_equal(block.edges[:2, 3:], TRUTH[[10, 9]] & before)
    assert not block.edges[:, :3].any()
    for field in (block.label, block.position, block.edges):
        assert not field[2].any()


def test_cuts_and_continuations__are_of_what_grows_in_any_ontology():
    scene = own_world.own_world()
    graph, num_given = on_device(scene, Capacity(24, 288)), own_world.NUM_OBSERVED
    truth = np.asarray(part_of_adjacency(graph))
    near = undirected_edges(scene, PROXIMITY)
    layers = ("floor", "room", "wall", "flat")

    @jax.jit
    def draw(key):
        cut = draw_cut(graph, key, (1, 2), "H", layers)
        return cut, draw_continuations(graph, cut, jax.random.fold_in(key, 1), 8, layers)

    place = np.array([layers.index(name) if name in layers else -1 for name in scene.globals.names])
    seen = set()
    for seed in range(12):
        cut, blocks = jax.tree.map(np.asarray, draw(jax.random.key(seed)))
        old = cut.survivors.nodes.mask
        assert old[:num_given].all()
        np.testing.assert_array_equal(cut.survivors.nodes.observed, np.arange(24) < num_given)
        np.testing.assert_array_equal(undirected_edges(cut.survivors, PROXIMITY), near)
        gone = np.flatnonzero(~old[: len(scene.nodes.label)])
        seen.add(len(gone))
        for block in [cut.block, *each_block(blocks)]:
            size = int(cut.block.mask.sum())
            assert block.mask.sum() == size
            offset = block.position[block.mask][:, None] - scene.nodes.position[None]
            alike = block.label[block.mask][:, None] == scene.nodes.label[None]
            slots = np.argmin(np.abs(offset).max(axis=-1) + 99 * ~alike, axis=-1)
            assert np.isin(slots, gone).all()
            assert len(set(slots)) == size
            np.testing.assert_array_equal(block.label[block.mask], scene.nodes.label[slots])
            expected = sorted(place[scene.nodes.label[gone]])[:size]
            assert sorted(place[scene.nodes.label[slots]]) == expected
            np.testing.assert_array_equal(block.edges[:size, 2:], truth[slots] & old)
            np.testing.assert_array_equal(block.edges[:size, :size], truth[np.ix_(slots, slots)])
    assert len(seen) > 4


def test_cuts_of_any_kind__lack_any_nodes_and_ask_for_the_first_of_them():
    """Every set of the grown nodes occurs; the block comes from the lowest layer that lacks any."""
    graph = on_device(SCENE)
    draw = jax.jit(jax.vmap(lambda key: draw_cut(graph, key, (1,), any_cuts=1.0)))
    cuts = jax.tree.map(np.asarray, draw(jax.random.split(jax.random.key(3), 600)))
    label, grown = SCENE.nodes.label, ~SCENE.nodes.observed
    seen = set()
    for cut in each(cuts):
        here = cut.survivors.nodes.mask[: len(label)]
        assert here[~grown].all()
        missing = np.flatnonzero(grown & ~here)
        seen.add(tuple(missing))
        assert cut.complete == (len(missing) == 0) == (not cut.has_block)
        assert cut.inserted == (here & grown).any()
        if len(missing):
            node = find(cut.block.position[0])
            assert node in missing
            assert label[node] == label[missing].min()
            np.testing.assert_array_equal(
                cut.block.edges[0, 1:], TRUTH[node] & cut.survivors.nodes.mask
            )
    assert len(seen) == 2 ** grown.sum()


def test_cuts_of_any_kind__are_the_share_of_them_that_is_asked_for():
    """The others lack the last nodes of the order alone: nothing stands on what is missing."""
    graph = on_device(SCENE)
    draw = jax.jit(jax.vmap(lambda key: draw_cut(graph, key, (1,), any_cuts=0.3)))
    here = np.asarray(draw(jax.random.split(jax.random.key(4), 2000)).survivors.nodes.mask)
    here, label = here[:, : len(SCENE.nodes.label)], SCENE.nodes.label
    highest = np.where(here, label, -1).max(axis=1)
    lowest = np.where(here, 99, label).min(axis=1)
    out_of_order = np.mean(highest > lowest)  # a wall or a room is missing below a higher node
    always = jax.jit(jax.vmap(lambda key: draw_cut(graph, key, (1,), any_cuts=1.0)))
    here = np.asarray(always(jax.random.split(jax.random.key(5), 2000)).survivors.nodes.mask)
    here = here[:, : len(label)]
    share = np.mean(np.where(here, label, -1).max(axis=1) > np.where(here, 99, label).min(axis=1))
    assert abs(out_of_order - 0.3 * share) < 0.03


def test_a_hole__is_around_one_node():
    """Half of the draws of the missing rooms are those nearest to a node of the scene."""
    label = np.array([PLANE] * 2 + [ROOM] * 9)
    position = np.zeros((11, 3))
    position[2:, 0] = np.arange(9.0) ** 1.3  # no two are equally far from a third
    graph = on_device(make_graph(label, position))
    draw = jax.jit(jax.vmap(lambda key: draw_missing(graph, key)))
    missing = np.asarray(draw(jax.random.split(jax.random.key(0), 4000)))[:, 2:11]
    run = np.array([len(np.flatnonzero(np.diff(np.flatnonzero(row)) > 1)) == 0 for row in missing])
    four = missing.sum(axis=1) == 4
    assert 0.45 < run[four].mean() < 0.65  # of the others, 6 of 126 are a run


def test_continuations__of_any_cut_come_next_and_know_all_that_is_there():
    graph = on_device(SCENE)

    def draw(key):
        key_cut, key_blocks = jax.random.split(key)
        cut = draw_cut(graph, key_cut, (1,), any_cuts=1.0)
        return cut, draw_continuations(graph, cut, key_blocks, 6)

    cuts, blocks = jax.jit(jax.vmap(draw))(jax.random.split(jax.random.key(6), 100))
    label, grown = SCENE.nodes.label, ~SCENE.nodes.observed
    for index, cut in enumerate(each(cuts)):
        here = np.asarray(cut.survivors.nodes.mask)
        missing = np.flatnonzero(grown & ~here[: len(label)])
        for block in each_block(jax.tree.map(lambda leaf, i=index: leaf[i], blocks)):
            assert block.mask.any() == bool(len(missing))
            if len(missing):
                node = find(block.position[0])
                assert label[node] == label[missing].min()
                np.testing.assert_array_equal(block.edges[0, 1:], TRUTH[node] & here)
