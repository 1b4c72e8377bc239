"""Arrays in an npz file: numpy's, never a pickle, and none that nobody asked for.

A small file may hold, or claim to hold, arrays that no memory takes: what is in it is looked at
before any of it is read.
"""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

MAX_BYTES: Final = 2**29  # of all arrays of a file
NPY: Final = ".npy"


def read_arrays(path: str | Path, is_known: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """Returns all arrays of an npz file, whose checksums are right.

    Args:
      path: the file.
      is_known: of a name, whether an array may be called so.

    Raises:
      ValueError: one sentence: no such file, damaged, too large, or with something that is unknown.
    """
    if not Path(path).is_file():
        raise ValueError(f"{path}: no such file, expected an npz file")
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            problem = _problem(members, is_known)
            arrays = {} if problem else {_name(one): _array(archive, one) for one in members}
    except Exception as error:  # a damaged archive, or array, raises almost anything
        expected = "an npz file of plain arrays, or a damaged one"
        raise ValueError(f"{path}: not {expected}") from error
    if problem:
        raise ValueError(f"{path}: {problem}")
    return arrays


def _name(member: zipfile.ZipInfo) -> str:
    return member.filename.removesuffix(NPY)


def _problem(members: list[zipfile.ZipInfo], is_known: Callable[[str], bool]) -> str | None:
    """Returns why an archive with such members is not read."""
    seen = set[str]()
    for member in members:
        name = _name(member)
        if not member.filename.endswith(NPY) or not is_known(name):
            return f"holds {member.filename!r:.60}, which is unknown, expected known arrays alone"
        if name in seen:
            return f"array {name:.60} is there twice, expected once"
        seen.add(name)
        if member.flag_bits & 1 or member.compress_type not in (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        ):
            return f"array {name:.60} is encrypted or packed otherwise, expected deflate"
    total = sum(member.file_size for member in members)
    if total > MAX_BYTES:
        return f"its arrays have {total} bytes, expected {MAX_BYTES} at most"
    return None


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """Returns an array that is as large as its member says."""
    with archive.open(member) as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
        if file.read(1):
            raise ValueError(f"{member.filename} goes on behind its array")
    return array
