"""What a Python that uses this package is set to, when it is imported: compiled programs are kept.

A script or a notebook then starts as quickly as the command line. What the user has said is left
alone. JAX is not imported here.

Not set here is malloc: what helps are huge pages (10,000 page faults a training step become 50),
and glibc takes them from GLIBC_TUNABLES alone, before Python starts, as `bin/bootstrap` sets it.
`mallopt` from a running Python has been tried: 10,000 faults as before.
"""

import os
import sys
from pathlib import Path
from typing import Final

CACHE_VARIABLE: Final = "JAX_COMPILATION_CACHE_DIR"
LEAST_SECONDS_VARIABLE: Final = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
LEAST_SECONDS: Final = 0.3  # of compiling, that a program is worth keeping


def cache_folder() -> str:
    """Returns where compiled programs are kept, unless the user says otherwise."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return str(Path(home, "sg3d_jax", "compiled"))


def configure() -> None:
    """Sets what is set at import."""
    # XLA takes its own compiled programs, read back from disk, for those of another machine.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    keep_compiled_programs()


def keep_compiled_programs() -> None:
    """Names JAX's persistent cache, where neither the environment nor the user's code has."""
    if CACHE_VARIABLE in os.environ:
        return
    if "jax" not in sys.modules:
        os.environ[CACHE_VARIABLE] = cache_folder()
        os.environ.setdefault(LEAST_SECONDS_VARIABLE, str(LEAST_SECONDS))
        return
    config = sys.modules["jax"].config
    if config.jax_compilation_cache_dir is None:
        config.update("jax_compilation_cache_dir", cache_folder())
        config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
