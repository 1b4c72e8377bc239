import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.baselines import midi_oracle
from sg3d_jax.baselines.midi_oracle import (
    MiDiOracle,
    MiDiOracleConfig,
    check_one_shot,
    inpaint,
    one_shot_capacity,
    one_shot_cut,
)
from sg3d_jax.fill import digress, midi
from sg3d_jax.fill.constraints import rules_of
from sg3d_jax.fill.midi import Frame, Schedules, make_schedules
from sg3d_jax.flagg.grow import ONE_SHOT
from sg3d_jax.infer.complete import complete
from sg3d_jax.nn.embed import surface_of
from sg3d_jax.nn.graph_transformer import Conditioning
from sg3d_jax.nn.relaxed_egnn import RelaxedTransformer
from sg3d_jax.scene.graph import observed_of, undirected_edges
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PART_OF, PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.padding import part_of_adjacency, unpad
from sg3d_jax.scene.validate import validate_graph
from tests.two_rooms import (
    CAPACITY,
    NO_GATES,
    NUM_PLANES,
    STATISTICS,
    observed,
    on_device,
    random_params,
    two_rooms,
)

pytestmark = pytest.mark.slow

STEPS = 3
MOST_STEPS = 350  # in float32 the signal of the last ones is 1.0
SIZES = MiDiOracleConfig(
    *(8, 1, 2, 8, 8, 1, 2),
    diffusion_steps=STEPS,
    noise_levels=4,
    sampling_steps=STEPS,
    resamplings=0,
)
SCENE = two_rooms()
NUM_NEW = len(SCENE.nodes.label) - NUM_PLANES
NUM_CONCEPTS = PAPER_ONTOLOGY.num_concepts
MODEL = MiDiOracle(SIZES, STATISTICS)
schedules_of = jax.jit(make_schedules, static_argnums=0)
adjacency_of = jax.jit(part_of_adjacency)


class Certain(RelaxedTransformer):
    """A network that knows the scene, whatever it sees."""

    def __call__(self, conditioning, centre, block_mask, label, edges, position, time):
        block = one_shot_cut(on_device(SCENE)).block
        logits = 30.0 * jax.nn.one_hot(block.label, NUM_CONCEPTS)
        offset = block.position - SCENE.nodes.position[:NUM_PLANES].mean(axis=0)[None]
        return logits, 30.0 * jax.nn.one_hot(block.edges + 0, 2), centre[None] + offset


@pytest.fixture(scope="module")
def params():
    return random_params(MODEL.init, on_device(SCENE))


def test_every_parameter__is_trained(params):
    step = jax.jit(jax.value_and_grad(MODEL.loss, has_aux=True))
    (total, terms), found = step(params, jax.random.key(1), on_device(SCENE))
    chex.assert_tree_all_finite((found, terms))
    np.testing.assert_allclose(total, midi.total_loss(terms), rtol=1e-6)
    flat, _ = jax.tree_util.tree_flatten_with_path(found)
    assert [jax.tree_util.keystr(path) for path, leaf in flat if not np.any(leaf)] == []


@jax.debug_key_reuse(False)  # JAX takes a vmapped scan over keys for their reuse
def test_samples__have_the_planes_bit_for_bit_and_as_many_nodes_as_told(params):
    steps = {"diffusion_steps": MOST_STEPS, "sampling_steps": MOST_STEPS, "resamplings": 2}
    config = dataclasses.replace(SIZES, **steps)
    model = MiDiOracle(config, STATISTICS)
    planes, sample = on_device(observed_of(SCENE)), jax.jit(model.sample)
    for number in (1, NUM_NEW):
        grown = sample(params, jax.random.key(2), planes, jnp.asarray(number))
        grown = jax.tree.map(np.asarray, grown)
        assert grown.halt_reason == ONE_SHOT
        chex.assert_tree_all_finite(grown.graph)
        for found, given in zip(grown.graph.nodes, planes.nodes, strict=True):
            np.testing.assert_array_equal(found[:NUM_PLANES], given[:NUM_PLANES])
        assert grown.graph.nodes.mask.sum() == NUM_PLANES + number
        new = grown.graph.nodes.label[NUM_PLANES : NUM_PLANES + number]
        assert not (new == PLANE).any()
        validate_graph(unpad(grown.graph), "grown", rules=False)


