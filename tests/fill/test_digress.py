import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.diffusion import categorical
from sg3d_jax.diffusion.schedules import cosine
from sg3d_jax.fill import digress
from sg3d_jax.fill.digress import Levels
from sg3d_jax.fill.protocol import Marginals
from sg3d_jax.nn.embed import Surface
from sg3d_jax.nn.graph_transformer import Conditioning, RectangleTransformer
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PLANE, ROOM, WALL
from sg3d_jax.scene.padding import Block
from tests.two_rooms import NO_GATES

NUM_BLOCK, NUM_OLD = 4, 6
SCHEDULE = cosine(5)
NUM_CONCEPTS = PAPER_ONTOLOGY.num_concepts
MARGINALS = Marginals(
    label=jnp.asarray([0, 0.5, 0.3, 0.2, 0, 0]),
    block_edge=jnp.asarray([0.7, 0.3]),
    cross_edge=jnp.asarray([0.6, 0.4]),
)


class Told(RectangleTransformer):
    """A network that says what it is told to, whatever it sees."""

    def __call__(self, conditioning, block_mask, label, edges, time):
        return self.get_variable("params", "label"), self.get_variable("params", "edge")


TOLD = Told(0, 0, 0, 0, 0, 0)


def say(label, edge):
    return {"params": {"label": jnp.asarray(label), "edge": jnp.asarray(edge)}}


def old_graph(num_real):
    surface = Surface(*(jnp.asarray(np.zeros((NUM_OLD, *rest), "f")) for rest in ((3,), (3,), ())))
    mask = jnp.asarray(np.arange(NUM_OLD) < num_real)
    return Conditioning(jnp.asarray(np.zeros(0, "f")), NO_GATES, surface, mask)


def make_block(num_new, num_old, seed=0):
    rng = np.random.default_rng(seed)
    mask = np.arange(NUM_BLOCK) < num_new
    square = np.tril(rng.random((NUM_BLOCK, NUM_BLOCK)) < 0.5, -1)
    across = rng.random((NUM_BLOCK, NUM_OLD)) < 0.5
    real = np.concatenate([mask, np.arange(NUM_OLD) < num_old])
    edges = np.concatenate([square | square.T, across], axis=1) & mask[:, None] & real[None]
    label = np.where(mask, [WALL, ROOM, ROOM, FLOOR], 0)
    fields = label.astype(np.int32), np.zeros((NUM_BLOCK, 3), np.float32), edges, mask
    return Block(*map(jnp.asarray, fields))


def random_logits(seed):
    rng = np.random.default_rng(seed)
    edge = rng.normal(size=(NUM_BLOCK, NUM_BLOCK + NUM_OLD, 2))
    return say(rng.normal(size=(NUM_BLOCK, NUM_CONCEPTS)), edge.astype(np.float32))


def loss_by_loops(params, block, num_old):
    """Mean cross-entropies over the real nodes, and over the real pairs, each once."""
    said = {name: np.asarray(value, np.float64) for name, value in params["params"].items()}
    num_new, terms = int(block.mask.sum()), {"label": [], "edge": []}

    def surprise(logits, target):
        return np.log(np.exp(logits).sum()) - logits[target]

    for new in range(num_new):
        terms["label"].append(surprise(said["label"][new], int(block.label[new])))
        for token in [*range(new), *range(NUM_BLOCK, NUM_BLOCK + num_old)]:
            pair = said["edge"][new, token], int(block.edges[new, token])
            terms["edge"].append(surprise(*pair))
    return {name: np.mean(values) for name, values in terms.items()}


@jax.jit
def loss_of(params, key, conditioning, block):
    return digress.loss(TOLD, params, key, conditioning, block, SCHEDULE, MARGINALS)


@jax.jit
def noise_of(key, block, old_mask, signal):
    clean, levels = digress.topology_of(block), digress.Levels(signal, signal)
    return digress.add_noise(key, clean, levels, block.mask, old_mask, MARGINALS)


@jax.debug_key_reuse(False)  # JAX takes a vmapped scan over keys for their reuse
@jax.jit
def sample_of(params, keys, conditioning, block_mask):
    def one(key):
        inputs = params, key, conditioning, block_mask, SCHEDULE, 3, MARGINALS
        return digress.sample(TOLD, *inputs)[0]

    return jax.vmap(one)(keys)


@pytest.mark.parametrize(("num_new", "num_old"), [(1, 2), (2, 6), (4, 5)])
def test_loss__is_a_mean_over_the_nodes_and_pairs_of_one_graph(num_new, num_old):
    block, params = make_block(num_new, num_old), random_logits(1)
    found = loss_of(params, jax.random.key(0), old_graph(num_old), block)
    for name, value in loss_by_loops(params, block, num_old).items():
        np.testing.assert_allclose(found[name], value, rtol=1e-5)


