import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.baselines.midi_oracle import (
    MiDiOracleConfig,
    complete,
    inpaint,
    make_midi_oracle,
)
from sg3d_jax.fill import midi
from sg3d_jax.fill.midi import Frame, make_schedules
from sg3d_jax.flagg.removal import one_shot_capacity, one_shot_cut
from sg3d_jax.nn.relaxed_egnn import RelaxedTransformer
from sg3d_jax.scene.ontology import NUM_CONCEPTS, PART_OF, PLANE
from sg3d_jax.scene.graph import observed_of, undirected_edges
from sg3d_jax.scene.padding import unpad
from sg3d_jax.scene.validate import validate_graph
from tests.two_rooms import (
    CAPACITY,
    NUM_PLANES,
    STATISTICS,
    moved,
    on_device,
    random_params,
    two_rooms,
)

STEPS = 3
SIZES = MiDiOracleConfig(
    *(8, 1, 2, 8, 8, 1, 2),
    diffusion_steps=STEPS,
    noise_levels=4,
    sampling_steps=STEPS,
    resamplings=0,
)
SCENE = two_rooms()
NUM_NEW = len(SCENE.nodes.label) - NUM_PLANES
MODEL = make_midi_oracle(SIZES, STATISTICS)


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
@pytest.mark.parametrize("resamplings", [0, 2])
def test_samples__have_the_planes_bit_for_bit_and_as_many_nodes_as_told(params, resamplings):
    model = make_midi_oracle(dataclasses.replace(SIZES, resamplings=resamplings), STATISTICS)
    planes = on_device(observed_of(SCENE))
    for number in (1, NUM_NEW):
        grown = jax.jit(model.sample)(params, jax.random.key(2), planes, jnp.asarray(number))
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
    model = make_midi_oracle(dataclasses.replace(SIZES, resamplings=1), STATISTICS)
    [[grown]] = complete(model, params, [SCENE])
    assert (grown.halt_reason, grown.steps) == ("ONE_SHOT", 1)
    np.testing.assert_array_equal(grown.graph.nodes.label, SCENE.nodes.label)
    np.testing.assert_allclose(grown.graph.nodes.position, SCENE.nodes.position, atol=1e-5)
    found, expected = (
        {tuple(sorted(pair)) for pair in undirected_edges(graph, PART_OF).tolist()}
        for graph in (grown.graph, SCENE)
    )
    assert found == expected


@pytest.mark.parametrize("time", [0, 120, 500])
def test_inpainted_planes__are_the_truth_with_the_noise_of_their_time(time):
    signal = make_schedules(MiDiOracleConfig()).at(jnp.asarray(time))
    planes, frame = on_device(observed_of(SCENE)), Frame(jnp.ones(3), jnp.float32(2.5))

    def position_of(key):
        return inpaint(key, planes, frame, signal).nodes.position[:NUM_PLANES]

    keys = jax.random.split(jax.random.key(3), 3000)
    drawn = np.asarray(jax.jit(jax.vmap(position_of))(keys), np.float64)
    level = float(signal.position)
    clean = np.asarray(planes.nodes.position[:NUM_PLANES], np.float64)
    np.testing.assert_allclose(drawn.mean(axis=0), 1 + level**2 * (clean - 1), atol=0.08 * level)
    spread = 2.5 * level * np.sqrt(max(1 - level**2, 0))
    np.testing.assert_allclose(drawn.std(axis=0), spread, rtol=0.1, atol=1e-6)


@jax.debug_key_reuse(False)
def test_completing__does_not_depend_on_the_batch_and_shifts_with_the_scene(params):
    few = floor_alone(SCENE)
    far = moved(SCENE, offset=(30, -20, 2))
    together = complete(MODEL, params, [SCENE, few, far], seed=4, samples=2)
    [alone] = complete(MODEL, params, [SCENE], seed=4, samples=2)
    for one, other in zip(together[0], alone, strict=True):
        assert all(jax.tree.leaves(jax.tree.map(np.array_equal, one, other)))
    assert not np.array_equal(alone[0].graph.nodes.position, alone[1].graph.nodes.position)
    for scene, samples in zip((SCENE, few, far), together, strict=True):
        for completion in samples:
            assert len(completion.graph.nodes.label) == len(scene.nodes.label)
            planes = completion.graph.nodes.position[: (scene.nodes.label == PLANE).sum()]
            np.testing.assert_array_equal(planes, scene.nodes.position[scene.nodes.label == PLANE])


def floor_alone(scene):
    """The scene with its last node, the floor, alone beside its planes."""
    nodes = jax.tree.map(lambda field: field[[*range(NUM_PLANES), 11]], scene.nodes)
    nothing = np.zeros(0, np.int32)
    return scene._replace(
        nodes=nodes,
        edges=jax.tree.map(lambda field: field[:0], scene.edges),
        senders=nothing,
        receivers=nothing,
        n_node=np.array([9], np.int32),
        n_edge=np.array([0], np.int32),
    )


def test_a_scene_without_anything_but_planes__is_refused(params):
    with pytest.raises(ValueError, match=r"^scene 1 has planes alone, expected a complete graph"):
        complete(MODEL, params, [SCENE, observed_of(SCENE)])


def test_the_room_for_new_nodes__is_enough_for_the_scene():
    assert one_shot_capacity(CAPACITY.nodes) >= NUM_NEW
