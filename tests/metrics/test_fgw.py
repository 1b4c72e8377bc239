import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.sharding import AxisType
from jax.sharding import PartitionSpec as P

from sg3d_jax.data import registry
from sg3d_jax.metrics.entropic import entropic_fgw
from sg3d_jax.metrics.fgw import (
    FGW,
    PAIRS_PER_CALL,
    _fgw_stacked,
    fgw,
    fgw_pairs,
    matched_labels,
    solvers,
)
from sg3d_jax.metrics.fgw_loss import fgw_loss
from sg3d_jax.metrics.fgw_problem import Scale, centred, one_hot, pose
from sg3d_jax.metrics.frank_wolfe import from_assignment, minimise
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import PLANE, ROOM
from sg3d_jax.scene.padding import Capacity, pad, stack
from tests import own_world
from tests.metrics.fgw_reference import (
    CAPACITY,
    graph_of,
    on_device,
    permute,
    perturb,
    placed,
    pot_fgw,
    pot_squared,
    random_hierarchy,
    random_pairs,
    reference_costs,
    reference_fgw,
)
from tests.unchecked import unchecked

LOOSE = Capacity(32, 384)


batched = jax.vmap(fgw)


@pytest.fixture(scope="module")
def pairs() -> tuple[list[SceneGraph], list[SceneGraph]]:
    return random_pairs()


@pytest.fixture(scope="module")
def costs(pairs) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    return [reference_costs(*pair) for pair in zip(*pairs, strict=True)]


def one(generated: SceneGraph, truth: SceneGraph, capacity: Capacity = CAPACITY) -> FGW:
    return fgw(on_device(generated, capacity), on_device(truth, capacity))


