import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.edge_attention import (
    NO_ROOM,
    EdgeAttentionClassifier,
    EdgeAwareAttention,
    EdgeBranchGAT,
    GraphAttention,
    Links,
    RoomReadout,
    reverse_of,
    room_means,
    segment_softmax,
    with_loops,
)
from tests.nn.gradients import with_gradient
from tests.two_rooms import random_params, rotation

NUM_NODES = 5
PAIRS = np.array([(0, 1), (0, 2), (1, 2), (2, 3)])  # node 4 is alone
SENDERS, RECEIVERS = np.concatenate([PAIRS, PAIRS[:, ::-1]]).T
NODES, EDGES = (np.random.default_rng(i).normal(size=(n, 3)) for i, n in ((0, 5), (1, 8)))
SQUARE = EdgeBranchGAT(2, 4, (6,))
L = EdgeAttentionClassifier(2, 4, 5, (6,), 3, 0.5)

run = jax.jit(apply, static_argnums=0)
softmax = jax.jit(segment_softmax, static_argnums=2)
add_loops = jax.jit(with_loops, static_argnums=1)


@functools.cache
def with_gradient_of(network):
    return with_gradient(functools.partial(apply, network))


def padded(num_nodes: int, num_edges: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, Links]:
    """Returns the graph with nonsense in its padding."""
    rng = np.random.default_rng(seed)
    nodes, edges = rng.normal(0, 9, (num_nodes, 3)), rng.normal(0, 9, (num_edges, 3))
    ends = rng.integers(num_nodes, size=(2, num_edges))
    nodes[:NUM_NODES], edges[: len(EDGES)] = NODES, EDGES
    ends[:, : len(EDGES)] = SENDERS, RECEIVERS
    links = Links(*ends, np.arange(num_edges) < len(EDGES))
    return nodes.astype("f"), edges.astype("f"), links


GRAPH = padded(NUM_NODES, len(EDGES))
WIDER = padded(9, 30)


@functools.cache
def params_of(network):
    return random_params(network.init, *GRAPH)


def leaky(value: np.ndarray, slope: float) -> np.ndarray:
    return np.where(value > 0, value, slope * value)


def test_segment_softmax__shares_one_among_the_real_edges_of_each_node():
    _, _, links = padded(7, 20)
    loops = add_loops(links, 7)
    scores = np.random.default_rng(2).normal(0, 40, (27, 2)).astype("f")
    weights = np.asarray(softmax(scores, loops, 7))
    assert not weights[~np.asarray(loops.mask)].any()
    total = np.zeros((7, 2))
    np.add.at(total, loops.receivers, weights)
    np.testing.assert_allclose(total, 1, atol=1e-6)


def test_segment_softmax__of_a_node_without_edges_is_finite_and_so_is_its_gradient():
    nothing = Links(np.zeros(3, int), np.zeros(3, int), np.zeros(3, bool))
    gradient = jax.jit(jax.grad(lambda scores, links: jnp.sum(softmax(scores, links, 2) ** 2)))
    np.testing.assert_array_equal(gradient(np.ones((3, 1), "f"), nothing), 0)


def test_reverse_of__finds_the_opposite_direction():
    reverse = np.asarray(jax.jit(reverse_of, static_argnums=1)(WIDER[2], 9))[: len(EDGES)]
    np.testing.assert_array_equal(reverse, [4, 5, 6, 7, 0, 1, 2, 3])


def test_graph_attention__is_a_loop_over_nodes_and_heads():
    layer, (nodes, _, links) = GraphAttention(2, 4), GRAPH
    loops = add_loops(links, NUM_NODES)
    params = random_params(layer.init, nodes, loops)
    weights = jax.tree.map(np.asarray, params["params"])
    states = (NODES @ weights["Dense_0"]["kernel"]).reshape(NUM_NODES, 2, 4)
    expected = np.zeros((NUM_NODES, 2, 4))
    for node in range(NUM_NODES):
        around = [*SENDERS[node == RECEIVERS], node]
        for head in range(2):
            own = weights["receiver"][head] @ states[node, head]
            scores = [own + weights["sender"][head] @ states[other, head] for other in around]
            share = np.exp(leaky(np.array(scores), 0.2))
            expected[node, head] = share / share.sum() @ states[around, head]
    found = run(layer, params, nodes, loops)
    np.testing.assert_allclose(found, expected.reshape(5, 8) + weights["bias"], atol=1e-5)


def test_edge_aware_attention__is_a_loop_over_nodes_and_heads():
    layer, (nodes, edges, links) = EdgeAwareAttention(2, 4, 6, 0.5), GRAPH
    params = random_params(layer.init, nodes, edges, links, None)
    weights = jax.tree.map(np.asarray, params["params"])
    kernel = {name: weights[name]["kernel"] for name in ("nodes", "edges", "message", "update")}
    states = (NODES @ kernel["nodes"]).reshape(NUM_NODES, 2, 4)
    along = (EDGES @ kernel["edges"]).reshape(-1, 2, 6)
    expected = np.zeros((NUM_NODES, 4))
    for node in range(NUM_NODES):
        incoming = np.flatnonzero(node == RECEIVERS)
        for head in range(2):
            sent = [np.r_[states[SENDERS[e], head], along[e, head]] for e in incoming]
            sent = np.array([*sent, np.r_[states[node, head], np.zeros(6)]])
            scores = [weights["score"][:, 0] @ np.r_[states[node, head], one] for one in sent]
            share = np.exp(leaky(np.array(scores), 0.01))
            expected[node] += share / share.sum() @ sent @ kernel["message"] / 2
    ends = np.concatenate([expected[SENDERS], expected[RECEIVERS], along.mean(axis=1)], axis=1)
    new_nodes, new_edges = run(layer, params, nodes, edges, links, None)
    np.testing.assert_allclose(new_nodes, expected, atol=1e-5)
    np.testing.assert_allclose(new_edges, np.maximum(ends @ kernel["update"], 0), atol=1e-5)


