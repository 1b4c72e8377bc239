from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.embed import surface_of
from sg3d_jax.nn.graph_transformer import (
    FEW_NODES,
    Conditioning,
    DistanceNetwork,
    Gates,
    OldGraphEncoder,
    RectangleTransformer,
    block_symmetric,
    linked_centre,
    propagate,
)
from sg3d_jax.nn.kin import connect_kin
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, ROOM, WALL
from sg3d_jax.scene.padding import Capacity
from tests.nn.gradients import with_gradient
from tests.two_rooms import (
    CAPACITY,
    NO_GATES,
    TWICE,
    moved,
    on_device,
    random_params,
    reordered,
    two_rooms,
    with_garbage,
)

SCENE = two_rooms()
NUM_BLOCK, NUM_OLD = 4, 12
NUM_CONCEPTS = PAPER_ONTOLOGY.num_concepts
ENCODER = OldGraphEncoder(8, 1, 3)
TOPOLOGY = RectangleTransformer(8, 8, 1, 2, 3, NUM_CONCEPTS)
LENGTHS = DistanceNetwork(8, 1, NUM_CONCEPTS)
MANY_NODES = Capacity(FEW_NODES + 8, 128)


class Inputs(NamedTuple):
    """What is known and noisy of a block."""

    mask: np.ndarray
    label: np.ndarray
    edges: np.ndarray
    distance: np.ndarray


def draw_inputs(num_new: int = 3) -> Inputs:
    """A noisy block beside the twelve old nodes, without edges at padding."""
    rng = np.random.default_rng(2)
    mask = np.arange(NUM_BLOCK) < num_new
    square = np.tril(rng.random((NUM_BLOCK, NUM_BLOCK)) < 0.5, -1)
    across = rng.random((NUM_BLOCK, CAPACITY.nodes)) < 0.3
    real = np.concatenate([mask, np.arange(CAPACITY.nodes) < NUM_OLD])
    edges = np.concatenate([square | square.T, across], axis=1) & mask[:, None] & real[None]
    distance = rng.normal(size=edges.shape).astype(np.float32)
    distance[:, :NUM_BLOCK] += distance[:, :NUM_BLOCK].T
    return Inputs(mask, np.where(mask, [ROOM, WALL, FLOOR, ROOM], 0), edges, distance)


@jax.jit
def run(params, graph, inputs):
    """Logits of labels and of edges, and standardised distances."""
    mask, label, edges, distance = jax.tree.map(jnp.asarray, inputs)
    conditioning = apply(ENCODER, params["encoder"], graph)
    time = jnp.float32(7)
    logits = apply(TOPOLOGY, params["topology"], conditioning, mask, label, edges + 0, time)
    return *logits, apply(LENGTHS, params["distance"], conditioning, label, edges, distance, time)


run_with_gradient = with_gradient(run)


@jax.jit
def encodings(params, graph):
    """What an encoder makes of a graph: as it is, for many rows, and by edges between kin."""
    ways = {
        "plain": (ENCODER, graph),
        "many rows": (OldGraphEncoder(8, 1, 3, many_rows=True), graph),
        "kin": (OldGraphEncoder(8, 1, 3, kin=2), graph),
        "connected": (ENCODER, connect_kin(graph, 2)),
    }
    return {way: apply(encoder, params, seen) for way, (encoder, seen) in ways.items()}


@pytest.fixture(scope="module")
def params():
    graph, inputs = on_device(SCENE), jax.tree.map(jnp.asarray, draw_inputs())

    def init(key):
        keys = jax.random.split(key, 3)
        encoder, time = ENCODER.init(keys[0], graph), jnp.float32(0)
        conditioning = apply(ENCODER, encoder, graph)
        mask, label, edges, distance = inputs
        return {
            "encoder": encoder,
            "topology": TOPOLOGY.init(keys[1], conditioning, mask, label, edges + 0, time),
            "distance": LENGTHS.init(keys[2], conditioning, label, edges, distance, time),
        }

    return random_params(init)


@pytest.fixture(scope="module")
def expected(params):
    return run(params, on_device(SCENE), draw_inputs())


def widened(inputs):
    """The same block beside more slots for old nodes."""
    more = ((0, 0), (0, TWICE.nodes - CAPACITY.nodes))
    return inputs._replace(edges=np.pad(inputs.edges, more), distance=np.pad(inputs.distance, more))


