import functools

import jax
import numpy as np
import pytest
from scipy.stats import binom

from sg3d_jax.flagg.corrupt import CorruptionConfig, added_slots, corrupt
from sg3d_jax.scene.graph import make_graph, undirected_edges
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PART_OF, PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.padding import Capacity, part_of_adjacency
from tests import own_world
from tests.two_rooms import CAPACITY, NUM_PLANES, PART_OF_PAIRS, on_device, two_rooms, with_garbage

SCENE = two_rooms()
NUM_CONCEPTS = PAPER_ONTOLOGY.num_concepts
STRONG = CorruptionConfig(p_node=0.3, p_drop=0.2, p_add=0.05, sigma_position=0.1)
NOTHING = CorruptionConfig(0.0, 0.0, 0.0, 0.0)
FULL = CorruptionConfig(0.0, 0.0, p_add=1.0, sigma_position=0.0)
RELABELLED = CorruptionConfig(p_node=1.0, p_drop=0.0, p_add=0.0, sigma_position=0.0)
DRAWS = 2000


@functools.partial(jax.jit, static_argnames="config")
def corrupt_often(graph, keys, config):
    return jax.vmap(lambda key: corrupt(graph, key, config))(keys)


def corrupted_often(graph, seed, config, draws=DRAWS):
    keys = jax.random.split(jax.random.key(seed), draws)
    return jax.tree.map(np.asarray, corrupt_often(graph, keys, config))


corrupt_once = jax.jit(corrupt, static_argnames="config")


@pytest.fixture(scope="module")
def corrupted():
    return corrupted_often(on_device(SCENE), 0, STRONG)


@pytest.fixture(scope="module")
def adjacency(corrupted):
    return np.asarray(jax.jit(jax.vmap(part_of_adjacency))(corrupted))


def test_planes_and_edges_between_them__are_untouched(corrupted):
    for found, given in zip(corrupted.nodes, on_device(SCENE).nodes, strict=True):
        planes = np.asarray(given)[:NUM_PLANES]
        np.testing.assert_array_equal(
            found[:, :NUM_PLANES], np.broadcast_to(planes, (DRAWS, *planes.shape))
        )
    near = undirected_edges(SCENE, PROXIMITY)
    for index in range(50):
        one = jax.tree.map(lambda leaf, i=index: leaf[i], corrupted)
        np.testing.assert_array_equal(undirected_edges(one, PROXIMITY), near)


def test_planes__that_are_joined_directly_stay_joined_or_apart(adjacency):
    assert not adjacency[:, :NUM_PLANES, :NUM_PLANES].any()


def test_labels__become_any_other_high_level_concept(corrupted):
    for node in range(NUM_PLANES, 12):
        own, drawn = SCENE.nodes.label[node], corrupted.nodes.label[:, node]
        frequencies = np.bincount(drawn, minlength=NUM_CONCEPTS) / DRAWS
        expected = np.full(NUM_CONCEPTS, STRONG.p_node / (NUM_CONCEPTS - 2))
        expected[PLANE], expected[own] = 0, 1 - STRONG.p_node
        np.testing.assert_allclose(frequencies, expected, atol=0.04)


def test_positions__get_noise_of_the_given_strength(corrupted):
    noise = corrupted.nodes.position[:, NUM_PLANES:12] - SCENE.nodes.position[NUM_PLANES:]
    np.testing.assert_allclose(noise.std(), STRONG.sigma_position, rtol=0.03)
    np.testing.assert_allclose(noise.mean(), 0, atol=0.005)
    assert not corrupted.nodes.position[:, 12:].any()


def test_edges__are_dropped_with_their_chance(adjacency):
    kept = adjacency[:, *np.transpose(PART_OF_PAIRS)]
    np.testing.assert_allclose(1 - kept.mean(axis=0), np.full(12, STRONG.p_drop), atol=0.04)


def test_edges__are_added_with_their_chance_to_every_pair_with_a_high_level_end(adjacency):
    missing = np.tri(12, k=-1, dtype=bool)
    missing[:NUM_PLANES, :NUM_PLANES] = False
    missing[tuple(np.transpose(PART_OF_PAIRS)[::-1])] = False
    added = adjacency[:, :12, :12][:, missing].mean(axis=0)
    np.testing.assert_allclose(added, np.full(missing.sum(), STRONG.p_add), atol=0.025)


def test_edges__stay_symmetric_and_are_counted(corrupted, adjacency):
    np.testing.assert_array_equal(adjacency, np.swapaxes(adjacency, 1, 2))
    mask = corrupted.edges.mask
    assert mask.shape[1] == CAPACITY.edges + 2 * added_slots(CAPACITY.nodes, STRONG)
    np.testing.assert_array_equal(corrupted.n_edge[:, 0], mask.sum(axis=1))
    np.testing.assert_array_equal(corrupted.n_edge.sum(axis=1), np.full(DRAWS, mask.shape[1]))
    twice = mask & (corrupted.edges.relation == PART_OF)
    np.testing.assert_array_equal(twice.sum(axis=1), adjacency.sum(axis=(1, 2)))
    assert not adjacency[:, 12:].any()


