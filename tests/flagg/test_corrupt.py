import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.flagg.corrupt import CorruptionConfig, corrupt
from sg3d_jax.scene.ontology import NUM_CONCEPTS, PART_OF, PLANE, PROXIMITY
from sg3d_jax.scene.graph import undirected_edges
from sg3d_jax.scene.padding import part_of_adjacency
from tests.two_rooms import CAPACITY, NUM_PLANES, PART_OF_PAIRS, on_device, two_rooms, with_garbage

SCENE = two_rooms()
STRONG = CorruptionConfig(p_node=0.3, p_drop=0.2, p_add=0.05, sigma_position=0.1, max_added=6)
NOTHING = CorruptionConfig(0.0, 0.0, 0.0, 0.0, max_added=3)
FULL = CorruptionConfig(0.0, 0.0, p_add=1.0, sigma_position=0.0, max_added=4)
DRAWS = 2000


@jax.jit
def strongly(keys):
    return jax.vmap(lambda key: corrupt(on_device(SCENE), key, STRONG))(keys)


@pytest.fixture(scope="module")
def corrupted():
    return jax.tree.map(np.asarray, strongly(jax.random.split(jax.random.key(0), DRAWS)))


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
    assert mask.shape[1] == CAPACITY.edges + 2 * STRONG.max_added
    np.testing.assert_array_equal(corrupted.n_edge[:, 0], mask.sum(axis=1))
    np.testing.assert_array_equal(corrupted.n_edge.sum(axis=1), np.full(DRAWS, mask.shape[1]))
    twice = mask & (corrupted.edges.relation == PART_OF)
    np.testing.assert_array_equal(twice.sum(axis=1), adjacency.sum(axis=(1, 2)))
    assert not adjacency[:, 12:].any()


def test_no_more_edges_are_added_than_there_is_room_for():
    full = jax.jit(lambda graph, key: corrupt(graph, key, FULL))(
        on_device(SCENE), jax.random.key(1)
    )
    assert len(undirected_edges(full, PART_OF)) == len(PART_OF_PAIRS) + FULL.max_added


@pytest.mark.parametrize("spoil", [False, True], ids=["clean", "garbage in the padding"])
def test_nothing__changes_nothing(spoil):
    graph = on_device(SCENE)
    given = with_garbage(graph, 2) if spoil else graph
    found = jax.jit(lambda graph, key: corrupt(graph, key, NOTHING))(given, jax.random.key(2))
    jax.tree.map(np.testing.assert_array_equal, found.nodes, given.nodes)
    for relation in (PART_OF, PROXIMITY):
        np.testing.assert_array_equal(
            undirected_edges(found, relation), undirected_edges(graph, relation)
        )
    assert not found.edges.mask[CAPACITY.edges :].any()
    assert jnp.array_equal(found.n_node, graph.n_node)
