"""Placement: where the grown nodes of a graph stand, told by its edges and what is observed.

Fill draws centroids as it draws edges, block by block, each with what was there by then. A drawn
centroid is off by what the others that might have been drawn are, and by what the denoiser cannot
measure. Once all edges are chosen, there is one best place: this is the regression that tells it.
As FD4 does, it sees topology first and geometry second; as it draws nothing, it takes one pass.

Source: ours; the order is that of FD4 (paper, Sec. "Generating edges, labels and centroids").
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.embed import safe_norm
from sg3d_jax.nn.vector_gine import VectorGINE
from sg3d_jax.scene.graph import SceneGraph


@dataclasses.dataclass(frozen=True)
class Placement:
    """The model of centroids given all else; pure functions on one padded graph.

    Attributes:
      width: scalars of a node.
      channels: vectors of a node.
      layers: of the network.
    """

    width: int
    channels: int
    layers: int

    @property
    def network(self) -> VectorGINE:
        """The network."""
        return VectorGINE(self.width, self.channels, self.layers)

    def init(self, key: Array, graph: SceneGraph) -> Any:
        """Draws initial parameters."""
        return self.network.init(key, graph)

    def positions(self, params: Any, graph: SceneGraph) -> Float[Array, "N 3"]:
        """Returns where the nodes of a padded graph stand, metres.

        Where the grown nodes of `graph` stand does not matter, but for those without parts; what is
        observed stays. Proximity edges do not matter either.
        """
        return apply(self.network, params, graph)


def placement_loss(
    position: Float[Array, "N 3"], seen: SceneGraph, true: SceneGraph
) -> Float[Array, ""]:
    """Returns the mean distance to the true centroids, metres; zero if nothing is grown.

    The distance and not its square: FGW counts distances, and where two places are as likely, one
    of them is better than the middle.

    Args:
      position: of `Placement.positions`, of the graph that was seen.
      seen: padded, perturbed: what it takes for another concept is not counted.
      true: the same nodes as they are.
    """
    nodes = true.nodes
    counted = nodes.mask & ~nodes.observed & (seen.nodes.label == nodes.label)
    distance = safe_norm(position - nodes.position)
    return jnp.sum(jnp.where(counted, distance, 0.0)) / jnp.maximum(jnp.sum(counted), 1)
