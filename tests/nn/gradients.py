"""What a network returns and how that depends on its parameters, in one program."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def with_gradient(network: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a function of the same arguments: the outputs, and the gradient of their squares."""

    def total(params: Any, *inputs: Any) -> tuple[jax.Array, Any]:
        outputs = network(params, *inputs)
        return sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(outputs)), outputs

    differentiated = jax.jit(jax.grad(total, has_aux=True))
    return lambda *arguments: differentiated(*arguments)[::-1]