def test_loss__weighs_a_small_graph_in_a_batch_like_a_large_one():
    """The pooled, misaligned weights of FLAGG's release would fail here."""
    sizes, params = [(1, 2), (4, 6)], random_logits(2)
    blocks = [make_block(*size) for size in sizes]
    batch = jax.tree.map(
        lambda *leaves: np.stack(leaves), *zip(map(old_graph, (2, 6)), blocks, strict=True)
    )
    keys = jax.random.split(jax.random.key(1))
    losses = jax.jit(jax.vmap(loss_of, (None, 0, 0, 0)))(params, keys, *batch)
    expected = [
        loss_by_loops(params, block, size[1]) for block, size in zip(blocks, sizes, strict=True)
    ]
    for name, values in losses.items():
        mean = np.mean([terms[name] for terms in expected])
        np.testing.assert_allclose(np.mean(values), mean, rtol=1e-5)


def test_loss__of_an_empty_block_is_zero():
    found = loss_of(random_logits(3), jax.random.key(2), old_graph(6), make_block(0, 6))
    assert jax.tree.map(float, found) == {"label": 0, "edge": 0}


@pytest.mark.parametrize("signal", [0.0, 0.5, 1.0])
def test_noise__is_symmetric_and_on_real_pairs_only(signal):
    block, old = make_block(3, 4), old_graph(4)
    for seed in range(5):
        noisy = noise_of(jax.random.key(seed), block, old.mask, jnp.float32(signal))
        assert_possible(noisy, np.asarray(block.mask), np.asarray(old.mask))
        if signal == 1:
            np.testing.assert_array_equal(noisy.edges, block.edges)
            np.testing.assert_array_equal(noisy.label, block.label)


def test_noise__has_the_marginals_of_its_kind_of_pair():
    block, old = make_block(4, 6), old_graph(6)
    keys = jax.random.split(jax.random.key(3), 2000)
    noisy = jax.jit(jax.vmap(noise_of, (0, None, None, None)))(keys, block, old.mask, 0.0)
    edges = np.asarray(noisy.edges)
    inside = edges[:, *np.tril_indices(NUM_BLOCK, -1)]
    np.testing.assert_allclose(inside.mean(), 0.3, atol=0.02)
    np.testing.assert_allclose(edges[:, :, NUM_BLOCK:].mean(), 0.4, atol=0.01)


def assert_possible(topology, block_mask, old_mask):
    edges = np.asarray(topology.edges)
    square = edges[..., :NUM_BLOCK]
    np.testing.assert_array_equal(square, np.swapaxes(square, -1, -2))
    assert not np.diagonal(square, axis1=-2, axis2=-1).any()
    assert not edges[..., ~block_mask, :].any()
    assert not edges[..., ~np.concatenate([block_mask, old_mask])].any()


def test_samples__are_symmetric_on_real_pairs_and_no_planes_whatever_the_network_says():
    conditioning, mask = old_graph(4), jnp.arange(NUM_BLOCK) < 3
    fond_of_planes = np.zeros((NUM_BLOCK, NUM_CONCEPTS), np.float32)
    fond_of_planes[:, PLANE] = 2
    params = say(fond_of_planes, np.zeros((NUM_BLOCK, NUM_BLOCK + NUM_OLD, 2), np.float32))
    drawn = sample_of(params, jax.random.split(jax.random.key(4), 200), conditioning, mask)
    assert_possible(drawn, np.asarray(mask), np.asarray(conditioning.mask))
    assert set(np.unique(drawn.label)) == {WALL, ROOM, FLOOR}
    assert 0.3 < np.asarray(drawn.edges)[:, :3, NUM_BLOCK : NUM_BLOCK + 4].mean() < 0.7


def test_samples__are_what_a_certain_network_predicts():
    target, conditioning = make_block(4, 6, seed=5), old_graph(6)
    topology = target.label, target.edges + 0
    one_hot = 100 * np.eye(NUM_CONCEPTS, dtype=np.float32), 100 * np.eye(2, dtype=np.float32)
    certain = say(*(one[np.asarray(real)] for one, real in zip(one_hot, topology, strict=True)))
    keys = jax.random.split(jax.random.key(5), 200)
    drawn = sample_of(certain, keys, conditioning, target.mask)
    for found, expected in zip(drawn, topology, strict=True):
        np.testing.assert_array_equal(found, np.broadcast_to(expected, found.shape))


def test_the_start__has_the_marginals_of_its_kind_of_pair():
    masks = jnp.arange(NUM_BLOCK) < 4, jnp.arange(NUM_OLD) < 6
    keys = jax.random.split(jax.random.key(6), 2000)
    drawn = jax.jit(jax.vmap(lambda key: digress.draw_start(key, *masks, MARGINALS)))(keys)
    edges, label = np.asarray(drawn.edges), np.asarray(drawn.label)
    inside = edges[:, *np.tril_indices(NUM_BLOCK, -1)]
    np.testing.assert_allclose(inside.mean(), 0.3, atol=0.02)
    np.testing.assert_allclose(edges[:, :, NUM_BLOCK:].mean(), 0.4, atol=0.01)
    shares = np.bincount(label.ravel(), minlength=NUM_CONCEPTS) / label.size
    np.testing.assert_allclose(shares, MARGINALS.label, atol=0.02)


