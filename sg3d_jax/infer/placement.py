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

TOLD: Final = 0.5  # share of the way from where a node was drawn to where its edges say


def placed(
    model: Model,
    params: Params,
    graph: SceneGraph,
    num_given: int,
    capacity: Capacity | None = None,
) -> SceneGraph:
    """Returns a complete graph whose grown nodes stand where their edges say.

    That is, half way from where they were drawn: the errors of both have little in common.

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
    grown = np.arange(len(drawn))[:, None] >= num_given
    position = np.where(grown, drawn + TOLD * (told - drawn), drawn)
    return graph._replace(nodes=nodes._replace(position=position))


@functools.partial(Compiled, static_argnames=("model",))
def _positions(model: Flagg, params: Params, graph: PackedGraph) -> Float[Array, "N 3"]:
    """Returns where the nodes of a padded graph stand, metres."""
    assert model.placement is not None
    return model.placement.positions(params.placement, in_32_bits(graph))
