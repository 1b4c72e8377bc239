import jax
import numpy as np
import pytest

from sg3d_jax.diffusion.sampler import ancestral_sample
from sg3d_jax.diffusion.schedules import strided_times

START = {"place": np.arange(3, dtype=np.float32), "seen": np.zeros((), np.int32)}


@jax.jit
def step(key, state, now, then):
    """Depends on everything that it is given, in a way that tells the order of steps."""
    noise = jax.random.uniform(key, (3,))
    return {
        "place": 0.9 * state["place"] + noise * now - then,
        "seen": 7 * state["seen"] + now - then,
    }


@pytest.mark.parametrize(("num_times", "num_steps"), [(9, 9), (9, 4), (9, 1), (1, 1)])
def test_a_sample__is_that_of_a_loop_over_the_steps(num_times, num_steps):
    key, state = jax.random.key(0), START
    times = np.asarray(strided_times(num_times, num_steps))
    keys = jax.random.split(jax.random.clone(key), num_steps)
    for index in range(num_steps):
        state = step(keys[index], state, int(times[index]), int(times[index + 1]))
    sample = jax.jit(ancestral_sample, static_argnums=(0, 3, 4))
    found = sample(step, START, key, num_times, num_steps)
    np.testing.assert_allclose(found["place"], state["place"], rtol=1e-6)
    assert found["seen"] == state["seen"]


def test_a_sample__of_more_steps_than_there_are_is_refused():
    with pytest.raises(ValueError, match=r"sampling steps must be in 1\.\.9, got 10"):
        ancestral_sample(step, START, jax.random.key(1), 9, 10)
