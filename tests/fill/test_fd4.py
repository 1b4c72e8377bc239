import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.fill.fd4 import FD4, FD4Config
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PLANE
from tests.opinions import OpinionatedFD4
from tests.two_rooms import (
    CAPACITY,
    NUM_PLANES,
    STATISTICS,
    all_at_once,
    moved,
    observed,
    random_params,
    rotation,
    two_rooms,
)

pytestmark = pytest.mark.slow

STEPS = 3


def make(steps, kind=FD4):
    sizes = {"encoder_width": 8, "gates": 2, "node_width": 8, "pair_width": 8, "distance_width": 8}
    layers = {"encoder_layers": 1, "layers": 1, "heads": 2, "distance_layers": 1}
    diffusion = {"diffusion_steps": STEPS, "topology_steps": steps, "distance_steps": steps}
    return kind(FD4Config(**sizes, **layers, **diffusion, noise_levels=4), STATISTICS)


FILL = make(STEPS)
loss_and_gradient = jax.jit(jax.value_and_grad(FILL.loss, has_aux=True))
compiled = jax.jit(FD4.sample, static_argnums=0)
whole_block = jax.jit(all_at_once)


def sample(fill, *inputs):
    return jax.tree.map(np.asarray, compiled(fill, *inputs))


@pytest.fixture(scope="module")
def params():
    return random_params(FILL.init, observed(two_rooms()), whole_block())


def test_every_parameter__is_trained(params):
    graph, block = observed(two_rooms()), whole_block()

    (_, terms), found = loss_and_gradient(params, jax.random.key(1), graph, block)
    chex.assert_tree_all_finite((found, terms))
    flat, _ = jax.tree_util.tree_flatten_with_path(found)
    idle = [jax.tree_util.keystr(path) for path, leaf in flat if not np.any(leaf)]
    assert idle == []


def test_loss__is_the_weighted_sum_of_its_terms(params):
    graph, block = observed(two_rooms()), whole_block()
    (total, terms), _ = loss_and_gradient(params, jax.random.key(2), graph, block)
    assert set(terms) == {"label", "edge", "distance"}
    expected = terms["label"] + 5 * terms["edge"] + terms["distance"]
    np.testing.assert_allclose(total, expected, rtol=1e-6)


def test_loss__of_an_empty_block_is_zero_and_teaches_nothing(params):
    empty = jax.tree.map(jnp.zeros_like, whole_block())
    inputs = jax.random.key(3), observed(two_rooms()), empty
    (total, _), gradient = loss_and_gradient(params, *inputs)
    assert total == 0
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(gradient))


@pytest.mark.parametrize("fill", [make(1, OpinionatedFD4), FILL], ids=["one step", "steps"])
def test_samples__fill_the_places_that_are_asked_for(params, fill):
    graph, mask = observed(two_rooms()), jnp.arange(4) < 3
    params = params if fill is FILL else random_params(fill.init, graph, whole_block())
    block = sample(fill, params, jax.random.key(4), graph, mask)
    chex.assert_tree_all_finite(block)
    np.testing.assert_array_equal(block.mask, mask)
    assert not (block.label[:3] == PLANE).any()
    assert (block.label < PAPER_ONTOLOGY.num_concepts).all()
    for field in (block.label, block.position, block.edges):
        assert not field[3].any()
    edges = block.edges
    np.testing.assert_array_equal(edges[:, :4], edges[:, :4].T)
    assert not edges[:, 4 + NUM_PLANES :].any()
    assert edges.shape == (4, 4 + CAPACITY.nodes)


@pytest.mark.parametrize(
    ("angle", "offset", "flip"), [(1.0, (0, 0, 0), False), (-2.5, (3, -6, 2), True)]
)
def test_samples__move_with_the_building(params, angle, offset, flip):
    # Some keys give lengths that hardly hold a node: float32 then moves it by millimetres.
    still, shaken = (
        sample(FILL, params, jax.random.key(6), observed(scene), jnp.ones(4, bool))
        for scene in (two_rooms(), moved(two_rooms(), angle, offset, flip))
    )
    np.testing.assert_array_equal(still.label, shaken.label)
    np.testing.assert_array_equal(still.edges, shaken.edges)
    matrix = rotation(angle) @ np.diag([1, -1 if flip else 1, 1])
    expected = still.position @ matrix.T + np.asarray(offset)
    np.testing.assert_allclose(shaken.position, expected, atol=1e-3)
