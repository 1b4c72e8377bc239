"""Entropic FGW through ott-jax: a smooth plan, and another way to a good one.

ott linearises GW + penalty W around the plan, solves the linear problem by Sinkhorn with an
entropy, and repeats. Its losses allow one matrix product, f(a) + g(b) - h(a) k(b), and |a - b| is
not of that form; a subclass of its problem brings our sum over thresholds instead.

This module imports ott, which takes seconds: nothing else of the package does.

Source: Peyré, Cuturi and Solomon, "Gromov-Wasserstein averaging of kernel and distance matrices",
ICML 2016. Altschuler, Weed and Rigollet, "Near-linear time approximation algorithms for optimal
transport via Sinkhorn iteration", NeurIPS 2017, Algorithm 2: rounding.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int
from ott.geometry.epsilon_scheduler import Epsilon
from ott.geometry.geometry import Geometry
from ott.problems.linear.linear_problem import LinearProblem
from ott.problems.quadratic.quadratic_problem import QuadraticProblem
from ott.solvers.linear.sinkhorn import Sinkhorn
from ott.solvers.quadratic.gromov_wasserstein import GromovWasserstein

from sg3d_jax.metrics.fgw import FGW, score_of
from sg3d_jax.metrics.fgw_problem import (
    ALPHA,
    PAPER_SCALE,
    Loss,
    Problem,
    Scalar,
    Scale,
    centred,
    check_choices,
    check_pair,
    mass_of_nodes,
    pose,
    structure_at_plan,
)
from sg3d_jax.metrics.frank_wolfe import from_plan, minimise
from sg3d_jax.scene.graph import SceneGraph

EPSILONS = (0.3, 0.1, 0.03, 0.01)
SINKHORN_ITERATIONS = 500
SINKHORN_THRESHOLD = 1e-3  # of the marginals, L1


def fused_penalty(alpha: Scalar) -> Scalar:
    """Returns the weight of W in ott's problem whose stationary points are those of FGW.

    ott linearises GW(P) + penalty W(P) to <structure(P) + penalty features, P>, where the gradient
    of GW is twice the structure. So its stationary points are those of GW + 2 penalty W.

    Args:
      alpha: weight of the structure, above 0.
    """
    return (1 - alpha) / (2 * alpha)


class HopProblem(QuadraticProblem):
    """ott's quadratic problem with the structure of `fgw_problem`, and an epsilon of its own."""

    def __init__(self, problem: Problem, alpha: Scalar, loss: Loss, epsilon: Scalar) -> None:
        """Poses FGW to ott; the penalty is part of the linear term, so that alpha may be traced."""
        mass = mass_of_nodes(problem)
        hops = (Geometry(side.astype(mass.dtype)) for side in problem.hops)
        self.linear_cost = fused_penalty(alpha) * problem.features
        super().__init__(*hops, geom_xy=Geometry(self.linear_cost), a=mass, b=mass)
        self.problem, self.loss_of_hops, self.epsilon = problem, loss, Epsilon(epsilon)

    def linearise(self, plan: Float[Array, "N N"]) -> LinearProblem:
        """Returns the linear problem around a plan."""
        structure = structure_at_plan(self.problem, plan, self.loss_of_hops)
        geometry = Geometry(structure + self.linear_cost, epsilon=self.epsilon)
        return LinearProblem(geometry, self.a, self.b)

    def update_linearization(self, transport: Any, *_: Any, **__: Any) -> LinearProblem:
        """Returns the linear problem around ott's current plan."""
        return self.linearise(transport.matrix)


