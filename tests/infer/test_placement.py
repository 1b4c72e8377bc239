"""Grown nodes of whole graphs, put where their edges say, wherever a graph stands."""

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.flagg.step import FlaggConfig, make_flagg
from sg3d_jax.infer.placement import placed
from sg3d_jax.scene.padding import Capacity
from tests.growing_rooms import AddRooms, stop_at
from tests.tiny_run import untrained_model
from tests.two_rooms import NUM_PLANES, moved, on_device, random_params, two_rooms

SCENE = two_rooms()
MODEL = make_flagg(FlaggConfig(coins=(1,), placement=(8, 3, 2)), AddRooms())


@pytest.fixture(scope="module")
def params():
    return stop_at(0)._replace(placement=random_params(MODEL.placement.init, on_device(SCENE)))


@pytest.fixture(scope="module")
def expected(params):
    return placed(MODEL, params, SCENE, NUM_PLANES).nodes.position


def test_grown_nodes_go_where_they_are_told_or_no_farther_than_allowed_and_what_was_given_stays(
    params, expected
):
    told = np.asarray(MODEL.placement.positions(params.placement, on_device(SCENE)))[:12]
    way = told - SCENE.nodes.position
    far = np.linalg.norm(way, axis=1)
    assert far[NUM_PLANES:].min() > 0.2
    moved_by = expected - SCENE.nodes.position
    npt.assert_allclose(np.linalg.norm(moved_by, axis=1)[NUM_PLANES:], 0.15, atol=1e-6)
    npt.assert_allclose(moved_by[8:] * far[8:, None] / 0.15, way[8:], atol=1e-3)
    npt.assert_array_equal(expected[:NUM_PLANES], SCENE.nodes.position[:NUM_PLANES])
    near = SCENE.nodes.position.copy()
    near[NUM_PLANES:] = np.add(told[NUM_PLANES:], [0.03, -0.04, 0.05])
    scene = SCENE._replace(nodes=SCENE.nodes._replace(position=near))
    npt.assert_allclose(placed(MODEL, params, scene, 8).nodes.position[8:], told[8:], atol=1e-4)
    with_room = placed(MODEL, params, SCENE, 10).nodes.position
    npt.assert_array_equal(with_room[:10], SCENE.nodes.position[:10])
    npt.assert_array_equal(with_room[10:], expected[10:])


def test_it_does_not_depend_on_the_place_or_the_padding(params, expected):
    motion = {"angle": 0.7, "offset": (1e5, -5e4, 20.0), "flip": True}
    found = placed(MODEL, params, moved(SCENE, **motion), NUM_PLANES)
    there = SCENE._replace(nodes=SCENE.nodes._replace(position=expected))
    npt.assert_allclose(found.nodes.position, moved(there, **motion).nodes.position, atol=2e-3)
    wider = placed(MODEL, params, SCENE, NUM_PLANES, Capacity(64, 512)).nodes.position
    npt.assert_allclose(wider, expected, atol=1e-4)


@pytest.mark.parametrize("method", ["midi", "ec-square"])
def test_without_a_placement_a_graph_stays_as_it_is(method):
    assert placed(untrained_model(method), None, SCENE, NUM_PLANES) is SCENE
