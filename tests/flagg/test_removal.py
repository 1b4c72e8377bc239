import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.flagg.blocks import fewest_coins
from sg3d_jax.flagg.removal import draw_continuations, draw_cut, draw_missing, extract_block
from sg3d_jax.scene.graph import make_graph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PLANE, PROXIMITY, ROOM, WALL
from sg3d_jax.scene.padding import Capacity, part_of_adjacency
from tests import own_world
from tests.two_rooms import CAPACITY, NUM_PLANES, on_device, two_rooms, with_garbage

COINS = (1, 2)
SCENE = two_rooms()
NUM_HIGH = len(SCENE.nodes.label) - NUM_PLANES
NEAR = undirected_edges(SCENE, PROXIMITY)
NUM_CUTS = 600
adjacency_of = jax.jit(jax.vmap(part_of_adjacency))


def truth_of(scene, num_slots):
    """The adjacency of the part-of edges of a host graph, with padding."""
    first, second = undirected_edges(scene, PART_OF).T
    truth = np.zeros((num_slots, num_slots), bool)
    truth[first, second] = truth[second, first] = True
    return truth


TRUTH = truth_of(SCENE, CAPACITY.nodes)


def drawing(number, coins, layers=(), any_cuts=0.0):
    """Returns a program that draws cuts, each with as many blocks that may come next."""

    @jax.jit
    def draw(graph, keys):
        def one(key):
            key_cut, key_blocks = jax.random.split(key)
            cut = draw_cut(graph, key_cut, coins, "H", layers, any_cuts)
            return cut, draw_continuations(graph, cut, key_blocks, number, layers)

        return jax.vmap(one)(keys)

    return lambda graph, keys: jax.tree.map(np.asarray, draw(graph, keys))


draw_by_coins = drawing(3, COINS)


def keys_of(seed, number=NUM_CUTS):
    return jax.random.split(jax.random.key(seed), number)


@pytest.fixture(scope="module")
def drawn():
    return draw_by_coins(on_device(SCENE), keys_of(0))


@pytest.fixture(scope="module")
def cuts(drawn):
    return drawn[0]


@pytest.fixture(scope="module")
def some_cuts(cuts):
    """Enough of the cuts for every kind of them."""
    return first_of(cuts, 100)


@pytest.fixture(scope="module")
def any_cuts():
    """Cuts of any kind, and blocks that may come next."""
    return drawing(6, (1,), any_cuts=1.0)(on_device(SCENE), keys_of(3, 2000))


def first_of(tree, number):
    return [jax.tree.map(lambda leaf, i=index: leaf[i], tree) for index in range(number)]


def each_block(blocks):
    return first_of(blocks, len(blocks.mask))


def find(position):
    """The slot of the node of the scene at this place."""
    offset = np.abs(SCENE.nodes.position - position).max(axis=-1)
    return int(np.argmin(offset))


def test_planes__survive_untouched_with_all_their_proximity_edges(cuts, some_cuts):
    whole, nodes = on_device(SCENE).nodes, cuts.survivors.nodes
    assert nodes.mask[:, :NUM_PLANES].all()
    for name in ("label", "position", "normal", "width", "observed"):
        found, given = getattr(nodes, name), getattr(whole, name)
        np.testing.assert_array_equal(found, np.broadcast_to(given, found.shape))
    for cut in some_cuts:
        np.testing.assert_array_equal(undirected_edges(cut.survivors, PROXIMITY), NEAR)
        assert not (cut.block.label[cut.block.mask] == PLANE).any()


def test_survivors__keep_exactly_the_edges_among_them(cuts):
    mask, survivors = cuts.survivors.nodes.mask, cuts.survivors
    np.testing.assert_array_equal(
        adjacency_of(survivors), TRUTH[None] & mask[:, :, None] & mask[:, None]
    )
    np.testing.assert_array_equal(survivors.n_node[:, 0], mask.sum(axis=1))
    np.testing.assert_array_equal(survivors.n_edge[:, 0], survivors.edges.mask.sum(axis=1))