@jax.debug_key_reuse(False)
def test_a_certain_network__gives_the_scene(monkeypatch, params):
    monkeypatch.setattr(midi, "RelaxedTransformer", Certain)
    [[grown]] = complete(MiDiOracle(SIZES, STATISTICS), params, [SCENE], candidates=1)
    assert (grown.halt_reason, grown.steps) == ("ONE_SHOT", 1)
    np.testing.assert_array_equal(grown.graph.nodes.label, SCENE.nodes.label)
    np.testing.assert_allclose(grown.graph.nodes.position, SCENE.nodes.position, atol=1e-5)
    found, expected = (
        {tuple(sorted(pair)) for pair in undirected_edges(graph, PART_OF).tolist()}
        for graph in (grown.graph, SCENE)
    )
    assert found == expected


@jax.jit
def inpainted(key, planes, signal):
    """Draws the positions of planes with noise many times."""
    frame = Frame(jnp.ones(3), jnp.float32(2.5))
    keys = jax.random.split(key, 3000)
    return jax.vmap(lambda key: inpaint(key, planes, frame, signal).nodes.position)(keys)


@pytest.mark.parametrize("time", [0, 120, 500])
def test_inpainted_planes__are_the_truth_with_the_noise_of_their_time(time):
    schedules = schedules_of(MiDiOracleConfig())
    signal = jax.tree.map(lambda levels: np.asarray(levels)[time], schedules)
    planes = on_device(observed_of(SCENE))
    drawn = np.asarray(inpainted(jax.random.key(3), planes, signal), np.float64)[:, :NUM_PLANES]
    level = float(signal.position)
    clean = np.asarray(planes.nodes.position[:NUM_PLANES], np.float64)
    np.testing.assert_allclose(drawn.mean(axis=0), 1 + level**2 * (clean - 1), atol=0.08 * level)
    spread = 2.5 * level * np.sqrt(max(1 - level**2, 0))
    np.testing.assert_allclose(drawn.std(axis=0), spread, rtol=0.1, atol=1e-6)


def as_it_is_shown(encoder, params, graph):
    """Encodes nothing: for networks that look at the positions of the planes alone."""
    return Conditioning(jnp.zeros(0), NO_GATES, surface_of(graph.nodes), graph.nodes.mask)


def drawn_to_planes(network, params, conditioning, centre, mask, label, edges, guess, time):
    """Predicts a place between the first guess and the planes, and nothing of the rest."""
    surface = conditioning.surface.position * conditioning.mask[:, None]
    logits = jnp.zeros((len(mask), NUM_CONCEPTS)), jnp.zeros((*edges.shape, 2))
    return *logits, 0.8 * guess + 0.1 * jnp.sum(surface, axis=0)[None] / NUM_PLANES


@jax.debug_key_reuse(False)
def test_a_sample__is_that_of_a_loop_that_undoes_each_step_and_takes_it_again(monkeypatch):
    monkeypatch.setattr(midi_oracle, "apply", as_it_is_shown)
    monkeypatch.setattr(midi, "apply", drawn_to_planes)
    config = dataclasses.replace(SIZES, diffusion_steps=9, sampling_steps=3, resamplings=1)
    model, params = MiDiOracle(config, STATISTICS), {"encoder": None, "denoiser": None}
    planes = observed(SCENE)
    mask = jnp.asarray(np.arange(one_shot_capacity(CAPACITY.nodes)) < NUM_NEW)
    known = mask, planes.nodes.mask, STATISTICS.marginals

    @jax.jit
    def begin(key):
        rules = rules_of(planes, len(mask), last=True)
        return midi.draw_start(key, *known), midi.frame_of(planes, STATISTICS), rules

    @jax.jit
    def draw(key, state, frame, rules, now, then):
        at_now, at_then = (make_schedules(config).at(time) for time in (now, then))
        between = Schedules(*(one / other for one, other in zip(at_now, at_then, strict=True)))
        key_planes, key_draw, key_undo = jax.random.split(key, 3)
        shown = as_it_is_shown(None, None, inpaint(key_planes, planes, frame, at_now))
        inputs = model.network, None, shown, frame, mask, state, at_now, now
        predicted = midi.denoise(*inputs)
        drawn = midi.reverse_step(key_draw, state, predicted, at_then, at_now, *known, rules)
        return drawn, midi.add_noise(key_undo, drawn, between, *known), predicted[:2]

    key = jax.random.key(5)
    key_start, key_steps, key_last = jax.random.split(key, 3)
    state, *scene = begin(key_start)
    keys = jax.random.split(key_steps, 3)
    for step, times in enumerate([(9, 6), (6, 3), (3, 0)]):
        first, again = jax.random.split(keys[step], 2)
        _, undone, _ = draw(first, state, *scene, *map(jnp.asarray, times))
        state, _, logits = draw(again, undone, *scene, *map(jnp.asarray, times))

    @jax.jit
    def end(key, state, logits, frame, rules):
        topology, settled = digress.settled(key, state.topology, logits, mask, rules)
        return midi.to_block(state._replace(topology=topology), frame, settled)

    expected = end(key_last, state, logits, *scene)
    grown = jax.jit(model.sample)(params, key, planes, jnp.asarray(NUM_NEW)).graph.nodes
    new = slice(NUM_PLANES, NUM_PLANES + NUM_NEW)
    np.testing.assert_array_equal(grown.label[new], expected.label[:NUM_NEW])
    np.testing.assert_allclose(grown.position[new], expected.position[:NUM_NEW], atol=1e-4)


