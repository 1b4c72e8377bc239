import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from sg3d_jax.baselines.edge_features import (
    Scales,
    absolute_features,
    count_scales,
    near_planes,
    relative_features,
    segment_distance,
)
from sg3d_jax.scene.graph import Nodes, make_graph
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.padding import stack
from tests.two_rooms import CAPACITY, NUM_PLANES, moved, on_device, two_rooms, with_garbage

SCENE = two_rooms()
SCALES = Scales(1.0, 5.0, 10.0)
run = jax.jit(lambda graph: (absolute_features(graph, SCALES), relative_features(graph, SCALES)))


def real(values, graph):
    """Keeps what belongs to planes and to the proximity edges between them."""
    ((planes, near), (plane, pair)), graph = jax.tree.map(np.asarray, (values, graph))
    is_near, is_plane = near_planes(graph).mask, graph.nodes.label == PLANE
    is_plane &= graph.nodes.mask
    return planes[is_plane], near[is_near], plane[is_plane], pair[is_near]


def segments(position, angle, width):
    """Returns planes on the ground as nodes."""
    normal = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    position = np.concatenate([position, np.zeros((len(position), 1))], axis=-1)
    label, mask = np.zeros(len(width), int), np.ones(len(width), bool)
    return Nodes(*(jnp.asarray(x) for x in (label, position, normal, width, 0 * width, mask, mask)))


def test_segment_distance__is_that_of_the_segments_of_the_planes():
    rng = np.random.default_rng(0)
    position, angle, width = (
        rng.uniform(0, 4, (40, 2)),
        rng.uniform(0, 7, 40),
        rng.uniform(0, 3, 40),
    )
    along = np.stack([-np.sin(angle), np.cos(angle)], axis=-1) * width[:, None] / 2
    lines = [
        shapely.LineString(ends) for ends in zip(position - along, position + along, strict=True)
    ]
    one, other = np.triu_indices(40, 1)
    expected = [lines[i].distance(lines[j]) for i, j in zip(one, other, strict=True)]
    assert 20 < np.count_nonzero(np.array(expected) == 0) < 700
    ends = jnp.asarray(one), jnp.asarray(other)
    found = jax.jit(segment_distance)(segments(position, angle, width), *ends)
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("position", "angle", "expected"),
    [
        ((3, 0), np.pi, (0.3, 0.25, 0.5)),  # opposite, in one room
        ((-0.2, 0), np.pi, (0.02, 0.75, 0.5)),  # the other face of a wall
        ((0, 2), np.pi / 2, (0.2, 0.5, 0.25)),  # at right angles, beside
    ],
)
def test_relative_features__tell_how_a_plane_lies_to_another(position, angle, expected):
    normal = [[1, 0, 0], [np.cos(angle), np.sin(angle), 0]]
    pair = make_graph([PLANE] * 2, [[0, 0, 0], [*position, 0]], normal, [2, 4], [], [(0, 1)])
    plane, edge = run(on_device(pair))[1]
    np.testing.assert_allclose(np.asarray(edge)[0], expected, atol=1e-5)
    np.testing.assert_allclose(np.asarray(plane)[:2, 0], [0.4, 0.8], atol=1e-6)


def test_absolute_features__of_a_plane_and_of_an_edge_from_it():
    position, normal = [[1, 2, 0], [4, -1, 5]], [[1, 0, 0], [0, -1, 0]]
    pair = make_graph([PLANE] * 2, position, normal, [2, 5], [], [(0, 1)])
    plane, edge = run(on_device(pair))[0]
    plane, edge = np.asarray(plane), np.asarray(edge)
    np.testing.assert_allclose(plane[:2], [[0.25, 1, 0.5], [1, 0.5, 0]], atol=1e-6)
    gap = np.hypot(0.5, 2) / 10  # from (1, 1) to (1.5, -1)
    np.testing.assert_allclose(edge[0], [gap, (-3 + 10) / 20, (3 + 10) / 20], atol=1e-5)


def test_relative_features__do_not_see_where_the_building_stands__absolute_ones_its_direction():
    graph = on_device(SCENE)
    expected = real(run(graph), graph)
    turned = real(run(on_device(moved(SCENE, 0.7, (3, -8, 2), flip=True))), graph)
    shifted = real(run(on_device(moved(SCENE, 0.0, (3, -8, 2)))), graph)
    chex.assert_trees_all_close(turned[2:], expected[2:], atol=1e-3)
    chex.assert_trees_all_close(shifted, expected, atol=1e-4)
    assert np.abs(turned[0] - expected[0]).max() > 0.1
    assert np.abs(turned[1] - expected[1]).max() > 0.1


def test_scales__are_of_planes_and_of_those_that_are_near():
    graphs = stack([SCENE, moved(SCENE, 1.0)], CAPACITY)
    spoilt = jax.tree.map(lambda leaf: np.asarray(leaf)[None], with_garbage(on_device(SCENE), 0))
    nodes = SCENE.nodes
    senders, receivers, near = near_planes(jax.tree.map(np.asarray, on_device(SCENE)))
    offset = (nodes.position[senders] - nodes.position[receivers])[near]
    expected = (
        nodes.width[:NUM_PLANES].min(),
        nodes.width.max(),
        np.linalg.norm(offset, axis=1).max(),
    )
    np.testing.assert_allclose(count_scales([graphs, spoilt]), expected, rtol=1e-5)


def test_scales__grow_with_any_of_the_stacks():
    wide = SCENE._replace(nodes=SCENE.nodes._replace(width=SCENE.nodes.width * 3))
    one, both = (
        count_scales([stack([graph], CAPACITY) for graph in graphs])
        for graphs in ([SCENE], [SCENE, wide])
    )
    np.testing.assert_allclose(both.width_max, 3 * one.width_max, rtol=1e-6)
    np.testing.assert_allclose(both.width_min, one.width_min)
