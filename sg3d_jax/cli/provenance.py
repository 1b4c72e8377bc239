"""Where a result comes from: the command, the code and the machine."""

import os
import platform
import shlex
import subprocess
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final

import sg3d_jax

CLONE: Final = Path(__file__).parents[2]
arguments: Final[ContextVar[tuple[str, ...]]] = ContextVar("arguments", default=())


def provenance() -> dict[str, Any]:
    """Returns what a result file says of its origin."""
    import jax

    return {
        "command": shlex.join(["sg3d", *arguments.get()]),
        "commit": _commit(),
        "machine": {
            "processor": _processor(),
            "cores": os.cpu_count(),
            "device": jax.devices()[0].device_kind,
        },
    }


def _commit() -> str:
    """Returns the commit of a clone, with "-dirty" if files differ from it; else the version."""
    if not (CLONE / ".git").exists():
        return sg3d_jax.__version__
    describe = ["git", "-C", str(CLONE), "describe", "--always", "--dirty"]
    try:
        run = subprocess.run(describe, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError):  # no git, or a clone of somebody else
        return sg3d_jax.__version__
    return run.stdout.strip()


def _processor() -> str:
    """Returns the name of the processor as the system has it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
