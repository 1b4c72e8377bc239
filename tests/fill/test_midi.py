import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.fill import midi
from sg3d_jax.fill.midi import Frame, MiDi, MiDiConfig, Schedules, State, make_schedules
from sg3d_jax.nn.embed import surface_of
from sg3d_jax.nn.graph_transformer import Conditioning
from sg3d_jax.nn.relaxed_egnn import RelaxedTransformer
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PLANE
from tests.two_rooms import (
    CAPACITY,
    NO_GATES,
    NUM_PLANES,
    STATISTICS,
    all_at_once,
    moved,
    observed,
    random_params,
    two_rooms,
)

pytestmark = pytest.mark.slow

STEPS = 3
NUM_CONCEPTS = PAPER_ONTOLOGY.num_concepts
SIZES = MiDiConfig(8, 1, 2, 8, 8, 1, 2, diffusion_steps=STEPS, noise_levels=4, sampling_steps=STEPS)
FILL = MiDi(SIZES, STATISTICS)
SCHEDULES = make_schedules(MiDiConfig())
loss_and_gradient = jax.jit(jax.value_and_grad(FILL.loss, has_aux=True))
sample = jax.jit(FILL.sample)


class Certain(RelaxedTransformer):
    """A network that knows the wall between both rooms, whatever it sees."""

    def __call__(self, conditioning, centre, block_mask, label, edges, position, time):
        block = wall()
        logits = 30.0 * jax.nn.one_hot(block.label, NUM_CONCEPTS)
        return logits, 30.0 * jax.nn.one_hot(block.edges + 0, 2), block.position


def wall():
    return jax.tree.map(
        lambda field: field[:1], all_at_once()._replace(edges=all_at_once().edges[:, 3:])
    )


@pytest.fixture(scope="module")
def params():
    return random_params(FILL.init, observed(two_rooms()), all_at_once())


def test_every_parameter__is_trained(params):
    graph, block = observed(two_rooms()), all_at_once()
    (_, terms), found = loss_and_gradient(params, jax.random.key(1), graph, block)
    chex.assert_tree_all_finite((found, terms))
    flat, _ = jax.tree_util.tree_flatten_with_path(found)
    assert [jax.tree_util.keystr(path) for path, leaf in flat if not np.any(leaf)] == []


def test_loss__is_the_weighted_sum_of_its_terms(params):
    graph, block = observed(two_rooms()), all_at_once()
    (total, terms), _ = loss_and_gradient(params, jax.random.key(2), graph, block)
    assert set(terms) == {"label", "edge", "position"}
    expected = terms["label"] + 5 * terms["edge"] + terms["position"]
    np.testing.assert_allclose(total, expected, rtol=1e-6)


def test_loss__of_an_empty_block_is_zero_and_teaches_nothing(params):
    empty = jax.tree.map(jnp.zeros_like, all_at_once())
    inputs = jax.random.key(3), observed(two_rooms()), empty
    (total, _), gradient = loss_and_gradient(params, *inputs)
    assert total == 0
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(gradient))


def test_loss__does_not_see_where_the_scene_stands(params):
    """The frame is that of the old graph, so a shift of everything is no change."""
    offset = np.array([20.0, -8.0, 3.0])
    block = all_at_once()
    far = block._replace(position=block.position + offset[None])
    here, _ = loss_and_gradient(params, jax.random.key(4), observed(two_rooms()), block)
    there, _ = loss_and_gradient(
        params, jax.random.key(4), observed(moved(two_rooms(), offset=offset)), far
    )
    for one, other in zip(jax.tree.leaves(here), jax.tree.leaves(there), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3)


@pytest.mark.parametrize("steps", [1, STEPS])
def test_samples__fill_the_places_that_are_asked_for(params, steps):
    graph, mask = observed(two_rooms()), jnp.arange(4) < 3
    fill = MiDi(dataclasses.replace(SIZES, sampling_steps=steps), STATISTICS)
    block = jax.jit(fill.sample)(params, jax.random.key(4), graph, mask)
    chex.assert_tree_all_finite(block)
    np.testing.assert_array_equal(block.mask, mask)
    assert not (block.label[:3] == PLANE).any()
    assert (block.label < NUM_CONCEPTS).all()
    for field in (block.label, block.position, block.edges):
        assert not field[3].any()
    edges = np.asarray(block.edges)
    np.testing.assert_array_equal(edges[:, :4], edges[:, :4].T)
    assert not edges[:, 4 + NUM_PLANES :].any()
    assert edges.shape == (4, 4 + CAPACITY.nodes)


def test_samples__shift_with_the_building(params):
    offset, mask = np.array([3.0, -6.0, 2.0]), jnp.ones(4, bool)
    still = sample(params, jax.random.key(5), observed(two_rooms()), mask)
    shaken = sample(params, jax.random.key(5), observed(moved(two_rooms(), offset=offset)), mask)
    np.testing.assert_array_equal(still.label, shaken.label)
    np.testing.assert_array_equal(still.edges, shaken.edges)
    np.testing.assert_allclose(shaken.position, still.position + offset[None], atol=1e-3)


