"""Splits: sizes, coverage, determinism."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sg3d_jax.data.splits import MIN_GRAPHS, PARTS, split, split_groups, split_of


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


@pytest.mark.parametrize("num_graphs", [200, 3000, 3003, 4000])
def test_a_part_of_a_set_or_more_of_it_is_dealt_as_the_set(num_graphs):
    whole, parts = split(3000), split(num_graphs, whole=3000)
    assert sorted(np.concatenate(parts).tolist()) == [*range(num_graphs)]
    for one, of_whole in zip(parts, whole, strict=True):
        shared = one[one < 3000]
        assert shared.tolist() == of_whole[of_whole < num_graphs].tolist()
        assert len(one)


def test_so_few_that_a_part_would_be_empty_are_dealt_by_themselves():
    for one, other in zip(split(5, whole=3000), split(5), strict=True):
        assert one.tolist() == other.tolist()


def test_published_results_rest_on_this_split():
    assert split(2400).test[:5].tolist() == [1863, 1546, 71, 822, 1379]


def test_too_few_graphs_are_refused():
    with pytest.raises(ValueError, match="at least 5 graphs, got 4"):
        split(4)


@given(st.lists(st.integers(0, 40), min_size=1, max_size=200), st.integers(0, 2**32))
def test_a_group_is_never_divided(groups, seed):
    parts = split_groups(groups, seed)
    if len(set(groups)) < MIN_GRAPHS:
        assert parts == ["test"] * len(groups)
        return
    assert len(parts) == len(groups)
    assert len(set(zip(groups, parts, strict=True))) == len(set(groups))
    assert set(parts) == set(PARTS)


def test_groups_of_one_are_dealt_60_20_20():
    parts = split_groups([f"building {i}" for i in range(1000)])
    assert [parts.count(part) for part in PARTS] == [600, 200, 200]


def test_a_file_that_states_its_parts_is_obeyed_whatever_the_seed():
    stated = split_of({"parts": ["test", "train", "test"]}, 3, seed=5)
    assert [sorted(part.tolist()) for part in stated] == [[1], [], [0, 2]]


def test_the_first_graphs_of_a_stated_part_are_a_sample_of_it():
    parts = ["test"] * 100
    first = split_of({"parts": parts}, 100, seed=5).test[:10]
    assert first.max() > 50
    np.testing.assert_array_equal(first, split_of({"parts": parts}, 100, seed=5).test[:10])


def test_a_file_that_states_no_parts_is_dealt_by_the_seed():
    for one, other in zip(split_of({}, 50, seed=5), split(50, 5), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("parts", [["test"], ["test", "exam"], "test", ["test", ["train"]], 3])
def test_parts_that_do_not_fit_are_refused(parts):
    with pytest.raises(ValueError, match="name one of train, validation, test for each graph"):
        split_of({"parts": parts}, 2)


@pytest.mark.parametrize("whole", ["3000", 4, True, 2.5, 10**12])
def test_a_whole_that_is_no_number_of_graphs_is_refused(whole):
    with pytest.raises(ValueError, match="expected a number from 5 to"):
        split_of({"whole": whole}, 10)
    with pytest.raises(ValueError, match="at least 5 graphs, got 3"):
        split_of({"whole": 3000}, 3)
