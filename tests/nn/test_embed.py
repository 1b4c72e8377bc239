import itertools

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.nn import embed
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PART_OF
from sg3d_jax.scene.padding import Capacity
from tests.two_rooms import moved, on_device, two_rooms, with_garbage

NUM_CONCEPTS = PAPER_ONTOLOGY.num_concepts
SCENE = two_rooms()
EVERYWHERE = np.eye(NUM_CONCEPTS)[SCENE.nodes.label]


relative_geometry = jax.jit(embed.relative_geometry)
common_neighbours = jax.jit(embed.common_neighbours)
sinusoids = jax.jit(embed.sinusoids)


@jax.jit
def describe(graph):
    """Everything that the networks are told of a graph, and of points beside its nodes."""
    surface = embed.surface_of(graph.nodes)
    points = surface.position[:12] + 0.3 * surface.normal[:12]
    return (
        embed.node_features(graph),
        embed.edge_features(graph),
        embed.graph_features(graph),
        embed.relative_to_points(points, surface)[:, :12],
    )


def part_of_neighbours(graph):
    pairs = np.stack([graph.senders, graph.receivers], axis=-1)
    pairs = pairs[np.asarray(graph.edges.relation) == PART_OF]
    return [set(pairs[pairs[:, 0] == node, 1]) for node in range(len(graph.nodes.label))]


def count_concepts(nodes):
    return EVERYWHERE[sorted(nodes)].sum(axis=0) if nodes else np.zeros(NUM_CONCEPTS)


@given(
    angle=st.floats(-4, 4),
    offset=st.tuples(*[st.floats(-20, 20)] * 3),
    flip=st.booleans(),
)
@settings(deadline=None, max_examples=15)
def test_features__do_not_change_when_the_building_is_turned_mirrored_or_shifted(
    angle, offset, flip
):
    still = describe(on_device(SCENE))
    shaken = describe(on_device(moved(SCENE, angle, offset, flip)))
    for before, after in zip(still, shaken, strict=True):
        np.testing.assert_allclose(before, after, atol=3e-4)


def test_features__change_when_the_building_is_laid_on_its_side():
    fallen = SCENE.nodes._replace(
        position=SCENE.nodes.position[:, [0, 2, 1]], normal=SCENE.nodes.normal[:, [0, 2, 1]]
    )
    upright, fallen = describe(on_device(SCENE)), describe(on_device(SCENE._replace(nodes=fallen)))
    for place in (1, 3):  # edges, points
        assert np.abs(np.asarray(upright[place]) - np.asarray(fallen[place])).max() > 0.1


def test_features__do_not_see_padding():
    graph = on_device(SCENE)
    clean, dirty = (
        jax.tree.map(np.asarray, describe(each)) for each in (graph, with_garbage(graph, 0))
    )
    for before, after in zip(clean[:3], dirty[:3], strict=True):
        np.testing.assert_array_equal(before, after)
    assert not clean[0][12:].any()
    assert not clean[1][len(SCENE.senders) :].any()


def test_node_features__count_the_neighbours_of_each_concept():
    features = np.asarray(describe(on_device(SCENE))[0])[:12]
    expected = np.stack([count_concepts(nodes) for nodes in part_of_neighbours(SCENE)])
    np.testing.assert_array_equal(features[:, :NUM_CONCEPTS], EVERYWHERE)
    counts = features[:, -2 * NUM_CONCEPTS :]
    np.testing.assert_array_equal(counts[:, :NUM_CONCEPTS], np.minimum(expected, 3))
    np.testing.assert_allclose(counts[:, NUM_CONCEPTS:], expected / 10)


def test_edge_features__count_the_common_neighbours_of_each_concept():
    features = np.asarray(describe(on_device(SCENE))[1])[: len(SCENE.senders)]
    neighbours = part_of_neighbours(SCENE)
    ends = zip(SCENE.senders, SCENE.receivers, strict=True)
    common = [count_concepts(neighbours[a] & neighbours[b]) for a, b in ends]
    np.testing.assert_array_equal(features[:, -NUM_CONCEPTS:], np.minimum(common, 2))
    np.testing.assert_array_equal(features[:, PART_OF], SCENE.edges.relation == PART_OF)


def test_graph_features__count_nodes_and_those_without_edges():
    lonely = SCENE.edges._replace(mask=(SCENE.senders != 8) & (SCENE.receivers != 8))
    features = np.asarray(describe(on_device(SCENE._replace(edges=lonely)))[2])
    expected = np.concatenate([EVERYWHERE.sum(axis=0), EVERYWHERE[8]])
    np.testing.assert_array_equal(features[: 2 * NUM_CONCEPTS], np.minimum(expected, 3))
    np.testing.assert_allclose(features[2 * NUM_CONCEPTS :], expected / 10)


