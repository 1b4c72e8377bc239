"""Floors as plans in the xy plane: random rectangles packed on a grid, merged into L shapes.

A `Plan` is changed by pure functions and turned into a storey of a scene graph last. Sides of a
rectangle are numbered counter-clockwise from +x; plane `4 r + s` is side s of room r until rooms
merge.

Source: paper, Sec. "Datasets"; rules and constants as observed in the graphs and settings that the
authors published (snt-arg/situational_graphs_datasets).
Differs: random numbers are our own, so graphs agree in distribution, not one by one; rooms are
packed along a skyline instead of cell by cell, which gives the same rectangles; at most one pair of
planes is fused when rooms merge, where the authors' tolerance fuses two or three in 2 of 1,000
merges.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.data.buildings import Motion, Storey, move_points, turn

_OUTWARD: Final = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
_LEFT: Final = np.roll(_OUTWARD, -1, axis=0)  # each outward direction turned by +90 degrees
# Below so many square metres two planes count as one line. As published, this also catches planes
# one cell out of line and, in 2 of 1,000 merges, a 0.1 m stub and the wall at right angles to it.
_MAX_COLLINEAR_AREA: Final = 0.1
_SIDES: Final = 4


@dataclass(frozen=True)
class SyntheticConfig:
    """How floors are drawn.

    Attributes:
      cell: side of a grid cell, metres.
      grid_cells: least and greatest number of cells a floor has in x and in y.
      room_cells: least and greatest number of cells a room has in x and in y. A free spot smaller
        than the least becomes a hole.
      wall_thickness: range of the wall thickness, one draw a floor, metres. Facing planes of
        neighbouring rooms are half a thickness apart, as in the published graphs.
      merge_ratio: probability that a wall is tried for merging its two rooms.
      rotate: whether the floor is turned about the origin by a uniform angle.
      stale_width: whether a plane fused from two keeps the width of one of them, as in the
        published graphs (6.5 % of the planes of S-F), instead of its true extent.

    Raises:
      ValueError: a range is empty or no room fits in the floor.
    """

    cell: float = 0.1
    grid_cells: tuple[int, int] = (50, 100)
    room_cells: tuple[int, int] = (10, 75)
    wall_thickness: tuple[float, float] = (0.16, 0.20)
    merge_ratio: float = 0.0
    rotate: bool = False
    stale_width: bool = True

    def __post_init__(self) -> None:
        """Refuses settings that no floor can be drawn with."""
        for name in ("grid_cells", "room_cells", "wall_thickness"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise ValueError(f"{name} is ({low}, {high}), expected 0 < least <= greatest")
        if self.room_cells[0] > self.grid_cells[0]:
            raise ValueError(
                f"the narrowest room has {self.room_cells[0]} cells and the narrowest floor "
                f"{self.grid_cells[0]}, expected a room to fit in every floor"
            )
        narrowest = self.cell * self.room_cells[0]
        if self.wall_thickness[1] >= 2 * narrowest:
            raise ValueError(
                f"wall_thickness reaches {self.wall_thickness[1]:g} m, expected less than twice "
                f"the narrowest room of {narrowest:g} m"
            )
        if not 0 <= self.merge_ratio <= 1:
            raise ValueError(f"merge_ratio is {self.merge_ratio:g}, expected 0 to 1")


class Plan(NamedTuple):
    """One floor: `p` planes, `r` rooms, `w` walls, all at the same height; metres."""

    ends: np.ndarray  # float[p, 2, 2], the two end points of each plane
    normal: np.ndarray  # float[p, 2], unit, into the room
    width: np.ndarray  # float[p], as published: may differ from the distance of the ends
    room: np.ndarray  # int[p], the room of each plane; -1 marks a plane being removed
    centre: np.ndarray  # float[r, 2], room centroids
    wall: np.ndarray  # int[w, 2], the two planes of each wall; -1 marks a wall being removed


def draw_plan(config: SyntheticConfig, rng: np.random.Generator) -> Plan:
    """Draws a floor of rectangular rooms, with a wall between any two that share a side."""
    first, size = pack_rooms(config, rng)
    thickness = rng.uniform(*config.wall_thickness)
    centre = config.cell * (first + (size - 1) / 2)
    half = (config.cell * size - thickness / 2)[:, None] / 2
    middle, reach = centre[:, None] + half * _OUTWARD, half * _LEFT
    ends = np.stack([middle + reach, middle - reach], axis=2).reshape(-1, 2, 2)
    return Plan(
        ends=ends,
        normal=np.tile(-_OUTWARD + 0.0, (len(centre), 1)),
        width=_length(ends),
        room=np.repeat(np.arange(len(centre)), _SIDES),
        centre=centre,
        wall=_shared_sides(first, size),
    )


def pack_rooms(config: SyntheticConfig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Fills a grid with rectangles, each at the free cell that is lowest in x, then in y.

    Returns:
      First cell, int[r, 2], and number of cells, int[r, 2], of each room; holes are left out.
    """
    low, high = config.room_cells
    end, num_columns = (int(n) for n in rng.integers(*config.grid_cells, size=2, endpoint=True))
    free_from = [0] * num_columns  # the first free x of each column y
    rooms = []
    while (x := min(free_from)) < end:
        y = free_from.index(x)
        y_end = next((k for k in range(y, num_columns) if free_from[k] > x), num_columns)
        wanted = rng.integers(low, high, size=2, endpoint=True)
        size_x, size_y = min(end - x, int(wanted[0])), min(y_end - y, int(wanted[1]))
        free_from[y : y + size_y] = [x + size_x] * size_y
        if min(size_x, size_y) >= low:
            rooms.append((x, y, size_x, size_y))
    table = np.array(rooms, int).reshape(-1, 4)
    return table[:, :2], table[:, 2:]


