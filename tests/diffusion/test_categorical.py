import jax
import numpy as np
import pytest

from sg3d_jax.diffusion import categorical
from sg3d_jax.diffusion.schedules import cosine

MARGINAL = np.array([0.0, 0.5, 0.3, 0.2])
SIGNAL = np.asarray(cosine(10), np.float64)
DRAWS = 20_000

add_noise = jax.jit(categorical.add_noise)
draw_marginal = jax.jit(categorical.draw_marginal, static_argnums=1)
draw = jax.jit(categorical.draw)
posterior = jax.jit(categorical.posterior)


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
    classes, signal = np.full(DRAWS, clean), np.float32(SIGNAL[time])
    noisy = add_noise(jax.random.key(time), classes, signal, MARGINAL)
    expected = transition(SIGNAL[time])[clean]
    np.testing.assert_allclose(frequencies(noisy), expected, atol=0.015)
    assert noisy.dtype == np.int32


def test_draw_marginal__has_its_frequencies_and_never_draws_the_impossible():
    drawn = np.asarray(draw_marginal(jax.random.key(1), (DRAWS,), MARGINAL))
    np.testing.assert_allclose(frequencies(drawn), MARGINAL, atol=0.015)
    assert not (drawn == 0).any()


def test_draw__has_the_frequencies_of_the_distribution():
    probs = np.tile(np.array([0.1, 0.0, 0.6, 0.3], np.float32), (DRAWS, 1))
    drawn = draw(jax.random.key(2), probs)
    np.testing.assert_allclose(frequencies(drawn), probs[0], atol=0.015)


@pytest.mark.parametrize(("then", "now"), [(2, 3), (0, 1), (4, 8), (1, 9), (9, 10), (0, 10)])
@pytest.mark.parametrize("noisy", [1, 2, 3])
def test_posterior__is_bayes_rule_also_where_times_are_skipped(then, now, noisy):
    probs_clean = np.array([0.0, 0.2, 0.7, 0.1])
    levels = np.float32(SIGNAL[then]), np.float32(SIGNAL[now])
    found = np.asarray(posterior(probs_clean, np.array(noisy), *levels, MARGINAL))
    expected = posterior_by_bayes(probs_clean, noisy, then, now)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    np.testing.assert_allclose(found.sum(), 1, rtol=1e-6)


def test_posterior__at_time_zero_is_the_prediction():
    probs_clean = np.random.default_rng(3).dirichlet(np.ones(4), 5).astype(np.float32)
    noisy, marginal = np.array([1, 2, 3, 1, 2]), np.full(4, 0.25, np.float32)
    found = posterior(probs_clean, noisy, np.float32(1), np.float32(SIGNAL[6]), marginal)
    np.testing.assert_allclose(found, probs_clean, rtol=1e-6)
