"""Halt: whether the graph is complete.

Source: paper, p_theta^H(H_t | G_t) in Sec. "FLAGG for graph extension".
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.gine import GraphHead
from sg3d_jax.scene.graph import SceneGraph


@dataclasses.dataclass(frozen=True)
class Halt:
    """The halting model: a GINE with a head of one logit; pure functions on one padded graph.

    Source: paper. Differs: FLAGG's release uses an MLP on graph-level features.

    Attributes:
      width: of the GINE.
      layers: of the GINE.
    """

    width: int
    layers: int

    @property
    def network(self) -> GraphHead:
        """The network."""
        return GraphHead(self.width, self.layers, 1)

    def init(self, key: Key[Array, ""], graph: SceneGraph) -> Any:
        """Draws initial parameters."""
        return self.network.init(key, graph)

    def logit(self, params: Any, graph: SceneGraph) -> Float[Array, ""]:
        """Returns the logit of the chance that a padded graph is complete."""
        return apply(self.network, params, graph)[0]


def halt_loss(
    logit: Float[Array, ""], complete: Bool[Array, ""], inserted: Bool[Array, ""]
) -> Float[Array, ""]:
    """Returns the binary cross-entropy; zero for the plane graph, which Halt never sees."""
    sign = jnp.where(complete, -1.0, 1.0)
    return jnp.where(inserted, jax.nn.softplus(sign * logit), 0.0)


def draw_halt(key: Key[Array, ""], logit: Float[Array, ""], threshold: bool) -> Bool[Array, ""]:
    """Decides by a threshold at probability one half, or by a draw as FLAGG does."""
    return logit > 0 if threshold else jax.random.uniform(key) < jax.nn.sigmoid(logit)
