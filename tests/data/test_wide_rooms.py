"""Footprints of every kind are divided into rooms that are wide enough to be in."""

import numpy as np
import pytest

from sg3d_jax.data.wide_plan import trace
from sg3d_jax.data.wide_rooms import COMMON, FOOTPRINTS, SOLID, draw_footprint, draw_rooms

NUM_ROOMS = {"few": 2.0, "home": 9.0, "corridor": 24.0, "core": 30.0, "hall": 6.0}
STRAIGHT = np.zeros(0, int)


def drawn(kind, seed, **changes):
    """A footprint and its rooms."""
    rng = np.random.default_rng([seed, len(kind)])
    footprint = draw_footprint(kind, NUM_ROOMS[kind], 0.2, rng)._replace(**changes)
    return footprint, draw_rooms(footprint, rng)


def num_rooms(labels):
    return trace(labels, STRAIGHT).room.max() + 1


def opened(mask, least):
    """The cells that a square within a mask covers, bool[x, y]."""
    windows = np.lib.stride_tricks.sliding_window_view(mask, (least, least)).all(axis=(2, 3))
    covered = np.zeros_like(mask)
    for x, y in np.argwhere(windows):
        covered[x : x + least, y : y + least] = True
    return covered


@pytest.mark.parametrize("kind", FOOTPRINTS)
def test_parts_fill_the_grid_and_the_rooms_are_about_as_many_as_asked(kind):
    counts = []
    for seed in range(25):
        footprint, labels = drawn(kind, seed)
        boxes = np.array([part.box for part in footprint.parts])
        assert labels.shape == footprint.size
        np.testing.assert_array_equal(boxes[:, :2].min(axis=0), 0)
        np.testing.assert_array_equal(boxes[:, 2:].max(axis=0), footprint.size)
        counts.append(num_rooms(labels))
    assert NUM_ROOMS[kind] / 2 < np.mean(counts) < 2 * NUM_ROOMS[kind]


@pytest.mark.parametrize("kind", ["few", "home", "core"])
def test_rooms_are_nowhere_narrower_than_a_passage(kind):
    for seed in range(25):
        footprint, labels = drawn(kind, seed)
        if min(footprint.size) < 2 * footprint.least:
            continue
        for label in np.unique(labels[labels != SOLID]):
            mask = labels == label
            assert opened(mask, footprint.least - 1)[mask].mean() > 0.9


def test_corridors_of_wings_are_joined_but_for_stairs_between_them():
    winged = [(f, labels) for f, labels in (drawn("corridor", s) for s in range(60)) if f.links]
    joined = [num_rooms(np.where(labels == COMMON, 0, SOLID)) == 1 for _, labels in winged]
    assert len(joined) > 5
    assert np.mean(joined) > 0.5


def test_nothing_merges_and_nothing_stands_in_rooms_where_no_share_says_so():
    for seed in range(10):
        _, labels = drawn("home", seed, merge=0.0, insets=0.0)
        assert (np.bincount(trace(labels, STRAIGHT).room) == 4).all()
    sides = [np.bincount(trace(drawn("home", s, merge=0.5)[1], STRAIGHT).room) for s in range(30)]
    assert {4, 6, 8} <= set(np.concatenate(sides).tolist())


def test_storeys_of_one_footprint_differ():
    footprint, labels = drawn("home", 3)
    other = draw_rooms(footprint, np.random.default_rng(99))
    assert labels.shape == other.shape
    assert (np.unique(labels).size, labels.tolist()) != (np.unique(other).size, other.tolist())
