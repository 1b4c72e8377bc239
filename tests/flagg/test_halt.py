import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.flagg.halt import draw_halt, halt_loss


@pytest.mark.parametrize("logit", [-40.0, -2.0, 0.0, 0.7, 40.0])
@pytest.mark.parametrize("complete", [False, True])
def test_loss__is_the_binary_cross_entropy(logit, complete):
    expected = np.logaddexp(0, -logit if complete else logit)
    found = halt_loss(jnp.float32(logit), jnp.asarray(complete), jnp.asarray(True))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("complete", [False, True])
def test_loss__of_the_plane_graph_is_zero(complete):
    assert halt_loss(jnp.float32(3), jnp.asarray(complete), jnp.asarray(False)) == 0


@pytest.mark.parametrize(("logit", "halts"), [(-0.1, False), (0.1, True)])
def test_threshold__is_at_one_half(logit, halts):
    for seed in range(5):
        assert draw_halt(jax.random.key(seed), jnp.float32(logit), True) == halts


def test_draws__halt_with_the_probability_of_the_logit():
    keys = jax.random.split(jax.random.key(0), 5000)
    halts = jax.jit(jax.vmap(lambda key: draw_halt(key, jnp.float32(-1), False)))(keys)
    np.testing.assert_allclose(halts.mean(), 1 / (1 + np.e), atol=0.02)
