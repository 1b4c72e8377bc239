"""Where a result comes from: the command, the code and the machine."""

import os
import platform
import shlex
import sys
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final

from sg3d_jax.origin import commit

arguments: Final[ContextVar[tuple[str, ...]]] = ContextVar("arguments", default=())


def provenance() -> dict[str, Any]:
    """Returns what a result file says of its origin."""
    import jax

    return {
        "command": shlex.join(["sg3d", *arguments.get()]),
        "commit": commit(),
        "machine": {
            "processor": _processor(),
            "cores": os.cpu_count(),
            "device": jax.devices()[0].device_kind,
        },
    }


def provenance_of_script() -> dict[str, Any]:
    """Returns the same for a script of benchmarks/, its command without folders of this machine."""
    script, *given = (Path(word).name for word in sys.argv)
    return {**provenance(), "command": " ".join([f"python benchmarks/{script}", *given])}


def _processor() -> str:
    """Returns the name of the processor as the system has it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