def test_a_certain_network__gives_what_it_knows_in_metres(monkeypatch, params):
    """The chain ends in the prediction: labels, edges and positions, with the centre added back."""
    monkeypatch.setattr(midi, "RelaxedTransformer", Certain)
    block = jax.jit(MiDi(SIZES, STATISTICS).sample)(
        params, jax.random.key(6), observed(two_rooms()), jnp.ones(1, bool)
    )
    for found, expected in zip(block, wall(), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-5)


def not_encoded():
    """Returns the old graph for networks that do not look at it."""
    nodes = observed(two_rooms()).nodes
    return Conditioning(jnp.zeros(0), NO_GATES, surface_of(nodes), nodes.mask)


def test_a_network__begins_with_the_noisy_positions_times_their_signal_in_metres(monkeypatch):
    shown, conditioning = [], not_encoded()

    def listen(network, params, *inputs):
        shown.append(inputs[-2])
        return jnp.zeros((1, NUM_CONCEPTS)), jnp.zeros((1, 17, 2)), jnp.ones((1, 3))

    monkeypatch.setattr(midi, "apply", listen)
    frame = Frame(jnp.asarray([1.0, -2.0, 0.5]), jnp.float32(3))
    noisy = State(midi.digress.topology_of(wall()), jnp.asarray([[0.5, -0.25, 2.0]]))
    levels = Schedules(*map(jnp.float32, (0.6, 0.5, 0.4)))
    known = conditioning, frame, wall().mask
    *_, position = midi.denoise(FILL.network, {}, *known, noisy, levels, jnp.asarray(1))
    np.testing.assert_allclose(shown[0], [[1.9, -2.45, 4.1]], rtol=1e-6)
    np.testing.assert_allclose(position, [[0, 1, 1 / 6]], atol=1e-6)


@pytest.mark.parametrize(("signal", "weight"), [(0.6, 0.5625), (0.99, 20), (1.0, 20), (0.0, 0)])
def test_errors_of_positions__weigh_as_their_signal_to_noise_up_to_a_limit(
    monkeypatch, signal, weight
):
    """The network says that all stands at the origin of the frame, whatever it sees."""
    centre = jnp.asarray([3.0, 1.0, 1.0])

    def at_origin(network, params, *inputs):
        return jnp.zeros((1, NUM_CONCEPTS)), jnp.zeros((1, 17, 2)), centre[None]

    monkeypatch.setattr(midi, "apply", at_origin)
    levels = Schedules(*map(jnp.float32, (signal, 0.5, 0.4)))
    frame, block = Frame(centre, jnp.float32(2)), wall()

    def losses(key):
        inputs = not_encoded(), frame, block, levels, jnp.asarray(1), STATISTICS.marginals
        return midi.losses(FILL.network, {}, key, *inputs)

    terms = jax.jit(losses)(jax.random.key(8))
    squared = np.mean(((np.asarray(block.position) - np.asarray(centre)) / 2) ** 2)
    np.testing.assert_allclose(terms["position"], weight * squared, rtol=1e-4)


def test_training__is_at_every_time_but_zero_and_at_the_levels_of_the_time(monkeypatch):
    def tell(network, params, key, conditioning, frame, block, signal, time, marginals):
        off = sum(jnp.abs(one - other) for one, other in zip(signal, made.at(time), strict=True))
        return {"label": 1.0 * (time == 1), "edge": 1.0 * (time == STEPS), "position": off}

    made = make_schedules(SIZES)
    monkeypatch.setattr(midi, "losses", tell)
    many = MiDi(dataclasses.replace(SIZES, noise_levels=600), STATISTICS)
    monkeypatch.setattr(midi, "apply", lambda *_: not_encoded())
    inputs = jax.random.key(10), observed(two_rooms()), all_at_once()
    terms = jax.jit(many.loss)({"encoder": None, "denoiser": None}, *inputs)[1]
    np.testing.assert_allclose(terms["label"], 1 / STEPS, atol=0.06)
    np.testing.assert_allclose(terms["edge"], 1 / STEPS, atol=0.06)
    assert terms["position"] == 0


@pytest.mark.parametrize(("steps", "last"), [(STEPS, 1), (1, STEPS)])
def test_a_network__is_told_the_time_at_which_a_step_begins(monkeypatch, params, steps, last):
    class Clock(Certain):
        def __call__(self, conditioning, centre, block_mask, label, edges, position, time):
            said = super().__call__(conditioning, centre, block_mask, label, edges, position, time)
            return *said[:2], jnp.broadcast_to(time, (1, 3))

    monkeypatch.setattr(midi, "RelaxedTransformer", Clock)
    fill = MiDi(dataclasses.replace(SIZES, sampling_steps=steps), STATISTICS)
    graph, mask = observed(two_rooms()), jnp.ones(1, bool)
    block = jax.jit(fill.sample)(params, jax.random.key(11), graph, mask)
    np.testing.assert_allclose(block.position, np.full((1, 3), last), atol=1e-4)