def real_part(outputs, rows=3):
    """Drops what is said of padding, and distances where there is no edge."""
    label, edges, distance = (np.asarray(output)[:rows] for output in outputs)
    width = NUM_BLOCK + NUM_OLD
    linked = draw_inputs().edges[:rows, :width]
    return label, edges[:, :width], np.where(linked, distance[:, :width], 0)


def assert_same(found, expected, atol=2e-5):
    for one, other in zip(real_part(found), real_part(expected), strict=True):
        np.testing.assert_allclose(one, other, atol=atol)


def test_outputs__do_not_depend_on_the_amount_of_padding(params, expected):
    found, _ = run_with_gradient(params, on_device(SCENE, TWICE), widened(draw_inputs()))
    assert_same(found, expected)


def test_outputs__do_not_depend_on_what_is_in_the_padding_of_the_old_graph(params, expected):
    assert_same(run(params, with_garbage(on_device(SCENE), 3), draw_inputs()), expected)


def test_distances__do_not_depend_on_noise_where_there_is_no_edge(params, expected):
    inputs = draw_inputs()
    noisier = inputs._replace(distance=np.where(inputs.edges, inputs.distance, 9).astype("f"))
    assert_same(run(params, on_device(SCENE), noisier), expected)


def test_outputs__do_not_see_where_the_building_stands(params, expected):
    shaken = on_device(moved(SCENE, -1.1, (4, 9, -3), flip=True))
    assert_same(run(params, shaken, draw_inputs()), expected, atol=1e-3)


def test_outputs__follow_the_numbering_of_the_old_graph(params, expected):
    inputs, order = draw_inputs(), np.random.default_rng(4).permutation(NUM_OLD)
    columns = np.arange(NUM_BLOCK + CAPACITY.nodes)
    columns[NUM_BLOCK : NUM_BLOCK + NUM_OLD] = NUM_BLOCK + order
    shuffled = inputs._replace(edges=inputs.edges[:, columns], distance=inputs.distance[:, columns])
    found = run(params, on_device(reordered(SCENE, order)), shuffled)
    label, edges, distance = (np.asarray(output) for output in found)
    back = np.argsort(columns)
    assert_same((label, edges[:, back], distance[:, back]), expected)


def test_outputs__follow_the_numbering_of_the_block(params, expected):
    inputs, order = draw_inputs(), np.array([2, 0, 1, 3])
    columns = np.concatenate([order, NUM_BLOCK + np.arange(CAPACITY.nodes)])
    shuffled = Inputs(
        inputs.mask[order],
        inputs.label[order],
        inputs.edges[order][:, columns],
        inputs.distance[order][:, columns],
    )
    label, edges, distance = map(np.asarray, run(params, on_device(SCENE), shuffled))
    rows, back = np.argsort(order), np.argsort(columns)
    found = label[rows], edges[rows][:, back], distance[rows][:, back]
    assert_same(found, expected)


def test_edges_inside_the_block__are_symmetric(expected):
    for output in expected[1:]:
        square = np.asarray(output)[:, :NUM_BLOCK]
        np.testing.assert_array_equal(square, np.swapaxes(square, 0, 1))


def test_outputs__see_the_noisy_edges_and_the_old_graph(params, expected):
    inputs = draw_inputs()
    edges = inputs.edges.copy()
    edges[0, NUM_BLOCK] ^= True
    changed = run(params, on_device(SCENE), inputs._replace(edges=edges))
    farther = on_device(SCENE._replace(nodes=SCENE.nodes._replace(width=SCENE.nodes.width * 2)))
    for other in (changed, run(params, farther, inputs)):
        for one, two in zip(real_part(other), real_part(expected), strict=True):
            assert np.abs(one - two).max() > 1e-4


@pytest.mark.parametrize(("num_new", "alone"), [(1, True), (2, False)])
def test_rivals__are_the_other_new_nodes_alone(params, num_new, alone):
    """What a node claims itself, and what padding claims, does not come back to it as a rival."""
    inputs, graph = draw_inputs(num_new), on_device(SCENE)
    kernel = params["topology"]["params"]["layers"]["context"]["kernel"]
    louder = np.array(kernel)
    louder[:, -TOPOLOGY.gates :] *= 3  # behind what is spread along the graph
    changed = jax.tree.map(lambda leaf: louder if leaf is kernel else leaf, params)
    found, expected = (np.asarray(run(of, graph, inputs)[1])[:num_new] for of in (changed, params))
    real = np.r_[:num_new, NUM_BLOCK : NUM_BLOCK + NUM_OLD]
    assert np.allclose(found[:, real], expected[:, real], atol=1e-6) == alone


