import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import entropy

from sg3d_jax.flagg.insert import Insert, draw_size, insert_loss
from tests.two_rooms import on_device, two_rooms

LOGITS = jnp.asarray([0.3, -1.2, 2.0])


@pytest.mark.parametrize("target", [[0.2, 0.5, 0.3], [1.0, 0.0, 0.0], [0.0, 0.25, 0.75]])
def test_loss__is_the_divergence_of_scipy(target):
    probs = np.exp(LOGITS) / np.exp(LOGITS).sum()
    found = insert_loss(LOGITS, jnp.asarray(target))
    np.testing.assert_allclose(found, entropy(target, probs), rtol=1e-5)


def test_loss__is_zero_for_the_truth_and_for_a_complete_graph():
    target = jax.nn.softmax(LOGITS)
    np.testing.assert_allclose(insert_loss(LOGITS, target), 0, atol=1e-6)
    assert insert_loss(LOGITS, jnp.zeros(3)) == 0


def test_sizes__are_drawn_from_the_coins():
    keys = jax.random.split(jax.random.key(0), 5000)
    sizes = np.asarray(jax.jit(jax.vmap(lambda key: draw_size(key, LOGITS, (1, 4, 16))))(keys))
    found = [np.mean(sizes == coin) for coin in (1, 4, 16)]
    np.testing.assert_allclose(found, jax.nn.softmax(LOGITS), atol=0.02)


@pytest.mark.parametrize("num_coins", [1, 2])
def test_insert__has_one_logit_a_coin(num_coins):
    insert, graph = Insert(4, 1, num_coins), on_device(two_rooms())

    def start(key):
        return insert.logits(insert.init(key, graph), graph)

    assert jax.eval_shape(start, jax.random.key(1)).shape == (num_coins,)


def test_insert__with_one_coin_has_nothing_to_learn():
    insert, graph = Insert(4, 1, 1), on_device(two_rooms())
    assert jax.tree.leaves(insert.init(jax.random.key(2), graph)) == []