@pytest.mark.parametrize("network", [SQUARE, L])
def test_logits__do_not_depend_on_padding(network):
    expected = run(network, params_of(network), *GRAPH)
    found, _ = with_gradient_of(network)(params_of(network), *WIDER)
    np.testing.assert_allclose(np.asarray(found)[: len(EDGES)], expected, atol=1e-5)


@pytest.mark.parametrize("network", [SQUARE, L])
def test_logits__do_not_see_the_numbering_of_nodes_and_edges(network):
    nodes, edges, links = GRAPH
    rng = np.random.default_rng(3)
    order, place = rng.permutation(NUM_NODES), rng.permutation(len(EDGES))
    slot = np.argsort(order)
    renumbered = Links(slot[links.senders][place], slot[links.receivers][place], links.mask)
    found = run(network, params_of(network), nodes[order], edges[place], renumbered)
    expected = np.asarray(run(network, params_of(network), *GRAPH))
    np.testing.assert_allclose(found, expected[place], atol=1e-5)


def test_logits_of_ec_l__are_the_same_in_both_directions():
    logits = np.asarray(run(L, params_of(L), *GRAPH))
    np.testing.assert_array_equal(logits[:4], logits[4:])
    assert np.abs(np.diff(logits, axis=0)).max() > 1e-3


def test_dropout__is_on_with_a_key_and_off_without():
    keys = [jax.random.key(seed) for seed in (0, 0, 1)]
    one, same, other = (np.asarray(run(L, params_of(L), *GRAPH, key)) for key in keys)
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 1e-3
    assert np.abs(run(L, params_of(L), *GRAPH) - one).max() > 1e-3


@pytest.mark.parametrize("network", [SQUARE, L])
def test_gradient__is_finite_on_a_graph_of_padding_only(network):
    empty = jax.tree.map(np.zeros_like, WIDER)
    _, gradient = with_gradient_of(network)(params_of(network), *empty)
    chex.assert_tree_all_finite(gradient)


ROOM = np.array([0, 0, 0, 0, 2, 2, 2, NO_ROOM])
READOUT = RoomReadout(8)


def planes(seed: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 7, 8)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return rng.normal(0, 2, (8, 2)), normal, rng.uniform(1, 3, 8)


def offsets_with_gradient(params, position, normal, width, room=ROOM):
    inputs = (field.astype("f") for field in (position, normal, width))
    found, gradient = with_gradient_of(READOUT)(params, *inputs, room)
    return np.asarray(found), gradient


def offsets(*inputs):
    return offsets_with_gradient(*inputs)[0]


@pytest.fixture(scope="module")
def readout_params():
    return random_params(READOUT.init, *(field.astype("f") for field in planes()), ROOM)


def test_offset_of_a_room__turns_and_mirrors_with_it_and_does_not_see_where_it_is(readout_params):
    position, normal, width = planes()
    expected = offsets(readout_params, position, normal, width)
    assert (np.abs(expected[[0, 2]]).max(axis=1) > 1e-2).all()
    matrix = rotation(0.8)[:2, :2] @ np.diag([1, -1])
    moved = position @ matrix.T + np.array([[7.0, -3.0]])
    found = offsets(readout_params, moved, normal @ matrix.T, width)
    np.testing.assert_allclose(found, expected @ matrix.T, atol=1e-4)


def test_offset_of_a_room__is_of_its_own_planes_in_any_order(readout_params):
    position, normal, width = planes()
    expected = offsets(readout_params, position, normal, width)
    order = np.random.default_rng(5).permutation(8)
    inputs = position[order], normal[order], width[order], ROOM[order]
    np.testing.assert_allclose(offsets(readout_params, *inputs), expected, atol=1e-5)
    position[ROOM != 2] += 1.5
    normal[ROOM != 2] *= -1
    found = offsets(readout_params, position, normal, width)
    np.testing.assert_allclose(found[2], expected[2], atol=1e-5)
    assert np.abs(found[0] - expected[0]).max() > 1e-3


def test_rooms_without_planes__have_no_offset_and_a_finite_gradient(readout_params):
    position, normal, width = planes()
    expected = offsets(readout_params, position, normal, width)
    np.testing.assert_array_equal(np.delete(expected, [0, 2], axis=0), 0)
    nobody = np.full(8, NO_ROOM)
    _, gradient = offsets_with_gradient(readout_params, position, normal, width, nobody)
    chex.assert_tree_all_finite(gradient)


def test_room_means__are_of_the_planes_of_each_room():
    position = planes()[0]
    means = np.asarray(jax.jit(room_means)(position, ROOM))
    np.testing.assert_allclose(means[0], position[:4].mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(means[2], position[4:7].mean(axis=0), atol=1e-6)
    np.testing.assert_array_equal(means[1], 0)
