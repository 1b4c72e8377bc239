import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.diffusion import categorical
from sg3d_jax.diffusion.schedules import cosine

MARGINAL = np.array([0.0, 0.5, 0.3, 0.2])
SIGNAL = np.asarray(cosine(10), np.float64)
DRAWS = 20_000


def transition(signal):
    """Q of a stretch of time that keeps a class with chance `signal`; row: from, column: to."""
    return signal * np.eye(len(MARGINAL)) + (1 - signal) * MARGINAL[None, :]


def posterior_by_bayes(probs_clean, noisy, then, now):
    """p(x_s | x_t) summed over x_0, from products of the one-step transition matrices."""
    step = [transition(SIGNAL[time] / SIGNAL[time - 1]) for time in range(1, now + 1)]
    to_then = np.linalg.multi_dot([np.eye(4), np.eye(4), *step[:then]])
    onwards = np.linalg.multi_dot([np.eye(4), np.eye(4), *step[then:]])
    joint = to_then * onwards[:, noisy][None, :]  # p(x_s, x_t | x_0)
    chance = joint.sum(axis=1)
    return sum(
        probs_clean[clean] * joint[clean] / chance[clean]
        for clean in range(4)
        if probs_clean[clean] > 0
    )


def frequencies(classes):
    return np.bincount(np.asarray(classes), minlength=len(MARGINAL)) / len(classes)


@pytest.mark.parametrize("time", [0, 3, 7, 10])
@pytest.mark.parametrize("clean", [1, 3])
def test_add_noise__has_the_frequencies_of_the_transition_matrix(time, clean):
    classes = jnp.full(DRAWS, clean)
    signal = jnp.float32(SIGNAL[time])
    noisy = categorical.add_noise(jax.random.key(time), classes, signal, jnp.asarray(MARGINAL))
    expected = transition(SIGNAL[time])[clean]
    np.testing.assert_allclose(frequencies(noisy), expected, atol=0.015)
    assert noisy.dtype == jnp.int32


def test_draw_marginal__has_its_frequencies_and_never_draws_the_impossible():
    drawn = categorical.draw_marginal(jax.random.key(1), (DRAWS,), jnp.asarray(MARGINAL))
    np.testing.assert_allclose(frequencies(drawn), MARGINAL, atol=0.015)
    assert not (drawn == 0).any()


def test_draw__has_the_frequencies_of_the_distribution():
    probs = jnp.broadcast_to(jnp.asarray([0.1, 0.0, 0.6, 0.3]), (DRAWS, 4))
    drawn = categorical.draw(jax.random.key(2), probs)
    np.testing.assert_allclose(frequencies(drawn), probs[0], atol=0.015)


@pytest.mark.parametrize(("then", "now"), [(2, 3), (0, 1), (4, 8), (1, 9), (9, 10), (0, 10)])
@pytest.mark.parametrize("noisy", [1, 2, 3])
def test_posterior__is_bayes_rule_also_where_times_are_skipped(then, now, noisy):
    probs_clean = np.array([0.0, 0.2, 0.7, 0.1])
    levels = jnp.float32(SIGNAL[then]), jnp.float32(SIGNAL[now])
    inputs = jnp.asarray(probs_clean), jnp.asarray(noisy), *levels, jnp.asarray(MARGINAL)
    found = categorical.posterior(*inputs)
    expected = posterior_by_bayes(probs_clean, noisy, then, now)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    np.testing.assert_allclose(found.sum(), 1, rtol=1e-6)


def test_posterior__at_time_zero_is_the_prediction():
    probs_clean = jax.nn.softmax(jax.random.normal(jax.random.key(3), (5, 4)))
    noisy = jnp.asarray([1, 2, 3, 1, 2])
    marginal = jnp.full(4, 0.25)
    found = categorical.posterior(
        probs_clean, noisy, jnp.float32(1), jnp.float32(SIGNAL[6]), marginal
    )
    np.testing.assert_allclose(found, probs_clean, rtol=1e-6)
