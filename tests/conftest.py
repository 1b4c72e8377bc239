"""JAX as the tests want it: strict, two devices, and with compiled programs kept between runs."""

import gc
import os
from pathlib import Path

import jax
import matplotlib

gc.set_threshold(50_000, 10, 10)  # tracing makes objects faster than collecting them pays

if jax.__version_info__ == (0, 10, 0):  # its older kernels compile in two thirds of the time
    flags = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = f"--xla_cpu_use_fusion_emitters=false {flags}"

matplotlib.use("Agg")

jax.config.update("jax_debug_key_reuse", True)
jax.config.update("jax_legacy_prng_key", "error")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_disable_most_optimizations", True)  # tests compile for long and run briefly


def _compilation_cache() -> Path:
    """Returns one folder a worker: JAX's cache is not safe against concurrent writers."""
    user_cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    root = os.environ.get("JAX_COMPILATION_CACHE_DIR") or Path(user_cache, "sg3d_jax", "tests")
    return Path(root, os.environ.get("PYTEST_XDIST_WORKER", "main"))


jax.config.update("jax_compilation_cache_dir", str(_compilation_cache()))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
