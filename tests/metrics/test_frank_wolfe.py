"""Steps and end of the search, on pairs of graphs that have nothing to do with each other."""

import functools

import jax
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from sg3d_jax.metrics import frank_wolfe
from sg3d_jax.metrics.fgw_problem import Problem, pose
from sg3d_jax.metrics.frank_wolfe import (
    Search,
    from_assignment,
    from_plan,
    from_product,
    minimise,
)
from tests.metrics.fgw_reference import graph_of, on_device, structure_of

SEEDS = range(6)
STEPS = np.linspace(0, 1, 501)


pose_compiled = jax.jit(pose)


@functools.cache
def random_problem(seed: int, size: int = 12) -> Problem:
    """Two random graphs that share the number of their nodes."""
    rng = np.random.default_rng(seed)
    sides = []
    for _ in range(2):
        pairs = np.argwhere(np.triu(rng.random((size, size)) < 0.25, 1))
        sides.append(graph_of(rng.integers(0, 6, size), 4 * rng.normal(size=(size, 3)), pairs))
    return jax.tree.map(np.asarray, pose_compiled(*(on_device(graph) for graph in sides)))


def in_float64(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns features and both scaled hops of the nodes that carry mass."""
    size = int(problem.size)
    arrays = (problem.features, *(hops / problem.unit for hops in problem.hops))
    return tuple(np.asarray(array, np.float64)[:size, :size] for array in arrays)


def gradient_at(problem: Problem, plan: np.ndarray, alpha: float) -> np.ndarray:
    """The derivative of (1 - alpha) <features, P> + alpha <structure(P), P>, by definition."""
    features, left, right = in_float64(problem)
    return (1 - alpha) * features + 2 * alpha * structure_of(plan, left, right)


def energy_at(problem: Problem, plan: np.ndarray, alpha: float) -> float:
    features, left, right = in_float64(problem)
    return float(np.sum(plan * ((1 - alpha) * features + alpha * structure_of(plan, left, right))))


def vertex_below(gradient: np.ndarray) -> np.ndarray:
    """The assignment that a linear function likes best, by scipy."""
    vertex = np.zeros_like(gradient)
    vertex[linear_sum_assignment(gradient)] = 1 / len(gradient)
    return vertex


def plan_of(problem: Problem, search: Search) -> np.ndarray:
    size = int(problem.size)
    return np.asarray(search.plan, np.float64)[:size, :size]


at_product = jax.jit(lambda problem: from_product(problem, "absolute"))
at_order = jax.jit(lambda problem, columns: from_assignment(problem, columns, "absolute"))
search_from = jax.jit(lambda problem, alpha, start: minimise(problem, alpha, "absolute", start))


@pytest.mark.parametrize("alpha", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("seed", SEEDS)
def test_search__ends_where_the_objective_falls_towards_no_assignment(seed, alpha):
    problem = random_problem(seed)
    order = np.random.default_rng(seed).permutation(int(problem.size))
    columns = np.concatenate([order, np.arange(len(order), len(problem.features))])
    for start in (at_product(problem), at_order(problem, columns)):
        found = search_from(problem, alpha, start)
        plan = plan_of(problem, found)
        gradient = gradient_at(problem, plan, alpha)
        assert np.sum(gradient * (plan - vertex_below(gradient))) < 1e-5
        assert found.iterations < frank_wolfe.MAX_ITERATIONS


def convex_problem(seed: int, size: int = 6) -> Problem:
    """A problem whose best step may be a part of the way.

    Hop distances make the objective all but concave, so that every step goes all the way. Here one
    graph has distance 1 between any two nodes and the other only from a node to itself, some more
    at random.
    """
    rng = np.random.default_rng(seed)
    left, right = 1 - np.eye(size, dtype=int), np.eye(size, dtype=int)
    noise = rng.random((size, size)) < 0.15
    right = np.where(noise | noise.T, 1, right)
    features = np.float32(rng.random((size, size)) / 3)
    hops = np.int32(left), np.int32(right)
    return Problem(features, hops, unit=np.ones((), "f"), size=np.array(size, "i"))


def test_every_step__is_the_best_along_its_direction(monkeypatch):
    monkeypatch.setattr(frank_wolfe, "MAX_ITERATIONS", 1)
    steps, alpha = [], 0.5

    @jax.jit
    def one_step(problem, search):
        start = from_plan(search.plan, search.structure)
        return minimise(problem, alpha, "absolute", start)

    for problem in map(convex_problem, SEEDS):
        search = at_product(problem)
        for _ in range(3):
            before = plan_of(problem, search)
            gradient = gradient_at(problem, before, alpha)
            vertex = vertex_below(gradient)
            search = one_step(problem, search)
            after = plan_of(problem, search)
            on_the_way = [before + t * (vertex - before) for t in STEPS]
            energies = [energy_at(problem, plan, alpha) for plan in on_the_way]
            best = int(np.argmin(energies))
            np.testing.assert_allclose(after, on_the_way[best], atol=1e-3)
            np.testing.assert_allclose(energy_at(problem, after, alpha), energies[best], atol=1e-6)
            steps.append(STEPS[best])
    assert sum(0.05 < step < 0.45 for step in steps) > 4  # twice of these would show


def test_search__converges_to_a_minimum_inside():
    for problem in map(convex_problem, SEEDS):
        plan = plan_of(problem, search_from(problem, 0.5, at_product(problem)))
        gradient = gradient_at(problem, plan, 0.5)
        assert np.sum(gradient * (plan - vertex_below(gradient))) < 1e-2
