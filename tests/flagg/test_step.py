import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.fill.fd4 import FD4Config, make_fd4
from sg3d_jax.fill.protocol import Fill, Statistics
from sg3d_jax.flagg import step
from sg3d_jax.flagg.halt import halt_loss
from sg3d_jax.flagg.insert import insert_loss
from sg3d_jax.flagg.grow import RUNNING, grow_from_planes
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.graph import observed_of
from tests.two_rooms import NUM_PLANES, on_device, random_params, two_rooms

SCENE = two_rooms()
STATISTICS = Statistics(
    label=jnp.asarray([0, 0.4, 0.4, 0.2, 0, 0]),
    block_edge=jnp.asarray([0.7, 0.3]),
    cross_edge=jnp.asarray([0.6, 0.4]),
    distance_mean=jnp.float32(2),
    distance_std=jnp.float32(0.5),
    position_std=jnp.float32(1),
)
QUIET = step.CorruptionConfig(0.0, 0.0, 0.0, 0.0, max_added=1)


def constant_fill() -> Fill:
    """A Fill whose loss is its parameter."""
    return Fill(
        init=lambda key, graph, block: jnp.float32(3),
        loss=lambda params, key, graph, block: (2 * params, {"constant": params}),
        sample=lambda params, key, graph, mask: None,
    )


@pytest.fixture(scope="module")
def simple():
    config = step.FlaggConfig(coins=(1, 2), width=4, depth=1, corruption=QUIET)
    model = step.make_flagg(config, constant_fill())
    params = random_params(functools.partial(step.init, model, graph=on_device(SCENE)))
    return model, params._replace(fill=jnp.float32(3))


def test_loss__is_the_sum_of_the_three_modules_on_one_cut(simple):
    model, params = simple
    graph = on_device(SCENE)

    @jax.jit
    def both(key, again):
        total, terms = step.loss(model, params, key, graph)
        cut = step.cut_graph(model.config, jax.random.split(again, 4)[0], graph)
        logits = model.insert.logits(params.insert, cut.survivors)
        logit = model.halt.logit(params.halt, cut.survivors)
        halt = halt_loss(logit, cut.complete, cut.inserted)
        return total, terms, insert_loss(logits, cut.insert_probs), halt

    for seed in range(6):
        total, terms, insert, halt = both(jax.random.key(seed), jax.random.key(seed))
        assert set(terms) == {"constant", "insert", "halt"}
        np.testing.assert_allclose(terms["insert"], insert, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(terms["halt"], halt, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(total, 6 + insert + halt, rtol=1e-5)


def test_loss__has_a_finite_gradient_that_reaches_every_module(simple):
    model, params = simple
    graphs, keys = on_device(SCENE), jax.random.split(jax.random.key(1), 8)

    @jax.jit
    def gradient(params):
        def mean(params):
            losses = jax.vmap(lambda key: step.loss(model, params, key, graphs)[0])(keys)
            return jnp.mean(losses)

        return jax.grad(mean)(params)

    found = gradient(params)
    chex.assert_tree_all_finite(found)
    for module in found:
        assert any(np.any(leaf) for leaf in jax.tree.leaves(module))


def telling_fill() -> Fill:
    """A Fill whose loss is the label of its block, and which tells a number of its key."""

    def loss(params, key, graph, block):
        label = block.label[0].astype(jnp.float32)
        return label, {"label": label, "noise": jax.random.uniform(key)}

    return Fill(lambda key, graph, block: jnp.float32(1), loss, lambda *_: None)


def test_loss__is_a_mean_over_what_may_come_next():
    """Walls come first and rooms after them; a wall and two rooms cannot share a state."""
    config = step.FlaggConfig(coins=(1,), width=4, depth=1, corruption=QUIET, continuations=16)
    model = step.make_flagg(config, telling_fill())
    graph = on_device(SCENE)
    params = step.init(model, jax.random.key(0), graph)

    @jax.jit
    def both(key, again):
        cut = step.cut_graph(config, jax.random.split(again, 4)[0], graph)
        return step.loss(model, params, key, graph)[1], cut

    for seed in range(8):
        terms, cut = both(jax.random.key(seed), jax.random.key(seed))
        np.testing.assert_allclose(terms["label"], cut.block.label[0])
        assert 0.2 < terms["noise"] < 0.8  # of sixteen keys


@pytest.mark.parametrize(("continuations", "ordering"), [(0, "H"), (2, "HP")])
def test_continuations__are_refused_where_there_are_none(continuations, ordering):
    with pytest.raises(ValueError, match=f"flagg.continuations is {continuations}, expected 1"):
        step.FlaggConfig(continuations=continuations, ordering=ordering)


def test_growing__with_an_untrained_model_leaves_the_planes_bit_for_bit():
    sizes = {"encoder_width": 8, "gates": 2, "node_width": 8, "pair_width": 8, "distance_width": 8}
    layers = {"encoder_layers": 1, "layers": 1, "heads": 2, "distance_layers": 1}
    diffusion = {"diffusion_steps": 3, "topology_steps": 2, "distance_steps": 2}
    fill = make_fd4(FD4Config(**sizes, **layers, **diffusion), STATISTICS)
    model = step.make_flagg(step.FlaggConfig(coins=(1, 2), width=4, depth=1), fill)
    planes = on_device(observed_of(SCENE))

    init = functools.partial(step.init, model, graph=on_device(SCENE))
    grow = jax.jit(functools.partial(grow_from_planes, model, max_steps=3))

    for seed in range(4):
        grown = grow(random_params(init, seed=seed), jax.random.key(seed), planes)
        assert grown.halt_reason != RUNNING
        count = int(grown.graph.n_node[0])
        assert NUM_PLANES < count <= NUM_PLANES + 6
        chex.assert_tree_all_finite(grown)
        for found, given in zip(grown.graph.nodes, planes.nodes, strict=True):
            np.testing.assert_array_equal(found[:NUM_PLANES], given[:NUM_PLANES])
        assert (grown.graph.nodes.label[NUM_PLANES:count] != PLANE).all()
        np.testing.assert_array_equal(grown.graph.nodes.mask, np.arange(16) < count)