def test_blocks__have_the_labels_places_and_edges_of_the_nodes_they_hold(some_cuts):
    capacity = max(COINS)
    for cut in some_cuts:
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


def test_layers__come_one_after_the_other(some_cuts):
    for cut in some_cuts:
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


def test_survivors_and_block__make_the_graph_of_the_next_step(some_cuts):
    """What is missing after the block is what the survivors and the block do not hold."""
    for cut in some_cuts:
        slots = [find(position) for position in cut.block.position[cut.block.mask]]
        after = cut.survivors.nodes.mask.copy()
        after[slots] = True
        rebuilt = TRUTH & cut.survivors.nodes.mask[:, None] & cut.survivors.nodes.mask[None]
        for row, slot in enumerate(slots):
            rebuilt[slot] |= cut.block.edges[row, max(COINS) :]
            rebuilt[slot, slots] |= cut.block.edges[row, : len(slots)]
        np.testing.assert_array_equal(rebuilt | rebuilt.T, TRUTH & after[:, None] & after[None])


def test_cut__does_not_depend_on_what_is_in_the_padding(cuts):
    spoilt, _ = draw_by_coins(with_garbage(on_device(SCENE), 0), keys_of(0))
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
    cut, _ = draw_by_coins(planes, keys_of(1))
    assert cut.complete.all()
    assert not cut.has_block.any()
    assert not cut.inserted.any()
    assert not cut.insert_probs.any()


def test_continuations__are_drawn_as_the_blocks_of_cuts_with_the_same_survivors():
    """One node at a time: each missing node of the next layer is as likely as another."""
    seen = set()
    for cut, blocks in first_of(drawing(64, (1,))(on_device(SCENE), keys_of(0, 20)), 20):
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


def test_continuations__are_blocks_as_large_as_that_of_the_cut(drawn):
    for cut, blocks in first_of(drawn, 20):
        np.testing.assert_array_equal(blocks.mask, np.broadcast_to(cut.block.mask, (3, 2)))
        inner = blocks.edges[:, :, :2]
        np.testing.assert_array_equal(inner, np.swapaxes(inner, 1, 2))
        for block in each_block(blocks):
            slots = [find(position) for position in block.position[block.mask]]
            assert len(set(slots)) == len(slots)


def test_extracted_blocks__hold_the_nodes_of_their_ranks_and_what_comes_before():
    rank = np.r_[[-1] * NUM_PLANES, 3, 2, 1, 0, [16] * 4]  # the floor first, the wall last
    extract = jax.jit(extract_block, static_argnames="capacity")
    block = extract(on_device(SCENE), rank, 1, 2, capacity=3)
    block = jax.tree.map(np.asarray, block)
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
    truth = truth_of(scene, 24)
    near = undirected_edges(scene, PROXIMITY)
    layers = ("floor", "room", "wall", "flat")
    drawn = drawing(8, COINS, layers)(graph, keys_of(0, 12))
    place = np.array([layers.index(name) if name in layers else -1 for name in scene.globals.names])
    seen = set()
    for cut, blocks in first_of(drawn, 12):
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


def test_cuts_of_any_kind__lack_any_nodes_and_ask_for_the_first_of_them(any_cuts):
    """Every set of the grown nodes occurs; the block comes from the lowest layer that lacks any."""
    cuts, (label, grown) = any_cuts[0], (SCENE.nodes.label, ~SCENE.nodes.observed)
    here = cuts.survivors.nodes.mask[:, : len(label)]
    assert here[:, ~grown].all()
    assert len(np.unique(here, axis=0)) == 2 ** grown.sum()
    np.testing.assert_array_equal(cuts.complete, here.all(axis=1))
    np.testing.assert_array_equal(cuts.has_block, ~cuts.complete)
    np.testing.assert_array_equal(cuts.inserted, here[:, grown].any(axis=1))
    for cut in first_of(cuts, 300):
        missing = np.flatnonzero(~cut.survivors.nodes.mask[: len(label)])
        if len(missing):
            node = find(cut.block.position[0])
            assert node in missing
            assert label[node] == label[missing].min()
            np.testing.assert_array_equal(
                cut.block.edges[0, 1:], TRUTH[node] & cut.survivors.nodes.mask
            )