def test_labels_and_edges__have_noise_of_their_own_levels():
    signal = Schedules(*map(jnp.float32, (0.5, 1.0, 0.0)))  # of positions, edges, labels
    block, old_mask = all_at_once(), observed(two_rooms()).nodes.mask
    clean = midi.state_of(block, Frame(jnp.zeros(3), jnp.float32(1)))

    def noisy(key):
        masks = block.mask, old_mask
        return midi.add_noise(key, clean, signal, *masks, STATISTICS.marginals).topology

    found = jax.jit(jax.vmap(noisy))(jax.random.split(jax.random.key(12), 8))
    np.testing.assert_array_equal(found.edges, np.broadcast_to(block.edges, found.edges.shape))
    assert (found.label != block.label[None]).any()


def test_samples__of_every_step_of_the_schedule_are_finite(params):
    """As many steps as are trained: the signal of the last ones is 1.0 in float32."""
    steps = 350
    assert make_schedules(dataclasses.replace(SIZES, diffusion_steps=steps)).position[1] == 1
    config = dataclasses.replace(SIZES, diffusion_steps=steps, sampling_steps=steps)
    graph, mask = observed(two_rooms()), jnp.ones(1, bool)
    block = jax.jit(MiDi(config, STATISTICS).sample)(params, jax.random.key(9), graph, mask)
    chex.assert_tree_all_finite(block)


def test_noise__settles_in_positions_first_then_in_edges_then_in_labels():
    middle = SCHEDULES.at(jnp.asarray(250))
    assert middle.position > middle.edge > middle.label > 0
    # MiDi's own levels at half time; its schedule begins one step later.
    np.testing.assert_allclose(middle, [0.9187, 0.7134, 0.4923], atol=3e-3)


def test_noise__of_positions_keeps_its_centre_of_mass():
    """The centre of a block is new information: noise on it must have full variance."""
    frame = Frame(jnp.zeros(3), jnp.float32(1))
    block, old_mask = all_at_once(), observed(two_rooms()).nodes.mask
    signal = make_schedules(SIZES).at(jnp.asarray(STEPS))

    def mean_of(key):
        clean = midi.state_of(block, frame)
        noisy: State = midi.add_noise(
            key, clean, signal, block.mask, old_mask, STATISTICS.marginals
        )
        return jnp.mean(noisy.position, axis=0)

    means = jax.jit(jax.vmap(mean_of))(jax.random.split(jax.random.key(7), 2000))
    np.testing.assert_allclose(np.var(means, axis=0), 1 / 4, rtol=0.15)


def test_frame__is_undone_by_its_inverse():
    frame = Frame(jnp.asarray([1.0, 2.0, 3.0]), jnp.float32(2))
    metres = jnp.asarray([[1.0, 2.0, 3.0], [3.0, 2.0, 3.0]])
    np.testing.assert_allclose(frame.to_unit(metres), [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(frame.to_metres(frame.to_unit(metres)), metres)


def test_prior_of_a_scene__is_as_wide_as_its_nodes_and_has_as_many_edges_in_every_one():
    statistics = STATISTICS._replace(cross_degree=1.6)
    fill = MiDi(dataclasses.replace(SIZES, scene_scale=True), statistics)
    graph = observed(two_rooms())
    frame, marginals = fill.prior(graph)
    real = np.asarray(graph.nodes.position)[np.asarray(graph.nodes.mask)]
    spread = np.sqrt(np.mean((real - real.mean(axis=0)) ** 2) + 0.25)
    np.testing.assert_allclose(frame.centre, real.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(frame.scale, spread, rtol=1e-5)
    np.testing.assert_allclose(marginals.cross_edge, [1 - 1.6 / len(real), 1.6 / len(real)])
    in_training, marginals = FILL.prior(graph)
    np.testing.assert_allclose(in_training.scale, STATISTICS.position_std)
    np.testing.assert_allclose(marginals.cross_edge, STATISTICS.cross_edge)


def test_a_scene_of_its_own_scale__is_learnt_and_drawn_in_metres(monkeypatch):
    """Training and sampling use the same prior; contacts are heard of."""
    config = dataclasses.replace(SIZES, scene_scale=True, contacts=2)
    fill = MiDi(config, STATISTICS._replace(cross_degree=1.6))
    graph, block = observed(two_rooms()), all_at_once()
    params = random_params(fill.init, graph, block)
    loss = jax.jit(jax.value_and_grad(lambda *inputs: fill.loss(*inputs)[0]))
    value, gradient = loss(params, jax.random.key(1), graph, block)
    chex.assert_tree_all_finite((value, gradient))
    (in_training, _), _ = loss_and_gradient(params, jax.random.key(1), graph, block)
    assert value != in_training
    monkeypatch.setattr(midi, "RelaxedTransformer", Certain)
    drawn = jax.jit(fill.sample)(params, jax.random.key(6), graph, jnp.ones(1, bool))
    for found, expected in zip(drawn, wall(), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-5)
