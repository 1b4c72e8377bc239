"""From rooms as labels of a grid to the planes of a storey: outlines, angles, wall thickness.

The lines of the grid are put into the plane by a `Frame`, which keeps each of them straight, or
bends those along x at a few places: walls stand at right angles, askew, in fans, around bends.
Then every side of a room moves inwards by half of the thickness of its wall. A line has one
thickness, so that a gap is as wide as was drawn, but for sides with a lining.
"""

from typing import Final, NamedTuple

import numpy as np
import shapely

from sg3d_jax.data.buildings import Storey
from sg3d_jax.data.floorplan import RULES, Sides, find_walls, storey_of

MIN_SIDE: Final = 0.12  # metres: a room with a shorter side is too narrow for its walls
SMALLEST_CUT: Final = 2.4  # metres: only rooms at least so wide are cut off at an angle
LINING: Final = (0.02, 0.07)  # metres that a lining is thick
MAX_SIDES: Final = 20  # of a room
STEEPEST: Final = 0.5  # tangent of the greatest angle that a line leans by
SMALLEST_BEND: Final = 0.14  # radians
MAX_BENDS: Final = 5
_TURNS: Final = 4  # sides of a cell: 0 right, 1 below, 2 left, 3 above


class Frame(NamedTuple):
    """Where the lines of a grid are: crossing (i, j) is at `base[i] + depth[j] * lean[i]`."""

    base: np.ndarray  # float[x + 1, 2], metres
    lean: np.ndarray  # float[x + 1, 2]
    depth: np.ndarray  # float[y + 1], metres
    bends: np.ndarray  # int[b], the lines in y at which those in x bend


class Thickness(NamedTuple):
    """The thickness of the walls along each line of a grid, metres."""

    x: np.ndarray  # float[x + 1]
    y: np.ndarray  # float[y + 1]
    oblique: float  # of walls that cut a room off at a corner or in two
    lined: float  # share of the sides that have a lining


class Outline(NamedTuple):
    """The corners of all rooms, ring by ring: `c` corners, each with the side that starts there."""

    corner: np.ndarray  # int[c, 2], line in x and in y; or float[c, 2], metres
    side: np.ndarray  # int[c], the line that the side runs along; or float[c], metres to move in
    ring: np.ndarray  # int[c], nondecreasing
    room: np.ndarray  # int[c], nondecreasing; the first ring of a room is its outer one


# --- outlines ---


