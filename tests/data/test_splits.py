"""Splits: sizes, coverage, determinism."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sg3d_jax.data.splits import MIN_GRAPHS, split


@pytest.mark.parametrize(
    ("num_graphs", "sizes"), [(2400, (1440, 480, 480)), (3000, (1800, 600, 600)), (5, (3, 1, 1))]
)
def test_sizes_are_60_20_20_percent(num_graphs, sizes):
    assert tuple(map(len, split(num_graphs))) == sizes


@given(st.integers(MIN_GRAPHS, 500), st.integers(0, 2**32))
def test_every_graph_is_in_exactly_one_part(num_graphs, seed):
    parts = split(num_graphs, seed)
    assert sorted(np.concatenate(parts)) == list(range(num_graphs))
    assert min(map(len, parts)) >= 1


def test_the_same_seed_gives_the_same_split_and_another_seed_another():
    for one, same, other in zip(split(100, 3), split(100, 3), split(100, 4), strict=True):
        np.testing.assert_array_equal(one, same)
        assert not np.array_equal(one, other)


def test_published_results_rest_on_this_split():
    assert split(2400).test[:5].tolist() == [1863, 1546, 71, 822, 1379]


def test_too_few_graphs_are_refused():
    with pytest.raises(ValueError, match="at least 5 graphs, got 4"):
        split(4)
