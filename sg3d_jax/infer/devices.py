"""What the devices of this process take side by side: lanes, batches, and shares of a batch."""

import os
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh

from sg3d_jax.scene.padding import Capacity

LANES = (16, 64, 256, 1024)  # graphs that an accelerator grows together, by how many there are
LANE_NODES = 65_536  # nodes of all of them at most: kernels then take longer than starting them
LANE_BYTES = 2**18  # memory that there must be for each of these: two to ten times what it takes


def num_lanes(capacity: Capacity, count: int = LANES[-1]) -> int:
    """Returns how many graphs of a bucket a device grows together by default, of so many in all.

    An accelerator has few places for few graphs: those that nothing fills cost as much.
    A core of a CPU draws a block of four floors of S-F in a quarter less time than four of one, of
    cities not, and waiting for one another takes that back.
    """
    if jax.default_backend() == "cpu":
        return 1
    memory = device_memory()
    nodes = LANE_NODES if memory is None else min(LANE_NODES, memory // LANE_BYTES)
    enough = next((lanes for lanes in LANES if lanes >= count), LANES[-1])
    return max(1, min(enough, nodes // capacity.nodes))


def device_memory() -> int | None:
    """Returns how many bytes JAX may take of the first device's memory; None if it does not say."""
    stats = jax.local_devices()[0].memory_stats()
    return stats and stats.get("bytes_limit")


def num_workers() -> int:
    """Returns how many batches are under way side by side: on a CPU as many as there are cores.

    On an accelerator they are compiled side by side, and what the host does for some takes no time
    from the others.
    """
    if jax.default_backend() != "cpu":
        return 4
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def lane_mesh() -> Mesh | None:
    """Returns the devices that a batch is dealt to, all of this process; None if there is but one.

    The devices of a CPU are the same cores, which threads use already.
    """
    told: Any = jax.config
    if jax.default_backend() == "cpu" or told.jax_default_device or jax.local_device_count() == 1:
        return None
    return Mesh(np.array(jax.local_devices()), ("lanes",))
