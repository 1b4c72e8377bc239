import jax
import numpy as np
import pytest

from sg3d_jax.diffusion import gaussian
from sg3d_jax.diffusion.schedules import cosine, strided_times

SIGNAL = np.asarray(cosine(10), np.float64)


def posterior_of_chain(clean, noisy, then, now):
    """Mean and variance of x_s given x_t and x_0, from the product of two normal densities."""
    step = SIGNAL[now] / SIGNAL[then]
    variance_then = 1 - SIGNAL[then] ** 2
    variance_step = (1 - SIGNAL[now] ** 2) - step**2 * variance_then
    precision = 1 / variance_then + step**2 / variance_step
    mean = (SIGNAL[then] * clean / variance_then + step * noisy / variance_step) / precision
    return mean, 1 / precision


compiled_step = jax.jit(gaussian.reverse_step)
compiled_steps = jax.jit(jax.vmap(gaussian.reverse_step))
add_noise = jax.jit(gaussian.add_noise)


def reverse_step(noise, clean, noisy, then, now):
    levels = np.float32(SIGNAL[then]), np.float32(SIGNAL[now])
    return np.asarray(compiled_step(noise, clean, noisy, *levels))


@pytest.mark.parametrize(("then", "now"), [(1, 2), (3, 7), (8, 9), (9, 10), (1, 10)])
def test_reverse_step__draws_from_the_posterior_of_the_chain(then, now):
    clean, noisy = np.array([0.3, -2.0, 1.1]), np.array([0.9, -0.4, 5.0])
    mean, variance = posterior_of_chain(clean, noisy, then, now)
    found_mean = reverse_step(np.zeros(3), clean, noisy, then, now)
    np.testing.assert_allclose(found_mean, mean, rtol=1e-4, atol=1e-6)
    deviation = reverse_step(np.ones(3), clean, noisy, then, now) - found_mean
    np.testing.assert_allclose(deviation, np.full(3, np.sqrt(variance)), rtol=1e-3)


@pytest.mark.parametrize("now", [1, 5, 10])
def test_reverse_step__to_time_zero_returns_the_prediction(now):
    clean, noisy, noise = np.random.default_rng(now).normal(size=(3, 8))
    np.testing.assert_allclose(reverse_step(noise, clean, noisy, 0, now), clean, rtol=1e-6)


@pytest.mark.parametrize("num_steps", [64, 333, 400, 500])
def test_reverse_step__is_finite_at_all_steps_where_the_signal_rounds_to_one(num_steps):
    """At this exponent the level at time 1 is 1.0 in float32."""
    signal, times = map(np.asarray, (cosine(500, 2.5), strided_times(500, num_steps)))
    assert signal[1] == 1
    ones = np.ones(num_steps, np.float32)
    inputs = ones, 2 * ones, 3 * ones, signal[times[1:]], signal[times[:-1]]
    found = np.asarray(compiled_steps(*inputs))
    assert np.isfinite(found).all()
    assert (found >= 0.9).all()  # a mean of prediction and noisy value, and noise on top
    assert found[-1] == 2


def test_add_noise__keeps_unit_variance_and_shrinks_the_mean():
    noise, spread = np.random.default_rng(0).normal(size=(2, 50_000)).astype(np.float32)
    noisy = np.asarray(add_noise(noise, spread, np.float32(0.6)))
    np.testing.assert_allclose([noisy.mean(), noisy.var()], [0, 1], atol=0.02)
    shifted = np.asarray(add_noise(noise, 3 + spread, np.float32(0.6)))
    np.testing.assert_allclose(shifted - noisy, np.full(50_000, 1.8), rtol=1e-4)
