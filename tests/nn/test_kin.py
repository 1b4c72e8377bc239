"""Kin are the nearest nodes of a node's own concept."""

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.nn.kin import connect_kin, hears_kin, kin_fit, kin_slots
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import BUILDING, FLOOR, PLANE, PROXIMITY, ROOM, WALL
from sg3d_jax.scene.padding import Capacity
from tests import own_world
from tests.two_rooms import on_device, with_garbage

CAPACITY = Capacity(64, 1024)

connect_compiled = jax.jit(connect_kin, static_argnums=1)
fit = jax.jit(kin_fit)
hears = jax.jit(hears_kin)


def connected(graph, k):
    return jax.tree.map(np.asarray, connect_compiled(graph, k))


@pytest.mark.parametrize("k", [1, 3, 8])
def test_kin__are_the_nearest_nodes_of_the_same_concept_above_the_walls(k):
    rng = np.random.default_rng(k)
    label = rng.permutation([PLANE] * 12 + [WALL] * 6 + [ROOM] * 7 + [FLOOR] * 3 + [BUILDING])
    position, size = rng.normal(size=(len(label), 3)), len(label)
    pairs = rng.permutation(size)[:20].reshape(-1, 2)
    graph = make_graph(label, position, np.zeros((size, 3)), np.zeros(size), pairs)
    padded = jax.tree.map(np.asarray, on_device(graph, CAPACITY))
    found = connected(padded, k)
    expected = set()
    for node in np.flatnonzero(label >= ROOM):
        kin = [int(other) for other in np.flatnonzero(label == label[node]) if other != node]
        kin.sort(key=lambda other: np.linalg.norm(position[other] - position[node]))
        expected |= {(other, int(node)) for other in kin[:k]}
    new = found.edges.mask[CAPACITY.edges :]
    ends = np.stack([found.senders, found.receivers], axis=-1)[CAPACITY.edges :]
    assert sorted(map(tuple, ends[new].tolist())) == sorted(expected)
    assert (ends[~new] == 0).all()
    assert (found.edges.relation[CAPACITY.edges :] == PROXIMITY).all()
    assert found.n_edge[0] == found.edges.mask.sum() == padded.n_edge[0] + len(expected)
    assert found.n_edge.sum() == len(found.edges.mask)
    for old, kept in zip(jax.tree.leaves(padded), jax.tree.leaves(found), strict=True):
        if old.shape[:1] == (CAPACITY.edges,):
            npt.assert_array_equal(kept[: CAPACITY.edges], old)


def test_kin__beyond_the_slots_for_them_are_left_out():
    label = np.array([PLANE] * 2 + [ROOM] * 10)
    position = np.arange(36.0).reshape(12, 3)
    graph = make_graph(label, position, np.zeros((12, 3)), np.zeros(12), np.zeros((0, 2)))
    found = connected(on_device(graph, Capacity(12, 4)), 8)
    kept = found.receivers[found.edges.mask]
    assert set(kept.tolist()) == {2, 3, 4, 5}


@pytest.mark.parametrize("num_rooms", [3, 4, 5, 6])
def test_kin__fit_up_to_a_third_of_the_slots(num_rooms):
    label = np.array([PLANE] * 2 + [WALL] * 2 + [ROOM] * (num_rooms - 1) + [FLOOR])
    graph = on_device(make_graph(label, np.zeros((len(label), 3))), Capacity(16, 16))
    assert kin_slots(16) == 5
    assert fit(graph) == (num_rooms <= 5)
    assert fit(with_garbage(graph, 0)) == (num_rooms <= 5)


def test_those_that_hear_of_their_kin__are_named_by_the_ontology():
    scene = own_world.own_world()
    graph = on_device(scene, Capacity(24, 288))
    hearing = [own_world.ROOM, own_world.FLAT, own_world.FLOOR]
    expected = np.pad(np.isin(scene.nodes.label, hearing), (0, 24 - len(scene.nodes.label)))
    npt.assert_array_equal(hears(graph), expected)
    npt.assert_array_equal(hears(with_garbage(graph, 1)), expected)
    found = connected(graph, 2)
    new = found.edges.mask[288:]
    ends = np.stack([found.senders, found.receivers], axis=-1)[288:][new]
    label = scene.nodes.label[ends]
    npt.assert_array_equal(label[:, 0], label[:, 1])
    assert np.bincount(label[:, 1]).tolist() == [0, 0, 0, 3 * 2, 2 * 1]  # the floor is alone
