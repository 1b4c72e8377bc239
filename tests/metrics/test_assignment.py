import jax
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from sg3d_jax.metrics.assignment import assign

CAPACITY = 12
assign_batch = jax.jit(jax.vmap(assign))


@given(
    st.lists(st.integers(0, CAPACITY), min_size=4, max_size=4),
    st.sampled_from([2, 5, 1000]),
    st.integers(0, 10_000),
)
@settings(deadline=None, max_examples=50)
def test_assignment__costs_what_scipy_pays_whatever_the_padding(sizes, levels, seed):
    # Few levels make many ties; the padding is cheaper than anything real.
    rng = np.random.default_rng(seed)
    cost = rng.integers(0, levels, (4, CAPACITY, CAPACITY)).astype(np.float32)
    for matrix, size in zip(cost, sizes, strict=True):
        matrix[size:] = matrix[:, size:] = -7.0
    found = np.asarray(assign_batch(cost, np.array(sizes, np.int32)))
    for matrix, size, columns in zip(cost, sizes, found, strict=True):
        assert sorted(columns[:size]) == list(range(size))
        np.testing.assert_array_equal(columns[size:], np.arange(size, CAPACITY))
        block = matrix[:size, :size]
        paid = block[np.arange(size), columns[:size]].sum()
        assert paid == block[linear_sum_assignment(block)].sum()
