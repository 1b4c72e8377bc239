import jax
import jax.numpy as jnp
import pytest

from sg3d_jax.flagg.compiled import Compiled, quick_options

OPTIMISED = "jax_disable_most_optimizations"


@pytest.fixture
def optimised():
    """Compiles as a user's program is, and not as the tests are."""
    jax.config.update(OPTIMISED, False)
    yield
    jax.config.update(OPTIMISED, True)


def test_quick_options__are_for_processors(optimised, monkeypatch):
    assert quick_options() == {"xla_backend_optimization_level": 1}
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert quick_options() is None


def test_quick_options__leave_alone_who_wants_no_optimisation():
    assert quick_options() is None


def test_a_compiled_function__is_a_jitted_one(optimised):
    function = Compiled(lambda number, power: number**power, static_argnames=("power",))
    assert function(jnp.asarray(3.0), power=2) == 9
    assert function(jnp.asarray(2.0), power=3) == 8
    assert function._cache_size() == 2
    assert "stablehlo" in function.lower(jnp.asarray(3.0), power=2).as_text()
