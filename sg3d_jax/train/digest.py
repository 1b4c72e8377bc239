"""Digests of arrays: whether they are, bit for bit, those that they were."""

import hashlib
from typing import Any

import jax
import numpy as np


def digest_of(tree: Any) -> str:
    """Returns a digest of the arrays and numbers of a tree: their order, types, shapes and bytes.

    Args:
      tree: nested tuples, lists and dictionaries; scene graphs and training states are some.
    """
    digest = hashlib.blake2b(digest_size=16)
    for leaf in jax.tree.leaves(tree):
        array = np.asarray(leaf)
        digest.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()
