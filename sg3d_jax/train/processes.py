"""Several processes that train one run: how what one of them knows becomes known to all.

All take the same steps on their own devices. The first alone reads and writes the run directory.
Where this process is alone, nothing is sent.
"""

import contextlib
from collections.abc import Generator
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from sg3d_jax.distributed import gathered

T = TypeVar("T")


@contextlib.contextmanager
def together() -> Generator[None]:
    """Ends, in all processes at once, a part of a run in which one may fail while others do not.

    Raises:
      ValueError: another process has failed; what failed here is raised as it is.
    """
    try:
        yield
    except BaseException:
        _all_are_well(False)
        raise
    if not _all_are_well(True):
        raise ValueError("another process of this run has failed, expected it to say why")


def _all_are_well(here: bool) -> bool:
    """Returns whether all processes say so, once all have been asked."""
    return all(gathered([here]))


def from_first(value: T) -> T:
    """Returns the value that the first process has."""
    return gathered([value])[0]


def on_all_devices(tree: T, mesh: Mesh) -> T:
    """Returns arrays, the same in every process, on all devices of a mesh.

    What is on one of them already is not copied there.
    """
    sharding = NamedSharding(mesh, PartitionSpec())
    if jax.process_count() == 1:
        return jax.device_put(tree, sharding)

    def placed(leaf: Any) -> Any:
        if jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            data, kind = jax.random.key_data(leaf), jax.random.key_impl(leaf)
            return jax.random.wrap_key_data(placed(data), impl=kind)
        return jax.make_array_from_process_local_data(sharding, np.asarray(leaf))

    return jax.tree.map(placed, tree)