def test_cuts_of_any_kind__are_the_share_of_them_that_is_asked_for(any_cuts):
    """The others lack the last nodes of the order alone: nothing stands on what is missing."""

    def share_out_of_order(here):  # a wall or a room is missing below a higher node
        here, label = here[:, : len(SCENE.nodes.label)], SCENE.nodes.label
        highest = np.where(here, label, -1).max(axis=1)
        return np.mean(highest > np.where(here, 99, label).min(axis=1))

    graph, always = on_device(SCENE), any_cuts[0].survivors.nodes.mask
    draw = jax.jit(jax.vmap(lambda key: draw_cut(graph, key, (1,), any_cuts=0.3)))
    sometimes = np.asarray(draw(keys_of(4, 2000)).survivors.nodes.mask)
    assert abs(share_out_of_order(sometimes) - 0.3 * share_out_of_order(always)) < 0.03


@pytest.mark.parametrize("any_cuts", [0.0, 0.4])
def test_cuts_of_the_upper_layers__remove_something_of_those_and_nothing_below(any_cuts):
    graph, label = on_device(SCENE), SCENE.nodes.label
    draw = jax.jit(
        jax.vmap(lambda key: draw_cut(graph, key, (1,), any_cuts=any_cuts, upper="room"))
    )
    cuts = jax.tree.map(np.asarray, draw(keys_of(5, 2000)))
    here = cuts.survivors.nodes.mask[:, : len(label)]
    assert here[:, label < ROOM].all()
    assert not cuts.survivors.nodes.mask[:, len(label) :].any()
    missing = (~here).sum(axis=1)
    np.testing.assert_array_equal(cuts.has_block, missing > 0)  # any cut may remove nothing
    if not any_cuts:
        num_upper = (label >= ROOM).sum()
        shares = np.bincount(missing, minlength=num_upper + 1) / len(missing)
        np.testing.assert_allclose(shares, [0] + [1 / num_upper] * num_upper, atol=0.04)
    lowest = np.where(here, 99, label).min(axis=1)
    np.testing.assert_array_equal(cuts.block.label[cuts.has_block, 0], lowest[cuts.has_block])


def test_the_upper_layers__are_those_of_the_order_and_a_graph_may_lack_them():
    def draw(scene, upper, layers):
        graph = on_device(scene)
        return jax.jit(jax.vmap(lambda key: draw_cut(graph, key, (1,), "H", layers, upper=upper)))(
            keys_of(6, 50)
        )

    top_down = ("floor", "room", "wall", "building", "city")
    cuts = draw(SCENE, "wall", top_down)
    here = np.asarray(cuts.survivors.nodes.mask)[:, : len(SCENE.nodes.label)]
    assert here[:, SCENE.nodes.label >= ROOM].all()
    assert not here[:, SCENE.nodes.label == WALL].all(axis=1).any()
    rooms = make_graph([PLANE] * 2 + [ROOM] * 2, np.arange(12.0).reshape(4, 3))
    without = draw(rooms, "floor", ())
    assert not np.asarray(without.has_block).any()
    assert np.asarray(without.complete).all()


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


def test_continuations__of_any_cut_come_next_and_know_all_that_is_there(any_cuts):
    label, grown = SCENE.nodes.label, ~SCENE.nodes.observed
    for cut, blocks in first_of(any_cuts, 100):
        here = cut.survivors.nodes.mask
        missing = np.flatnonzero(grown & ~here[: len(label)])
        for block in each_block(blocks):
            assert block.mask.any() == bool(len(missing))
            if len(missing):
                node = find(block.position[0])
                assert label[node] == label[missing].min()
                np.testing.assert_array_equal(block.edges[0, 1:], TRUTH[node] & here)
