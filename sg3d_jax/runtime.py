"""What a Python that uses this package is set to, when it is imported: compiled programs are kept.

A script or a notebook then starts as quickly as the command line. What the user has said is left
alone. JAX is not imported here.

Not set here is malloc: what helps are huge pages (10,000 page faults a training step become 50),
and glibc takes them from GLIBC_TUNABLES alone, before Python starts, as `bin/bootstrap` sets it.
`mallopt` from a running Python has been tried: 10,000 faults as before.
"""

import importlib
import os
import sys
import time
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Final

LOG_VARIABLE: Final = "TF_CPP_MIN_LOG_LEVEL"
JAX_SAYS: Final = "1"  # in its place
CACHE_VARIABLE: Final = "JAX_COMPILATION_CACHE_DIR"
LEAST_SECONDS_VARIABLE: Final = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
LEAST_SECONDS: Final = 0.3  # of compiling, that a program is worth keeping
ZSTANDARD: Final = b"\x28\xb5\x2f\xfd"  # how what it has compressed begins
CHECKED: Final = "checked"  # the file whose age says when entries of the cache were last checked


def cache_folder() -> str:
    """Returns where compiled programs are kept, unless the user says otherwise."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return str(Path(home, "sg3d_jax", "compiled"))


def configure() -> None:
    """Sets what is set at import."""
    silence_xla()
    keep_compiled_programs()


def silence_xla() -> None:
    """Leaves out what XLA logs, unless the user has said otherwise.

    It takes its own compiled programs, read back from disk, for those of another machine, and says
    so in kilobytes. The variable is read when JAX is imported, which sets it to `JAX_SAYS` where
    nobody has. Then JAX's option tells XLA, which keeps to it when the option, and with it Python's
    loggers, are again as before.
    """
    if (jax := sys.modules.get("jax")) is None:
        os.environ.setdefault(LOG_VARIABLE, "3")
    elif os.environ.get(LOG_VARIABLE) == JAX_SAYS and jax.config.jax_logging_level == "NOTSET":
        for level in ("CRITICAL", "NOTSET"):
            jax.config.update("jax_logging_level", level)


def keep_compiled_programs() -> None:
    """Names JAX's persistent cache, where neither the environment nor the user's code has."""
    if CACHE_VARIABLE in os.environ:
        return
    folder = cache_folder()
    if "jax" not in sys.modules:
        os.environ[CACHE_VARIABLE] = folder
        os.environ.setdefault(LEAST_SECONDS_VARIABLE, str(LEAST_SECONDS))
    else:
        config = sys.modules["jax"].config
        if config.jax_compilation_cache_dir is not None:
            return
        config.update("jax_compilation_cache_dir", folder)
        config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
    with suppress(OSError):  # no folder yet, or one that is not ours to write in
        remove_damaged(Path(folder))


def remove_damaged(folder: Path) -> None:
    """Removes compiled programs that are cut short, as of a process that was killed.

    JAX writes them under their final name, and never writes again what is there: a half program
    would be compiled anew in every process, with a warning. Whole ones are known by decompressing
    them, in 6 ms each, so only those are checked that are newer than the last check; where there
    are none, this takes 4 ms with 900 programs.
    """
    checked, now = folder / CHECKED, time.time()
    since = checked.stat().st_mtime if checked.exists() else 0.0
    new = [entry for entry in os.scandir(folder) if entry.name.endswith("-cache")]
    new = [Path(entry.path) for entry in new if entry.stat().st_mtime >= since]
    if not new:
        return
    for path in new:
        if not _is_whole(path.read_bytes()):
            path.unlink(missing_ok=True)
    checked.touch()
    os.utime(checked, (now, now))


def _is_whole(program: bytes) -> bool:
    """Returns whether a compiled program can be decompressed, by whichever way JAX chose for it."""
    try:
        if program.startswith(ZSTANDARD):
            importlib.import_module("compression.zstd").decompress(program)
        else:
            zlib.decompress(program)
    except ImportError:  # Python before 3.14, with the package zstandard: not checked
        return True
    except Exception:
        return False
    return True
