"""Where a network puts the nodes of a graph, and what that does not depend on."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.vector_gine import VectorGINE, amid_parts, directions, part_of_alone
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import PART_OF, PLANE, ROOM
from tests.nn.gradients import with_gradient
from tests.two_rooms import (
    CAPACITY,
    LABELS,
    NUM_PLANES,
    PART_OF_PAIRS,
    TWICE,
    moved,
    on_device,
    planes_of_room,
    random_params,
    reordered,
    two_rooms,
    with_garbage,
)

SCENE = two_rooms()
NETWORK = VectorGINE(8, 3, 2)
NUM_NODES = len(LABELS)
MOTION = {"angle": 0.7, "offset": (12.0, -5.0, 3.0), "flip": True}


@jax.jit
def run(params, graph):
    return apply(NETWORK, params, graph)


run_with_gradient = with_gradient(run)


@pytest.fixture(scope="module")
def params():
    return random_params(NETWORK.init, on_device(SCENE))


@pytest.fixture(scope="module")
def expected(params):
    return np.asarray(run(params, on_device(SCENE)))


def test_grown_nodes_start_in_the_middle_of_their_parts():
    away = SCENE._replace(
        nodes=SCENE.nodes._replace(position=SCENE.nodes.position + 9 * (np.arange(12) > 7)[:, None])
    )
    graph = on_device(away)
    position = np.asarray(amid_parts(graph).nodes.position)
    npt.assert_allclose(position[:NUM_NODES], SCENE.nodes.position, atol=1e-6)
    npt.assert_array_equal(position[:NUM_PLANES], graph.nodes.position[:NUM_PLANES])


def test_what_has_no_parts_starts_where_it_is():
    scene = make_graph([PLANE, PLANE, ROOM], [[0, 0, 0], [4, 0, 0], [7, 8, 9]])
    npt.assert_array_equal(amid_parts(on_device(scene)).nodes.position[2], [7, 8, 9])


def test_part_of_edges_alone_are_kept_and_all_of_them():
    graph = on_device(SCENE)
    kept = part_of_alone(graph)
    chosen = np.asarray(kept.edges.mask)
    assert (np.asarray(kept.edges.relation)[chosen] == PART_OF).all()
    pairs = np.stack([kept.senders, kept.receivers], axis=1)[chosen].tolist()
    assert sorted(pairs) == sorted([*map(list, PART_OF_PAIRS), *([b, a] for a, b in PART_OF_PAIRS)])
    assert len(kept.edges.mask) == 6 * CAPACITY.nodes < len(graph.edges.mask)


def test_the_directions_of_an_edge():
    """From a plane at the origin that looks north to one 3 m north and 4 m west, 1 m higher."""
    position, normal = [[0, 0, 0], [-4, 3, 1]], [[0, 1, 0], [1, 0, 0]]
    scene = make_graph([PLANE, PLANE], position, normal, [1, 1], proximity=[(1, 0)])
    found = np.asarray(directions(scene)[0])
    npt.assert_allclose(found[:3], [[1, 0, 0], [0, 1, 0], [-4, 3, 1]])
    npt.assert_allclose(found[3:], [[-4, 0, 0], [0, 3, 0], [0, 0, 1]])


def test_what_is_observed_stays_and_all_else_moves(expected):
    npt.assert_allclose(expected[:NUM_PLANES], SCENE.nodes.position[:NUM_PLANES], atol=1e-6)
    apart = np.linalg.norm(expected[NUM_PLANES:12] - SCENE.nodes.position[NUM_PLANES:], axis=1)
    assert (apart > 0.01).all()


def test_centroids_move_as_the_scene_does(params, expected):
    found = np.asarray(run(params, on_device(moved(SCENE, **MOTION))))[:NUM_NODES]
    where = SCENE._replace(nodes=SCENE.nodes._replace(position=expected[:NUM_NODES].astype(float)))
    npt.assert_allclose(found, moved(where, **MOTION).nodes.position, atol=2e-3)


def test_neither_padding_nor_order_nor_proximity_matters(params, expected):
    expected = expected[:NUM_NODES]
    for graph in (
        with_garbage(on_device(SCENE), 1),
        on_device(SCENE, TWICE),
        on_device(make_graph(*SCENE.nodes[:4], part_of=PART_OF_PAIRS)),
    ):
        npt.assert_allclose(run(params, graph)[:NUM_NODES], expected, atol=1e-4)
    order = np.random.default_rng(0).permutation(NUM_NODES)
    npt.assert_allclose(
        run(params, on_device(reordered(SCENE, order)))[:NUM_NODES], expected[order], atol=1e-4
    )


def test_gradients_are_finite_and_reach_every_parameter(params):
    _, gradient = run_with_gradient(params, on_device(SCENE))
    chex.assert_tree_all_finite(gradient)
    assert all(np.any(leaf) for leaf in jax.tree.leaves(gradient))


def test_a_room_can_be_put_amid_what_is_left_of_its_planes():
    """Two planes end early: parts along the normals of the senders alone lead to the middle."""
    centroid, normal, width = planes_of_room(0.0, 4.0, 0.0, 3.0)
    hidden = np.array([[0, 0.4], [0, 0], [-1, 0], [-1.3, 0]])
    seen = np.pad(np.array(centroid) + hidden, [(0, 0), (0, 1)])
    scene = make_graph(
        [PLANE] * 4 + [ROOM],
        [*seen, [0, 0, 0]],
        [*np.pad(normal, [(0, 0), (0, 1)]), [0, 0, 0]],
        [*width, 0],
        [(plane, 4) for plane in range(4)],
    )
    graph = amid_parts(on_device(scene))
    start = np.asarray(graph.nodes.position[4])
    assert np.abs(start[:2] - [2, 1.5]).min() > 0.05
    to_room = np.asarray(graph.edges.mask & (graph.receivers == 4))
    along = np.asarray(directions(graph))[to_room, 3]
    npt.assert_allclose(start + 2 * along.mean(axis=0), [2, 1.5, 0], atol=1e-6)
    assert jnp.allclose(along[:, 2], 0)
