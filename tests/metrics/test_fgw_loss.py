import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from sg3d_jax.metrics.fgw import fgw
from sg3d_jax.metrics.fgw_loss import fgw_loss
from sg3d_jax.scene.graph import SceneGraph, ontology_of
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.padding import pad, stack
from tests import own_world
from tests.metrics.fgw_reference import (
    CAPACITY,
    on_device,
    perturb,
    random_pairs,
    reference_costs,
    reference_fgw,
)

GENERATED, TRUTH = random_pairs()
NUM_PAIRS = len(TRUTH)
OPTIMISER = optax.adam(0.03)

gradients = jax.jit(jax.value_and_grad(fgw_loss, argnums=(0, 1)), static_argnames="loss")


def hardened(graph: SceneGraph) -> np.ndarray:
    """Label distributions that are sure of the labels of a graph."""
    return np.eye(ontology_of(graph).num_concepts, dtype=np.float32)[np.asarray(graph.nodes.label)]


def softened(graph: SceneGraph, seed: int) -> np.ndarray:
    """Label distributions that lean to the labels of a graph, each in its own way."""
    hard = hardened(graph)
    doubt = np.random.default_rng(seed).dirichlet(np.ones(hard.shape[1]), len(hard))
    return 0.7 * hard + 0.3 * doubt.astype(np.float32)


@given(st.integers(0, NUM_PAIRS - 1), st.sampled_from(["absolute", "squared"]), st.integers(0, 99))
@settings(deadline=None, max_examples=8)
def test_gradients__are_those_of_finite_differences(index, loss, seed):
    with jax.enable_x64(True):
        generated, truth = (pad(side[index], CAPACITY) for side in (GENERATED, TRUTH))
        rng = np.random.default_rng(seed)
        at = generated.nodes.position, softened(generated, seed).astype(np.float64)
        ways = [rng.normal(size=value.shape) for value in at]
        ways = [way / np.linalg.norm(way) for way in ways]

        def evaluated(*at):
            return jax.tree.map(np.asarray, gradients(*at, generated, truth, loss=loss))

        _, found = evaluated(*at)
        for slot, way in enumerate(ways):
            step = [1e-6 * way * (index == slot) for index, way in enumerate(ways)]
            ahead, _ = evaluated(*(x + dx for x, dx in zip(at, step, strict=True)))
            behind, _ = evaluated(*(x - dx for x, dx in zip(at, step, strict=True)))
            expected = (ahead - behind) / 2e-6
            np.testing.assert_allclose(np.sum(found[slot] * way), expected, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("index", range(NUM_PAIRS))
def test_loss__of_hard_labels_is_fgw(index):
    generated, truth = on_device(GENERATED[index]), on_device(TRUTH[index])
    value, _ = gradients(generated.nodes.position, hardened(generated), generated, truth)
    np.testing.assert_allclose(value, fgw(generated, truth).value, atol=3e-6)


@pytest.mark.parametrize("index", range(NUM_PAIRS))
def test_gradients__are_finite_and_zero_at_padding(index):
    generated, truth = on_device(GENERATED[index]), on_device(TRUTH[index])
    at = generated.nodes.position, softened(generated, index)
    mask = np.asarray(generated.nodes.mask)
    of_position, of_label = map(np.asarray, gradients(*at, generated, truth)[1])
    for gradient in (of_position, of_label):
        assert np.isfinite(gradient).all()
        assert not gradient[~mask].any()
    assert of_label[mask].any(axis=1).all()


def test_gradients__at_identical_graphs_vanish():
    truth = on_device(TRUTH[3])
    value, found = gradients(truth.nodes.position, hardened(truth), truth, truth)
    assert value < 3e-6
    for gradient in found:
        np.testing.assert_allclose(gradient, 0, atol=1e-6)


def mean_loss(parameters, generated, truth):
    label = jax.nn.softmax(parameters["logits"])
    return jnp.mean(jax.vmap(fgw_loss)(parameters["position"], label, generated, truth))


@jax.jit
def train_step(parameters, state, *sides):
    """Returns new parameters and state, the loss, and its gradient."""
    value, gradient = jax.value_and_grad(mean_loss)(parameters, *sides)
    updates, state = OPTIMISER.update(gradient, state)
    return optax.apply_updates(parameters, updates), state, value, gradient


@pytest.fixture(scope="module")
def at_start():
    """Returns parameters that lean to the generated graphs, the optimiser's state, both sides."""
    sides = stack(GENERATED, CAPACITY), stack(TRUTH, CAPACITY)
    logits = jnp.asarray(3 * hardened(sides[0]))
    parameters = {"position": sides[0].nodes.position, "logits": logits}
    return parameters, OPTIMISER.init(parameters), *sides


def test_gradients__in_a_vmap_are_those_of_every_pair_alone(at_start):
    parameters, batched = jax.tree.map(np.asarray, (at_start[0], train_step(*at_start)[-1]))
    label = special.softmax(parameters["logits"], axis=-1)
    for index in range(NUM_PAIRS):
        pair = (on_device(side[index]) for side in (GENERATED, TRUTH))
        at = parameters["position"][index], label[index]
        _, (of_position, of_label) = jax.tree.map(np.asarray, gradients(*at, *pair))
        of_logits = at[1] * (of_label - np.sum(at[1] * of_label, axis=1, keepdims=True))
        found = {name: NUM_PAIRS * gradient[index] for name, gradient in batched.items()}
        # At its own place a plane has no direction to go: its gradient is a rounding error.
        moves = np.asarray(at_start[2].nodes.label)[index] != PLANE
        np.testing.assert_allclose(found["position"][moves], of_position[moves], atol=1e-6)
        np.testing.assert_allclose(found["logits"], of_logits, atol=1e-6)


def test_loss_and_gradients__of_a_made_up_ontology_are_right():
    world = own_world.own_world()
    pair = perturb(np.random.default_rng(0), world, 1, 0.1), world
    generated, truth = (on_device(graph) for graph in pair)
    value, _ = gradients(generated.nodes.position, hardened(generated), generated, truth)
    expected, _, _ = reference_fgw(*reference_costs(*pair), 0.5)
    np.testing.assert_allclose(value, expected, atol=3e-6)
    at = generated.nodes.position, softened(generated, 0)
    _, found = jax.tree.map(np.asarray, gradients(*at, generated, truth))
    assert found[1].shape == (CAPACITY.nodes, own_world.ONTOLOGY.num_concepts)
    for gradient in found:
        assert np.isfinite(gradient).all()
        assert gradient.any()


def test_a_training_step_on_the_loss_lowers_it_without_compiling_again(at_start):
    parameters, state, *sides = at_start
    values = []
    for _ in range(15):
        parameters, state, value, _ = train_step(parameters, state, *sides)
        values.append(float(value))
    assert values[-1] < 0.9 * values[0]
    assert train_step._cache_size() == 1
