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
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PLANE, WALL
from sg3d_jax.scene.padding import Block
from tests.opinions import Blind
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
sample = jax.jit(MiDi.sample, static_argnums=0)
prior = jax.jit(MiDi.prior, static_argnums=0)
CERTAIN, SEEN, TIME = range(3)


class Told(RelaxedTransformer):
    """A network that knows the wall between both rooms, or takes what it sees for the truth.

    Or it tells the time, in metres.
    """

    def __call__(self, conditioning, centre, block_mask, label, edges, position, time):
        what, wall_edges, place = (
            self.get_variable("params", name) for name in ("what", "edges", "position")
        )
        num_block = len(label)
        wall_edges = jnp.pad(jnp.tile(wall_edges, (num_block, 1)), [(0, 0), (num_block, 0)])
        is_seen = what == SEEN
        label, edges = jnp.where(is_seen, label, WALL), jnp.where(is_seen, edges, wall_edges)
        places = jnp.stack(jnp.broadcast_arrays(place, position, time[None, None]))
        return 30 * jax.nn.one_hot(label, NUM_CONCEPTS), 30 * jax.nn.one_hot(edges, 2), places[what]


class ToldMiDi(MiDi):
    encoder = Blind(8, 1, 2)
    network = Told(8, 8, 1, 2, 2, NUM_CONCEPTS)


def told(what):
    edges, position = np.asarray(wall().edges)[:, 1:].astype(np.int32), wall().position
    network = {"params": {"what": np.int32(what), "edges": edges, "position": position}}
    return {"encoder": {}, "denoiser": network}


def with_steps(steps, trained=STEPS):
    """Returns a model that is told what its network says."""
    sizes = dataclasses.replace(SIZES, diffusion_steps=trained, sampling_steps=steps)
    return ToldMiDi(sizes, STATISTICS)


whole_block = jax.jit(all_at_once)


def wall():
    block = jax.tree.map(np.asarray, whole_block())
    first = Block(block.label[:1], block.position[:1], block.edges[:1, 3:], block.mask[:1])
    return jax.tree.map(jnp.asarray, first)


@pytest.fixture(scope="module")
def params():
    return random_params(FILL.init, observed(two_rooms()), whole_block())


def test_every_parameter__is_trained(params):
    graph, block = observed(two_rooms()), whole_block()
    (_, terms), found = loss_and_gradient(params, jax.random.key(1), graph, block)
    chex.assert_tree_all_finite((found, terms))
    flat, _ = jax.tree_util.tree_flatten_with_path(found)
    assert [jax.tree_util.keystr(path) for path, leaf in flat if not np.any(leaf)] == []


def test_loss__is_the_weighted_sum_of_its_terms(params):
    graph, block = observed(two_rooms()), whole_block()
    (total, terms), _ = loss_and_gradient(params, jax.random.key(2), graph, block)
    assert set(terms) == {"label", "edge", "position"}
    expected = terms["label"] + 5 * terms["edge"] + terms["position"]
    np.testing.assert_allclose(total, expected, rtol=1e-6)


def test_loss__of_an_empty_block_is_zero_and_teaches_nothing(params):
    empty = jax.tree.map(jnp.zeros_like, whole_block())
    inputs = jax.random.key(3), observed(two_rooms()), empty
    (total, _), gradient = loss_and_gradient(params, *inputs)
    assert total == 0
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(gradient))


def test_loss__does_not_see_where_the_scene_stands(params):
    """The frame is that of the old graph, so a shift of everything is no change."""
    offset = np.array([20.0, -8.0, 3.0])
    block = whole_block()
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
    fill, params = (FILL, params) if steps == STEPS else (with_steps(1), told(SEEN))
    block = jax.tree.map(np.asarray, sample(fill, params, jax.random.key(4), graph, mask))
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
    still, shaken = (
        sample(FILL, params, jax.random.key(5), observed(scene), mask)
        for scene in (two_rooms(), moved(two_rooms(), offset=offset))
    )
    np.testing.assert_array_equal(still.label, shaken.label)
    np.testing.assert_array_equal(still.edges, shaken.edges)
    np.testing.assert_allclose(shaken.position, still.position + offset[None], atol=1e-3)


