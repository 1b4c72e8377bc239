"""The one ancestral loop: from noise to a sample, by the reverse steps of any process."""

from collections.abc import Callable
from typing import TypeVar

import jax
from jaxtyping import Array, Int, Key

from sg3d_jax.diffusion.schedules import strided_times

State = TypeVar("State")


def ancestral_sample(
    step: Callable[[Key[Array, ""], State, Int[Array, ""], Int[Array, ""]], State],
    start: State,
    key: Key[Array, ""],
    num_times: int,
    num_steps: int,
) -> State:
    """Draws a sample by `num_steps` reverse steps, a stride over the trained times.

    Args:
      step: (key, state, now, then) -> the state at the earlier time `then`: predicts the clean
        state from the one at time `now` and draws from the posterior in between.
      start: noise, the state at time S; any tree of arrays.
      key: one for all steps.
      num_times: S, the steps of the trained schedule.
      num_steps: how many of them are taken, at most S.

    Raises:
      ValueError: num_steps is not in 1..S.
    """

    def body(
        state: State, inputs: tuple[Key[Array, ""], Int[Array, ""], Int[Array, ""]]
    ) -> tuple[State, None]:
        return step(inputs[0], state, *inputs[1:]), None

    times = strided_times(num_times, num_steps)
    keys = jax.random.split(key, num_steps)
    return jax.lax.scan(body, start, (keys, times[:-1], times[1:]))[0]
