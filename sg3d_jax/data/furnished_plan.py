"""What a storey is like to those who live in it: its rooms' shapes, where they meet, and doors.

The rooms are read off the planes of a storey, whose widths must be true: a side ends where the next
one begins. So every storey of true widths can be furnished, not only those that are drawn.

Source: doors are as wide as the common metric and imperial ones (First In Architecture, "Metric
Data 12: Standard door sizes"; leaves of 0.73 to 0.93 m, and wider pairs of them); what doors join
which kinds of rooms is our own.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import shapely

from sg3d_jax.data.buildings import Storey
from sg3d_jax.data.floorplan import RULES, Sides, facing_pairs

LEAST_LINE: Final = 0.95  # metres of a wall between two rooms that a door has a place in
JAMB: Final = 0.1  # metres at least from a door to the end of its wall
GAP: Final = 0.01  # metres between sides of one room that are of different rings
DOOR_WIDTHS: Final = (0.73, 0.76, 0.83, 0.93, 1.2)  # metres,
DOOR_SHARES: Final = (0.25, 0.5, 0.75, 0.95, 1.0)  # and the share of the doors that are no wider
SMALL: Final = frozenset(("bathroom", "storage", "balcony"))  # the three narrowest are theirs
OUTSIDE: Final = 3.0  # metres before a side that are free if it is an outer one
OUTER_WALL: Final = 0.15  # metres from an outer side to the middle of its wall

# How unlike a door is between rooms of two kinds, relative to one into a corridor; the sum over the
# rooms, for pairs of other kinds than below.
_UNLIKE: Final[Mapping[str, float]] = MappingProxyType(
    {
        "corridor": 0.5,
        "hall": 0.6,
        "living room": 1.0,
        "stairwell": 1.2,
        "kitchen": 2.0,
        "office": 2.5,
        "classroom": 2.5,
        "meeting room": 2.5,
        "bedroom": 3.0,
        "storage": 3.5,
        "balcony": 4.0,
        "bathroom": 4.0,
    }
)
_UNLIKE_PAIRS: Final[Mapping[frozenset[str], float]] = MappingProxyType(
    {
        frozenset(("bedroom", "bathroom")): 5.0,
        frozenset(("living room", "balcony")): 2.0,
        frozenset(("bedroom", "balcony")): 3.0,
        frozenset(("living room", "kitchen")): 1.5,
        frozenset(("kitchen", "storage")): 3.5,
    }
)


class Layout(NamedTuple):
    """The rooms of a storey and where they meet: `r` rooms, `p` sides, `c` pairs of rooms."""

    sides: Sides  # the planes
    shape: np.ndarray  # object[r], their polygons
    centre: np.ndarray  # float[r, 2], metres
    area: list[float]  # r of them, square metres
    depth: list[float]  # r of them, metres: the shorter side of a box of this area and perimeter
    meeting: list[dict[int, int]]  # of each room the others that a door may lead to, and by which
    line: np.ndarray  # float[c, 2, 2], place for it: the ends of the middle of the wall, metres
    free: np.ndarray  # bool[p], sides that have no wall in common with others

    @property
    def num_rooms(self) -> int:
        """How many rooms there are."""
        return len(self.area)


class Door(NamedTuple):
    """A door, metres."""

    place: np.ndarray  # float[2]
    along: np.ndarray  # float[2], unit, direction of its wall
    width: float
    rooms: tuple[int, ...]  # the two that it joins, or the one that it leads into


def layout_of(storey: Storey) -> Layout:
    """Reads the rooms of a storey off its planes."""
    along = np.column_stack([storey.normal[:, 1], -storey.normal[:, 0]])
    reach = storey.width[:, None] / 2 * along
    ends = np.stack([storey.plane - reach, storey.plane + reach], axis=1)
    sides = Sides(ends, storey.normal, storey.room)
    breaks = np.abs(ends[1:, 0] - ends[:-1, 1]).max(axis=1) > GAP
    breaks |= np.diff(storey.room) != 0
    ring = np.append(0, np.cumsum(breaks))
    rings = shapely.linearrings(ends[:, 0], indices=ring)
    shape = shapely.polygons(rings, indices=storey.room[np.append(True, breaks)])
    area = shapely.area(shape)
    half = shapely.length(shape) / 4
    depth = half - np.sqrt(np.maximum(half**2 - area, 0))
    wall = np.full(len(ends), -1)
    wall[storey.wall[:, 0]] = storey.wall[:, 1]
    meeting, line = _meetings(sides, wall, len(area))
    return Layout(
        sides=sides,
        shape=shape,
        centre=storey.room_centre,
        area=area.tolist(),
        depth=depth.tolist(),
        meeting=meeting,
        line=line,
        free=wall < 0,
    )


def _meetings(
    sides: Sides, wall: np.ndarray, num_rooms: int
) -> tuple[list[dict[int, int]], np.ndarray]:
    """Returns where rooms meet, see `Layout`: the longest line of each pair of rooms."""
    facing = facing_pairs(sides, RULES)
    length = np.linalg.norm(facing.middle[:, 1] - facing.middle[:, 0], axis=1)
    one, other = facing.planes.T
    found = np.flatnonzero((wall[one] == wall[other]) & (wall[one] >= 0) & (length >= LEAST_LINE))
    found = found[np.argsort(length[found], kind="stable")]
    meeting: list[dict[int, int]] = [{} for _ in range(num_rooms)]
    rooms = sides.room[facing.planes[found]].tolist()
    for index, (first, second) in enumerate(rooms):  # of several lines the longest comes last
        meeting[first][second] = meeting[second][first] = index
    return meeting, facing.middle[found]


# --- doors ---


def draw_doors(
    layout: Layout,
    kind: Sequence[str],
    unit: Sequence[int],
    common: int | None,
    is_entered: bool,
    inner_doors: float,
    rng: np.random.Generator,
) -> list[Door]:
    """Draws the doors of a storey.

    The rooms of a unit hang together by doors, as a tree or by a few more. Every unit has a door
    into the common one: a flat one, of departments nearly every room that lies at it. Where there
    is no common unit, or none that can be reached, a unit has a door to the outside.

    Args:
      layout: of the storey.
      kind: of each room.
      unit: of each room.
      common: which unit the others share; None if there is none.
      is_entered: whether one comes in from the outside.
      inner_doors: probability of a door that a unit would hang together without.
      rng: source of randomness.
    """
    pairs: list[tuple[int, int]] = []
    entered: list[list[int]] = []
    members: dict[int, list[int]] = {}
    for room, of in enumerate(unit):
        members.setdefault(of, []).append(room)

    def unlike(one: int, other: int) -> float:
        pair = frozenset((kind[one], kind[other]))
        known = _UNLIKE_PAIRS.get(pair, _UNLIKE[kind[one]] + _UNLIKE[kind[other]])
        return known * (0.7 + 0.6 * rng.random())

    for of, rooms in members.items():
        tree, further = _tree(layout, rooms, unlike)
        gates = []
        if of != common and common is not None:
            gates = [
                (unlike(room, other), room, other)
                for room in rooms
                for other in layout.meeting[room]
                if unit[other] == common and kind[other] in ("corridor", "hall", "stairwell")
            ]
        gates.sort()
        is_flat = len({kind[room] for room in rooms} & {"bedroom", "living room"}) > 0
        if gates and is_flat:
            pairs.append(gates[0][1:])
        elif gates:
            opened = {gates[0][1]} | {room for _, room, _ in gates if rng.random() < 0.9}
            best = {room: other for _, room, other in reversed(gates)}
            pairs += [(room, best[room]) for room in sorted(opened)]
            tree = [pair for pair in tree if not opened.issuperset(pair) or rng.random() < 0.5]
        elif is_entered or (common is not None and of != common):
            entered.append(sorted(rooms, key=lambda room: unlike(room, room)))
        pairs += tree
        pairs += [pair for pair in further if rng.random() < inner_doors]
    small = [each in SMALL for each in kind]
    doors = [
        _door(layout.line[layout.meeting[a][b]], (a, b), small[a] or small[b], rng)
        for a, b in pairs
    ]
    entrances = (_entrance(layout, rooms, rng) for rooms in entered)
    return doors + [door for door in entrances if door is not None]


def _tree(
    layout: Layout, rooms: Sequence[int], unlike: Callable[[int, int], float]
) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Returns the pairs of rooms that hang them together, the likeliest, and those left over."""
    edges = sorted(
        (unlike(room, other), room, other)
        for room in rooms
        for other in layout.meeting[room]
        if room < other and other in rooms
    )
    head = {room: room for room in rooms}
    tree, further = [], []
    for cost, one, other in edges:
        if head[one] != head[other]:
            joined = head[other]
            head = {room: head[one] if of == joined else of for room, of in head.items()}
            tree.append((one, other))
        elif cost < 5:  # nobody has two doors to a bathroom
            further.append((one, other))
    return tree, further


