"""Halt: whether the graph is complete.

Source: paper, p_theta^H(H_t | G_t) in Sec. "FLAGG for graph extension".
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.gine import GraphHead
from sg3d_jax.scene.graph import SceneGraph


class Halt(NamedTuple):
    """The halting model: two pure functions on one padded graph.

    Attributes:
      init: (key, graph) -> params.
      logit: (params, graph) -> float[], of the chance that the graph is complete.
    """

    init: Callable[[Key[Array, ""], SceneGraph], Any]
    logit: Callable[[Any, SceneGraph], Float[Array, ""]]


def make_halt(width: int, layers: int) -> Halt:
    """Builds the halting model: a GINE with a head of one logit.

    Source: paper. Differs: FLAGG's release uses an MLP on graph-level features.
    """
    network = GraphHead(width, layers, 1)

    def logit(params: Any, graph: SceneGraph) -> Float[Array, ""]:
        return apply(network, params, graph)[0]

    return Halt(init=network.init, logit=logit)


def halt_loss(
    logit: Float[Array, ""], complete: Bool[Array, ""], inserted: Bool[Array, ""]
) -> Float[Array, ""]:
    """Returns the binary cross-entropy; zero for the plane graph, which Halt never sees."""
    sign = jnp.where(complete, -1.0, 1.0)
    return jnp.where(inserted, jax.nn.softplus(sign * logit), 0.0)


def draw_halt(key: Key[Array, ""], logit: Float[Array, ""], threshold: bool) -> Bool[Array, ""]:
    """Decides by a threshold at probability one half, or by a draw as FLAGG does."""
    drawn = jax.random.uniform(key) < jax.nn.sigmoid(logit)
    return jnp.where(threshold, logit > 0, drawn)
