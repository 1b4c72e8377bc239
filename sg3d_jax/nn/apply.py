"""Applying a network, its linear layers, and a stack of equal ones: linen, narrowed and quicker."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import errors
from flax import linen as nn
from jaxtyping import Array, Float


def apply(network: nn.Module, params: Any, *inputs: Any) -> Any:
    """Returns what the network computes; linen's own `apply` may also return mutated variables."""
    return network.apply(params, *inputs)


class Dense(nn.Module):
    """linen's linear layer, which for parameters that are given traces nothing but their product.

    linen traces the initial value of every parameter that it is given, to compare the shapes: a
    sixth of the time to trace growing. Here the shape alone is asked for.

    Raises:
      ScopeParamShapeError: a given parameter has another shape.
    """

    features: int
    use_bias: bool = True
    kernel_init: Callable[..., Any] = nn.initializers.lecun_normal()

    @nn.compact
    def __call__(self, inputs: Float[Array, "... D"]) -> Float[Array, "... K"]:
        """Returns W x + b."""
        kernel = self._parameter("kernel", self.kernel_init, (inputs.shape[-1], self.features))
        outputs = _product(inputs, kernel)
        if not self.use_bias:
            return outputs
        bias = self._parameter("bias", nn.initializers.zeros, (self.features,))
        return outputs + jnp.expand_dims(bias, range(inputs.ndim - 1))

    def _parameter(self, name: str, init: Callable[..., Any], shape: tuple[int, ...]) -> Array:
        if not self.has_variable("params", name):
            return self.param(name, init, shape)
        value = self.get_variable("params", name)
        if value.shape != shape:
            raise errors.ScopeParamShapeError(name, "/" + "/".join(self.path), value.shape, shape)
        return value


def _product(inputs: Float[Array, "... D"], kernel: Float[Array, "D K"]) -> Float[Array, "... K"]:
    """Returns inputs @ kernel; of one row as the first of two, the other of zeros.

    XLA would make a loop of single additions of the product of one row with what `stacked` slices,
    a quarter of the time that a CPU takes to grow a floor.
    """
    if inputs.size == kernel.shape[0]:
        rows = jnp.pad(inputs.reshape(1, -1), ((0, 1), (0, 0)))
        return (rows @ kernel)[0].reshape(*inputs.shape[:-1], -1)
    return jax.lax.dot_general(inputs, kernel, (((inputs.ndim - 1,), (0,)), ((), ())))


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
        check_constancy_invariants=False,  # which would trace the layer once more
    )
