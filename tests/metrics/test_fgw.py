import itertools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import shortest_path

from sg3d_jax.metrics.fgw import FGW, PAIRS_PER_CALL, _fgw_stacked, fgw, fgw_pairs
from sg3d_jax.scene.concepts import FLOOR, PART_OF, PLANE, ROOM, WALL
from sg3d_jax.scene.graph import SceneGraph, make_graph, undirected_edges
from sg3d_jax.scene.padding import Capacity, pad, stack

CAPACITY = Capacity(24, 288)


def random_hierarchy(rng: np.random.Generator, rooms: int, noise: float = 0.0) -> SceneGraph:
    """Rooms of four planes on a row, a wall between neighbours, one floor; positions in metres."""
    sides = np.array([[0.0, 2.0, 1.0], [4.0, 2.0, 1.0], [2.0, 0.0, 1.0], [2.0, 4.0, 1.0]])
    planes = np.concatenate([sides + np.array([4.0 * room, 0, 0]) for room in range(rooms)])
    walls = np.array([[4.0 * room, 2.0, 1.0] for room in range(1, rooms)]).reshape(-1, 3)
    centres = np.array([[4.0 * room + 2.0, 2.0, 1.0] for room in range(rooms)])
    label = [PLANE] * len(planes) + [WALL] * len(walls) + [ROOM] * rooms + [FLOOR]
    wall, room, floor = len(planes), len(planes) + len(walls), len(label) - 1
    edges = [(4 * index + side, room + index) for index in range(rooms) for side in range(4)]
    edges += [(4 * index + 1, wall + index) for index in range(rooms - 1)]
    edges += [(4 * index + 4, wall + index) for index in range(rooms - 1)]
    edges += [(room + index, floor) for index in range(rooms)]
    position = np.concatenate([planes, walls, centres, centres.mean(axis=0, keepdims=True)])
    position += rng.normal(size=position.shape) * 0.05
    position[wall:] += rng.normal(size=position[wall:].shape) * noise
    return graph_of(label, position, edges)


def graph_of(label: list[int], position: np.ndarray, part_of: list | np.ndarray) -> SceneGraph:
    """A host graph without normals, widths or proximity."""
    count = len(label)
    return make_graph(label, position, np.zeros((count, 3)), np.zeros(count), part_of)


def perturb(rng: np.random.Generator, graph: SceneGraph, drop: int, share: float) -> SceneGraph:
    """Moves the new nodes by metres, drops the last `drop` of them and a share of the edges."""
    label, position = graph.nodes.label, graph.nodes.position.copy()
    new = label != PLANE
    position[new] += rng.normal(size=(new.sum(), 3))
    keep = len(label) - drop
    pairs = undirected_edges(graph, PART_OF)
    pairs = pairs[(pairs < keep).all(axis=1)]
    pairs = pairs[rng.random(len(pairs)) >= share]
    return graph_of(label[:keep], position[:keep], pairs)


def placed(graph: SceneGraph, position: np.ndarray | jax.Array) -> SceneGraph:
    return graph._replace(nodes=graph.nodes._replace(position=position))


def permute(graph: SceneGraph, order: np.ndarray) -> SceneGraph:
    """The same graph with its nodes listed in another order."""
    slot = np.argsort(order)
    pairs = slot[undirected_edges(graph, PART_OF)]
    return graph_of(graph.nodes.label[order], graph.nodes.position[order], pairs)


