"""Insert: how many nodes come next.

Source: paper, p_theta^I(m_t | G_{t-1}) in Sec. "FLAGG for graph extension".
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.gine import GraphHead
from sg3d_jax.scene.graph import SceneGraph


class Insert(NamedTuple):
    """The insertion model: two pure functions on one padded graph.

    Attributes:
      init: (key, graph) -> params.
      logits: (params, graph) -> float[K], one logit a coin.
    """

    init: Callable[[Key[Array, ""], SceneGraph], Any]
    logits: Callable[[Any, SceneGraph], Float[Array, " K"]]


def make_insert(width: int, layers: int, num_coins: int) -> Insert:
    """Builds the insertion model: a GINE with a head of one logit a coin.

    Where there is only one block size there is nothing to predict, and the model is a constant
    without parameters, as in FLAGG's sequential schedule.
    """
    if num_coins == 1:
        return Insert(init=lambda key, graph: {}, logits=lambda params, graph: jnp.zeros(1))
    network = GraphHead(width, layers, num_coins)

    def logits(params: Any, graph: SceneGraph) -> Float[Array, " K"]:
        return apply(network, params, graph)

    return Insert(init=network.init, logits=logits)


def insert_loss(logits: Float[Array, " K"], target: Float[Array, " K"]) -> Float[Array, ""]:
    """Returns KL(target || softmax(logits)); zero for the zero target of a complete graph.

    Source: FLAGG's insertion loss.
    """
    log_target = jnp.log(jnp.maximum(target, 1e-8))
    return jnp.sum(target * (log_target - jax.nn.log_softmax(logits)))


def draw_size(
    key: Key[Array, ""], logits: Float[Array, " K"], coins: tuple[int, ...]
) -> Int[Array, ""]:
    """Draws the size of the next block."""
    return jnp.asarray(coins, jnp.int32)[jax.random.categorical(key, logits)]
