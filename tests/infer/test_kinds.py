"""How likely each kind is for what was grown, wherever a graph stands and however it is padded."""

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.fill.midi import MiDi, MiDiConfig
from sg3d_jax.flagg import step
from sg3d_jax.flagg.step import FlaggConfig, make_flagg
from sg3d_jax.infer import lanes
from sg3d_jax.infer.kinds import chances_of_kinds, with_kinds
from sg3d_jax.scene.padding import Capacity
from tests.furnished_rooms import NUM_OBSERVED, furnished_rooms
from tests.tiny_run import untrained_model
from tests.two_rooms import STATISTICS, moved, on_device, random_params, reordered

GRAPH = furnished_rooms()
MODEL = make_flagg(
    FlaggConfig(width=4, depth=1), MiDi(MiDiConfig(), STATISTICS, FURNISHED_ONTOLOGY)
)


@pytest.fixture(scope="module")
def params():
    return step.Params(None, None, None, random_params(MODEL.kinds.init, on_device(GRAPH)))


@pytest.fixture(scope="module")
def expected(params):
    return chances_of_kinds(MODEL, params, GRAPH, NUM_OBSERVED)


def test_chances_are_those_of_the_kinds_of_each_concept(expected):
    assert expected.shape == (4, 12)
    assert expected.dtype == np.float64
    npt.assert_allclose(expected[:3].sum(axis=1), 1, atol=1e-6)
    assert (expected[:2] > 0).all()
    npt.assert_array_equal(expected[2] > 0, [True] * 3 + [False] * 9)  # of a unit
    assert not expected[3].any()  # a floor has none


def test_chances_do_not_depend_on_the_place_or_the_padding(params, expected, monkeypatch):
    shifted = moved(GRAPH, angle=0.7, offset=(1e5, -5e4, 20.0))
    found = chances_of_kinds(MODEL, params, shifted, NUM_OBSERVED)
    npt.assert_allclose(found, expected, atol=1e-4)
    monkeypatch.setattr(lanes, "growth_capacity", lambda num_observed: Capacity(64, 512))
    npt.assert_allclose(chances_of_kinds(MODEL, params, GRAPH, NUM_OBSERVED), expected, atol=1e-5)


def test_chances_follow_the_order_of_the_grown_nodes(params, expected):
    order = np.array([6, 8, 5, 7])
    found = chances_of_kinds(MODEL, params, reordered(GRAPH, np.r_[:5, order]), NUM_OBSERVED)
    npt.assert_allclose(found, expected[order - NUM_OBSERVED], atol=1e-5)


@pytest.mark.parametrize("method", ["midi", "ec-square"])
def test_a_model_that_tells_no_kinds_says_so(method):
    assert chances_of_kinds(untrained_model(method), None, GRAPH, NUM_OBSERVED) is None


def test_grown_nodes_get_their_likeliest_kind_and_given_ones_keep_theirs():
    chances = np.array([[0.2, 0.5, 0.3], [0.1, 0.1, 0.8], [0.6, 0.2, 0.2], [0, 0, 0]])
    assert with_kinds(GRAPH, chances).nodes.kind.tolist() == [0, 0, 0, 0, 1, 2, 3, 1, 0]
    assert GRAPH.nodes.kind.tolist() == [0, 0, 0, 0, 1, 1, 3, 2, 0]