def sample_all_steps(params, key):
    """Draws one node by as many steps as are trained."""
    steps = 350
    assert make_schedules(dataclasses.replace(SIZES, diffusion_steps=steps)).position[1] == 1
    return sample(with_steps(steps, steps), params, key, observed(two_rooms()), jnp.ones(1, bool))


def test_a_certain_network__gives_what_it_knows_in_metres():
    """The chain ends in the prediction: labels, edges and positions, with the centre added back."""
    block = sample_all_steps(told(CERTAIN), jax.random.key(6))
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

    @jax.jit
    def begin(*known):
        *_, position = midi.denoise(FILL.network, {}, *known, noisy, levels, jnp.asarray(1))
        return shown[0], position

    first, position = begin(conditioning, frame, wall().mask)
    np.testing.assert_allclose(first, [[1.9, -2.45, 4.1]], rtol=1e-6)
    np.testing.assert_allclose(position, [[0, 1, 1 / 6]], atol=1e-6)


class AtOrigin(RelaxedTransformer):
    """A network that says that all stands at the origin of the frame, whatever it sees."""

    def __call__(self, conditioning, centre, block_mask, label, edges, position, time):
        return jnp.zeros((1, NUM_CONCEPTS)), jnp.zeros((1, 17, 2)), centre[None]


@jax.jit
def losses_at_origin(key, frame, block, levels):
    inputs = not_encoded(), frame, block, levels, jnp.asarray(1), STATISTICS.marginals
    return midi.losses(AtOrigin(8, 8, 1, 2, 2, NUM_CONCEPTS), {}, key, *inputs)


@pytest.mark.parametrize(("signal", "weight"), [(0.6, 0.5625), (0.99, 20), (1.0, 20), (0.0, 0)])
def test_errors_of_positions__weigh_as_their_signal_to_noise_up_to_a_limit(signal, weight):
    levels, block = Schedules(*map(jnp.float32, (signal, 0.5, 0.4))), wall()
    centre = np.array([3.0, 1.0, 1.0], np.float32)
    frame = Frame(jnp.asarray(centre), jnp.float32(2))
    terms = losses_at_origin(jax.random.key(8), frame, block, levels)
    squared = np.mean(((np.asarray(block.position) - centre) / 2) ** 2)
    np.testing.assert_allclose(terms["position"], weight * squared, rtol=1e-4)


def test_training__is_at_every_time_but_zero_and_at_the_levels_of_the_time(monkeypatch):
    def tell(network, params, key, conditioning, frame, block, signal, time, marginals):
        off = sum(jnp.abs(one - other) for one, other in zip(signal, made.at(time), strict=True))
        return {"label": 1.0 * (time == 1), "edge": 1.0 * (time == STEPS), "position": off}

    made = make_schedules(SIZES)
    monkeypatch.setattr(midi, "losses", tell)
    many = MiDi(dataclasses.replace(SIZES, noise_levels=600), STATISTICS)
    monkeypatch.setattr(midi, "apply", lambda *_: not_encoded())
    inputs = jax.random.key(10), observed(two_rooms()), whole_block()
    terms = jax.jit(many.loss)({"encoder": None, "denoiser": None}, *inputs)[1]
    np.testing.assert_allclose(terms["label"], 1 / STEPS, atol=0.06)
    np.testing.assert_allclose(terms["edge"], 1 / STEPS, atol=0.06)
    assert terms["position"] == 0


