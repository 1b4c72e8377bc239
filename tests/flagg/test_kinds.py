"""The kinds of grown nodes: what the model of them sees, and what it is asked."""

import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.fill.midi import MiDi, MiDiConfig
from sg3d_jax.flagg.kinds import Kinds, kind_loss
from sg3d_jax.flagg.step import FlaggConfig, make_flagg
from sg3d_jax.nn.embed import node_features
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from tests.furnished_rooms import BED, ROOM, ROOMS, UNIT, furnished_rooms, with_kind
from tests.two_rooms import STATISTICS, on_device, random_params

KINDS = Kinds(4, 1, FURNISHED_ONTOLOGY)
GRAPH = on_device(furnished_rooms())
loss_of = jax.jit(kind_loss)
loss_and_gradient = jax.jit(jax.value_and_grad(kind_loss))
features_of = jax.jit(node_features)


@pytest.fixture(scope="module")
def logits():
    return np.asarray(jax.jit(KINDS.logits)(random_params(KINDS.init, GRAPH), GRAPH))


def test_each_concept_has_as_many_logits_as_kinds(logits):
    assert logits.shape[1] == KINDS.most == 12
    finite = np.isfinite(logits[:9])
    assert finite.sum(axis=1).tolist() == [0, 0, 0, 0, 12, 12, 12, 3, 0]  # objects are given
    assert finite[7, :3].all()  # those of a unit come first
    assert (logits[:9][~finite] == -np.inf).all()


def test_a_model_of_concepts_without_kinds_has_nothing_to_tell_them():
    assert make_flagg(FlaggConfig(), MiDi(MiDiConfig(), STATISTICS)).kinds is None
    model = make_flagg(FlaggConfig(), MiDi(MiDiConfig(), STATISTICS, FURNISHED_ONTOLOGY))
    assert model.kinds == Kinds(32, 2, FURNISHED_ONTOLOGY)
    assert Kinds(4, 1, PAPER_ONTOLOGY).most == 0


def test_the_loss_is_the_mean_cross_entropy_of_known_kinds(logits):
    expected = [-log_softmax(logits[row])[kind] for row, kind in ((5, 0), (6, 2), (7, 1))]
    npt.assert_allclose(loss_of(logits, GRAPH, GRAPH), np.mean(expected), rtol=1e-5)
    unknown = on_device(with_kind(furnished_rooms(), ROOMS[1], 0))
    npt.assert_allclose(loss_of(logits, GRAPH, unknown), np.mean(expected[::2]), rtol=1e-5)


def log_softmax(row):
    row = row[np.isfinite(row)].astype(float)
    return row - np.log(np.exp(row).sum())


def test_what_is_taken_for_another_concept_is_not_asked_for_its_kind(logits):
    label = np.array(GRAPH.nodes.label)
    label[ROOMS[1]] = UNIT
    seen = GRAPH._replace(nodes=GRAPH.nodes._replace(label=jnp.asarray(label)))
    expected = [-log_softmax(logits[row])[kind] for row, kind in ((5, 0), (7, 1))]
    npt.assert_allclose(loss_of(logits, seen, GRAPH), np.mean(expected), rtol=1e-5)


def test_where_no_kind_is_known_the_loss_is_zero_and_its_gradient_is_finite(logits):
    true = furnished_rooms()
    none = on_device(true._replace(nodes=true.nodes._replace(kind=np.zeros(9))))
    for graph, is_known in ((none, False), (GRAPH, True)):
        loss, gradient = map(np.asarray, loss_and_gradient(logits, GRAPH, graph))
        assert np.isfinite(gradient).all()
        assert gradient.any() == (loss > 0) == is_known


def test_kinds_of_what_is_observed_are_inputs_and_those_of_what_is_grown_never():
    rooms = furnished_rooms()
    features = np.asarray(features_of(GRAPH))
    for room in ROOMS:
        npt.assert_array_equal(features_of(on_device(with_kind(rooms, room, 7))), features)
    other = np.asarray(features_of(on_device(with_kind(rooms, BED, 7))))
    changed = (other != features).any(axis=1)
    assert np.flatnonzero(changed).tolist() == [BED]
    assert (np.abs(other - features)[BED].sum(), ROOM) == (2.0, 5)  # one bit for another
