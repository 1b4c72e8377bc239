"""Applying a network: the one place where linen's return type is narrowed."""

from typing import Any

from flax import linen as nn


def apply(network: nn.Module, params: Any, *inputs: Any) -> Any:
    """Returns what the network computes; linen's own `apply` may also return mutated variables."""
    return network.apply(params, *inputs)
