"""A split of a data set as a few stacks of padded graphs on the device, one a size bucket."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from sg3d_jax.data import registry
from sg3d_jax.data.splits import split_of
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.padding import Capacity, stack
from sg3d_jax.scene.proximity import connect_planes
from sg3d_jax.train.config import DataConfig

EDGE_ROUNDING = 32


def load_split(config: DataConfig, part: str) -> list[SceneGraph]:
    """Returns the host graphs of "train", "validation", "test" or "all".

    Raises:
      ValueError: there is no such data set, or it has no graphs for this part.
    """
    graphs, header = registry.load(config.name, config.num_graphs, config.seed)
    if part == "all":
        return graphs
    chosen = getattr(split_of(header, len(graphs), config.split_seed), part)
    if not len(chosen):
        raise ValueError(f"{config.name}: none of its {len(graphs)} graphs is for {part}")
    return [graphs[i] for i in chosen]


def stack_by_size(graphs: Sequence[SceneGraph], capacities: Sequence[int]) -> list[SceneGraph]:
    """Stacks complete host graphs with their proximity edges, each in the smallest bucket.

    Args:
      graphs: host graphs.
      capacities: node capacities in increasing order.

    Returns:
      One stack a bucket that is used; as many edge slots as its graphs need.

    Raises:
      ValueError: a graph is larger than the largest capacity.
    """
    sizes = np.array([len(graph.nodes.label) for graph in graphs])
    if sizes.max() > max(capacities):
        raise ValueError(
            f"graph {sizes.argmax()} has {sizes.max()} nodes, more than the largest training "
            f"capacity, {max(capacities)}"
        )
    bucket_of = np.searchsorted(np.asarray(capacities), sizes)
    stacks = []
    for bucket in np.unique(bucket_of):
        members = [graphs[i] for i in np.flatnonzero(bucket_of == bucket)]
        nodes = capacities[bucket]
        room = nodes * min(nodes, 20)  # more than any union of 10 nearest neighbours has used
        connected = jax.jit(jax.vmap(connect_planes))(stack(members, Capacity(nodes, room)))
        needed = int(jnp.max(connected.n_edge[:, 0]))
        stacks.append(_with_edge_slots(connected, -(-needed // EDGE_ROUNDING) * EDGE_ROUNDING))
    return stacks


def _with_edge_slots(graphs: SceneGraph, slots: int) -> SceneGraph:
    """Drops the edge slots that no graph of the stack uses."""
    real = graphs.n_edge[:, 0]
    return graphs._replace(
        edges=jax.tree.map(lambda leaf: leaf[:, :slots], graphs.edges),
        senders=graphs.senders[:, :slots],
        receivers=graphs.receivers[:, :slots],
        n_edge=jnp.stack([real, slots - real], axis=-1),
    )