def trace(labels: np.ndarray, bends: np.ndarray) -> Outline:
    """Returns the corners of every connected patch of one label, -1 excepted.

    Args:
      labels: int[x, y].
      bends: int[b], lines in y at which a side along x has a corner.

    Returns:
      An outline in lines of the grid; `side` counts lines in x first. Outer rings turn
      counter-clockwise, holes clockwise.
    """
    padded = _framed(labels, -1)
    lines_x, lines_y = _changes(padded), _changes(padded.T)
    if len(bends):
        lines_x = np.union1d(lines_x, bends[(bends > lines_x[0]) & (bends < lines_x[-1])])
    cells = _framed(padded[lines_x[:-1] + 1][:, lines_y[:-1] + 1], -1)
    bent = np.zeros((len(lines_x) + 2, len(lines_y) + 2), bool)
    bent[1:-1] = np.isin(lines_x, bends)[:, None]
    edge, following, end, vertex, turn = _corners(cells, bent)
    order, ring = _rings(np.searchsorted(edge, end[following]))
    corner = np.stack(np.divmod(vertex[order], len(lines_y) + 2), axis=1) - 1
    corner = np.column_stack([lines_x[corner[:, 0]], lines_y[corner[:, 1]]])
    along_x = following[order] % 2 == 1
    side = np.where(along_x, len(labels) + 1 + corner[:, 1], corner[:, 0])
    label = cells.ravel()[edge[order] // _TURNS]
    is_hole = np.bincount(ring, turn[order]) < 0
    room = _rooms_of_rings(corner, ring, label, is_hole)
    rank = np.empty(len(room), int)
    rank[np.lexsort((is_hole, room))] = np.arange(len(room))
    by_room = np.argsort(rank[ring], kind="stable")
    ring = ring[by_room]
    return Outline(corner[by_room], side[by_room], rank[ring], room[ring])


def _framed(cells: np.ndarray, value: int) -> np.ndarray:
    """Puts a row of one value around a grid."""
    framed = np.full((cells.shape[0] + 2, cells.shape[1] + 2), value)
    framed[1:-1, 1:-1] = cells
    return framed


def _changes(padded: np.ndarray) -> np.ndarray:
    """Returns the lines between rows that differ; line k is between rows k and k + 1."""
    return np.flatnonzero((padded[1:] != padded[:-1]).any(axis=1))


def _corners(cells: np.ndarray, bent: np.ndarray) -> tuple[np.ndarray, ...]:
    """Returns the edges of cells at whose ends a side of a patch ends, walking around it.

    Edge `4 k + s` is side s of cell k, walked with the cell on the left.

    Returns:
      Sorted edges, the edge that comes after each, for every edge of a patch the one at which its
      side ends, the crossing at the end of each and its turn: 1 left, -1 right, 0 for a bend.
    """
    cell = np.arange(cells.size).reshape(cells.shape)
    crossing = np.arange(bent.size).reshape(bent.shape)
    end = np.zeros(_TURNS * cells.size, int)
    found = []
    for quarter in range(_TURNS):  # turned so that the walk goes up on the right of a cell
        turned, name = np.rot90(cells, quarter), np.rot90(cell, quarter)
        here, beside = turned[:-1, :-1], turned[1:, :-1]
        ahead, across = turned[:-1, 1:], turned[1:, 1:]
        is_edge = (here != beside) & (here >= 0)
        left = ahead != here
        right = ~left & (across == here)
        ends = left | right
        if quarter % 2:
            ends |= np.rot90(bent, quarter)[1:-1, 1:-1]
        ends &= is_edge
        steps = np.where(ends, np.arange(ends.shape[1]), ends.shape[1])
        last = np.minimum.accumulate(steps[:, ::-1], axis=1)[:, ::-1]
        x, y = np.nonzero(is_edge)
        end[_TURNS * name[x, y] + quarter] = _TURNS * name[x, last[x, y]] + quarter
        x, y = np.nonzero(ends)
        to_left, to_right = left[x, y], right[x, y]
        after = np.where(
            to_left, name[x, y], np.where(to_right, name[x + 1, y + 1], name[x, y + 1])
        )
        turn = to_left.astype(int) - to_right
        after = _TURNS * after + (quarter - turn) % _TURNS
        at = np.rot90(crossing, quarter)[x + 1, y + 1]
        found.append(np.stack([_TURNS * name[x, y] + quarter, after, at, turn]))
    edge, after, at, turn = np.concatenate(found, axis=1)
    order = np.argsort(edge)
    return edge[order], after[order], end, at[order], turn[order]


def _rings(successor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the cycles of a permutation: its items in order, and the cycle of each."""
    following = successor.tolist()
    left = [True] * len(following)
    order, ring, number = [], [], 0
    for start in range(len(following)):
        if not left[start]:
            continue
        item = start
        while left[item]:
            left[item] = False
            order.append(item)
            ring.append(number)
            item = following[item]
        number += 1
    return np.array(order), np.array(ring)


def _rooms_of_rings(
    corner: np.ndarray, ring: np.ndarray, label: np.ndarray, is_hole: np.ndarray
) -> np.ndarray:
    """Returns the room of each ring: an outer ring has its own, a hole that of one around it."""
    room = np.cumsum(~is_hole) - 1
    starts = np.flatnonzero(np.diff(ring, prepend=-1))
    label = label[starts]
    low, high = np.minimum.reduceat(corner, starts), np.maximum.reduceat(corner, starts)
    area = (high - low).prod(axis=1)
    for hole in np.flatnonzero(is_hole):
        around = ~is_hole & (label == label[hole])
        around &= (low <= low[hole]).all(axis=1) & (high >= high[hole]).all(axis=1)
        room[hole] = room[np.where(around, area, area.max() + 1).argmin()]
    return room


# --- from lines to metres ---


def put_in_place(
    outline: Outline, frame: Frame, thickness: Thickness, rng: np.random.Generator
) -> Outline:
    """Puts an outline where its lines are and says by how much each side has to move in, metres."""
    i, j = outline.corner.T
    half = np.concatenate([thickness.x, thickness.y])[outline.side] / 2
    lined = rng.random(len(half)) < thickness.lined
    if len(frame.bends):  # on both sides of a bend the same
        lined &= outline.side < len(thickness.x)
    half = half + np.where(lined, rng.uniform(*LINING, len(half)), 0)
    corner = frame.base[i] + frame.depth[j, None] * frame.lean[i]
    return outline._replace(corner=corner, side=half)


def cut_off(outline: Outline, share: float, thickness: float, rng: np.random.Generator) -> Outline:
    """Cuts some four-sided rooms at an angle: across, in two, or at their corners.

    Args:
      outline: metres.
      share: of the rooms that are large enough.
      thickness: of the walls that cut, metres.
      rng: source of randomness.
    """
    length = np.linalg.norm(outline.corner[_next(outline.ring)] - outline.corner, axis=1)
    size = np.bincount(outline.room)
    starts = np.cumsum(size) - size
    fits = (size == _TURNS) & (np.minimum.reduceat(length, starts) >= SMALLEST_CUT)
    chosen = np.flatnonzero(fits & (rng.random(len(size)) < share))
    if not len(chosen):
        return outline
    kept = ~np.isin(outline.room, chosen)
    parts = [
        part
        for first in starts[chosen].tolist()
        for part in _cut_room(
            outline.corner[first : first + _TURNS],
            outline.side[first : first + _TURNS],
            thickness / 2,
            rng,
        )
    ]
    number = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    added = np.concatenate(parts)
    _, room = np.unique(np.append(outline.room[kept], number + len(size)), return_inverse=True)
    return Outline(
        corner=np.concatenate([outline.corner[kept], added[:, :2]]),
        side=np.concatenate([outline.side[kept], added[:, 2]]),
        ring=np.concatenate([outline.ring[kept], number + outline.ring[-1] + 1]),
        room=room,
    )


def _cut_room(
    corner: np.ndarray, side: np.ndarray, half: float, rng: np.random.Generator
) -> list[np.ndarray]:
    """Returns what a cut makes of a room: float[c, 3] each, corners and what their sides move."""
    turn = int(rng.integers(_TURNS))
    a, b, c, d = (
        np.append(*row) for row in zip(np.roll(corner, turn, 0), np.roll(side, turn), strict=True)
    )
    kind, one, other = rng.random(3).tolist()

    def between(start: np.ndarray, end: np.ndarray, share: float, move: float) -> np.ndarray:
        return np.append(start[:2] + share * (end - start)[:2], move)

    if kind < 0.3:  # from corner to corner
        parts = [np.stack([a, b, _moves(c, half)]), np.stack([_moves(a, half), c, d])]
        return parts[: 1 if kind < 0.1 else 2]
    if kind < 0.65:  # across
        here = between(a, b, 0.3 + 0.4 * one, half)
        there = between(c, d, 0.3 + 0.4 * other, c[2])
        return [
            np.stack([a, here, there, d]),
            np.stack([_moves(here, a[2]), b, c, _moves(there, half)]),
        ]
    corners = [a, b, c, d]
    number = 1 if kind < 0.9 else _TURNS
    share = 0.15 + 0.2 * one
    parts = []
    ring: list[np.ndarray] = []
    for index, at in enumerate(corners):
        before, after = corners[index - 1], corners[(index + 1) % _TURNS]
        if index >= number:
            ring.append(at)
            continue
        near, far = between(at, before, share, half), between(at, after, share, at[2])
        ring += [near, far]
        if number == 1:
            parts.append(np.stack([_moves(near, before[2]), at, _moves(far, half)]))
    return [np.stack(ring), *parts]


def _moves(row: np.ndarray, move: float) -> np.ndarray:
    """Returns a corner whose side moves in by another length."""
    return np.append(row[:2], move)


def moved_in(outline: Outline) -> tuple[Outline, np.ndarray]:
    """Moves every side of every room in.

    Args:
      outline: metres.

    Returns:
      The rooms within their walls, and which of them are none, bool[r]: a side has vanished.
    """
    following = _next(outline.ring)
    along = outline.corner[following] - outline.corner
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    before = np.empty(len(following), int)
    before[following] = np.arange(len(following))
    sine = np.sum(normal[before] * along, axis=1)
    move = outline.side[before, None] * along - outline.side[:, None] * along[before]
    corner = outline.corner + move / sine[:, None]
    left = np.sum((corner[following] - corner) * along, axis=1)
    vanished = np.bincount(outline.room, left < MIN_SIDE) > 0
    return outline._replace(corner=corner), vanished


def _next(ring: np.ndarray) -> np.ndarray:
    """Returns the index of the corner after each."""
    following = np.arange(1, len(ring) + 1)
    last = np.flatnonzero(np.diff(ring, append=-1))
    following[last] = np.append(0, last[:-1] + 1)
    return following


# --- a storey ---


def storey_of_labels(
    labels: np.ndarray,
    frame: Frame,
    thickness: Thickness,
    askew: float,
    rng: np.random.Generator,
) -> Storey | None:
    """Turns rooms on a grid into planes, walls, rooms and the centre of a floor.

    Rooms that are too narrow for their walls are left solid.

    Args:
      labels: int[x, y], see `trace`.
      frame: where the lines of the grid are.
      thickness: of the walls.
      askew: share of the rooms that are cut at an angle.
      rng: source of randomness.

    Returns:
      None if no room is left, or one has more than `MAX_SIDES` sides.
    """
    outline = trace(labels, frame.bends)
    if np.bincount(outline.room).max() > MAX_SIDES:
        return None
    outline = put_in_place(outline, frame, thickness, rng)
    if askew:
        outline = cut_off(outline, askew, thickness.oblique, rng)
    outline, vanished = moved_in(outline)
    starts = np.flatnonzero(np.diff(outline.ring, prepend=-1))
    ring = np.cumsum(np.diff(outline.ring, prepend=outline.ring[0]) > 0)
    rings = shapely.linearrings(outline.corner, indices=ring)
    shapes = shapely.polygons(rings, indices=outline.room[starts])
    kept = ~vanished & shapely.is_valid(shapes)
    if not kept.any():
        return None
    ends = np.stack([outline.corner, outline.corner[_next(outline.ring)]], axis=1)
    of_kept = kept[outline.room]
    ends, room = ends[of_kept], (np.cumsum(kept) - 1)[outline.room[of_kept]]
    along = ends[:, 1] - ends[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    sides = Sides(ends, np.column_stack([-along[:, 1], along[:, 0]]), room)
    wall, wall_centre = find_walls(sides, shapes[kept], RULES)
    return storey_of(sides, shapes[kept], wall, wall_centre)


# --- frames ---


def draw_frame(size: tuple[int, int], step: float, askew: float, rng: np.random.Generator) -> Frame:
    """Draws where the lines of a grid are.

    Args:
      size: cells in x and in y.
      step: metres, mean side of a cell.
      askew: probability that lines do not meet at right angles.
      rng: source of randomness.
    """
    x, y = (np.append(0, np.cumsum(step * rng.uniform(0.85, 1.15, number))) for number in size)
    depth = y - y[-1] / 2
    kind = rng.random() / askew if askew else 1.0
    if kind < 0.4:
        bent = _bent(x, y[-1], depth, rng)
        if bent:
            return bent
    lean = np.zeros(len(x))
    if kind < 0.7:  # in a fan, or some lines askew
        knots = np.sort(rng.uniform(0, x[-1], int(rng.integers(2, 6))))
        steepest = min(STEEPEST, 0.4 * x[-1] / (len(knots) * y[-1]))
        lean = np.interp(x, knots, rng.uniform(-steepest, steepest, len(knots)))
        slope = np.abs(np.diff(lean) / np.diff(x)).max() * y[-1] / 2
        lean *= min(1.0, 0.4 / slope) if slope else 1.0
    elif kind < 1:  # all askew alike
        lean += rng.uniform(-STEEPEST, STEEPEST)
    return Frame(
        base=np.column_stack([x, np.zeros(len(x))]),
        lean=np.column_stack([lean, np.ones(len(x))]),
        depth=depth,
        bends=np.zeros(0, int),
    )


def _bent(
    x: np.ndarray, height: float, depth: np.ndarray, rng: np.random.Generator
) -> Frame | None:
    """Draws a frame whose lines in x bend, all one way or to and fro; None if it is too short."""
    number = int(rng.integers(1, MAX_BENDS, endpoint=True))
    bends = np.round(np.arange(1, number + 1) * (len(x) - 1) / (number + 1)).astype(int)
    pieces = np.concatenate([[0], bends, [len(x) - 1]])
    length = np.diff(x[pieces])
    largest = min(np.radians(45), 2 * np.arctan(0.5 * length.min() / height))
    if largest < SMALLEST_BEND:
        return None
    angle = rng.uniform(SMALLEST_BEND, largest, number)
    angle *= 1 if rng.random() < 0.6 else rng.choice([-1, 1], number)
    heading = np.append(0, np.cumsum(angle))
    along = np.column_stack([np.cos(heading), np.sin(heading)])
    across = np.column_stack([-along[:, 1], along[:, 0]])
    piece = np.repeat(np.arange(number + 1), np.diff(pieces))
    base = np.zeros((len(x), 2))
    base[1:] = np.cumsum(np.diff(x)[:, None] * along[piece], axis=0)
    tangent = np.tan(angle / 2)
    left, right = np.append(0, tangent), np.append(-tangent, 0)
    piece = np.append(piece, number)
    share = (x - x[pieces[piece]]) / length[piece]
    lean = (left[piece] + share * (right - left)[piece])[:, None] * along[piece] + across[piece]
    return Frame(base, lean, depth, bends)
