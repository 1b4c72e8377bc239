"""Applying a network, and a stack of equal layers: where linen's own interface is narrowed."""

from typing import Any

import jax
from flax import linen as nn


def apply(network: nn.Module, params: Any, *inputs: Any) -> Any:
    """Returns what the network computes; linen's own `apply` may also return mutated variables."""
    return network.apply(params, *inputs)


def stacked(layer: type[nn.Module], number: int, in_axes: Any = nn.broadcast) -> Any:
    """Returns a module class that runs equal layers one after another.

    It is compiled as one layer in a loop, whatever their number; their parameters are stacked along
    a first axis. For the gradient, products of matrices are kept and all else is computed again,
    which on a CPU takes no longer than to keep it, and two thirds of the memory.

    Args:
      layer: its `__call__(state, *inputs)` returns (state, None).
      number: how many of them.
      in_axes: of the inputs: `nn.broadcast` for what all layers see, else the axis of the layers.
    """
    policy = jax.checkpoint_policies.dots_saveable
    return nn.scan(
        nn.remat(layer, policy=policy, prevent_cse=False),
        variable_axes={"params": 0},
        split_rngs={"params": True},
        in_axes=in_axes,
        length=number,
    )
