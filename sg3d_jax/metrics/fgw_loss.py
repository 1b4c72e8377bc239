"""FGW as a loss: its gradient with respect to positions and soft labels.

The plan minimises the energy, so a small change of the plan does not change the energy, and the
derivative of the minimum is that of the energy at a fixed plan (envelope theorem). The gradient is
exact wherever the best plan is unique, costs one product after the solver, and needs nothing of it.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sg3d_jax.metrics.fgw_problem import (
    ALPHA,
    PAPER_SCALE,
    Loss,
    Scalar,
    Scale,
    check_choices,
    check_pair,
    pose,
)
from sg3d_jax.metrics.frank_wolfe import from_product, minimise
from sg3d_jax.scene.graph import SceneGraph

SOFTENING = 1e-12  # of squared distances, whose root has no gradient at zero


def fgw_loss(
    position: Float[Array, "N 3"],
    label: Float[Array, "N C"],
    generated: SceneGraph,
    truth: SceneGraph,
    alpha: Scalar = ALPHA,
    scale: Scale = PAPER_SCALE,
    loss: Loss = "absolute",
) -> Float[Array, ""]:
    """Returns the FGW distance to the truth of a graph with other positions and labels.

    Unlike `fgw`, it leaves all positions where they are, since `position` is what is differentiated
    and so on the device: bring graphs that stand far from the origin there first, `position` with
    them (`moved_by(graph, -centre_of_observed(truth))` of scene.padding, on the host).

    Args:
      position: centroids, metres, in place of those of `generated`.
      label: distributions over the concepts, in place of the labels of `generated`. One-hot rows
        give `fgw`, up to a softening of 1e-6 a distance.
      generated: padded; gives the nodes and part-of edges, which are constants.
      truth: padded to the same capacity, of the same concepts. What is observed in it sets the
        origin and the unit of positions.
      alpha: weight of the structure, from 0 to 1.
      scale: what counts as distance 1 in metres and in hops.
      loss: how two hop distances differ: "absolute" or "squared".

    Returns:
      A scalar, differentiable with respect to `position` and `label`; gradients are zero at padding
      and finite everywhere. `vmap` over pairs.

    Raises:
      ValueError: the graphs have different ontologies or capacities, `alpha` is outside 0 to 1, or
        there is no such loss.

    Source: paper, Sec. "Metrics", Eq. for d_FGW.
    Differs: |x| is sqrt(|x|^2 + 1e-12), whose gradient is zero, not undefined, at zero.
    """
    check_choices(alpha, loss)
    check_pair(generated, truth)
    return _fgw_loss(position, label, generated, truth, alpha, scale, loss)


@partial(jax.jit, static_argnames="loss")
def _fgw_loss(
    position: Float[Array, "N 3"],
    label: Float[Array, "N C"],
    generated: SceneGraph,
    truth: SceneGraph,
    alpha: Scalar,
    scale: Scale,
    loss: Loss,
) -> Float[Array, ""]:
    """Returns the loss of a pair that has been checked."""
    placed = generated._replace(nodes=generated.nodes._replace(position=position))
    problem = pose(placed, truth, scale, label, SOFTENING)
    fixed, weight = jax.lax.stop_gradient((problem, alpha))
    found = minimise(fixed, weight, loss, from_product(fixed, loss))
    w = jnp.sum(problem.features * found.plan)
    gw = jnp.sum(found.structure * found.plan)
    return (1 - alpha) * w + alpha * gw
