"""Where grown nodes stand: what the loss counts, and the module in a model that grows."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import optax
import pytest

from sg3d_jax.flagg.placement import Placement, placement_loss
from sg3d_jax.flagg.step import CorruptionConfig, Flagg, FlaggConfig, make_flagg
from sg3d_jax.scene.ontology import WALL
from tests.growing_rooms import AddRooms, Counting, Even, stop_at
from tests.two_rooms import NUM_PLANES, observed, on_device, random_params, two_rooms

QUIET = CorruptionConfig(0.0, 0.0, 0.0, 0.0)
CONFIG = FlaggConfig(coins=(1,), placement=(8, 3, 2), corruption=QUIET)
MODULES = Even(1, 1, 1), AddRooms(), Counting(1, 1)
MODEL = Flagg(CONFIG, *MODULES, placement=Placement(8, 3, 2))
SCENE = two_rooms()
GRAPH = on_device(SCENE)
OFF = np.array([[0, 0, 0], [3, 4, 0], [0, 0, 1], [0, 2, 0]], float)  # of wall, rooms, floor
loss_and_gradient = jax.jit(jax.value_and_grad(placement_loss))


def off():
    return GRAPH.nodes.position.at[NUM_PLANES:12].add(OFF)


def test_the_loss_is_the_mean_distance_of_what_is_grown():
    loss, gradient = loss_and_gradient(off().at[0].add(7.0), GRAPH, GRAPH)
    npt.assert_allclose(loss, (0 + 5 + 1 + 2) / 4, rtol=1e-5)
    assert np.isfinite(gradient).all()
    assert np.flatnonzero(np.any(gradient, axis=1)).tolist() == [9, 10, 11]


def test_what_is_taken_for_another_concept_is_not_counted():
    label = GRAPH.nodes.label.at[9].set(WALL)
    seen = GRAPH._replace(nodes=GRAPH.nodes._replace(label=label))
    npt.assert_allclose(loss_and_gradient(off(), seen, GRAPH)[0], (0 + 1 + 2) / 3, rtol=1e-5)


def test_where_nothing_is_grown_the_loss_is_zero_and_its_gradient_is_finite():
    graph = observed(SCENE)
    loss, gradient = loss_and_gradient(graph.nodes.position + 1, graph, graph)
    assert (float(loss), np.any(gradient)) == (0.0, np.False_)
    chex.assert_tree_all_finite(gradient)


def test_a_model_has_the_placement_that_is_configured_or_none():
    assert make_flagg(CONFIG, AddRooms()).placement == Placement(8, 3, 2)
    assert make_flagg(FlaggConfig(), AddRooms()).placement is None


@pytest.mark.parametrize("sizes", [(8, 3), (8, 3, 0), (8, 3, 2, 1)])
def test_other_sizes_are_refused(sizes):
    with pytest.raises(ValueError, match=r"^flagg\.placement is .*, expected a width, channels"):
        FlaggConfig(placement=sizes)


def test_a_placement_learns_where_centroids_are():
    """Its loss is one of those of the model, and reaches nothing else."""
    placement = random_params(MODEL.placement.init, GRAPH)
    params, key = stop_at(99)._replace(placement=placement), jax.random.key(0)
    optimiser = optax.adam(0.01)

    @jax.jit
    def learnt(params):
        def step(state, _):
            params, of_optimiser = state
            loss = lambda own: MODEL.placement_loss(params._replace(placement=own), key, GRAPH)
            (value, _), gradient = jax.value_and_grad(loss, has_aux=True)(params.placement)
            updates, of_optimiser = optimiser.update(gradient, of_optimiser)
            new = optax.apply_updates(params.placement, updates)
            return (params._replace(placement=new), of_optimiser), value

        state = params, optimiser.init(params.placement)
        return jax.lax.scan(step, state, length=60)[1]

    losses = np.asarray(learnt(params))
    assert losses[-10:].mean() < 0.3 * losses[0]
    total, terms = jax.jit(MODEL.loss)(params, key, GRAPH)
    npt.assert_allclose(terms["placement"], losses[0], rtol=1e-5)
    rest, others = jax.jit(Flagg(CONFIG, *MODULES).loss)(params, key, GRAPH)
    npt.assert_allclose(total, rest + terms["placement"], rtol=1e-5)
    assert terms.keys() - others.keys() == {"placement"}


def test_parameters_are_drawn_for_it():
    params = jax.eval_shape(make_flagg(CONFIG, AddRooms()).init, jax.random.key(0), GRAPH)
    alone = jax.eval_shape(MODEL.placement.init, jax.random.key(0), GRAPH)
    chex.assert_trees_all_equal_shapes_and_dtypes(params.placement, alone)
    assert jnp.result_type(*jax.tree.leaves(params.placement)) == jnp.float32
