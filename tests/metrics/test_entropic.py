import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.metrics.entropic import entropic_fgw, fused_penalty, round_to_feasible
from sg3d_jax.metrics.fgw import FGW, fgw
from sg3d_jax.metrics.fgw_problem import mass_of_nodes, pose
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.padding import Capacity, pad
from tests import own_world
from tests.metrics.fgw_reference import (
    CAPACITY,
    graph_of,
    on_device,
    permute,
    perturb,
    placed,
    pot,
    random_pairs,
    reference_costs,
    reference_fgw,
    structure_of,
)

GENERATED, TRUTH = random_pairs()


def smooth(generated: SceneGraph, truth: SceneGraph, capacity: Capacity = CAPACITY) -> FGW:
    return entropic_fgw(
        on_device(generated, capacity), on_device(truth, capacity), epsilons=(0.1, 0.03)
    )


@pytest.fixture(scope="module")
def smooth_scores() -> list[FGW]:
    return [smooth(*pair) for pair in zip(GENERATED, TRUTH, strict=True)]


def test_entropic_value__is_near_the_exact_one_and_polish_brings_it_there(smooth_scores):
    pairs = [[on_device(graph) for graph in pair] for pair in zip(GENERATED, TRUTH, strict=True)]
    exact = np.array([fgw(*pair).value for pair in pairs])
    polished = [entropic_fgw(*pair, polish=True) for pair in pairs]
    assert all(score.converged for score in polished)
    # Either may end in the better local optimum; on most pairs both find the same.
    ratio = np.array([score.value for score in polished]) / exact
    np.testing.assert_allclose(np.median(ratio), 1, atol=1e-5)
    assert np.mean(ratio) < 1.02
    near = np.array([score.value for score in smooth_scores]) / exact
    assert np.median(near) < 1.05
    assert all(score.converged for score in smooth_scores)


def test_entropic_plan__is_feasible_smooth_and_empty_at_padding(smooth_scores):
    for score, *pair in zip(smooth_scores, GENERATED, TRUTH, strict=True):
        size = max(len(graph.nodes.label) for graph in pair)
        plan = np.asarray(score.plan)
        np.testing.assert_allclose(plan[:size, :size].sum(axis=0), 1 / size, atol=1e-6)
        np.testing.assert_allclose(plan[:size, :size].sum(axis=1), 1 / size, atol=1e-6)
        assert not plan[size:].any()
        assert not plan[:, size:].any()
        assert np.count_nonzero(plan) > size


def test_entropic_energies__are_those_of_the_plan_by_definition(smooth_scores):
    for score, *pair in zip(smooth_scores, GENERATED, TRUTH, strict=True):
        distance, left, right = reference_costs(*pair)
        plan = np.asarray(score.plan, np.float64)[: len(distance), : len(distance)]
        structure = structure_of(plan, left, right)
        np.testing.assert_allclose(score.w, np.sum(plan * distance), atol=1e-5)
        np.testing.assert_allclose(score.gw, np.sum(plan * structure), atol=1e-5)
        np.testing.assert_allclose(score.value, (score.w + score.gw) / 2, rtol=1e-5)


@pytest.mark.parametrize("alpha", [0.5, 0.2, 0.8])
def test_penalty__makes_the_plan_the_one_that_pot_finds_with_the_same_entropy(alpha):
    # POT linearises 2 alpha structure + (1 - alpha) features: ours times 2 alpha, entropy likewise.
    distance, left, right = reference_costs(GENERATED[1], TRUTH[1])
    mass = np.full(len(distance), 1 / len(distance))
    expected = pot().gromov.entropic_fused_gromov_wasserstein(
        distance, left, right, mass, mass, epsilon=2 * alpha * 0.3, alpha=alpha, warn=False
    )
    pair = on_device(GENERATED[1]), on_device(TRUTH[1])
    found = entropic_fgw(*pair, alpha, loss="squared", epsilons=(0.3,)).plan
    found = np.asarray(found)[: len(distance), : len(distance)]
    assert fused_penalty(alpha) == (1 - alpha) / (2 * alpha)
    np.testing.assert_allclose(found / mass[0], expected / mass[0], atol=5e-3)


@given(st.integers(0, len(TRUTH) - 1), st.integers(0, 999))
@settings(deadline=None, max_examples=3)
def test_entropic_value__does_not_depend_on_padding_or_the_order_of_nodes(index, seed):
    rng = np.random.default_rng(seed)
    pair = GENERATED[index], TRUTH[index]
    shuffled = [permute(graph, rng.permutation(len(graph.nodes.label))) for graph in pair]
    expected = smooth(*pair).value
    np.testing.assert_allclose(smooth(*pair, Capacity(32, 384)).value, expected, atol=1e-4)
    np.testing.assert_allclose(smooth(*shuffled).value, expected, atol=1e-4)


def test_entropic_fgw__of_empty_and_single_graphs_is_that_of_fgw():
    empty = graph_of([], np.zeros((0, 3)), np.zeros((0, 2)))
    plane = graph_of([0], np.zeros((1, 3)), np.zeros((0, 2)))
    for pair in ((empty, empty), (plane, plane), (plane, empty), (empty, plane)):
        exact = fgw(*(on_device(graph) for graph in pair))
        np.testing.assert_allclose(smooth(*pair).value, exact.value, atol=1e-6)


def test_entropic_fgw__of_host_graphs_does_not_depend_on_where_they_stand(smooth_scores):
    far = [
        [
            pad(placed(graph, graph.nodes.position + np.array([5e5, 5e6, 120.0])), CAPACITY)
            for graph in side[1:4]
        ]
        for side in (GENERATED, TRUTH)
    ]
    found = [entropic_fgw(*pair, epsilons=(0.1, 0.03)) for pair in zip(*far, strict=True)]
    near = [score.value for score in smooth_scores[1:4]]
    np.testing.assert_allclose([score.value for score in found], near, atol=1e-5)


def test_entropic_fgw__of_a_made_up_ontology_is_near_the_exact_one():
    truth = own_world.own_world()
    made = perturb(np.random.default_rng(0), truth, 1, 0.1)
    exact, _, _ = reference_fgw(*reference_costs(made, truth), 0.5)
    assert 0.1 < exact <= smooth(made, truth).value < 1.1 * exact


def test_rounding__changes_an_infeasible_plan_no_more_than_its_marginals_are_wrong():
    @jax.jit
    def problem_mass(generated, truth):
        return mass_of_nodes(pose(generated, truth))

    mass = np.asarray(problem_mass(on_device(GENERATED[0]), on_device(TRUTH[0])))
    noise = np.random.default_rng(0).uniform(0.5, 1.5, (len(mass), len(mass)))
    plan = np.float32(mass[:, None] * mass[None, :] * noise)
    round_compiled = jax.jit(round_to_feasible)
    rounded = np.asarray(round_compiled(plan, mass))
    for axis in (0, 1):
        np.testing.assert_allclose(rounded.sum(axis), mass, atol=1e-7)
    wrong = sum(np.abs(plan.sum(axis) - mass).sum() for axis in (0, 1))
    assert np.abs(rounded - plan).sum() <= 2 * wrong
    np.testing.assert_allclose(round_compiled(rounded, mass), rounded, atol=1e-7)


def test_a_weight_of_zero_is_refused():
    with pytest.raises(ValueError, match="alpha is 0, expected a number above 0"):
        entropic_fgw(on_device(GENERATED[0]), on_device(TRUTH[0]), 0.0)
