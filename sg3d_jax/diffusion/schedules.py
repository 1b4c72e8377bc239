"""Cumulative noise schedules and the time grid on which a trained process is sampled."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def cosine(num_steps: int, exponent: float = 1.0) -> Float[Array, " {num_steps}+1"]:
    """Returns the cumulative signal level at times 0..S: 1 at time 0, about 0 at time S.

    Args:
      num_steps: S.
      exponent: nu; what has a larger one is noised later, and so settles earlier when generated.

    Source: DiGress and FLAGG: f(t / S) / f(0) with f(x) = cos^2(pi / 2 * (x + 0.008) / 1.008); with
    x^nu in place of x, MiDi.
    Differs: MiDi's level at time 0 already contains one step of noise.
    """
    time = (np.arange(num_steps + 1) / num_steps) ** exponent
    signal = np.cos(0.5 * np.pi * (time + 0.008) / 1.008) ** 2
    return jnp.asarray((signal / signal[0]).astype(np.float32))


def strided_times(num_steps: int, num_samples: int) -> Int[Array, " {num_samples}+1"]:
    """Returns the decreasing times S..0 of a sampler that takes `num_samples` steps.

    Args:
      num_steps: S, the steps of the trained schedule.
      num_samples: K, at most S; K = S visits every time.

    Raises:
      ValueError: K is not in 1..S.
    """
    if not 1 <= num_samples <= num_steps:
        raise ValueError(f"sampling steps must be in 1..{num_steps}, got {num_samples}")
    times = np.round(np.linspace(num_steps, 0, num_samples + 1))
    return jnp.asarray(times.astype(np.int32))
