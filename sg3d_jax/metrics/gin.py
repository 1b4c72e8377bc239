"""Random graph isomorphism networks (GIN): untrained, they still tell graphs apart.

Their parameters are drawn from a seed. It belongs to the metric: scores of other networks differ.
"""

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

HIDDEN: Final = 35
NUM_LAYERS: Final = 2


class Dense(NamedTuple):
    """An affine map."""

    weight: Float[Array, "I O"]  # of the product
    bias: Float[Array, " O"]  # added to it


class Layer(NamedTuple):
    """What a GIN applies to a node and the sum of its neighbours."""

    inner: Dense  # applied first
    outer: Dense  # applied second


GIN = tuple[Layer, ...]


def init_gin(key: PRNGKeyArray) -> GIN:
    """Draws a network: orthogonal weights, biases uniform within 1 / sqrt(inputs).

    Source: Thompson et al., "On evaluation metrics for graph generative models", ICLR 2022, whose
    code FLAGG's is: "three" layers, the input being the first.
    """
    sizes = (1, *[HIDDEN] * NUM_LAYERS)
    keys = jax.random.split(key, (NUM_LAYERS, 2))
    return tuple(
        Layer(_init_dense(inner, size), _init_dense(outer, HIDDEN))
        for size, (inner, outer) in zip(sizes, keys, strict=False)
    )


def gin_embedding(
    gin: GIN, adjacency: Bool[Array, "N N"], mask: Bool[Array, " N"]
) -> Float[Array, " F"]:
    """Embeds one padded graph.

    Args:
      gin: the network.
      adjacency: symmetric, without loops; False at padding.
      mask: True for real nodes.

    Returns:
      The sums over nodes of what each layer finds, one layer behind the other: F = 70.

    Source: Xu et al., "How powerful are graph neural networks?", ICLR 2019, Eq. 4.1 with epsilon 0.
    A node starts with its degree, counted in both directions: twice its neighbours.
    Differs: FLAGG's networks hold untrained batch norms, which divide by sqrt(1 + 1e-5); ours none.
    """
    links = adjacency.astype(jnp.result_type(float))
    hidden = 2 * jnp.sum(links, axis=1, keepdims=True)
    pooled = []
    for layer in gin:
        hidden = hidden + links @ hidden
        for dense in layer:
            hidden = jax.nn.relu(hidden @ dense.weight + dense.bias[None, :])
        pooled.append(jnp.sum(jnp.where(mask[:, None], hidden, 0.0), axis=0))
    return jnp.concatenate(pooled)


def _init_dense(key: PRNGKeyArray, num_inputs: int) -> Dense:
    """Draws an affine map to `HIDDEN` values, in float32 whatever precision is switched on."""
    weight_key, bias_key = jax.random.split(key)
    bound = num_inputs**-0.5
    weight = jax.nn.initializers.orthogonal()(weight_key, (num_inputs, HIDDEN), jnp.float32)
    return Dense(weight, jax.random.uniform(bias_key, (HIDDEN,), jnp.float32, -bound, bound))