def test_gradient__is_finite_where_everything_is_padding(params):
    graph = jax.tree.map(np.zeros_like, on_device(SCENE, TWICE))
    nothing = jax.tree.map(np.zeros_like, widened(draw_inputs()))
    _, gradient = run_with_gradient(params, graph, nothing)
    chex.assert_tree_all_finite(gradient)


def test_linked_centre__is_the_mean_of_the_linked_or_of_all_old_nodes():
    @jax.jit
    def centre_in(nodes, linked):
        old = Conditioning(jnp.zeros(0), NO_GATES, surface_of(nodes), nodes.mask)
        return linked_centre(linked, old)

    linked = np.zeros((3, CAPACITY.nodes), np.float32)
    linked[0, [1, 4]] = 1
    linked[1, [2, 15]] = 1  # 15 is padding
    centre, count = map(np.asarray, centre_in(with_garbage(on_device(SCENE), 5).nodes, linked))
    position = SCENE.nodes.position
    expected = [position[[1, 4]].mean(axis=0), position[2], position.mean(axis=0)]
    np.testing.assert_allclose(centre, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(count[:, 0], [2, 1, 0])


def test_block_symmetric__averages_pairs_inside_the_block_only():
    pairs = np.random.default_rng(1).normal(size=(3, 8, 2)).astype("f")
    found = np.asarray(jax.jit(block_symmetric)(pairs))
    np.testing.assert_allclose(found[0, 2], (pairs[0, 2] + pairs[2, 0]) / 2)
    np.testing.assert_array_equal(found[:, 3:], pairs[:, 3:])


@jax.jit
def propagate_all(all_gates, rows):
    return [propagate(gates, rows) for gates in all_gates]


def test_rows__travel_along_the_gated_edges_alike_by_scatter_and_by_product():
    """A loop over the edges of a multigraph says what both should give."""
    rng = np.random.default_rng(0)
    num_edges, num_gates = 40, 3
    senders, receivers = rng.integers(0, NUM_OLD, (2, num_edges))
    values = rng.normal(size=(num_edges, num_gates)).astype(np.float32)
    rows = rng.normal(size=(2, NUM_OLD, num_gates)).astype(np.float32)
    expected, dense = np.zeros_like(rows), np.zeros((num_gates, NUM_OLD, NUM_OLD), np.float32)
    for sender, receiver, value in zip(senders, receivers, values, strict=True):
        expected[:, receiver] += value * rows[:, sender]
        dense[:, receiver, sender] += value
    gates = [Gates(values, senders, receivers, matrix) for matrix in (None, dense)]
    for found in propagate_all(gates, rows):
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_the_encoder__has_the_same_gates_as_a_list_of_edges_and_as_a_matrix(params):
    small = encodings(params["encoder"], on_device(SCENE))["plain"].gates
    made = encodings(params["encoder"], on_device(SCENE, MANY_NODES))
    gates = [made["plain"].gates, made["many rows"].gates, small]
    assert [one.dense is None for one in gates] == [True, False, False]
    rows = np.random.default_rng(0).normal(size=(2, MANY_NODES.nodes, 3)).astype("f")
    rows[:, CAPACITY.nodes :] = 0
    expected, found = propagate_all(gates[:2], rows)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    (found,) = propagate_all(gates[2:], rows[:, : CAPACITY.nodes])
    np.testing.assert_allclose(found, expected[:, : CAPACITY.nodes], atol=1e-5)


def test_the_encoder__sees_edges_between_kin_if_it_is_told_to(params):
    made = encodings(params["encoder"], on_device(SCENE))
    linked, expected = made["kin"], made["connected"]
    np.testing.assert_allclose(linked.nodes, expected.nodes, atol=1e-6)
    np.testing.assert_allclose(linked.gates.values, expected.gates.values, atol=1e-6)
    moved_on = np.abs(np.asarray(linked.nodes) - np.asarray(made["plain"].nodes)).max(axis=-1)
    assert set(np.flatnonzero(moved_on > 1e-6)) == set(np.flatnonzero(SCENE.nodes.label == ROOM))
