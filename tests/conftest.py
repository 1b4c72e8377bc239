"""JAX as the tests want it: strict, two devices, and with compiled programs kept between runs."""

import contextlib
import os
from pathlib import Path

import jax
import matplotlib

if jax.__version_info__ == (0, 10, 0):  # its older kernels compile in two thirds of the time
    flags = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = f"--xla_cpu_use_fusion_emitters=false {flags}"

matplotlib.use("Agg")

jax.config.update("jax_debug_key_reuse", True)
jax.config.update("jax_legacy_prng_key", "error")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_disable_most_optimizations", True)  # tests compile for long and run briefly


def _compilation_caches() -> Path:
    """Returns the folder of all workers' compiled programs."""
    user_cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    root = os.environ.get("JAX_COMPILATION_CACHE_DIR") or Path(user_cache, "sg3d_jax", "tests")
    return Path(root)


def _share_programs(caches: Path) -> None:
    """Gives every worker what the others compiled in earlier runs, on another Python too."""
    folders = [path for path in caches.glob("*") if path.is_dir()]
    for program in [path for folder in folders for path in folder.iterdir() if path.is_file()]:
        for folder in folders:
            with contextlib.suppress(FileExistsError):
                (folder / program.name).hardlink_to(program)


# One folder a worker: JAX's cache is not safe against concurrent writers.
worker = os.environ.get("PYTEST_XDIST_WORKER")
if worker is None:  # before there are any
    _share_programs(_compilation_caches())
jax.config.update("jax_compilation_cache_dir", str(_compilation_caches() / (worker or "main")))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
