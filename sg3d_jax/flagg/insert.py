"""Insert: how many nodes come next.

Source: paper, p_theta^I(m_t | G_{t-1}) in Sec. "FLAGG for graph extension".
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.gine import GraphHead
from sg3d_jax.scene.graph import SceneGraph


@dataclasses.dataclass(frozen=True)
class Insert:
    """The insertion model: a GINE with a head of one logit a coin; pure functions on one graph.

    Where there is only one block size there is nothing to predict, and the model is a constant
    without parameters, as in FLAGG's sequential schedule.

    Attributes:
      width: of the GINE.
      layers: of the GINE.
      num_coins: K, block sizes to choose from.
    """

    width: int
    layers: int
    num_coins: int

    @property
    def network(self) -> GraphHead:
        """The network."""
        return GraphHead(self.width, self.layers, self.num_coins)

    def init(self, key: Key[Array, ""], graph: SceneGraph) -> Any:
        """Draws initial parameters."""
        return {} if self.num_coins == 1 else self.network.init(key, graph)

    def logits(self, params: Any, graph: SceneGraph) -> Float[Array, " K"]:
        """Returns one logit a coin for the next block of a padded graph."""
        return jnp.zeros(1) if self.num_coins == 1 else apply(self.network, params, graph)


def insert_loss(logits: Float[Array, " K"], target: Float[Array, " K"]) -> Float[Array, ""]:
    """Returns KL(target || softmax(logits)); zero for the zero target of a complete graph.

    Source: FLAGG's insertion loss.
    """
    log_target = jnp.log(jnp.maximum(target, 1e-8))
    return jnp.sum(target * (log_target - jax.nn.log_softmax(logits)))


def draw_size(
    key: Key[Array, ""], logits: Float[Array, " K"], coins: tuple[int, ...]
) -> Int[Array, ""]:
    """Draws the size of the next block; with one coin there is nothing to draw."""
    if len(coins) == 1:
        return jnp.int32(coins[0])
    return jnp.asarray(coins, jnp.int32)[jax.random.categorical(key, logits)]