def test_a_network__is_told_the_time_at_which_a_step_begins():
    block = sample_all_steps(told(TIME), jax.random.key(10))
    np.testing.assert_allclose(block.position, np.full((1, 3), 1), atol=1e-4)
    inputs = jax.random.key(11), observed(two_rooms()), jnp.ones(4, bool)
    block = sample(with_steps(1), told(TIME), *inputs)
    np.testing.assert_allclose(block.position, np.full((4, 3), STEPS), atol=1e-4)


@jax.jit
def noisy_often(block, old_mask, signal):
    """Draws noisy states in a frame that is that of the scene."""
    clean = midi.state_of(block, Frame(jnp.zeros(3), jnp.float32(1)))

    def noisy(key):
        return midi.add_noise(key, clean, signal, block.mask, old_mask, STATISTICS.marginals)

    return jax.vmap(noisy)(jax.random.split(jax.random.key(12), 2000))


def test_labels_and_edges__have_noise_of_their_own_levels():
    signal = Schedules(*map(jnp.float32, (0.5, 1.0, 0.0)))  # of positions, edges, labels
    block, old_mask = whole_block(), observed(two_rooms()).nodes.mask
    found = jax.tree.map(np.asarray, noisy_often(block, old_mask, signal).topology)
    np.testing.assert_array_equal(found.edges, np.broadcast_to(block.edges, found.edges.shape))
    assert (found.label != np.asarray(block.label)).any()


def test_samples__of_every_step_of_the_schedule_are_finite():
    """As many steps as are trained: the signal of the last ones is 1.0 in float32."""
    chex.assert_tree_all_finite(sample_all_steps(told(SEEN), jax.random.key(9)))


def test_noise__settles_in_positions_first_then_in_edges_then_in_labels():
    middle = SCHEDULES.at(jnp.asarray(250))
    assert middle.position > middle.edge > middle.label > 0
    # MiDi's own levels at half time; its schedule begins one step later.
    np.testing.assert_allclose(middle, [0.9187, 0.7134, 0.4923], atol=3e-3)


def test_noise__of_positions_keeps_its_centre_of_mass():
    """The centre of a block is new information: noise on it must have full variance."""
    block, old_mask = whole_block(), observed(two_rooms()).nodes.mask
    signal = make_schedules(SIZES).at(jnp.asarray(STEPS))
    means = np.mean(noisy_often(block, old_mask, signal).position, axis=1)
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
    frame, marginals = prior(fill, graph)
    real = np.asarray(graph.nodes.position)[np.asarray(graph.nodes.mask)]
    spread = np.sqrt(np.mean((real - real.mean(axis=0)) ** 2) + 0.25)
    np.testing.assert_allclose(frame.centre, real.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(frame.scale, spread, rtol=1e-5)
    np.testing.assert_allclose(marginals.cross_edge, [1 - 1.6 / len(real), 1.6 / len(real)])
    in_training, marginals = prior(FILL, graph)
    np.testing.assert_allclose(in_training.scale, STATISTICS.position_std)
    np.testing.assert_allclose(marginals.cross_edge, STATISTICS.cross_edge)


def test_a_scene_of_its_own_scale__is_learnt_and_drawn_in_metres():
    """Training and sampling use the same prior; contacts are heard of."""
    config = dataclasses.replace(SIZES, scene_scale=True, contacts=2)
    statistics = STATISTICS._replace(cross_degree=1.6)
    fill, graph, block = MiDi(config, statistics), observed(two_rooms()), whole_block()
    params = random_params(fill.init, graph, block)
    loss = jax.jit(jax.value_and_grad(lambda *inputs: fill.loss(*inputs)[0]))
    value, gradient = loss(params, jax.random.key(1), graph, block)
    chex.assert_tree_all_finite((value, gradient))
    (in_training, _), _ = loss_and_gradient(params, jax.random.key(1), graph, block)
    assert value != in_training
    certain = ToldMiDi(config, statistics), told(CERTAIN)
    drawn = sample(*certain, jax.random.key(6), graph, jnp.ones(1, bool))
    for found, expected in zip(drawn, wall(), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-5)
