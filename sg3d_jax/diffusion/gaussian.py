"""Gaussian diffusion of real values, variance preserving, predicting the clean value.

x_t = signal(t) x_0 + sqrt(1 - signal(t)^2) noise: the signal level itself, not its root,
multiplies the signal.

Source: MiDi, Sec. 3, and D4; paper, Eq. (distance_transition).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

TINY = 1e-12


def add_noise(
    noise: Float[Array, "..."], clean: Float[Array, "..."], signal: Float[Array, ""]
) -> Float[Array, "..."]:
    """Returns x_t given x_0 and standard normal noise of its shape; `signal` is the level at t.

    The noise is an argument so that the caller can give it the symmetry of its data.
    """
    return signal * clean + jnp.sqrt(1 - signal**2) * noise


def reverse_step(
    noise: Float[Array, "..."],
    predicted: Float[Array, "..."],
    noisy: Float[Array, "..."],
    signal_next: Float[Array, ""],
    signal_now: Float[Array, ""],
) -> Float[Array, "..."]:
    """Returns x_s given x_t, the predicted x_0 and standard normal noise, for s < t.

    Args:
      noise: of the shape of `noisy`.
      predicted: the network's estimate of x_0.
      noisy: x_t.
      signal_next: signal level at s; 1 at s = 0, where the prediction comes back unchanged.
      signal_now: signal level at t.
    """
    variance_next, variance_now = 1 - signal_next**2, 1 - signal_now**2
    step = signal_now / signal_next
    # Near time 0 the signal rounds to 1: nothing is left of the noise, as at time 0 itself.
    ratio = jnp.where(variance_now > 0, variance_next / jnp.maximum(variance_now, TINY), 0.0)
    shrink = 1 - step**2 * ratio
    mean = signal_next * shrink * predicted + step * ratio * noisy
    return mean + jnp.sqrt(variance_next * shrink) * noise