def surface(position, normal=(0, 0, 0), width=0.0):
    return embed.Surface(*(np.asarray(field, np.float32) for field in (position, normal, width)))


def metres(description, num_lengths):
    return 5 * np.asarray(description)[:num_lengths]


def test_relative_geometry__of_a_corner():
    """Seen from a plane of 4 m that looks along x, one of 2 m that looks along y, 1.5 m higher."""
    receiver = surface((0, 0, 0), (1, 0, 0), 4.0)
    sender = surface((1, 2, 1.5), (0, -1, 0), 2.0)
    description = np.asarray(relative_geometry(receiver, sender))
    expected = [5**0.5, 1.5, 1, 2, 0, 2, 1, 0, 0, 0, 2, 6]
    np.testing.assert_allclose(metres(description, 12), expected, atol=1e-6)
    np.testing.assert_allclose(description[-1], 0)


def test_relative_geometry__of_facing_planes_swaps_with_its_ends():
    one, other = surface((0, 0, 1), (1, 0, 0), 3.0), surface((4, 0.5, 2), (-1, 0, 0), 5.0)
    there, back = (np.asarray(relative_geometry(*ends)) for ends in ((one, other), (other, one)))
    np.testing.assert_allclose(metres(there, 8), [16.25**0.5, 1, 4, 0.5, -1, 4, 0.5, -2], atol=1e-6)
    np.testing.assert_allclose(metres(back, 8), [16.25**0.5, -1, 4, 0.5, -2, 4, 0.5, -1], atol=1e-6)
    np.testing.assert_allclose(there[-1], -1)


def test_relative_to_points__is_seen_from_the_surfaces():
    points = np.array([[1, 3, 2], [0, 0, 0]], np.float32)
    plane = surface([(0, 0, 0)], [(1, 0, 0)], [4.0])
    seen = np.asarray(jax.jit(embed.relative_to_points)(points, plane))
    np.testing.assert_allclose(metres(seen[0, 0], 5), [10**0.5, 2, 1, 3, 1], atol=1e-5)
    np.testing.assert_allclose(metres(seen[1, 0], 5), [0, 0, 0, 0, -2], atol=1e-5)


def test_multiscale__resolves_centimetres_and_buildings():
    shown = np.asarray(jax.jit(embed.multiscale)(np.array([0.01, 100], np.float32)))
    expected = [0.002, 20, np.tanh(0.1), 1, np.tanh(0.01), 1]
    np.testing.assert_allclose(shown, expected, rtol=1e-5)


def test_safe_norm__has_a_finite_gradient_at_zero():
    norm = jax.jit(jax.value_and_grad(lambda vector: embed.safe_norm(vector)))
    np.testing.assert_array_equal(norm(np.zeros(3, np.float32))[1], np.zeros(3))
    np.testing.assert_allclose(norm(np.array([3, 0, 4], np.float32))[0], 5, rtol=1e-6)


@pytest.mark.parametrize("time", [0.0, 1.0, 499.0])
def test_sinusoids__have_frequencies_from_one_to_a_thousandth(time):
    frequency = [1000 ** (-place / 8) for place in range(8)]
    expected = [f(time * rate) for f, rate in itertools.product((np.sin, np.cos), frequency)]
    np.testing.assert_allclose(sinusoids(np.float32(time)), expected, atol=1e-4)


@pytest.mark.parametrize(("num_nodes", "slots"), [(31, 36), (32, 36), (33, 36), (70, 73)])
def test_common_neighbours__are_those_of_a_loop_over_pairs(num_nodes, slots):
    """A word, in which neighbours are bits, has 32."""
    rng = np.random.default_rng(num_nodes)
    label = rng.integers(0, NUM_CONCEPTS, num_nodes)
    pairs = rng.integers(0, num_nodes, (4 * num_nodes, 2))
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]]), axis=0)
    nothing = np.zeros((num_nodes, 3))
    graph = make_graph(label, nothing, nothing, np.zeros(num_nodes), pairs)
    neighbours = part_of_neighbours(graph)
    padded = on_device(graph, Capacity(slots, 8 * slots))
    found = np.asarray(common_neighbours(padded))[: len(graph.senders)]
    for edge, (one, other) in enumerate(zip(graph.senders, graph.receivers, strict=True)):
        shared = sorted(neighbours[one] & neighbours[other])
        expected = np.bincount(label[shared], minlength=NUM_CONCEPTS)
        np.testing.assert_array_equal(found[edge], expected)
    assert found.sum() > num_nodes
