from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from sg3d_jax.fill import mds
from sg3d_jax.nn.embed import Surface
from tests.two_rooms import rotation

NUM_BLOCK, NUM_OLD = 4, 12  # of which eight old nodes are real
REAL = np.arange(NUM_OLD) < 8
recover = jax.jit(mds.recover_positions)
compiled_stress = jax.jit(mds.stress)


class Problem(NamedTuple):
    """Old nodes and the links of a block, as `recover_positions` wants them."""

    distance: np.ndarray
    edges: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    above: np.ndarray = np.zeros(NUM_BLOCK, bool)

    def solve(self) -> np.ndarray:
        old = Surface(*map(jnp.asarray, (self.position, self.normal, np.zeros(NUM_OLD, "f"))))
        inputs = jnp.asarray(self.distance), jnp.asarray(self.edges), old, jnp.asarray(REAL)
        return np.asarray(recover(*inputs, jnp.asarray(self.above)))


def problem(links, truth, position, normal=None, stretch=1.0) -> Problem:
    """Links are pairs (block node, token); distances are those of the truth, stretched."""
    old, new = np.zeros((NUM_OLD, 3), np.float32), np.zeros((NUM_BLOCK, 3), np.float32)
    old[: len(position)], new[: len(truth)] = position, truth
    facing = np.zeros_like(old)
    if normal is not None:
        facing[: len(normal)] = normal
    edges = np.zeros((NUM_BLOCK, NUM_BLOCK + NUM_OLD), bool)
    for node, token in links:
        edges[node, token] = True
        if token < NUM_BLOCK:
            edges[token, node] = True
    tokens = np.concatenate([new, old])
    distance = stretch * np.linalg.norm(new[:, None] - tokens[None], axis=-1)
    return Problem(distance.astype(np.float32), edges, old, facing)


def walls_of_room(angle=0.0, height=0.0, tilt=0.0):
    """Eight plane centroids around the origin, at one height, or at several with a tilt."""
    x = np.array([-2, 2, 0, 0.3, -2.1, 2.2, -0.5, 1.0])
    y = np.array([0, 0.2, -1.5, 1.6, 1.0, -0.9, 1.4, -1.3])
    z = height + tilt * np.sin(np.arange(8))
    return np.stack([x, y, z], axis=-1) @ rotation(angle).T


def old_links(node, olds):
    return [(node, NUM_BLOCK + old) for old in olds]


def residuals(moving, instance, free):
    position = np.zeros((NUM_BLOCK, 3))
    position[free] = moving.reshape(-1, 3)
    tokens = np.concatenate([position, instance.position])
    length = np.linalg.norm(position[:, None] - tokens[None], axis=-1)
    once = instance.edges.copy()
    once[:, :NUM_BLOCK] = np.tril(once[:, :NUM_BLOCK], -1)
    return (length - instance.distance)[once]


def stress(position, instance):
    old, distance, edges = map(jnp.asarray, (instance.position, instance.distance, instance.edges))
    return float(compiled_stress(jnp.asarray(position), old, distance, edges))


@given(
    first=st.tuples(*[st.floats(-10, 10)] * 3),
    direction=st.floats(-4, 4),
    thickness=st.floats(0.05, 0.6),
)
@settings(deadline=None, max_examples=25)
def test_a_wall__stands_between_its_two_planes(first, direction, thickness):
    across = rotation(direction)[:, 0] * thickness
    planes = np.array([first, first + across])
    truth = [first + across / 2]
    instance = problem(old_links(0, [0, 1]), truth, planes)
    np.testing.assert_allclose(instance.solve()[:1], truth, atol=5e-3)


@pytest.mark.parametrize("floors", [[(1, 2, 0)], [(1, 2, 0), (1, 2, 3)], [(9, 4, 1), (-3, 1, 2)]])
@pytest.mark.parametrize("stretch", [0.99, 1.0, 1.01])
def test_what_stands_above__is_found_above(floors, stretch):
    """A building over one floor, over two on top of each other, a city over two buildings."""
    position = np.array(floors, np.float32)
    truth = [*position[:, :2].mean(axis=0), position[:, 2].max() + 4]
    instance = problem(old_links(0, range(len(floors))), [truth], position, stretch=stretch)
    instance = instance._replace(above=np.arange(NUM_BLOCK) == 0)
    np.testing.assert_allclose(instance.solve()[0], truth, atol=0.4 if stretch != 1 else 0.01)


