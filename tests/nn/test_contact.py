"""Contacts are the observed nodes whose extents come closest."""

import jax
import numpy as np
import numpy.testing as npt
import pytest
import shapely

from sg3d_jax.nn.contact import connect_contacts, gaps
from sg3d_jax.scene.graph import make_graph, undirected_edges
from sg3d_jax.scene.ontology import PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.padding import Capacity
from tests.two_rooms import on_device

CAPACITY = Capacity(24, 96)

connect_compiled = jax.jit(connect_contacts, static_argnums=1)


def connected(graph, k):
    return jax.tree.map(np.asarray, connect_compiled(on_device(graph, CAPACITY), k))


@pytest.fixture(scope="module")
def scene():
    """Planes of all headings at two heights, some of them neighbours, and two rooms."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 14)
    normal = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(14)])
    position = np.column_stack([rng.uniform(0, 12, (16, 2)), rng.integers(0, 2, 16) * 3.0])
    width = rng.uniform(0.5, 4, 14)
    return make_graph(
        [PLANE] * 14 + [ROOM] * 2,
        position,
        np.pad(normal, [(0, 2), (0, 0)]),
        np.pad(width, (0, 2)),
        proximity=[(0, 1), (2, 5), (3, 9), (0, 7)],
    )


def distances(graph):
    """The squared distances of the nearest ends, by shapely."""
    nodes = graph.nodes
    along = np.column_stack([-nodes.normal[:, 1], nodes.normal[:, 0]])
    reach = nodes.width[:, None] / 2 * along
    ends = np.stack([nodes.position[:, :2] - reach, nodes.position[:, :2] + reach], axis=1)
    lines, points = shapely.linestrings(ends), shapely.points(ends)
    apart = shapely.distance(points[:, :, None], lines[None, None]).min(axis=1)
    height = nodes.position[:, 2]
    return np.minimum(apart, apart.T) ** 2 + (height[:, None] - height[None]) ** 2


def test_gaps__are_those_of_shapely(scene):
    found = np.asarray(jax.jit(gaps)(on_device(scene, CAPACITY).nodes))[:16, :16]
    npt.assert_allclose(found, distances(scene), atol=1e-4)


@pytest.mark.parametrize("k", [1, 4, 30])
def test_contacts__are_the_nearest_by_extent_that_are_no_neighbours_yet(scene, k):
    found = connected(scene, k)
    squared, joined = distances(scene), undirected_edges(scene, PROXIMITY)
    known = {(int(a), int(b)) for pair in joined for a, b in (pair, pair[::-1])}
    expected = set()
    for node in range(14):
        others = [o for o in range(14) if o != node and (o, node) not in known]
        others.sort(key=lambda other: squared[other, node])
        expected |= {(other, node) for other in others[:k]}
    new = found.edges.mask[CAPACITY.edges :]
    ends = np.stack([found.senders, found.receivers], axis=-1)[CAPACITY.edges :]
    assert sorted(map(tuple, ends[new].tolist())) == sorted(expected)
    assert (found.edges.relation[CAPACITY.edges :] == PROXIMITY).all()
    assert found.n_edge[0] == found.edges.mask.sum()
    assert found.n_edge.sum() == len(found.edges.mask)


def test_contacts__of_planes_that_meet_far_from_their_middles_are_found():
    """Two sides of a corridor's corner, and ten short planes around the middle of the first."""
    position = np.zeros((12, 3))
    position[1, :2] = 10, 10
    position[2:, 0] = np.linspace(-2, 2, 10)
    position[2:, 1] = 1
    normal = np.tile([0.0, 1.0, 0.0], (12, 1))
    normal[1] = [-1.0, 0.0, 0.0]
    width = np.full(12, 0.3)
    width[:2] = 20
    found = connected(make_graph([PLANE] * 12, position, normal, width), 1)
    assert found.senders[found.edges.mask][:2].tolist() == [1, 0]
