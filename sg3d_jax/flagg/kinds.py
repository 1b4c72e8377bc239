"""Kinds: what a grown node is, such as a bedroom among rooms, told from the graph around it.

A kind is no concept of its own: which walls bound a room is a matter of geometry, alike for all
kinds, and a bedroom and a kitchen that compete for one wall must exclude each other as any two
rooms do. So a room is grown as a room, and its kind is found in the graph that it then is part of,
with a probability for each: by its shape, its neighbours, and what stands in it.

Source: ours; the paper names classes that it does not know as future work.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.gine import NodeHead
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import Ontology


@dataclasses.dataclass(frozen=True)
class Kinds:
    """The model of kinds: a GINE with logits of every node; pure functions on one padded graph.

    Attributes:
      width: of the GINE.
      layers: of the GINE.
      ontology: the concepts.
    """

    width: int
    layers: int
    ontology: Ontology

    @property
    def most(self) -> int:
        """K, the most kinds that a grown concept has; with 0 there is nothing to tell."""
        return int(np.max(self.ontology.num_kinds * ~self.ontology.is_observed))

    @property
    def network(self) -> NodeHead:
        """The network."""
        return NodeHead(self.width, self.layers, self.most)

    def init(self, key: Array, graph: SceneGraph) -> Any:
        """Draws initial parameters."""
        return self.network.init(key, graph)

    def logits(self, params: Any, graph: SceneGraph) -> Float[Array, "N K"]:
        """Returns the logits of the kinds of every node of a padded graph, -inf beyond its own."""
        has = jnp.asarray(self.ontology.num_kinds)[graph.nodes.label]
        logits = apply(self.network, params, graph)
        return jnp.where(jnp.arange(self.most)[None] < has[:, None], logits, -jnp.inf)


def kind_loss(logits: Float[Array, "N K"], seen: SceneGraph, true: SceneGraph) -> Float[Array, ""]:
    """Returns the mean cross-entropy over grown nodes whose kind is known; zero if there are none.

    Args:
      logits: of `Kinds.logits`, of the graph that was seen.
      seen: padded, perturbed: what it takes for another concept has no kind.
      true: the same nodes as they are.
    """
    nodes = true.nodes
    known = nodes.mask & ~nodes.observed & (nodes.kind > 0) & (seen.nodes.label == nodes.label)
    safe = jnp.where(known[:, None], logits, 0.0)
    kind = jnp.maximum(nodes.kind.astype(jnp.int32) - 1, 0)
    loss = -jnp.take_along_axis(jax.nn.log_softmax(safe), kind[:, None], axis=1)[:, 0]
    return jnp.sum(jnp.where(known, loss, 0.0)) / jnp.maximum(jnp.sum(known), 1)