def _shared_sides(first: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Returns the pairs of facing planes, int[w, 2], in the order of their first common cell."""
    last = first + size
    start = np.maximum(first[:, None], first[None])  # of the overlap, [a, b, axis]
    overlap = start < np.minimum(last[:, None], last[None])
    touch = last[:, None] == first[None]
    found = []
    for axis in (0, 1):
        a, b = np.nonzero(touch[..., axis] & overlap[..., 1 - axis])
        cell = start[a, b]
        cell[:, axis] -= 1
        side = np.full(len(a), axis)
        found.append(np.column_stack([cell, side, _SIDES * a + axis, _SIDES * b + axis + 2]))
    table = np.concatenate(found)
    return table[np.lexsort(table[:, 2::-1].T)][:, 3:]


def merge_rooms(plan: Plan, ratio: float, stale_width: bool, rng: np.random.Generator) -> Plan:
    """Merges pairs of neighbouring rectangles into L shapes.

    Each wall is tried with probability `ratio`. Its rooms merge if exactly one of its two planes
    has no other wall and both rooms are still rectangles. The plane without other walls goes; the
    other one is shortened to what the removed room leaves of it; two planes on one line are fused.

    Args:
      plan: rectangular rooms.
      ratio: probability.
      stale_width: see `SyntheticConfig`.
      rng: source of randomness.

    Returns:
      A plan whose rooms have 4, 6 or 7 planes; planes and walls that went keep their places,
      marked -1, until `without_removed`. The centroid of a merged room is the mean centroid of the
      eight planes before any is removed, as published.
    """
    num_walls = np.bincount(plan.wall.ravel(), minlength=len(plan.room))
    free = np.bincount(plan.room, minlength=len(plan.centre)) == _SIDES
    for index in np.flatnonzero(rng.random(len(plan.wall)) < ratio).tolist():
        planes = plan.wall[index]
        rooms = plan.room[planes]
        alone = num_walls[planes] == 1
        if alone[0] != alone[1] and free[rooms].all():
            free[rooms] = False
            removed, shortened = planes[np.argsort(~alone)].tolist()
            first, second = rng.permutation(rooms).tolist()
            plan = _cut(plan, index, shortened, removed)
            plan = _fuse(plan, first, second, removed, stale_width)
    return plan


def _cut(plan: Plan, wall: int, shortened: int, removed: int) -> Plan:
    """Opens the wall between two rooms: one of its planes is shortened, the wall is removed.

    The end nearest to the other room's planes moves to their projection nearest the other end.
    """
    ends, width, walls = plan.ends.copy(), plan.width.copy(), plan.wall.copy()
    others = plan.ends[plan.room == plan.room[removed]].mean(axis=1)
    start, along = ends[shortened, 0], ends[shortened, 1] - ends[shortened, 0]
    fraction = np.clip((others - start) @ along / (along @ along), 0, 1)
    if fraction.min() <= 1 - fraction.max():
        ends[shortened, 0] = start + fraction.max() * along
    else:
        ends[shortened, 1] = start + fraction.min() * along
    width[shortened] = _length(ends[shortened])
    walls[wall] = -1
    return plan._replace(ends=ends, width=width, wall=walls)


def _fuse(plan: Plan, first: int, second: int, removed: int, stale_width: bool) -> Plan:
    """Gives the planes of the second room to the first and fuses a pair that lies on one line."""
    ends, width, wall = plan.ends.copy(), plan.width.copy(), plan.wall.copy()
    room, centre = plan.room.copy(), plan.centre.copy()
    of_first, of_second = np.flatnonzero(room == first), np.flatnonzero(room == second)
    room[of_second] = first
    room[removed] = -1
    area = _area_between(ends[of_first], ends[of_second])
    area[(of_first == removed)[:, None] | (of_second == removed)] = np.inf
    i, j = np.unravel_index(np.argmin(area), area.shape)
    if area[i, j] < _MAX_COLLINEAR_AREA:
        kept, fused = of_first[i], of_second[j]
        ends[kept] = _farthest_ends(ends[kept], ends[fused])
        width[kept] = width[kept] if stale_width else _length(ends[kept])
        wall[wall == fused] = kept
        room[fused] = -1
    centre[first] = ends[np.concatenate([of_first, of_second])].mean(axis=(0, 1))
    return plan._replace(ends=ends, width=width, room=room, centre=centre, wall=wall)


def _area_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns float[a, b]: the greater area that segment a spans with an end of segment b."""
    along = (one[:, 1] - one[:, 0])[:, None, None]
    offset = other[None] - one[:, None, None, 0]
    area = along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]
    return np.abs(area).max(axis=-1)


