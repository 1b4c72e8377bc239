import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.diffusion.threefry import UNROLLED, unrolled

DRAWS = {
    "uniform": lambda key: jax.random.uniform(key, (3, 5)),
    "scalar": lambda key: jax.random.normal(key),
    "integers": lambda key: jax.random.randint(key, (40,), -3, 17),
    "categorical": lambda key: jax.random.categorical(key, jnp.arange(5.0), shape=(9,)),
    "narrow bits": lambda key: jax.random.bits(key, (7,), jnp.uint8),
    "split": lambda key: jax.random.key_data(jax.random.split(key, 7)),
    "split in a shape": lambda key: jax.random.key_data(jax.random.split(key, (2, 3))),
    "fold_in": lambda key: jax.random.key_data(jax.random.fold_in(key, 2**32 - 2)),
    "vmap": lambda key: jax.vmap(jax.random.uniform)(jax.random.split(key, 4)),
}


@jax.jit
def all_draws(key):
    """Each draw by the unrolled generator and by JAX's own."""
    clone = jax.random.clone
    return {name: (draw(unrolled(clone(key))), draw(clone(key))) for name, draw in DRAWS.items()}


@pytest.mark.parametrize("name", DRAWS)
@pytest.mark.parametrize("seed", [0, 2**32 - 1])
def test_numbers_are_those_of_jax(name, seed):
    np.testing.assert_array_equal(*all_draws(jax.random.key(seed))[name])


def test_a_seed_gives_the_key_that_it_gives_in_jax():
    made, own = jax.random.key(12345), jax.random.key(12345, impl=UNROLLED)
    assert own.dtype == unrolled(made).dtype
    np.testing.assert_array_equal(jax.random.key_data(own), jax.random.key_data(made))


def test_a_draw_is_compiled_without_a_loop():
    lowered = jax.jit(lambda key: jax.random.uniform(unrolled(key), (5,))).lower(jax.random.key(0))
    assert "while" not in lowered.as_text()


def test_keys_of_a_split_are_computed_once():
    """XLA would compute them again in every program that draws; JAX 0.12 never compiles that."""

    def draw(key):
        keys = jax.random.split(jax.random.split(unrolled(key), 3)[1], 3)
        return jax.random.uniform(keys[0], (6, 65)), jax.random.normal(keys[1], (65,))

    compiled = jax.jit(draw).lower(jax.random.key(0)).compile().as_text()
    assert compiled.count(" shift-left(") <= 4 * 20  # rounds of two splits and two draws


def test_keys_of_other_generators_stay_as_they_are():
    for impl in ("rbg", UNROLLED):
        key = jax.random.key(0, impl=impl)
        assert unrolled(key) is key
