"""The solver of FGW: Frank-Wolfe whose linear step is an exact assignment.

Nothing is relaxed, but the problem is not convex: the search ends at a stationary point, not always
at the minimum.

Source: Vayer et al., "Fused Gromov-Wasserstein distance for structured objects", Algorithms 13(9),
2020: the conditional gradient with an exact line search.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sg3d_jax.metrics.assignment import assign
from sg3d_jax.metrics.fgw_problem import (
    Loss,
    Problem,
    Scalar,
    mass_of_nodes,
    plan_of_assignment,
    structure_at_assignment,
    structure_at_product,
)

TOLERANCE = 1e-6
MAX_ITERATIONS = 50


class Search(NamedTuple):
    """A Frank-Wolfe iterate."""

    plan: Float[Array, "N N"]  # mass from rows to columns
    structure: Float[Array, "N N"]  # sum_kl P_kl loss(a_ik, b_jl)
    gap: Float[Array, ""]  # how far the objective may be above a stationary point
    iterations: Int[Array, ""]  # assignments solved so far


def from_plan(plan: Float[Array, "N N"], structure: Float[Array, "N N"]) -> Search:
    """Returns a search that starts at a plan, given its structure.

    The gap is as sharded as the plan: `shard_map` wants every part of a loop's start so.
    """
    return Search(plan, structure, jnp.full_like(plan[0, 0], jnp.inf), jnp.array(0, jnp.int32))


def from_product(problem: Problem, loss: Loss) -> Search:
    """Returns a search that starts at the product plan."""
    mass = mass_of_nodes(problem)
    return from_plan(mass[:, None] * mass[None, :], structure_at_product(problem, loss))


def from_assignment(problem: Problem, columns: Int[Array, " N"], loss: Loss) -> Search:
    """Returns a search that starts at the plan of an assignment."""
    plan = plan_of_assignment(problem, columns)
    return from_plan(plan, structure_at_assignment(problem, columns, loss))


def minimise(problem: Problem, alpha: Scalar, loss: Loss, start: Search) -> Search:
    """Returns a stationary point of the FGW objective that is no worse than the start.

    Every vertex of the set of plans is an assignment. With few exceptions the search ends at one,
    after two or three steps. From the product plan, that is where restarts end too if the graphs
    are alike; where they are not, as with Rand's, a restart does better on about a third of the
    pairs, by at most 0.010.
    """
    alpha = jnp.full_like(problem.unit, alpha)  # as sharded, see `from_plan`

    def step(search: Search) -> Search:
        gradient = (1 - alpha) * problem.features + 2 * alpha * search.structure
        columns = assign(gradient, problem.size)
        vertex = plan_of_assignment(problem, columns)
        gap = jnp.sum(gradient * (search.plan - vertex))

        def move() -> tuple[Array, Array]:
            structure = structure_at_assignment(problem, columns, loss)
            curvature = alpha * jnp.sum((structure - search.structure) * (vertex - search.plan))
            # The objective along the step is curvature t^2 - gap t, on 0 <= t <= 1.
            inner = jnp.clip(gap / (2 * jnp.where(curvature > 0, curvature, 1.0)), 0.0, 1.0)
            t = jnp.where(curvature > 0, inner, 1.0)
            return (
                (1 - t) * search.plan + t * vertex,
                (1 - t) * search.structure + t * structure,
            )

        stay = search.plan, search.structure
        # A gap that is not a number moves, so that the score becomes none either.
        plan, structure = jax.lax.cond(gap <= TOLERANCE, lambda: stay, move)
        return Search(plan, structure, gap, search.iterations + 1)

    def unfinished(search: Search) -> Bool[Array, ""]:
        return (search.gap > TOLERANCE) & (search.iterations < MAX_ITERATIONS)

    return jax.lax.while_loop(unfinished, step, start)