def test_a_step__draws_from_the_posterior_of_its_kind_of_pair():
    """The network says the same of every pair; all is noisy in the same way."""
    masks = jnp.arange(NUM_BLOCK) < 4, jnp.arange(NUM_OLD) < 6
    noisy = make_block(4, 6)._replace(edges=jnp.ones((NUM_BLOCK, NUM_BLOCK + NUM_OLD), bool))
    levels = Levels(jnp.float32(0.7), jnp.float32(0.5)), Levels(jnp.float32(0.4), jnp.float32(0.2))
    share = jnp.asarray([0.0, 0.2, 0.5, 0.3, 0.0, 0.0])
    posterior = jax.jit(categorical.posterior)

    def draw(key):
        state = digress.topology_of(noisy)
        logits = (
            jnp.broadcast_to(jnp.log(share), (NUM_BLOCK, NUM_CONCEPTS)),
            jnp.zeros((NUM_BLOCK, NUM_BLOCK + NUM_OLD, 2)),
        )
        return digress.reverse_step(key, state, *logits, *levels, *masks, MARGINALS)

    drawn = jax.jit(jax.vmap(draw))(jax.random.split(jax.random.key(7), 2000))
    edges, label = np.asarray(drawn.edges), np.asarray(drawn.label)
    inside, across = edges[:, *np.tril_indices(NUM_BLOCK, -1)], edges[:, :, NUM_BLOCK:]
    signals = levels[0].edge, levels[1].edge
    for found, marginal in ((inside, MARGINALS.block_edge), (across, MARGINALS.cross_edge)):
        half = jnp.asarray([0.5, 0.5])
        expected = np.asarray(posterior(half, jnp.int32(1), *signals, marginal))
        np.testing.assert_allclose(found.mean(), expected[1], atol=0.015)
    for place in range(NUM_BLOCK):
        signals = levels[0].label, levels[1].label
        expected = posterior(share, noisy.label[place], *signals, MARGINALS.label)
        shares = np.bincount(label[:, place], minlength=NUM_CONCEPTS) / len(label)
        np.testing.assert_allclose(shares, expected, atol=0.04)


class Clock(RectangleTransformer):
    """A network that says which time it is told: walls at time 2, rooms at any other."""

    def __call__(self, conditioning, block_mask, label, edges, time):
        said = jnp.where(time == 2, jax.nn.one_hot(WALL, NUM_CONCEPTS), time * ROOM_ALONE)
        logits = 30.0 * jnp.broadcast_to(said[None], (NUM_BLOCK, NUM_CONCEPTS))
        return logits, jnp.zeros((NUM_BLOCK, NUM_BLOCK + NUM_OLD, 2))


ROOM_ALONE = jax.nn.one_hot(ROOM, NUM_CONCEPTS)
CLOCK = Clock(*[0] * 6)


@pytest.mark.parametrize(("num_steps", "expected"), [(5, ROOM), (2, WALL)])
def test_a_network__is_told_the_time_at_which_a_step_begins(num_steps, expected):
    """The last of two steps, a stride over five times, begins at time 2; that of five at 1."""
    known = old_graph(6), jnp.ones(NUM_BLOCK, bool)
    sample = jax.jit(
        lambda key: digress.sample(CLOCK, {}, key, *known, SCHEDULE, num_steps, MARGINALS)
    )
    drawn, _ = sample(jax.random.key(8))
    np.testing.assert_array_equal(drawn.label, np.full(NUM_BLOCK, expected))


def test_training__is_at_every_time_but_zero_and_at_the_level_of_the_time(monkeypatch):
    """What a network is shown at a time has kept as many labels as the schedule says."""
    block = make_block(4, 6)._replace(label=jnp.full(NUM_BLOCK, FLOOR))

    def tell(network, params, conditioning, block_mask, label, edges, time):
        return jnp.mean((label == FLOOR).astype(jnp.float32)), time

    monkeypatch.setattr(digress, "apply", tell)
    terms = lambda kept, time, *_: {"kept": kept, "time": time}
    monkeypatch.setattr(digress, "cross_entropies", terms)

    def loss(key):
        return digress.loss(TOLD, {}, key, old_graph(6), block, SCHEDULE, MARGINALS)

    told = jax.jit(jax.vmap(loss))(jax.random.split(jax.random.key(9), 4000))
    kept, time, schedule = map(np.asarray, (told["kept"], told["time"], SCHEDULE))
    np.testing.assert_array_equal(np.unique(time), range(1, len(SCHEDULE)))
    for now in range(1, len(SCHEDULE)):
        np.testing.assert_allclose(np.mean(time == now), 1 / 5, atol=0.03)
        expected = schedule[now] + (1 - schedule[now]) * float(MARGINALS.label[FLOOR])
        np.testing.assert_allclose(kept[time == now].mean(), expected, atol=0.04)
