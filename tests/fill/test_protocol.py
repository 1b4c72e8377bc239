import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.fill.protocol import count_statistics, real_pairs
from sg3d_jax.flagg.removal import Cut, draw_cut
from sg3d_jax.scene.ontology import NUM_CONCEPTS, PLANE
from tests.two_rooms import on_device, two_rooms

NUM_BLOCK = 4


@pytest.fixture(scope="module")
def cuts() -> Cut:
    graph = on_device(two_rooms())
    keys = jax.random.split(jax.random.key(0), 40)
    return jax.jit(jax.vmap(lambda key: draw_cut(graph, key, (1, 4))))(keys)


def count_by_loops(cuts: Cut) -> tuple[np.ndarray, list, list, list, list]:
    """Labels, whether pairs inside and across are linked, lengths of links, offsets of nodes."""
    label, inside, across, length, offset = np.zeros(NUM_CONCEPTS), [], [], [], []
    for index in range(len(cuts.complete)):
        block, graph = jax.tree.map(lambda leaf, i=index: leaf[i], (cuts.block, cuts.survivors))
        block, old = jax.tree.map(np.asarray, (block, graph.nodes))
        for new in np.flatnonzero(block.mask):
            label[block.label[new]] += 1
            offset.append(block.position[new] - old.position[old.mask].mean(axis=0))
            pairs = [(inside, new, other, block.position[other]) for other in range(new)]
            for token in np.flatnonzero(old.mask):
                pairs.append((across, new, NUM_BLOCK + token, old.position[token]))
            for kind, row, column, end in pairs:
                kind.append(block.edges[row, column])
                if kind[-1]:
                    length.append(np.linalg.norm(block.position[row] - end))
    return label, inside, across, length, offset


def test_statistics__are_those_of_a_loop_over_pairs(cuts):
    found = jax.jit(count_statistics)(cuts)
    label, inside, across, length, offset = count_by_loops(cuts)
    np.testing.assert_allclose(found.label, label / label.sum(), rtol=1e-5)
    np.testing.assert_allclose(found.block_edge[1], np.mean(inside), rtol=1e-5)
    np.testing.assert_allclose(found.cross_edge[1], np.mean(across), rtol=1e-5)
    np.testing.assert_allclose(found.distance_mean, np.mean(length), rtol=1e-5)
    np.testing.assert_allclose(found.distance_std, np.std(length) + 1e-3, rtol=1e-4)
    spread = np.sqrt(np.mean(np.square(offset)))
    np.testing.assert_allclose(found.position_std, spread + 1e-3, rtol=1e-4)
    assert 0 < np.mean(inside) < 1
    for marginal in found[:3]:
        np.testing.assert_allclose(jnp.sum(marginal), 1, rtol=1e-6)
    assert found.label[PLANE] == 0


def test_statistics__without_any_pair_inside_a_block_are_finite(cuts):
    graph = on_device(two_rooms())
    keys = jax.random.split(jax.random.key(1), 40)
    single = jax.jit(jax.vmap(lambda key: draw_cut(graph, key, (1,))))(keys)
    found = count_statistics(single)
    np.testing.assert_array_equal(found.block_edge, [1, 0])
    assert all(np.isfinite(field).all() for field in found)


def test_real_pairs__are_each_pair_once_and_none_of_padding():
    block_mask, old_mask = jnp.asarray([True, True, True, False]), jnp.asarray([True, False])
    square, cross = real_pairs(block_mask, old_mask)
    np.testing.assert_array_equal(np.argwhere(square), [[1, 0], [2, 0], [2, 1]])
    np.testing.assert_array_equal(np.argwhere(cross), [[0, 0], [1, 0], [2, 0]])