def entropic_fgw(
    generated: SceneGraph,
    truth: SceneGraph,
    alpha: Scalar = ALPHA,
    scale: Scale = PAPER_SCALE,
    loss: Loss = "absolute",
    epsilons: tuple[Scalar, ...] = EPSILONS,
    polish: bool = False,
) -> FGW:
    """Returns the FGW distance of two padded graphs at an entropic plan.

    Args:
      generated: padded; its proximity edges are ignored.
      truth: padded to the same capacity, of the same concepts. What is observed in it sets the
        origin and the unit of positions. Host graphs may stand anywhere, as in `fgw`.
      alpha: weight of the structure, above 0 and at most 1.
      scale: what counts as distance 1 in metres and in hops.
      loss: how two hop distances differ: "absolute" or "squared".
      epsilons: weights of the entropy, from coarse to fine; each stage starts where the one before
        ended. The last decides how smooth the plan is. In units of GW.
      polish: end with the exact Frank-Wolfe: the value can only fall, and the plan becomes an
        assignment.

    Returns:
      `FGW` at a plan that has the marginals of the problem; `value` is without entropy.
      `iterations` counts linearisations, in all stages. The gradient with respect to positions is
      zero: the problem is a constant.

    Raises:
      ValueError: the graphs have different ontologies or capacities, `alpha` is not above 0 and at
        most 1, or there is no such loss.

    Source: ott-jax, `GromovWasserstein`; the module docstring.
    """
    check_choices(alpha, loss)
    if not isinstance(alpha, jax.Array) and alpha == 0:
        raise ValueError("alpha is 0, expected a number above 0: ott weighs features against it")
    check_pair(generated, truth)
    return _entropic_fgw(*centred(generated, truth), alpha, scale, loss, epsilons, polish)


@partial(jax.jit, static_argnames=("loss", "polish"))
def _entropic_fgw(
    generated: SceneGraph,
    truth: SceneGraph,
    alpha: Scalar,
    scale: Scale,
    loss: Loss,
    epsilons: tuple[Scalar, ...],
    polish: bool,
) -> FGW:
    """Returns the FGW distance at an entropic plan of two graphs near the origin."""
    problem = jax.lax.stop_gradient(pose(generated, truth, scale))
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):  # as ott needs
        plan, converged, iterations = _anneal(problem, alpha, loss, epsilons)
    start = from_plan(plan, structure_at_plan(problem, plan, loss))
    if polish:
        score = score_of(problem, minimise(problem, alpha, loss, start), alpha)
        return score._replace(iterations=iterations + score.iterations)
    return score_of(problem, start, alpha)._replace(converged=converged, iterations=iterations)


def _anneal(
    problem: Problem, alpha: Scalar, loss: Loss, epsilons: tuple[Scalar, ...]
) -> tuple[Float[Array, "N N"], Bool[Array, ""], Int[Array, ""]]:
    """Returns the feasible plan of the last stage, whether that converged, and all iterations."""
    mass = mass_of_nodes(problem)
    product = mass[:, None] * mass[None, :]
    sinkhorn = Sinkhorn(threshold=SINKHORN_THRESHOLD, max_iterations=SINKHORN_ITERATIONS)
    solve = GromovWasserstein(linear_solver=sinkhorn, warm_start=True)

    def stage(plan: Array, epsilon: Array) -> tuple[Array, tuple[Array, Array]]:
        posed = HopProblem(problem, alpha, loss, epsilon)
        found = solve(posed, init=posed.linearise(plan))
        plan = round_to_feasible(jnp.where(product > 0, found.matrix, 0.0), mass)
        return plan, (jnp.asarray(found.converged), jnp.sum(found.costs != -1, dtype=jnp.int32))

    stages = jnp.asarray(epsilons, mass.dtype)
    plan, (converged, iterations) = jax.lax.scan(stage, product, stages)
    return plan, converged[-1], jnp.sum(iterations, dtype=jnp.int32)


def round_to_feasible(plan: Float[Array, "N N"], mass: Float[Array, " N"]) -> Float[Array, "N N"]:
    """Returns a plan near the given one with exactly the marginals `mass` on both sides.

    Rows, then columns, that carry too much are scaled down; what is then missing is spread by a
    product.
    """
    plan = plan * jnp.minimum(_ratio(mass, jnp.sum(plan, axis=1)), 1.0)[:, None]
    plan = plan * jnp.minimum(_ratio(mass, jnp.sum(plan, axis=0)), 1.0)[None, :]
    # Rounding errors below zero would make the sum of the missing mass a poor divisor.
    rows, columns = (jnp.maximum(mass - jnp.sum(plan, axis=axis), 0.0) for axis in (1, 0))
    return plan + _ratio(rows, jnp.sum(rows))[:, None] * columns[None, :]


def _ratio(numerator: Array, denominator: Array) -> Array:
    """Divides, and returns zero where the denominator is zero."""
    zero = denominator == 0
    return jnp.where(zero, 0.0, numerator / jnp.where(zero, 1.0, denominator))