def _farthest_ends(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns the end of each of two segments, float[2, 2], that lie farthest apart."""
    distance = _length(np.stack(np.broadcast_arrays(one[:, None], other[None]), axis=-2))
    i, j = np.unravel_index(np.argmax(distance), distance.shape)
    return np.stack([one[i], other[j]])


def _length(ends: np.ndarray) -> np.ndarray:
    """Returns the length of segments, float[...], from float[..., 2, 2]."""
    return np.asarray(np.linalg.norm(ends[..., 0, :] - ends[..., 1, :], axis=-1))


def without_removed(plan: Plan) -> Plan:
    """Drops the planes and walls marked as removed and the rooms without planes."""
    keep = plan.room >= 0
    slot = np.cumsum(keep) - 1
    rooms, room = np.unique(plan.room[keep], return_inverse=True)
    return Plan(
        ends=plan.ends[keep],
        normal=plan.normal[keep],
        width=plan.width[keep],
        room=room,
        centre=plan.centre[rooms],
        wall=slot[plan.wall[plan.wall[:, 0] >= 0]],
    )


def move_plan(plan: Plan, motion: Motion) -> Plan:
    """Moves a plan rigidly."""
    return plan._replace(
        ends=move_points(plan.ends, *motion),
        normal=turn(plan.normal, motion.angle),
        centre=move_points(plan.centre, *motion),
    )


def fit_plan(plan: Plan, target: Plan, stale_width: bool) -> Plan:
    """Shrinks a plan, never enlarging it, into the box of another and centres it there.

    Args:
      plan: what to fit.
      target: whose box to fit it in; both axis-aligned.
      stale_width: whether planes keep the width they had, as in the published graphs.

    Returns:
      The plan, scaled uniformly.
    """
    (low, high), (target_low, target_high) = _box(plan), _box(target)
    scale = min(1.0, ((target_high - target_low) / (high - low)).min())
    middle, target_middle = (low + high) / 2, (target_low + target_high) / 2
    return plan._replace(
        ends=(plan.ends - middle) * scale + target_middle,
        width=plan.width if stale_width else plan.width * scale,
        centre=(plan.centre - middle) * scale + target_middle,
    )


def _box(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Returns the least and greatest coordinates of a plan, float[2] each."""
    return plan.ends.min(axis=(0, 1)), plan.ends.max(axis=(0, 1))


def storey_of(plan: Plan) -> Storey:
    """Turns a plan into a storey whose floor node is the mean of its rooms."""
    plane = plan.ends.mean(axis=1)
    return Storey(
        plane=plane,
        normal=plan.normal,
        width=plan.width,
        room=plan.room,
        room_centre=plan.centre,
        wall=np.column_stack([plan.wall.ravel(), np.repeat(np.arange(len(plan.wall)), 2)]),
        wall_centre=plane[plan.wall].mean(axis=1),
        centre=plan.centre.mean(axis=0),
    )
