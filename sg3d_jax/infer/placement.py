"""Where the grown nodes of complete graphs stand, told once their edges are chosen."""

import functools
from typing import Final

import numpy as np
from jaxtyping import Array, Float

from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.compiled import Compiled, in_32_bits
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.lanes import Model, padded_around
from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.scene.padding import Capacity

REACH: Final = 0.15  # metres that a node is moved at most


def placed(
    model: Model,
    params: Params,
    graph: SceneGraph,
    num_given: int,
    capacity: Capacity | None = None,
) -> SceneGraph:
    """Returns a complete graph whose grown nodes stand where their edges say, or nearer to it.

    No node is moved by more than `REACH` from where it was drawn. Where geometry decides, what is
    told is right to a centimetre and what is drawn is not; where they are far apart, habits of a
    data set decide, and those Fill knows better.

    Args:
      model: that grew it; if it has no placement, the graph stays as it is.
      params: its parameters.
      graph: host graph, over the pieces of what is observed.
      num_given: how many of its first nodes were given; these stay.
      capacity: to pad it to; None for the bucket in which it would begin to grow.
    """
    if not isinstance(model, Flagg) or model.placement is None:
        return graph
    nodes, drawn = graph.nodes, np.asarray(graph.nodes.position, np.float64)
    packed, centre = padded_around(graph, capacity)
    told = np.asarray(_positions(model, params, packed), np.float64)[: len(drawn)] + centre
    way = np.where(np.arange(len(drawn))[:, None] >= num_given, told - drawn, 0.0)
    share = REACH / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), REACH)
    return graph._replace(nodes=nodes._replace(position=drawn + share * way))


@functools.partial(Compiled, static_argnames=("model",))
def _positions(model: Flagg, params: Params, graph: PackedGraph) -> Float[Array, "N 3"]:
    """Returns where the nodes of a padded graph stand, metres."""
    assert model.placement is not None
    return model.placement.positions(params.placement, in_32_bits(graph))