@pytest.mark.parametrize("reference", [reference_fgw, pot_fgw])
@pytest.mark.parametrize("alpha", [0.5, 0.2])
def test_fgw__agrees_with_other_solvers(pairs, costs, reference, alpha):
    scores = fgw_pairs(*pairs, alpha)
    expected = [reference(*cost, alpha) for cost in costs]
    found = np.stack([scores.value, scores.gw, scores.w], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert scores.converged.all()
    assert scores.value.min() > 0.1


@pytest.mark.parametrize("alpha", [0.5, 0.2])
def test_fgw__with_the_squared_loss_agrees_with_pots_own_solver(pairs, costs, alpha):
    scores = fgw_pairs(*pairs, alpha, loss="squared")
    expected = [pot_squared(*cost, alpha) for cost in costs]
    found = np.stack([scores.value, scores.gw, scores.w], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("name", ["s-f-square", "s-f"])
def test_fgw__agrees_with_pot_on_floors(name):
    rng = np.random.default_rng(1)
    truth = [graph for graph in registry.make(name, 30) if 16 < len(graph.nodes.label) <= 24]
    generated = [perturb(rng, graph, int(rng.integers(3)), 0.1) for graph in truth]
    assert len(truth) > 2
    costs = [reference_costs(*pair) for pair in zip(generated, truth, strict=True)]
    for loss, solver in (("absolute", pot_fgw), ("squared", pot_squared)):
        expected = [solver(*cost, 0.5)[0] for cost in costs]
        np.testing.assert_allclose(
            fgw_pairs(generated, truth, loss=loss).value, expected, atol=1e-4
        )


def test_fgw__is_as_good_as_the_best_of_ten_random_starts(pairs):
    @jax.jit
    def best_of_ten(generated, truth, orders):
        problem = pose(generated, truth)

        def from_order(order):
            inside = jnp.arange(len(order)) < problem.size
            columns = jnp.argsort(jnp.where(inside, order, jnp.inf))
            found = minimise(
                problem, 0.5, "absolute", from_assignment(problem, columns, "absolute")
            )
            return jnp.sum((problem.features + found.structure) * found.plan) / 2

        return jnp.min(jax.lax.map(from_order, orders))

    orders = np.random.default_rng(0).random((len(pairs[0]), 10, CAPACITY.nodes), np.float32)
    sides = ([on_device(graph) for graph in side] for side in pairs)
    best = [best_of_ten(*each) for each in zip(*sides, orders, strict=True)]
    assert np.mean(fgw_pairs(*pairs).value / np.array(best)) < 1.001


def test_scale__is_what_counts_as_distance_one(pairs, costs):
    generated, truth = (on_device(side[3]) for side in pairs)
    nodes = pairs[1][3].nodes
    spread = float(np.sqrt(np.var(nodes.position[nodes.label == PLANE], axis=0)[:2].mean()))
    hops = costs[3][1]  # as shares of the longest
    longest = float(round(1 / hops[hops > 0].min()))
    paper = fgw(generated, truth)
    same = fgw(generated, truth, scale=Scale(metres=spread, hops=longest))
    np.testing.assert_allclose(same[:3], paper[:3], rtol=1e-5)
    # Of GW alone, the plan does not depend on the unit; a power of two rounds nothing.
    half = Scale(metres=2 * spread, hops=2 * longest)
    halved, whole = fgw(generated, truth, 1.0, half).gw, fgw(generated, truth, 1.0).gw
    np.testing.assert_allclose(halved, np.asarray(whole) / 2)


def test_plan__has_uniform_marginals_and_gives_the_energies_by_brute_force(pairs):
    generated, truth = pairs[0][2], pairs[1][2]
    score = one(generated, truth)
    distance, left, right = reference_costs(generated, truth)
    size = len(distance)
    plan = np.asarray(score.plan, np.float64)
    assert not plan[size:].any()
    assert not plan[:, size:].any()
    plan = plan[:size, :size]
    np.testing.assert_allclose(plan.sum(axis=0), 1 / size, atol=1e-6)
    np.testing.assert_allclose(plan.sum(axis=1), 1 / size, atol=1e-6)
    np.testing.assert_allclose(score.w, np.sum(plan * distance), atol=1e-5)
    moved = np.argwhere(plan > 0)
    energy = sum(
        plan[i, j] * plan[k, l] * abs(left[i, k] - right[j, l])
        for (i, j), (k, l) in itertools.product(moved, moved)
    )
    np.testing.assert_allclose(score.gw, energy, atol=1e-5)


@given(st.integers(1, 3), st.integers(0, 4), st.sampled_from([0.0, 0.3, 1.0]), st.integers(0, 999))
@settings(deadline=None, max_examples=15)
def test_fgw__does_not_depend_on_padding_or_the_order_of_nodes(rooms, drop, share, seed):
    rng = np.random.default_rng(seed)
    truth = random_hierarchy(rng, rooms)
    generated = perturb(rng, truth, drop, share)
    shuffled = [
        permute(graph, rng.permutation(len(graph.nodes.label))) for graph in (generated, truth)
    ]
    expected = one(generated, truth)
    np.testing.assert_allclose(one(generated, truth, LOOSE)[:3], expected[:3], atol=1e-6)
    np.testing.assert_allclose(one(*shuffled).value, expected.value, atol=1e-5)


def test_fgw__of_a_graph_with_itself_is_zero_wherever_it_stands(pairs):
    _, truth = pairs
    far = [placed(graph, graph.nodes.position + 5e6) for graph in truth]
    assert np.abs(fgw_pairs(truth, truth).value).max() < 1e-5
    assert np.abs(fgw_pairs(far, far).value).max() < 1e-5


UTM = np.array([5e5, 5e6, 120.0])  # where a building stands, metres


def at(graph: SceneGraph, offset: np.ndarray) -> SceneGraph:
    return placed(graph, graph.nodes.position + offset)


def test_fgw__of_host_graphs_does_not_depend_on_where_they_stand(pairs):
    def values(sides, place):
        padded = ([place(graph, CAPACITY) for graph in side] for side in sides)
        return np.array([fgw(*pair).value for pair in zip(*padded, strict=True)])

    moved = [[at(graph, UTM) for graph in side] for side in pairs]
    near, far = values(pairs, pad), values(moved, pad)
    np.testing.assert_allclose(far, near, atol=1e-6)
    np.testing.assert_allclose(far, fgw_pairs(*moved).value, atol=1e-6)
    # On the device the metres are lost before fgw sees them.
    assert np.max(np.abs(values(moved, on_device) - near) / near) > 0.01


def test_centring__leaves_alone_what_is_on_the_device_or_traced(pairs):
    pair = [on_device(side[2]) for side in pairs]
    assert all(new is old for new, old in zip(centred(*pair), pair, strict=True))
    mixed = pad(pairs[0][2], CAPACITY), pair[1]
    assert all(new is old for new, old in zip(centred(*mixed), mixed, strict=True))
    expected = fgw(*pair).value
    host = [
        jax.tree.map(lambda *leaves: np.stack(leaves), *(pad(graph, CAPACITY) for graph in side))
        for side in pairs
    ]
    device = [stack(side, CAPACITY) for side in pairs]
    np.testing.assert_array_equal(batched(*host).value, batched(*device).value)
    far = [pad(at(side[2], UTM), CAPACITY) for side in pairs]
    np.testing.assert_allclose(jax.jit(lambda: fgw(*far).value)(), expected, atol=1e-6)


def test_centring__moves_both_graphs_alike_and_keeps_padding_at_zero(pairs):
    host = [pad(at(side[2], UTM), CAPACITY) for side in pairs]
    made, true = centred(*host)
    planes = true.nodes.position[true.nodes.observed]
    np.testing.assert_allclose(planes.mean(axis=0), 0, atol=1e-8)
    for old, new in zip(host, (made, true), strict=True):
        shift = (old.nodes.position - new.nodes.position)[old.nodes.mask]
        np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-8)
        assert not new.nodes.position[~old.nodes.mask].any()


def test_fgw__does_not_depend_on_the_unit_of_length(pairs):
    scaled = [
        [
            graph._replace(nodes=graph.nodes._replace(position=graph.nodes.position * 7))
            for graph in side
        ]
        for side in pairs
    ]
    np.testing.assert_allclose(fgw_pairs(*scaled).value, fgw_pairs(*pairs).value, atol=1e-5)


def test_dummies__cost_their_features_and_one_hop_more_than_the_longest_path():
    # Planes at x = -1 and 1, so one spread is sqrt(1/2) m; the room lies at their centre.
    ends = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    truth = graph_of([PLANE, PLANE, ROOM], ends, [[0, 2], [1, 2]])
    generated = graph_of([PLANE, PLANE], ends[:2], np.zeros((0, 2)))
    score = one(generated, truth)
    # The room's feature is its one-hot label alone: the dummy is 1 away, and a third of the mass.
    np.testing.assert_allclose(score.w, 1 / 3, atol=1e-6)
    # Two planes 1 apart against 2, dummy 2 apart from them against 1; ordered pairs; longest is 2.
    np.testing.assert_allclose(score.gw, 2 * (1 + 1 + 1) / 9 / 2, atol=1e-6)


def test_fgw__of_single_nodes_and_of_one_plane_is_finite():
    plane = graph_of([PLANE], np.zeros((1, 3)), np.zeros((0, 2)))
    room = graph_of([PLANE, ROOM], np.array([[0.0, 0, 0], [3.0, 4.0, 0]]), [[0, 1]])
    scores = fgw_pairs([plane, room], [plane, plane])
    assert scores.value[0] == 0
    # One plane has no spread: metres stay metres.
    np.testing.assert_allclose(scores.w[1], np.sqrt(26) / 2, rtol=1e-6)
    assert np.isfinite(scores.gw[1])


EMPTY = graph_of([], np.zeros((0, 3)), np.zeros((0, 2)))
ONE_PLANE = graph_of([PLANE], np.zeros((1, 3)), np.zeros((0, 2)))
APART = graph_of([PLANE, PLANE, ROOM, ROOM], np.eye(4, 3), [[0, 2]])


def test_fgw__of_empty_single_and_disconnected_graphs_is_finite():
    graphs = [EMPTY, ONE_PLANE, APART]
    pairs = list(itertools.product(graphs, graphs))
    scores = fgw_pairs(*zip(*pairs, strict=True))
    assert scores.converged.all()
    assert np.isfinite(scores.value).all()
    same = np.array([generated is truth for generated, truth in pairs])
    assert (scores.value[same] == 0).all()
    assert (scores.value[~same] > 0).all()


def test_fgw__in_a_vmap_is_that_of_every_pair_alone(pairs):
    found = batched(*(stack(side, CAPACITY) for side in pairs)).value
    np.testing.assert_allclose(found, fgw_pairs(*pairs).value, atol=1e-6)


def test_fgw_pairs__keeps_the_order_across_buckets_and_calls(pairs):
    generated, truth = (list(side) * 9 for side in pairs)
    scores, once = fgw_pairs(generated, truth), fgw_pairs(*pairs)
    assert len(truth) > PAIRS_PER_CALL
    np.testing.assert_array_equal(scores.value, np.tile(once.value, 9))


def test_fgw_pairs__compiles_once_a_bucket_whatever_the_number_of_pairs(pairs):
    fgw_pairs(*pairs)
    compiled = _fgw_stacked._cache_size()
    fgw_pairs(pairs[0][:5], pairs[1][:5])
    fgw_pairs(pairs[0] * 7, pairs[1] * 7)
    assert _fgw_stacked._cache_size() == compiled


def value(position, generated, truth):
    return fgw(placed(generated, position), truth).value


def test_gradient__of_the_positions_is_that_of_finite_differences(pairs):
    generated, truth = (on_device(side[2]) for side in pairs)
    position = np.array(generated.nodes.position)
    gradient = np.asarray(jax.grad(value)(jnp.asarray(position), generated, truth))
    assert np.isfinite(gradient).all()
    node, step = np.argmax(np.abs(gradient[:, 0])), 1e-2
    sides = []
    for sign in (1, -1):
        aside = position.copy()
        aside[node, 0] += sign * step
        sides.append(float(value(jnp.asarray(aside), generated, truth)))
    np.testing.assert_allclose(gradient[node, 0], (sides[0] - sides[1]) / (2 * step), rtol=2e-2)


def test_gradient__against_a_host_truth_is_that_against_one_on_the_device(pairs):
    generated, truth = (pad(side[2], CAPACITY) for side in pairs)
    position = jnp.asarray(generated.nodes.position)
    found = np.asarray(jax.grad(value)(position, generated, truth))
    assert np.abs(found).max() > 0.01
    expected = jax.grad(value)(position, generated, on_device(pairs[1][2]))
    np.testing.assert_array_equal(found, expected)


def own_pairs() -> tuple[list[SceneGraph], list[SceneGraph]]:
    """The made-up world, erred on in several ways; what is observed is more than its planes."""
    rng, truth = np.random.default_rng(3), own_world.own_world()
    made = [perturb(rng, truth, drop, share) for drop in (0, 1, 3) for share in (0.0, 0.2)]
    return [truth, *made], [truth] * 7


def test_fgw__of_a_made_up_ontology_agrees_with_another_solver():
    made, true = own_pairs()
    scores = fgw_pairs(made, true)
    expected = [
        reference_fgw(*reference_costs(*pair), 0.5) for pair in zip(made, true, strict=True)
    ]
    found = np.stack([scores.value, scores.gw, scores.w], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    alone = [one(*pair, LOOSE).value for pair in zip(made, true, strict=True)]
    np.testing.assert_allclose(alone, scores.value, atol=1e-6)
    num_concepts = own_world.ONTOLOGY.num_concepts
    assert scores.matched.shape == (7, num_concepts, num_concepts)
    np.testing.assert_allclose(np.diag(scores.matched[0]), np.bincount(true[0].nodes.label))


def test_fgw__measures_from_all_that_is_observed():
    # The pillar is observed beside the planes: it shares in their centre and in their spread.
    position = np.array([[0.0, 0, 0], [2.0, 0, 0], [7.0, 0, 0], [3.0, 4, 0]])
    label = [own_world.PLANE, own_world.PLANE, own_world.PILLAR, own_world.ROOM]
    pairs = [(0, 3), (1, 3), (2, 3)]
    truth = graph_of(label, position, pairs, own_world.ONTOLOGY)
    higher = position + np.array([[0, 0, 0]] * 3 + [[0, 0, 1]])
    off = graph_of(label, higher, pairs, own_world.ONTOLOGY)
    spread = np.sqrt(np.var([0.0, 2.0, 7.0]) / 2)
    np.testing.assert_allclose(one(off, truth, LOOSE).w, 1 / spread / 4, rtol=1e-5)


def test_graphs_of_different_ontologies_are_refused():
    own, paper = own_world.own_world(), random_hierarchy(np.random.default_rng(0), 2)
    with pytest.raises(ValueError, match="another ontology than the true one"):
        one(own, paper, LOOSE)
    for made, true in (([own], [paper]), ([own, paper], [own, paper])):
        with pytest.raises(ValueError, match="different ontologies, expected one"):
            fgw_pairs(made, true)


def test_matched__counts_the_real_nodes_that_the_plan_puts_on_each_other(pairs):
    matched = jax.jit(matched_labels)
    for generated, truth in zip(*pairs, strict=True):
        padded = on_device(generated), on_device(truth)
        plan = np.asarray(fgw(*padded).plan)
        size = max(len(generated.nodes.label), len(truth.nodes.label))
        expected = np.zeros((6, 6))
        for row, left in enumerate(generated.nodes.label):
            for column, right in enumerate(truth.nodes.label):
                expected[left, right] += size * plan[row, column]
        np.testing.assert_allclose(matched(plan, *padded), expected, atol=1e-5)


def test_lists_that_do_not_pair_up_are_refused(pairs):
    with pytest.raises(ValueError, match="11 generated graphs cannot be paired with 10"):
        fgw_pairs(pairs[0], pairs[1][:-1])


def test_fgw_pairs__takes_padded_graphs_and_generators(pairs):
    expected = fgw_pairs(*pairs)
    padded = [[pad(graph, LOOSE) for graph in side] for side in pairs]
    np.testing.assert_array_equal(fgw_pairs(*padded).value, expected.value)
    device = ((on_device(graph) for graph in side) for side in pairs)
    found = fgw_pairs(*device)
    for name in ("value", "matched"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-5)


def test_one_graph_in_place_of_a_list_is_refused(pairs):
    with unchecked(), pytest.raises(ValueError, match="got one scene graph, expected a list"):
        fgw_pairs(pairs[0][0], pairs[1][0])


DISTANCES = {
    "fgw": fgw,
    "entropic_fgw": entropic_fgw,
    "fgw_loss": lambda a, *rest, **more: fgw_loss(a.nodes.position, one_hot(a), a, *rest, **more),
}


@pytest.mark.parametrize("distance", DISTANCES.values(), ids=DISTANCES.keys())
def test_graphs_that_are_not_padded_alike_are_refused(pairs, distance):
    large, small = pairs[1][3], pairs[1][0]
    stacked = stack([small, small], CAPACITY)
    stacked_on_host = jax.tree.map(np.asarray, stacked)
    for pair, sentence in (
        ((large, small), "the graphs have 24 and 6 slots, expected one capacity"),
        ((small, large), "the graphs have 6 and 24 slots, expected one capacity"),
        ((ONE_PLANE, large), "the graphs have 1 and 24 slots, expected one capacity"),
        ((EMPTY, EMPTY), "the graphs have 0 and 0 slots, expected one capacity, above 0"),
        ((stacked, stacked), r"\(2, 24\) and \(2, 24\), expected one graph each"),
        ((stacked_on_host, pad(small, CAPACITY)), r"\(2, 24\) and \(24,\), expected one graph"),
    ):
        with unchecked(), pytest.raises(ValueError, match=sentence):
            distance(*pair)


@pytest.mark.parametrize("name", ["fgw_pairs", *DISTANCES])
def test_a_weight_or_a_loss_that_there_is_not_is_refused(pairs, name):
    if name == "fgw_pairs":
        distance, pair = fgw_pairs, pairs
    else:
        distance, pair = DISTANCES[name], [on_device(side[0]) for side in pairs]
    for alpha in (2.0, -0.1, np.float32(1.5), np.nan):
        with unchecked(), pytest.raises(ValueError, match=f"alpha is {alpha}, expected a number"):
            distance(*pair, alpha)
    with unchecked(), pytest.raises(ValueError, match="'foo', expected one of absolute, squared"):
        distance(*pair, loss="foo")


def test_a_traced_weight_is_not_looked_at(pairs):
    pair = [on_device(side[0]) for side in pairs]
    jax.eval_shape(lambda alpha: fgw(*pair, alpha), jnp.float32(2.0))


@pytest.mark.parametrize("kind", [AxisType.Explicit, AxisType.Auto])
def test_fgw_pairs__do_not_depend_on_the_mesh_that_the_caller_has_set(pairs, kind):
    expected, compiled = fgw_pairs(*pairs).value, _fgw_stacked._cache_size()
    for size in (1, 2):
        with jax.set_mesh(jax.make_mesh((size,), ("batch",), (kind,))):
            np.testing.assert_array_equal(fgw_pairs(*pairs).value, expected)
            assert jax.sharding.get_mesh().axis_names == ("batch",)
    assert _fgw_stacked._cache_size() == compiled


@pytest.mark.parametrize("distance", [fgw, DISTANCES["fgw_loss"]], ids=["fgw", "fgw_loss"])
def test_fgw_and_its_gradient__can_be_sharded(pairs, distance):
    """What `shard_map` checks by default, it checks as it traces."""

    def value(position, generated, truth):
        return jax.tree.leaves(distance(placed(generated, position), truth))[0]

    def of_all(generated, truth):
        return jax.vmap(jax.value_and_grad(value))(generated.nodes.position, generated, truth)

    def one_by_one(generated, truth):
        return jax.lax.map(lambda pair: value(pair[0].nodes.position, *pair), (generated, truth))

    sides = [stack(side[:2], CAPACITY) for side in pairs]
    mesh = jax.make_mesh((2,), ("pairs",), (AxisType.Auto,))
    for run in (of_all, one_by_one):
        sharded = jax.shard_map(run, mesh=mesh, in_specs=P("pairs"), out_specs=P("pairs"))
        shapes = [jax.tree.map(jnp.shape, jax.eval_shape(f, *sides)) for f in (sharded, run)]
        assert shapes[0] == shapes[1]


@pytest.mark.parametrize("distance", DISTANCES.values(), ids=DISTANCES.keys())
def test_fgw__promotes_no_types(pairs, distance):
    pair = [on_device(side[0]) for side in pairs]
    plan = jnp.zeros((CAPACITY.nodes, CAPACITY.nodes))
    with jax.numpy_dtype_promotion("strict"):
        jax.eval_shape(distance, *pair)
        jax.eval_shape(matched_labels, plan, *pair)


@pytest.mark.parametrize("broken", [np.nan, np.inf, 1e30])
def test_positions_that_are_no_numbers__give_nan_for_their_pair_alone(pairs, broken):
    generated, truth = (list(side) for side in pairs)
    position = generated[2].nodes.position.copy()
    position[-3:] = broken
    generated[2] = placed(generated[2], position)
    scores, expected = fgw_pairs(generated, truth), fgw_pairs(*pairs).value.copy()
    expected[2] = np.nan
    np.testing.assert_array_equal(scores.value, expected)
    assert not scores.converged[2]


def test_pairs__are_solved_by_the_cpu_where_there_is_one(monkeypatch):
    one, other = jax.devices()  # of which one stands for an accelerator
    held = {None: [other], "cpu": [one]}

    def local_devices(backend=None):
        if backend not in held:
            raise RuntimeError(f"Unknown backend {backend}")
        return held[backend]

    monkeypatch.setattr(jax, "local_devices", local_devices)
    assert solvers() == [one]
    del held["cpu"]
    assert solvers() == [other]
