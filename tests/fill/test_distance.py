import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.diffusion.schedules import cosine
from sg3d_jax.fill import distance
from sg3d_jax.fill.protocol import Statistics
from sg3d_jax.nn.embed import Surface
from sg3d_jax.nn.graph_transformer import Conditioning, DistanceNetwork
from sg3d_jax.scene.padding import Block
from tests.two_rooms import NO_GATES

NUM_BLOCK, NUM_OLD, MEAN, STD = 3, 5, 1.5, 0.4
SCHEDULE = cosine(4)
STATISTICS = Statistics(
    (1 / 6,) * 6,
    (0.5, 0.5),
    (0.5, 0.5),
    distance_mean=MEAN,
    distance_std=STD,
    position_std=1.0,
)


@pytest.fixture
def optimised():
    """Symmetry to the last bit is that of programs as users compile them."""
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", True)


class Told(DistanceNetwork):
    """A network that predicts one number, times the noisy distance if asked to."""

    def __call__(self, conditioning, label, edges, distance, time):
        constant, factor = self.get_variable("params", "told")
        return constant + factor * distance


TOLD = Told(0, 0, 0)


def say(constant, factor=0.0):
    return {"params": {"told": jnp.asarray([constant, factor])}}


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    position, old = rng.normal(0, 2, (2, NUM_OLD, 3)).astype(np.float32)
    mask = np.array([True, True, False])
    edges = np.zeros((NUM_BLOCK, NUM_BLOCK + NUM_OLD), bool)
    edges[0, 1] = edges[1, 0] = True
    edges[0, NUM_BLOCK + 2] = edges[1, NUM_BLOCK] = edges[1, NUM_BLOCK + 3] = True
    label, nothing = np.zeros(NUM_BLOCK, np.int32), np.zeros((NUM_OLD, 3), np.float32)
    block = Block(*map(jnp.asarray, (label, position[:3], edges, mask)))
    surface = Surface(*map(jnp.asarray, (old, nothing, nothing[:, 0])))
    rows, old_mask = map(jnp.asarray, (nothing[:0, 0], np.arange(NUM_OLD) < 4))
    return Conditioning(rows, NO_GATES, surface, old_mask), block


@jax.jit
def loss_of(params, key, conditioning, block):
    return distance.loss(TOLD, params, key, conditioning, block, SCHEDULE, STATISTICS)


@jax.jit
def sample_of(params, key, conditioning, block):
    inputs = conditioning, block.label, block.edges, SCHEDULE, 2, STATISTICS
    return distance.sample(TOLD, params, key, *inputs)


def test_loss__is_the_mean_over_new_edges_each_once(scene):
    conditioning, block = scene
    new, old = np.asarray(block.position), np.asarray(conditioning.surface.position)
    ends = [(new[1], new[0]), (new[0], old[2]), (new[1], old[0]), (new[1], old[3])]
    clean = [(np.linalg.norm(a - b) - MEAN) / STD for a, b in ends]
    found = loss_of(say(0.3), jax.random.key(0), conditioning, block)
    np.testing.assert_allclose(found, np.mean((0.3 - np.array(clean)) ** 2), rtol=1e-5)


def test_loss__depends_on_the_noise_that_the_network_sees(scene):
    first, second = (loss_of(say(0.0, 1.0), jax.random.key(seed), *scene) for seed in (1, 2))
    assert first != second


def test_loss__without_edges_is_zero(scene):
    conditioning, block = scene
    lonely = block._replace(edges=jnp.asarray(np.zeros_like(block.edges)))
    assert loss_of(say(0.3), jax.random.key(3), conditioning, lonely) == 0


def test_loss__ignores_edges_of_padding(scene):
    conditioning, block = scene
    more = np.array(block.edges)
    more[2] = more[:, NUM_BLOCK + 4] = True
    expected, found = (
        loss_of(say(0.3), jax.random.key(4), conditioning, block._replace(edges=edges))
        for edges in (block.edges, jnp.asarray(more))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize(("said", "metres"), [(0.5, MEAN + 0.5 * STD), (-10.0, 0.0)])
def test_samples__are_in_metres_and_never_negative(optimised, scene, said, metres):
    found = sample_of(say(said), jax.random.key(5), *scene)
    np.testing.assert_allclose(found, np.full_like(found, metres), rtol=1e-6)


def test_samples__are_symmetric_inside_the_block(optimised, scene):
    found = np.asarray(sample_of(say(0.0, 0.9), jax.random.key(6), *scene))
    square = found[:, :NUM_BLOCK]
    np.testing.assert_array_equal(square, square.T)
    assert len(np.unique(found)) > NUM_OLD


class Clock(DistanceNetwork):
    """A network that repeats what it sees at one time, and says the time at any other."""

    def __call__(self, conditioning, label, edges, distance, time):
        return jnp.where(time == self.get_variable("params", "time"), distance, time)


CLOCK = Clock(0, 0, 0)


@pytest.mark.parametrize(("num_steps", "last"), [(4, 1), (2, 2), (1, 4)])
def test_a_network__is_told_the_time_at_which_a_step_begins(scene, num_steps, last):
    conditioning, block = scene
    inputs = conditioning, block.label, block.edges, SCHEDULE, num_steps, STATISTICS
    sample = jax.jit(lambda key: distance.sample(CLOCK, {"params": {"time": 0}}, key, *inputs))
    found = sample(jax.random.key(7))
    np.testing.assert_allclose(found, np.full_like(found, MEAN + last * STD), rtol=1e-6)


def test_training__is_at_every_time_but_zero_and_at_the_level_of_the_time(scene):
    conditioning, block = scene
    ends = np.concatenate([block.position, conditioning.surface.position])
    first, second = ends[[1, 0, 1, 1]], ends[[0, 5, 3, 6]]
    clean = (np.linalg.norm(first - second, axis=-1) - MEAN) / STD
    told = {time: np.mean((time - clean) ** 2) for time in range(1, 5)}

    @jax.jit
    def losses(keys, repeated):
        def one(key):
            params = {"params": {"time": repeated}}
            return distance.loss(CLOCK, params, key, conditioning, block, SCHEDULE, STATISTICS)

        return jax.vmap(one)(keys)

    for repeated in range(1, 5):
        keys = jax.random.split(jax.random.key(8 + repeated), 4000)
        found = np.asarray(losses(keys, repeated))
        others = [np.isclose(found, told[time]) for time in told if time != repeated]
        shares = [np.mean(is_told) for is_told in others]
        np.testing.assert_allclose(shares, 1 / 4, atol=0.03)
        rest = found[~np.any(others, axis=0)]
        signal = float(SCHEDULE[repeated])
        expected = (1 - signal) ** 2 * np.mean(clean**2) + 1 - signal**2
        np.testing.assert_allclose(rest.mean(), expected, rtol=0.15)