def test_every_missing_edge__is_added_if_it_is_certain():
    full = corrupt_once(on_device(SCENE), jax.random.key(1), FULL)
    every_pair, between_planes = 12 * 11 // 2, NUM_PLANES * (NUM_PLANES - 1) // 2
    assert len(undirected_edges(full, PART_OF)) == every_pair - between_planes


@pytest.mark.parametrize("p_add", [0.0001, 0.0005, 0.01])
@pytest.mark.parametrize("num_nodes", [16, 48, 489, 2048])
def test_room_for_added_edges__lacks_in_less_than_one_graph_in_ten_million(num_nodes, p_add):
    num_pairs = num_nodes * (num_nodes - 1) // 2
    assert binom.sf(added_slots(num_nodes, CorruptionConfig(p_add=p_add)), num_pairs, p_add) < 1e-7
    assert added_slots(num_nodes, CorruptionConfig(p_add=0.0)) == 0


def test_edges_of_a_large_graph__are_added_all_over_it():
    """On 489 nodes 37 are due; once there were 8 at most, all at the first planes."""
    num_nodes, num_planes, draws = 489, 300, 30
    config = CorruptionConfig(p_node=0.0, p_drop=0.0, sigma_position=0.0)
    label = np.where(np.arange(num_nodes) < num_planes, PLANE, ROOM)
    graph = on_device(make_graph(label, np.zeros((num_nodes, 3))), Capacity(num_nodes, 4))
    found = corrupted_often(graph, 3, config, draws)
    mask, slots = found.edges.mask, added_slots(num_nodes, config)
    assert mask.shape[1] == 4 + 2 * slots
    missing = np.argwhere(np.triu(label[:, None] + label[None, :] > PLANE, 1))
    due = config.p_add * len(missing)
    assert due == pytest.approx(37, abs=1)
    added = mask.sum(axis=1) / 2
    np.testing.assert_allclose(added.mean(), due, atol=4 * np.sqrt(due / draws))
    np.testing.assert_allclose(added.std(), np.sqrt(due), rtol=0.5)
    ends = np.sort(np.stack([found.senders, found.receivers], axis=-1), axis=-1)[mask]
    error = 4 * missing.std(axis=0) / np.sqrt(len(ends) / 2)
    np.testing.assert_array_less(np.abs(ends.mean(axis=0) - missing.mean(axis=0)), error)


def test_labels__become_concepts_that_grow_in_any_ontology():
    scene, draws = own_world.own_world(), 600
    graph, num_nodes = on_device(scene, Capacity(24, 288)), len(scene.nodes.label)
    label = corrupted_often(graph, 4, RELABELLED, draws).nodes.label[:, :num_nodes]
    given = scene.nodes.observed
    np.testing.assert_array_equal(
        label[:, given], np.broadcast_to(scene.nodes.label[given], (draws, given.sum()))
    )
    grown = np.flatnonzero(~own_world.ONTOLOGY.is_observed)
    for node in np.flatnonzero(~given):
        others = grown[grown != scene.nodes.label[node]]
        counts = np.bincount(label[:, node], minlength=own_world.ONTOLOGY.num_concepts)
        assert counts.sum() == counts[others].sum()
        np.testing.assert_allclose(counts[others] / draws, 1 / len(others), atol=0.1)


@pytest.mark.parametrize("spoil", [False, True], ids=["clean", "garbage in the padding"])
def test_nothing__changes_nothing(spoil):
    graph = on_device(SCENE)
    given = with_garbage(graph, 2) if spoil else graph
    found = jax.tree.map(np.asarray, corrupt_once(given, jax.random.key(2), NOTHING))
    jax.tree.map(np.testing.assert_array_equal, found.nodes, given.nodes)
    for relation in (PART_OF, PROXIMITY):
        np.testing.assert_array_equal(
            undirected_edges(found, relation), undirected_edges(graph, relation)
        )
    assert not found.edges.mask[CAPACITY.edges :].any()
    np.testing.assert_array_equal(found.n_node, graph.n_node)


def test_edges__may_be_added_by_the_node_so_that_large_graphs_are_not_drowned():
    config = CorruptionConfig(0.0, 0.0, 0.0, added_per_node=0.15)
    found = corrupted_often(on_device(SCENE), 1, config)
    added = (found.n_edge[:, 0] - np.asarray(on_device(SCENE).n_edge)[0]) / 2
    np.testing.assert_allclose(added.mean(), 0.15 * 12, rtol=0.05)
    assert found.edges.mask.shape[1] == CAPACITY.edges + 2 * added_slots(CAPACITY.nodes, config)
