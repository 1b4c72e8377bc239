import jax.numpy as jnp
import numpy as np

from sg3d_jax.fill.protocol import frame_centre, real_pairs
from tests.two_rooms import STATISTICS, on_device, two_rooms, with_garbage


def test_real_pairs__are_each_pair_once_and_none_of_padding():
    block_mask, old_mask = jnp.asarray([True, True, True, False]), jnp.asarray([True, False])
    square, cross = real_pairs(block_mask, old_mask)
    np.testing.assert_array_equal(np.argwhere(square), [[1, 0], [2, 0], [2, 1]])
    np.testing.assert_array_equal(np.argwhere(cross), [[0, 0], [1, 0], [2, 0]])


def test_frame__is_centred_at_the_mean_of_the_real_nodes():
    nodes = with_garbage(on_device(two_rooms()), 0).nodes
    centre = frame_centre(nodes.position, nodes.mask)
    np.testing.assert_allclose(centre, two_rooms().nodes.position.mean(axis=0), rtol=1e-5)
    nothing = frame_centre(nodes.position, jnp.zeros_like(nodes.mask))
    np.testing.assert_array_equal(nothing, np.zeros(3))


def test_marginals__are_the_statistics_as_arrays_under_the_same_names():
    for name, values in STATISTICS.marginals._asdict().items():
        np.testing.assert_allclose(values, getattr(STATISTICS, name), rtol=1e-6)