def test_what_stands_above__may_hang_on_new_nodes():
    truth = np.array([[0.5, 0.2, 0], [-0.8, 0.1, 0], [-0.15, 0.15, 4]], np.float32)
    links = [(2, 0), (2, 1), *old_links(0, range(4)), *old_links(1, range(4))]
    instance = problem(links, truth, walls_of_room())
    instance = instance._replace(above=np.arange(NUM_BLOCK) == 2)
    np.testing.assert_allclose(instance.solve()[:3], truth, atol=0.05)


@pytest.mark.parametrize("stretch", [0.7, 1.3])
def test_a_wall__stays_on_the_line_between_its_planes_whatever_the_distances(stretch):
    for direction in np.linspace(-3, 3, 20):
        across = rotation(direction)[:, 0]
        planes = np.array([[3.0, -2.0, 1.0], [3.0, -2.0, 1.0] + 0.2 * across])
        middle = planes.mean(axis=0)
        found = problem(old_links(0, [0, 1]), middle[None], planes, stretch=stretch).solve()[0]
        off = (found - middle) - ((found - middle) @ across) * across
        assert np.linalg.norm(off) < 1e-4


@given(st.lists(st.integers(0, 7), min_size=4, max_size=8, unique=True), st.integers(0, 1000))
@settings(deadline=None, max_examples=25)
def test_a_room__is_found_from_its_distances(olds, seed):
    truth = np.random.default_rng(seed).normal(0, 0.5, 3) * [1, 1, 0]
    instance = problem(old_links(0, olds), [truth], walls_of_room())
    np.testing.assert_allclose(instance.solve()[0], truth, atol=2e-3)


@pytest.mark.parametrize("stretch", [0.8, 1.2, 1.6])
@pytest.mark.parametrize("olds", [[0, 1], [0, 1, 2], range(8)])
def test_a_room__stays_at_the_height_of_its_planes_whatever_the_distances(stretch, olds):
    instance = problem(old_links(0, olds), np.zeros((1, 3)), walls_of_room(), stretch=stretch)
    assert instance.solve()[0, 2] == 0


def test_rooms_and_their_new_floor__are_found_together():
    planes = walls_of_room(tilt=0.5)
    rooms = np.array([[-1.0, 0.1, 0.1], [1.1, -0.2, 0.0]])
    truth = np.concatenate([rooms, rooms.mean(axis=0, keepdims=True)])
    links = old_links(0, [0, 2, 3, 4, 6]) + old_links(1, [1, 2, 3, 5, 7]) + [(2, 0), (2, 1)]
    found = problem(links, truth, planes).solve()
    np.testing.assert_allclose(found[:3], truth, atol=5e-3)


def test_the_order_of_a_new_room_and_its_floor__does_not_matter():
    planes, room = walls_of_room(), np.array([0.4, -0.2, 0.0])
    truth = np.stack([room, room])
    links = [*old_links(1, range(4)), (0, 1), *old_links(0, [5])]
    swapped = [*old_links(0, range(4)), (0, 1), *old_links(1, [5])]
    found, other = (problem(pairs, truth, planes).solve() for pairs in (links, swapped))
    np.testing.assert_allclose(found[[1, 0]], other[:2], atol=1e-5)


def test_a_node_without_edges__stands_at_the_mean_of_the_old_graph():
    planes = walls_of_room(height=1.3)
    found = problem(old_links(1, range(8)), np.zeros((2, 3)), planes).solve()
    np.testing.assert_allclose(found[0], planes.mean(axis=0), atol=1e-6)


def test_a_node_with_one_neighbour__stands_at_its_distance_in_front():
    planes = walls_of_room()
    normal = np.array([[0.0, 1.0, 0.0]])
    truth = planes[:1] + 0.7 * normal
    found = problem(old_links(0, [0]), truth, planes, normal).solve()
    np.testing.assert_allclose(found[:1], truth, atol=1e-4)


def test_a_node_beside_one_point__stands_at_its_distance_towards_the_others():
    planes = walls_of_room()
    inwards = planes.mean(axis=0) - planes[5]
    truth = planes[5] + 0.7 * inwards / np.linalg.norm(inwards)
    found = problem(old_links(0, [5]), truth[None], planes).solve()
    np.testing.assert_allclose(found[0], truth, atol=1e-4)


