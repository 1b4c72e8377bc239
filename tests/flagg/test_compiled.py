import platform
import resource
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.flagg.compiled import Compiled, give_back_memory, quick_options

OPTIMISED = "jax_disable_most_optimizations"


@pytest.fixture
def optimised():
    """Compiles as a user's program is, and not as the tests are."""
    jax.config.update(OPTIMISED, False)
    yield
    jax.config.update(OPTIMISED, True)


def test_quick_options__are_for_processors(optimised, monkeypatch):
    assert quick_options() == {"xla_backend_optimization_level": 1}
    older = {"xla_cpu_use_fusion_emitters"} if jax.__version_info__ < (0, 11) else set()
    assert quick_options(growing=True).keys() - quick_options().keys() == older
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


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="others keep nothing")
def test_memory_that_is_freed__is_given_back():
    def held():
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    blocks = [np.ones(1000) for _ in range(8000)]  # small: glibc keeps them, and the last on top
    del blocks[:-1]
    before = held()
    give_back_memory()
    assert held() < before - 50e6
