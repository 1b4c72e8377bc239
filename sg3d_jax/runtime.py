"""What a Python that uses this package is set to: compiled programs kept, memory not given back.

`bin/sg3d` can say both before Python starts; a script or a notebook cannot, so the package says
them when it is imported. What the user has said is left alone. JAX is not imported here.
"""

import ctypes
import os
import sys
from pathlib import Path
from typing import Final

CACHE_VARIABLE: Final = "JAX_COMPILATION_CACHE_DIR"
LEAST_SECONDS_VARIABLE: Final = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
LEAST_SECONDS: Final = 0.3  # of compiling, that a program is worth keeping
# Of mallopt(3): numbers of glibc's malloc.h, and the largest values that its int arguments hold.
TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3
KEPT_BYTES: Final = 2**31 - 1
TOP_PAD_BYTES: Final = 64 * 2**20


def cache_folder() -> str:
    """Returns where compiled programs are kept, unless the user says otherwise."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return str(Path(home, "sg3d_jax", "compiled"))


def configure() -> None:
    """Keeps compiled programs between processes, and large temporaries mapped between steps."""
    # XLA takes its own compiled programs, read back from disk, for those of another machine.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    keep_compiled_programs()
    keep_memory()


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


def keep_memory() -> None:
    """Tells glibc not to return large temporaries to the system, only to fault them in again.

    Nothing happens where the environment tunes malloc, or on another C library.
    """
    if "GLIBC_TUNABLES" in os.environ or not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for parameter, value in (
            (MMAP_THRESHOLD, KEPT_BYTES),
            (TRIM_THRESHOLD, KEPT_BYTES),
            (TOP_PAD, TOP_PAD_BYTES),
        ):
            mallopt(parameter, value)
