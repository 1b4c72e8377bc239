"""Which code this is: its version, the commit of a clone, and a digest of its files."""

import hashlib
import subprocess
from pathlib import Path
from typing import Final

VERSION: Final = "0.2.0"
PACKAGE: Final = Path(__file__).parent
CLONE: Final = PACKAGE.parent


def commit() -> str:
    """Returns the commit of a clone, with "-dirty" if files differ from it; else the version."""
    if not (CLONE / ".git").exists():
        return VERSION
    describe = ["git", "-C", str(CLONE), "describe", "--always", "--dirty"]
    try:
        run = subprocess.run(describe, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError):  # no git, or a clone of somebody else
        return VERSION
    return run.stdout.strip()


def code() -> str:
    """Returns a digest of the Python files of the package: what a commit leaves open when dirty."""
    digest = hashlib.blake2b(digest_size=16)
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
