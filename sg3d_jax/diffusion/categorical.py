"""Discrete diffusion with marginal transitions, for labels and edges.

Q_bar(t) = signal(t) I + (1 - signal(t)) 1 pi^T: a variable keeps its class with probability
signal(t), and is otherwise drawn again from the marginal pi.

Source: DiGress, Sec. 3 and 4; paper, Eq. (digress_transition).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

TINY = 1e-12


def add_noise(
    key: Key[Array, ""],
    classes: Int[Array, "..."],
    signal: Float[Array, "..."],
    marginal: Float[Array, " C"],
) -> Int[Array, "..."]:
    """Draws x_t given x_0.

    Args:
      key: one draw.
      classes: x_0, any shape.
      signal: signal level at t, broadcastable to `classes`.
      marginal: pi.

    Returns:
      x_t, the shape of `classes`. Padding in, noise out: mask it where it is used.
    """
    key_keep, key_draw = jax.random.split(key)
    keep = jax.random.uniform(key_keep, classes.shape) < signal
    return jnp.where(keep, classes, draw_marginal(key_draw, classes.shape, marginal))


def draw_marginal(
    key: Key[Array, ""], shape: tuple[int, ...], marginal: Float[Array, " C"]
) -> Int[Array, "..."]:
    """Draws x_T: independent classes from the marginal, of the given shape."""
    uniform, boundaries = jax.random.uniform(key, shape), jnp.cumsum(marginal)[:-1]
    return jnp.searchsorted(boundaries, uniform, method="compare_all")


def posterior(
    probs_clean: Float[Array, "... C"],
    noisy: Int[Array, "..."],
    signal_next: Float[Array, ""],
    signal_now: Float[Array, ""],
    marginal: Float[Array, " C"],
) -> Float[Array, "... C"]:
    """Returns p(x_s | x_t) for s < t, with the clean class summed out.

    Args:
      probs_clean: p(x_0 | x_t), the network's prediction.
      noisy: x_t.
      signal_next: signal level at s; 1 at s = 0, where the result is the prediction itself.
      signal_now: signal level at t.
      marginal: pi.

    Source: DiGress, Eq. for p_theta(x_{t-1} | x_t); the step may skip times because
    Q_bar(t) Q_bar(s)^-1 has the same form with signal(t) / signal(s).
    """
    num_classes = marginal.shape[0]
    is_noisy = jax.nn.one_hot(noisy, num_classes)
    ratio = signal_now / signal_next
    chance_of_noisy = jnp.take(marginal, noisy)[..., None]
    now_given_next = ratio * is_noisy + (1 - ratio) * chance_of_noisy
    now_given_clean = signal_now * is_noisy + (1 - signal_now) * chance_of_noisy
    weight = probs_clean / jnp.maximum(now_given_clean, TINY)
    redrawn = (1 - signal_next) * jnp.sum(weight, axis=-1, keepdims=True)
    redrawn *= jnp.broadcast_to(marginal, probs_clean.shape)
    unnormalised = now_given_next * (signal_next * weight + redrawn)
    return unnormalised / jnp.maximum(jnp.sum(unnormalised, axis=-1, keepdims=True), TINY)


def draw(key: Key[Array, ""], probs: Float[Array, "... C"]) -> Int[Array, "..."]:
    """Draws one class from each distribution on the last axis."""
    return jax.random.categorical(key, jnp.log(jnp.maximum(probs, TINY))).astype(jnp.int32)