@pytest.mark.parametrize(
    ("position", "stretch"),
    [(np.zeros((8, 3)), 1.0), (np.ones((8, 3)), 3.0), (walls_of_room(), 0.0)],
    ids=["zero distances", "coincident points", "distances of zero between others"],
)
def test_what_has_no_direction__is_finite(position, stretch):
    links = old_links(0, [0, 1, 2]) + old_links(1, [2]) + [(1, 0), (2, 1), (3, 2)]
    instance = problem(links, np.zeros((4, 3)), position, stretch=stretch)
    assert np.isfinite(instance.solve()).all()


@pytest.mark.parametrize(("num_new", "tolerance"), [(1, 1e-6), (NUM_BLOCK, 1e-3)])
def test_stress__is_as_low_as_scipy_gets_it_from_the_same_start(num_new, tolerance):
    """In the plane of the old nodes, where inconsistent distances have one minimum nearby."""
    new = slice(num_new)
    for seed in range(20):
        instance = inconsistent(seed, num_new)
        neighbours = instance.edges[new, NUM_BLOCK:]
        start = np.stack([instance.position[chosen, :2].mean(axis=0) for chosen in neighbours])

        def flat(moving, instance=instance):
            return residuals(np.pad(moving.reshape(-1, 2), ((0, 0), (0, 1))), instance, new)

        lowest = np.sum(least_squares(flat, start.ravel()).fun ** 2)
        assert stress(instance.solve(), instance) <= lowest + tolerance


@pytest.mark.parametrize("stretch", [0.6, 1.5])
def test_stress__comes_to_a_minimum_also_where_the_first_steps_are_far_too_long(stretch):
    """Old nodes of nearly one height hardly curve the stress upwards: damping must be raised."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        links = old_links(0, rng.choice(8, rng.integers(3, 8), replace=False))
        truth = rng.normal(0, 0.5, 3) * [1, 1, 0.1]
        instance = problem(links, [truth], walls_of_room(tilt=0.1), stretch=stretch)
        found = instance.solve()
        fit = least_squares(residuals, found[0], args=(instance, slice(1)), xtol=1e-12, ftol=1e-12)
        assert stress(found, instance) <= np.sum(fit.fun**2) + 1e-4


def inconsistent(seed: int, num_new: int) -> Problem:
    """New nodes among coplanar old ones, with distances that are off by a few percent."""
    rng = np.random.default_rng(seed)
    truth = rng.normal(0, 0.4, (num_new, 3)) * [1, 1, 0]
    olds = [rng.choice(8, rng.integers(4, 8), replace=False) for _ in truth]
    links = [link for node, chosen in enumerate(olds) for link in old_links(node, chosen)]
    links += [(num_new - 1, node) for node in range(num_new - 2)]
    exact = problem(links, truth, walls_of_room())
    noise = 0.03 * rng.normal(size=exact.distance.shape)
    noise[:, :NUM_BLOCK] += noise[:, :NUM_BLOCK].T
    return exact._replace(distance=(exact.distance * (1 + noise)).astype(np.float32))


def test_stress__counts_every_edge_once():
    rng = np.random.default_rng(5)
    truth = rng.normal(size=(NUM_BLOCK, 3)).astype(np.float32)
    links = old_links(0, [0, 3]) + old_links(2, [1]) + [(1, 0), (3, 2)]
    instance = problem(links, truth, walls_of_room(), stretch=1.3)
    expected = np.sum(residuals(truth.ravel(), instance, slice(None)) ** 2)
    np.testing.assert_allclose(stress(truth, instance), expected, rtol=1e-5)


def test_gradient__is_finite_also_at_coincident_points_and_without_edges():
    instance = problem([*old_links(0, [0, 1, 2]), (1, 0)], np.zeros((4, 3)), np.zeros((8, 3)))

    def total(distance, position):
        old = Surface(position, jnp.zeros((NUM_OLD, 3)), jnp.zeros(NUM_OLD))
        edges, mask = jnp.asarray(instance.edges), jnp.asarray(REAL)
        above = jnp.zeros(NUM_BLOCK, bool)
        return jnp.sum(mds.recover_positions(distance, edges, old, mask, above) ** 2)

    gradients = jax.jit(jax.grad(total, argnums=(0, 1)))(
        jnp.asarray(instance.distance), jnp.asarray(instance.position)
    )
    chex.assert_tree_all_finite(gradients)