def reference_costs(
    generated: SceneGraph, truth: SceneGraph
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Feature distances and both hop matrices, in float64, dummies included."""
    planes = truth.nodes.position[truth.nodes.label == PLANE]
    scale = np.sqrt(planes[:, :2].var(axis=0).mean()) or 1.0
    size = max(len(generated.nodes.label), len(truth.nodes.label))
    features, hops, longest = [], [], []
    for graph in (generated, truth):
        count = len(graph.nodes.label)
        row = np.zeros((size, 9))
        row[:count, :3] = (graph.nodes.position - planes.mean(axis=0)) / scale
        row[np.arange(count), 3 + graph.nodes.label] = 1.0
        adjacency = np.zeros((count, count))
        adjacency[tuple(undirected_edges(graph, PART_OF).T)] = 1.0
        path = shortest_path(adjacency, directed=False, unweighted=True)
        path[np.isinf(path)] = 1 + path[np.isfinite(path)].max()
        padded = np.full((size, size), 1 + path.max())
        padded[:count, :count] = path
        np.fill_diagonal(padded, 0.0)
        features.append(row)
        hops.append(padded)
        longest.append(path.max())
    scale = max(*longest, 1.0)
    distance = np.linalg.norm(features[0][:, None] - features[1][None], axis=-1)
    return distance, hops[0] / scale, hops[1] / scale


def structure_of(plan: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The tensor product sum_kl P_kl |a_ik - b_jl|, by definition."""
    difference = np.abs(left[:, None, :, None] - right[None, :, None, :])
    return np.einsum("ijkl,kl->ij", difference, plan)


def reference_fgw(
    distance: np.ndarray, left: np.ndarray, right: np.ndarray, alpha: float
) -> tuple[float, float, float]:
    """FGW, GW and W by Frank-Wolfe with scipy's assignment and the four-axis tensor."""
    size = len(distance)
    plan = np.full((size, size), 1.0 / size**2)
    for _ in range(100):
        structure = structure_of(plan, left, right)
        gradient = (1 - alpha) * distance + 2 * alpha * structure
        vertex = np.zeros_like(plan)
        vertex[linear_sum_assignment(gradient)] = 1.0 / size
        slope = np.sum(gradient * (vertex - plan))
        if slope > -1e-12:
            break
        curvature = alpha * np.sum(structure_of(vertex - plan, left, right) * (vertex - plan))
        step = min(1.0, -slope / (2 * curvature)) if curvature > 0 else 1.0
        plan = plan + step * (vertex - plan)
    w = np.sum(distance * plan)
    gw = np.sum(structure_of(plan, left, right) * plan)
    return (1 - alpha) * w + alpha * gw, gw, w


def pot_fgw(
    distance: np.ndarray, left: np.ndarray, right: np.ndarray, alpha: float
) -> tuple[float, float, float]:
    """FGW, GW and W by POT's generic conditional gradient with the absolute loss."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ot = pytest.importorskip("ot")
    mass = np.full(len(distance), 1.0 / len(distance))

    def energy(plan):
        return np.sum(plan * structure_of(plan, left, right))

    def line_search(cost, plan, direction, *_, **__):
        slope = np.sum(cost_of(plan) * direction)
        curvature = alpha * np.sum(structure_of(direction, left, right) * direction)
        step = min(1.0, -slope / (2 * curvature)) if curvature > 0 else 1.0
        after = plan + step * direction
        return step, 1, (1 - alpha) * np.sum(distance * after) + alpha * energy(after)

    def cost_of(plan):
        return (1 - alpha) * distance + 2 * alpha * structure_of(plan, left, right)

    plan = ot.optim.cg(
        mass,
        mass,
        (1 - alpha) * distance,
        alpha,
        energy,
        lambda plan: 2 * structure_of(plan, left, right),
        np.outer(mass, mass),
        line_search=line_search,
    )
    w, gw = np.sum(distance * plan), energy(plan)
    return (1 - alpha) * w + alpha * gw, gw, w


@pytest.fixture(scope="module")
def pairs() -> tuple[list[SceneGraph], list[SceneGraph]]:
    """Generated and true graphs of one to four rooms, of unequal sizes, some disconnected."""
    rng = np.random.default_rng(7)
    truth = [random_hierarchy(rng, rooms) for rooms in (1, 2, 3, 4, 1, 2, 3, 4)]
    drops, shares = (0, 1, 2, 3, 3, 2, 1, 0), (0.0, 0.1, 0.2, 0.3, 0.3, 0.0, 0.5, 0.2)
    made = [perturb(rng, *each) for each in zip(truth, drops, shares, strict=True)]
    return made + truth[:3], truth + made[:3]


def one(generated: SceneGraph, truth: SceneGraph, capacity: Capacity = CAPACITY) -> FGW:
    return fgw(*(jax.tree.map(jnp.asarray, pad(graph, capacity)) for graph in (generated, truth)))


@pytest.mark.parametrize("reference", [reference_fgw, pot_fgw])
@pytest.mark.parametrize("alpha", [0.5, 0.2])
def test_fgw__agrees_with_other_solvers(pairs, reference, alpha):
    scores = fgw_pairs(*pairs, alpha)
    expected = [reference(*reference_costs(*pair), alpha) for pair in zip(*pairs, strict=True)]
    found = np.stack([scores.value, scores.gw, scores.w], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert scores.converged.all()
    assert scores.value.min() > 0.1


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


def test_fgw__does_not_depend_on_padding(pairs):
    generated, truth = pairs[0][1], pairs[1][1]
    tight = one(generated, truth, Capacity(len(truth.nodes.label), 64))
    loose = one(generated, truth, CAPACITY)
    np.testing.assert_allclose(loose[:3], tight[:3], atol=1e-6)


def test_fgw__does_not_depend_on_the_order_of_nodes(pairs):
    rng = np.random.default_rng(0)
    shuffled = [
        [permute(graph, rng.permutation(len(graph.nodes.label))) for graph in side]
        for side in pairs
    ]
    np.testing.assert_allclose(fgw_pairs(*shuffled).value, fgw_pairs(*pairs).value, atol=1e-5)


def test_fgw__of_a_graph_with_itself_is_zero_wherever_it_stands(pairs):
    _, truth = pairs
    far = [placed(graph, graph.nodes.position + 5e6) for graph in truth]
    assert np.abs(fgw_pairs(truth, truth).value).max() < 1e-5
    assert np.abs(fgw_pairs(far, far).value).max() < 1e-5


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


def test_fgw__in_a_vmap_is_that_of_every_pair_alone(pairs):
    batched = jax.vmap(fgw)(*(stack(side, CAPACITY) for side in pairs))
    np.testing.assert_allclose(batched.value, fgw_pairs(*pairs).value, atol=1e-6)


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


def test_gradient__of_the_positions_is_that_of_finite_differences(pairs):
    generated, truth = (jax.tree.map(jnp.asarray, pad(side[2], CAPACITY)) for side in pairs)

    def value(position):
        return fgw(
            generated._replace(nodes=generated.nodes._replace(position=position)), truth
        ).value

    position = generated.nodes.position
    gradient = jax.grad(value)(position)
    assert jnp.isfinite(gradient).all()
    node = int(jnp.argmax(jnp.abs(gradient[:, 0])))
    step = 1e-2
    sides = [value(position.at[node, 0].add(sign * step)) for sign in (1, -1)]
    np.testing.assert_allclose(gradient[node, 0], (sides[0] - sides[1]) / (2 * step), rtol=2e-2)


def test_lists_that_do_not_pair_up_are_refused(pairs):
    with pytest.raises(ValueError, match="11 generated graphs cannot be paired with 10"):
        fgw_pairs(pairs[0], pairs[1][:-1])


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