def test_training__shows_planes_with_the_noise_of_the_time_of_the_block(monkeypatch):
    def tell(network, params, key, conditioning, frame, block, signal, time, marginals):
        level, clean = signal.position, SCENE.nodes.position[0, 0]
        error = conditioning.surface.position[0, 0] - frame.centre[0]
        error -= level**2 * (clean - frame.centre[0])
        spread = frame.scale * level * jnp.sqrt(1 - level**2)
        scaled = jnp.where(time < STEPS, error / spread, 0.0)  # nothing is left at the last time
        return {"label": scaled, "edge": scaled**2, "position": 1.0 * time}

    monkeypatch.setattr(midi_oracle, "apply", as_it_is_shown)
    monkeypatch.setattr(midi, "losses", tell)
    config = dataclasses.replace(SIZES, noise_levels=3000)
    params = {"encoder": None, "denoiser": None}
    graph = on_device(SCENE)
    terms = jax.jit(MiDiOracle(config, STATISTICS).loss)(params, jax.random.key(6), graph)[1]
    np.testing.assert_allclose(terms["label"], 0, atol=0.08)
    np.testing.assert_allclose(terms["edge"], 1 - 1 / STEPS, atol=0.12)
    np.testing.assert_allclose(terms["position"], np.mean(range(1, STEPS + 1)), atol=0.08)


def test_the_signal_of_the_last_of_so_many_steps__is_one():
    schedules = schedules_of(MiDiOracleConfig(diffusion_steps=MOST_STEPS))
    assert np.asarray(schedules.position)[1] == 1


def test_the_room_for_new_nodes__is_enough_for_the_scene():
    assert one_shot_capacity(CAPACITY.nodes) >= NUM_NEW


def test_one_shot__leaves_the_planes_and_takes_all_else_as_one_block():
    graph = jax.tree.map(np.asarray, on_device(SCENE))
    cut = jax.tree.map(np.asarray, jax.jit(one_shot_cut)(graph))
    num_nodes, num_block = len(graph.nodes.mask), one_shot_capacity(len(graph.nodes.mask))
    truth = np.asarray(adjacency_of(graph))
    np.testing.assert_array_equal(cut.survivors.nodes.mask, np.arange(num_nodes) < NUM_PLANES)
    np.testing.assert_array_equal(
        undirected_edges(cut.survivors, PROXIMITY), undirected_edges(SCENE, PROXIMITY)
    )
    assert not np.asarray(adjacency_of(cut.survivors)).any()
    assert len(cut.block.mask) == num_block
    np.testing.assert_array_equal(np.flatnonzero(cut.block.mask), range(NUM_NEW))
    high = slice(NUM_PLANES, NUM_PLANES + NUM_NEW)
    np.testing.assert_array_equal(cut.block.label[:NUM_NEW], SCENE.nodes.label[high])
    np.testing.assert_allclose(cut.block.position[:NUM_NEW], SCENE.nodes.position[high], rtol=1e-6)
    expected = np.concatenate([truth[high, high], truth[high, :NUM_PLANES]], axis=1)
    found = np.delete(cut.block.edges[:NUM_NEW], np.s_[NUM_NEW:num_block], axis=1)
    np.testing.assert_array_equal(found[:, : NUM_NEW + NUM_PLANES], expected)
    assert cut.block.edges.sum() == expected.sum()


def test_one_shot__is_refused_where_a_bucket_has_no_room():
    graphs = jax.tree.map(lambda leaf: np.asarray(leaf)[None], on_device(SCENE))
    check_one_shot([graphs])
    observed = np.arange(graphs.nodes.label.shape[1])[None] < 3
    nodes = graphs.nodes._replace(label=np.where(observed, PLANE, ROOM), observed=observed)
    crowded = graphs._replace(nodes=nodes)
    with pytest.raises(
        ValueError, match="bucket of 16 nodes has 9 that are not planes, expected at"
    ):
        check_one_shot([graphs, crowded])
