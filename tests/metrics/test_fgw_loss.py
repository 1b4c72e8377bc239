import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.metrics.fgw import fgw
from sg3d_jax.metrics.fgw_loss import fgw_loss
from sg3d_jax.metrics.fgw_problem import one_hot
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.padding import stack
from tests import own_world
from tests.metrics.fgw_reference import CAPACITY, on_device, perturb, random_pairs

GENERATED, TRUTH = random_pairs()
NUM_PAIRS = len(TRUTH)

gradients = jax.jit(jax.value_and_grad(fgw_loss, argnums=(0, 1)))


def softened(graph: SceneGraph, seed: int) -> jax.Array:
    """Label distributions that lean to the labels of a graph, each in its own way."""
    doubt = np.random.default_rng(seed).dirichlet(np.ones(6), len(graph.nodes.label))
    return 0.7 * one_hot(graph) + 0.3 * jnp.asarray(doubt, graph.nodes.position.dtype)


@given(st.integers(0, NUM_PAIRS - 1), st.sampled_from(["absolute", "squared"]), st.integers(0, 99))
@settings(deadline=None, max_examples=8)
def test_gradients__are_those_of_finite_differences(index, loss, seed):
    with jax.enable_x64(True):
        generated, truth = (
            jax.tree.map(
                lambda leaf: leaf.astype(jnp.float64) if leaf.dtype == jnp.float32 else leaf,
                on_device(side[index]),
            )
            for side in (GENERATED, TRUTH)
        )
        rng = np.random.default_rng(seed)
        at = generated.nodes.position, softened(generated, seed)
        ways = [jnp.asarray(rng.normal(size=value.shape)) for value in at]
        ways = [way / jnp.linalg.norm(way) for way in ways]

        def value(*at):
            return fgw_loss(*at, generated, truth, loss=loss)

        found = jax.grad(value, argnums=(0, 1))(*at)
        for slot, way in enumerate(ways):
            step = [1e-6 * way * (index == slot) for index, way in enumerate(ways)]
            ahead = value(*(x + dx for x, dx in zip(at, step, strict=True)))
            behind = value(*(x - dx for x, dx in zip(at, step, strict=True)))
            expected = (ahead - behind) / 2e-6
            np.testing.assert_allclose(jnp.sum(found[slot] * way), expected, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("index", range(NUM_PAIRS))
def test_loss__of_hard_labels_is_fgw(index):
    generated, truth = on_device(GENERATED[index]), on_device(TRUTH[index])
    value, _ = gradients(generated.nodes.position, one_hot(generated), generated, truth)
    np.testing.assert_allclose(value, fgw(generated, truth).value, atol=3e-6)


@pytest.mark.parametrize("index", range(NUM_PAIRS))
def test_gradients__are_finite_and_zero_at_padding(index):
    generated, truth = on_device(GENERATED[index]), on_device(TRUTH[index])
    at = generated.nodes.position, softened(generated, index)
    of_position, of_label = gradients(*at, generated, truth)[1]
    for gradient in (of_position, of_label):
        assert jnp.isfinite(gradient).all()
        assert not gradient[~generated.nodes.mask].any()
    assert of_label[generated.nodes.mask].any(axis=1).all()


def test_gradients__at_identical_graphs_vanish():
    truth = on_device(TRUTH[3])
    value, found = gradients(truth.nodes.position, one_hot(truth), truth, truth)
    assert value < 3e-6
    for gradient in found:
        np.testing.assert_allclose(gradient, 0, atol=1e-6)


def test_gradients__in_a_vmap_are_those_of_every_pair_alone():
    sides = stack(GENERATED, CAPACITY), stack(TRUTH, CAPACITY)
    at = sides[0].nodes.position, jax.vmap(one_hot)(sides[0])
    batched = jax.jit(jax.vmap(jax.grad(fgw_loss, argnums=(0, 1))))(*at, *sides)
    for index in range(NUM_PAIRS):
        pair = (on_device(side[index]) for side in (GENERATED, TRUTH))
        _, alone = gradients(at[0][index], at[1][index], *pair)
        # At its own place a plane has no direction to go: its gradient is a rounding error.
        moves = sides[0].nodes.label[index] != PLANE
        np.testing.assert_allclose(batched[0][index][moves], alone[0][moves], atol=1e-6)
        np.testing.assert_allclose(batched[1][index], alone[1], atol=1e-6)


def test_loss_and_gradients__of_a_made_up_ontology_are_right():
    truth = own_world.own_world()
    made = perturb(np.random.default_rng(0), truth, 1, 0.1)
    generated, truth = (on_device(graph) for graph in (made, truth))
    value, _ = gradients(generated.nodes.position, one_hot(generated), generated, truth)
    np.testing.assert_allclose(value, fgw(generated, truth).value, atol=3e-6)
    at = generated.nodes.position, softened(generated, 0)
    _, found = gradients(*at, generated, truth)
    assert found[1].shape == (CAPACITY.nodes, own_world.ONTOLOGY.num_concepts)
    for gradient in found:
        assert jnp.isfinite(gradient).all()
        assert gradient.any()


def test_a_training_step_on_the_loss_lowers_it_without_compiling_again():
    generated, truth = stack(GENERATED, CAPACITY), stack(TRUTH, CAPACITY)
    optimiser = optax.adam(0.03)

    def mean_loss(parameters):
        label = jax.nn.softmax(parameters["logits"])
        return jnp.mean(jax.vmap(fgw_loss)(parameters["position"], label, generated, truth))

    @jax.jit
    def train_step(parameters, state):
        value, gradient = jax.value_and_grad(mean_loss)(parameters)
        updates, state = optimiser.update(gradient, state)
        return optax.apply_updates(parameters, updates), state, value

    parameters = {
        "position": generated.nodes.position,
        "logits": 3 * jax.vmap(one_hot)(generated),
    }
    state, values = optimiser.init(parameters), []
    for _ in range(15):
        parameters, state, value = train_step(parameters, state)
        values.append(float(value))
    assert values[-1] < 0.9 * values[0]
    assert train_step._cache_size() == 1
