"""Plans of floors: packing, walls, merging, moving and fitting."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.data import synthetic_floor
from sg3d_jax.data.buildings import Motion
from sg3d_jax.data.synthetic import S_F, S_F_SQUARE
from sg3d_jax.data.synthetic_floor import Plan, SyntheticConfig

configs = st.sampled_from([S_F_SQUARE, S_F])
indices = st.integers(0, 10**6)


@given(indices)
@settings(deadline=None, max_examples=30)
def test_rectangles_are_closed_and_do_not_overlap(index):
    plan = synthetic_floor.draw_plan(S_F_SQUARE, np.random.default_rng(index))
    corners = plan.ends.reshape(-1, 4, 2, 2)
    np.testing.assert_allclose(
        corners[:, :, 0], np.roll(corners, -1, axis=1)[:, :, 1][:, [3, 0, 1, 2]][:, [1, 2, 3, 0]]
    )
    low, high = corners.min(axis=(1, 2)), corners.max(axis=(1, 2))
    start, end = np.maximum(low[:, None], low), np.minimum(high[:, None], high)
    overlap = (end - start > 1e-9).all(axis=-1)
    assert (overlap == np.eye(len(low), dtype=bool)).all()
    np.testing.assert_allclose(plan.centre, (low + high) / 2)
    inwards = (plan.centre[plan.room] - plan.ends.mean(axis=1)) * plan.normal
    assert (inwards.sum(axis=1) > 0).all()
    assert (plan.normal[plan.wall].sum(axis=1) == 0).all(), "planes of a wall face each other"


# --- the rules, against a direct cell-by-cell implementation ---


def packed_cell_by_cell(config: SyntheticConfig, rng: np.random.Generator) -> np.ndarray:
    """Fills the grid as the paper's authors do: room numbers from 1, holes -1."""
    grid = np.zeros(rng.integers(*config.grid_cells, size=2, endpoint=True), int)
    low, high = config.room_cells
    number = 0
    for x, y in np.ndindex(grid.shape):
        if grid[x, y]:
            continue
        free_x = next((k for k, cell in enumerate(grid[x:, y]) if cell), len(grid) - x)
        free_y = next((k for k, cell in enumerate(grid[x, y:]) if cell), grid.shape[1] - y)
        size = np.minimum([free_x, free_y], rng.integers(low, high, size=2, endpoint=True))
        number += min(size) >= low
        grid[x : x + size[0], y : y + size[1]] = number if min(size) >= low else -1
    return grid


@given(configs, indices)
@settings(deadline=None, max_examples=10)
def test_skyline_packing_and_walls_are_those_of_the_cell_by_cell_scan(config, seed):
    grid = packed_cell_by_cell(config, np.random.default_rng(seed))
    rooms = [np.argwhere(grid == number) for number in range(1, grid.max() + 1)]
    first, size = synthetic_floor.pack_rooms(config, np.random.default_rng(seed))
    np.testing.assert_array_equal(first, [cells.min(axis=0) for cells in rooms])
    np.testing.assert_array_equal(first + size, [cells.max(axis=0) + 1 for cells in rooms])

    walls = {}
    for x, y in np.ndindex(grid.shape):
        for side, neighbour in ((0, grid[x + 1 :, y][:1]), (1, grid[x, y + 1 :][:1])):
            a, b = grid[x, y], neighbour[0] if len(neighbour) else -1
            if a > 0 and b > 0 and a != b:
                walls.setdefault((a, b), [4 * (a - 1) + side, 4 * (b - 1) + side + 2])
    plan = synthetic_floor.draw_plan(config, np.random.default_rng(seed))
    assert plan.wall.tolist() == list(walls.values())


def test_facing_planes_are_half_a_wall_thickness_apart():
    config = dataclasses.replace(S_F_SQUARE, wall_thickness=(0.18, 0.18))
    plan = synthetic_floor.draw_plan(config, np.random.default_rng(3))
    offset = np.diff(plan.ends.mean(axis=1)[plan.wall], axis=1)[:, 0]
    normal = plan.normal[plan.wall[:, 0]]
    np.testing.assert_allclose(np.abs((offset * normal).sum(axis=1)), 0.09)


# --- merging ---


def rectangles(first: list, size: list) -> Plan:
    """Returns the plan of given rectangles, in metres, without space between them."""
    first, size = np.array(first, float), np.array(size, float)
    outward = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    centre, left = first + size / 2, np.roll(outward, -1, axis=0)
    middle = centre[:, None] + outward * size[:, None] / 2
    reach = left * size[:, None] / 2
    ends = np.stack([middle + reach, middle - reach], axis=2).reshape(-1, 2, 2)
    return Plan(
        ends=ends,
        normal=np.tile(-outward, (len(first), 1)),
        width=np.abs(np.diff(ends, axis=1)).sum(axis=(1, 2)),
        room=np.repeat(np.arange(len(first)), 4),
        centre=centre,
        wall=np.zeros((0, 2), int),
    )


def three_rooms() -> Plan:
    """A wide room (6 x 2) below a narrow one (4 x 2, left) and a third (2 x 2, right)."""
    plan = rectangles([(0, 0), (0, 2), (4, 2)], [(6, 2), (4, 2), (2, 2)])
    return plan._replace(wall=np.array([[1, 4 + 3], [1, 8 + 3], [4 + 0, 8 + 2]]))


