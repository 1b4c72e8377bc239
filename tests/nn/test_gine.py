import chex
import jax
import numpy as np
import pytest

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.gine import GINE, GraphHead
from sg3d_jax.scene.padding import Capacity
from tests.nn.gradients import with_gradient
from tests.two_rooms import (
    TWICE,
    moved,
    on_device,
    random_params,
    reordered,
    two_rooms,
    with_garbage,
)

SCENE = two_rooms()
ORDER = np.random.default_rng(0).permutation(12)
ENCODER, HEAD = GINE(8, 2), GraphHead(8, 1, 3)


@jax.jit
def run(params, graph):
    """Node states and graph logits."""
    return apply(ENCODER, params[0], graph).nodes, apply(HEAD, params[1], graph)


run_with_gradient = with_gradient(run)


@pytest.fixture(scope="module")
def params():
    graph = on_device(SCENE)
    return random_params(ENCODER.init, graph), random_params(HEAD.init, graph)


@pytest.fixture(scope="module")
def expected(params):
    return jax.tree.map(np.asarray, run(params, on_device(SCENE)))


def test_nodes_and_logits__do_not_depend_on_the_amount_of_padding(params, expected):
    (nodes, logits), _ = run_with_gradient(params, on_device(SCENE, TWICE))
    nodes = np.asarray(nodes)
    np.testing.assert_allclose(nodes[:16], expected[0], atol=1e-5)
    np.testing.assert_allclose(logits, expected[1], atol=1e-5)
    assert not nodes[12:].any()


def test_nodes_and_logits__do_not_depend_on_what_is_in_the_padding(params, expected):
    spoilt = run(params, with_garbage(on_device(SCENE), 1))
    chex.assert_trees_all_close(spoilt, expected, atol=1e-5)


def test_nodes_follow_the_numbering__and_logits_do_not_see_it(params, expected):
    nodes, logits = run(params, on_device(reordered(SCENE, ORDER)))
    np.testing.assert_allclose(np.asarray(nodes)[:12], expected[0][ORDER], atol=1e-5)
    np.testing.assert_allclose(logits, expected[1], atol=1e-5)


def test_nodes_and_logits__do_not_see_where_the_building_stands(params, expected):
    shaken = run(params, on_device(moved(SCENE, 0.7, (3, -8, 2), flip=True)))
    chex.assert_trees_all_close(shaken, expected, atol=1e-3)


def test_messages__travel_along_both_kinds_of_edges(params, expected):
    for relation in (0, 1):
        kept = np.asarray(SCENE.edges.relation) != relation
        cut = SCENE._replace(
            edges=SCENE.edges._replace(relation=SCENE.edges.relation[kept], mask=kept[kept]),
            senders=SCENE.senders[kept],
            receivers=SCENE.receivers[kept],
        )
        assert np.abs(np.asarray(run(params, on_device(cut))[0]) - expected[0]).max() > 1e-2


def test_gradient__is_finite_on_a_graph_of_padding_only(params):
    _, gradient = run_with_gradient(params, jax.tree.map(np.zeros_like, on_device(SCENE, TWICE)))
    chex.assert_tree_all_finite(gradient)


def test_a_graph_without_any_padding__is_encoded_as_with_it(params, expected):
    nodes, logits = run(params, on_device(SCENE, Capacity(12, len(SCENE.senders))))
    np.testing.assert_allclose(nodes, expected[0][:12], atol=1e-5)
    np.testing.assert_allclose(logits, expected[1], atol=1e-5)