def _door(
    line: np.ndarray, rooms: tuple[int, ...], is_small: bool, rng: np.random.Generator
) -> Door:
    """Draws a door in a line, which is long enough."""
    along = line[1] - line[0]
    length = float(np.hypot(*along))
    along = along / length
    share, at = rng.random(2).tolist()
    share *= DOOR_SHARES[2] if is_small else 1.0
    drawn = DOOR_WIDTHS[int(np.searchsorted(DOOR_SHARES, share))]
    width = min(drawn, length - 2 * JAMB)
    free = length - width - 2 * JAMB
    return Door(line[0] + (JAMB + width / 2 + at * free) * along, along, width, rooms)


def _entrance(layout: Layout, rooms: Sequence[int], rng: np.random.Generator) -> Door | None:
    """Draws a door to the outside, of the first room that has an outer side; None if none has."""
    width = np.linalg.norm(layout.sides.ends[:, 1] - layout.sides.ends[:, 0], axis=1)
    wide = layout.free & (width >= LEAST_LINE)
    for room in rooms:
        own = np.flatnonzero((layout.sides.room == room) & wide)
        for side in own[np.argsort(-width[own], kind="stable")].tolist():
            normal = layout.sides.normal[side]
            line = layout.sides.ends[side] - OUTER_WALL * normal
            before = line.mean(axis=0) - np.outer([0.0, OUTSIDE], normal)
            if not shapely.intersects(layout.shape, shapely.linestrings(before)).any():
                return _door(line, (room,), False, rng)
    return None