def merge_first_wall(plan: Plan, stale_width: bool) -> Plan:
    """Merges over wall 0 only."""

    class OnlyFirst(np.random.Generator):
        def random(self, size: int) -> np.ndarray:
            return np.array([0.0] + [1.0] * (size - 1))

    merged = synthetic_floor.merge_rooms(plan, 0.5, stale_width, OnlyFirst(np.random.PCG64(0)))
    return synthetic_floor.without_removed(merged)


def test_merging_two_rectangles_gives_an_l_of_six_planes():
    plan = merge_first_wall(three_rooms(), stale_width=False)
    assert np.bincount(plan.room).tolist() == [6, 4]
    lengths = np.linalg.norm(np.diff(plan.ends, axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(plan.width, lengths)
    expected = {((6, 0), (6, 2)), ((4, 2), (6, 2)), ((4, 2), (4, 4)), ((0, 4), (4, 4))}
    expected |= {((0, 0), (0, 4)), ((0, 0), (6, 0))}
    merged = plan.ends[plan.room == 0].round(9).astype(int)
    assert {tuple(sorted(map(tuple, ends))) for ends in merged.tolist()} == expected


def test_merging_drops_the_wall_and_keeps_the_others():
    plan = merge_first_wall(three_rooms(), stale_width=True)
    centres = plan.ends.mean(axis=1)[plan.wall].tolist()
    assert sorted(centres) == [[[4, 3], [4, 3]], [[5, 2], [5, 2]]]


def test_centroid_of_a_merged_room_is_the_mean_of_eight_planes():
    plan = merge_first_wall(three_rooms(), stale_width=True)
    wide = [(6, 1), (5, 2), (3, 0)]  # the shortened plane counts where it is now
    narrow = [(4, 3), (2, 4), (2, 2)]  # the removed plane counts too
    fused = [(0, 2)]
    fragments = [(0, 1), (0, 3)]  # one of the fused planes still counts where it was
    candidates = [np.mean([*wide, *narrow, *fused, old], axis=0) for old in fragments]
    assert any(np.allclose(plan.centre[0], candidate) for candidate in candidates)


def test_a_wall_between_planes_without_other_walls_is_not_merged():
    plan = rectangles([(0, 0), (0, 2)], [(4, 2), (4, 2)])._replace(wall=np.array([[1, 7]]))
    merged = synthetic_floor.merge_rooms(plan, 1.0, True, np.random.default_rng(0))
    assert (merged.room == plan.room).all()


# --- moving and fitting ---


def draw(seed: int) -> Plan:
    return synthetic_floor.draw_plan(S_F, np.random.default_rng(seed))


@given(indices, st.floats(-10, 10), st.floats(-50, 50))
@settings(deadline=None, max_examples=20)
def test_moving_keeps_lengths_and_the_fixed_point_goes_to_its_target(seed, angle, shift):
    plan = draw(seed)
    about = plan.centre[0]
    moved = synthetic_floor.move_plan(plan, Motion(angle, about, np.array([shift, 1.0])))
    np.testing.assert_allclose(moved.centre[0] - about, [shift, 1.0], atol=1e-9)
    lengths = [np.linalg.norm(np.diff(p.ends, axis=1)[:, 0], axis=1) for p in (plan, moved)]
    np.testing.assert_allclose(*lengths)
    inwards = (moved.centre[moved.room] - moved.ends.mean(axis=1)) * moved.normal
    assert (inwards.sum(axis=1) > 0).all()


@given(indices, indices)
@settings(deadline=None, max_examples=30)
def test_a_fitted_plan_lies_centred_in_the_box_of_the_other_and_never_grows(seed, other):
    plan, target = draw(seed), draw(other)
    fitted = synthetic_floor.fit_plan(plan, target, stale_width=False)
    low, high = fitted.ends.min(axis=(0, 1)), fitted.ends.max(axis=(0, 1))
    target_low, target_high = target.ends.min(axis=(0, 1)), target.ends.max(axis=(0, 1))
    np.testing.assert_allclose(low + high, target_low + target_high)
    size, target_size = high - low, target_high - target_low
    scale = size / np.ptp(plan.ends, axis=(0, 1))
    np.testing.assert_allclose(scale[0], scale[1])
    assert (size <= target_size + 1e-9).all()
    assert scale[0] == pytest.approx(1) or np.isclose(size, target_size).any()
    np.testing.assert_allclose(fitted.width, plan.width * scale[0])


def test_stale_widths_of_a_fitted_plan_are_those_before_shrinking():
    plan, target = draw(0), draw(1)
    smaller = target._replace(ends=target.ends / 3)
    fitted = synthetic_floor.fit_plan(plan, smaller, stale_width=True)
    np.testing.assert_array_equal(fitted.width, plan.width)
    assert np.ptp(fitted.ends) < np.ptp(plan.ends)


# --- settings ---


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grid_cells": (100, 50)}, "grid_cells"),
        ({"room_cells": (0, 50)}, "room_cells"),
        ({"room_cells": (60, 70)}, "a room to fit"),
        ({"wall_thickness": (0.2, 2.5)}, "wall_thickness"),
        ({"merge_ratio": 1.5}, "merge_ratio"),
    ],
)
def test_settings_that_cannot_be_drawn_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(S_F, **change)
