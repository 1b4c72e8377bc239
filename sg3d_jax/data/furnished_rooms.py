"""What the rooms of a storey are for: uses, stairwells, units and the kinds of rooms.

Everything is read off the rooms' sizes, shapes and where they meet, as those who move in would do.
Homes have one flat a storey or several around a corridor: a flat has one kitchen, bathrooms are
small, the corridor has the most neighbours, the living room is the largest. Floors of offices and
schools have departments along a corridor, classrooms are large.

Source: a classroom for 30 pupils has 55 to 62 square metres (BB103, UK Department for Education);
rooms of flats are about as large, and as often there, as in the Japanese flats that `room_labels`
reads. The rules are our own.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import shapely

from sg3d_jax.data.furnished_plan import Layout

HUB: Final = 5  # a corridor meets so many rooms at least, where units share it
FEW_ROOMS: Final = 6  # a storey of fewer rooms has no corridor that is shared
ONE_FLAT: Final = (8, 14)  # rooms of a storey from which on a home has several flats there
HOUSE: Final = 2  # storeys at most of a house, whose stairs are part of the flat of each storey
FLAT_SIZE: Final = (3, 8)  # rooms of a flat of several that are aimed at,
FLAT_AREA: Final = 110.0  # and its area at most, square metres
DEPARTMENT_SIZE: Final = (3, 9)  # rooms
SMALLEST_UNIT: Final = 14.0  # square metres; a smaller one belongs to the one beside it
LIVABLE: Final = 9.0  # square metres of the largest room of a flat at least, where there are others
LIVING_ROOMS: Final = 0.7  # share of the flats of four rooms or more that have one
LARGE_ROOMS: Final = 40.0  # square metres of a room on average, beyond which hardly anybody lives
STAIRWELL_AREA: Final = (4.0, 40.0)  # square metres
STAIRWELL_DEPTH: Final = 1.7  # metres at least
STAIRWELL_SHARE: Final = 0.7  # of the area of the largest room of the storey at most
ALIKE: Final = 0.5  # share of its area that a stairwell has in common with the one below
CLASSROOM: Final = (30.0, 120.0)  # square metres


class Zones(NamedTuple):
    """What the rooms of a storey are for."""

    kind: list[str]  # of each room, "" where it is unknown
    unit: list[int]  # of each room
    unit_kind: list[str]  # of each unit
    common: int | None  # the unit that the others share, if there is one


# --- uses and stairwells of a building ---


def draw_use(layouts: Sequence[Layout], rng: np.random.Generator) -> str:
    """Draws what a building is for: "home", "office" or "school"."""
    area = [each for layout in layouts for each in layout.area]
    has_hub = any(_hub(layout) is not None for layout in layouts)
    classrooms = sum(CLASSROOM[0] <= each <= CLASSROOM[1] for each in area) / len(area)
    home = 0.6 if has_hub else 0.9
    home *= 1.0 if np.mean(area) < LARGE_ROOMS else 0.03
    office = 0.5 if has_hub else 0.15
    school = 2.0 * classrooms if has_hub and classrooms > 0.15 else 0.0
    at = rng.random() * (home + office + school)
    return "home" if at < home else "office" if at < home + office else "school"


def _hub(layout: Layout) -> int | None:
    """Returns the room that most others meet; None if there is no such among enough rooms."""
    if layout.num_rooms < FEW_ROOMS:
        return None
    count = [len(others) for others in layout.meeting]
    hub = max(range(layout.num_rooms), key=lambda room: (count[room], -layout.depth[room]))
    return hub if count[hub] >= HUB else None


def find_stairwells(layouts: Sequence[Layout], rng: np.random.Generator) -> list[int | None]:
    """Finds a room for stairs at one place in all storeys that have one there.

    Returns:
      The room of each storey; None for a storey that has none there.
    """
    first = layouts[0]
    hub = _hub(first)
    candidates = [
        room
        for room in range(first.num_rooms)
        if room != hub and first.meeting[room] and _fits_stairs(first, room)
    ]
    best, most = [None] * len(layouts), 0.0
    for room in candidates:
        found = [_room_over(first, room, layout) for layout in layouts]
        storeys = sum(each is not None for each in found)
        value = storeys + 0.5 * (hub in first.meeting[room]) + 0.4 * rng.random()
        if value > most:
            best, most = found, value
    return best


def _fits_stairs(layout: Layout, room: int) -> bool:
    """Returns whether stairs have a place in a room, which is not the main one of a storey."""
    low, high = STAIRWELL_AREA
    high = min(high, STAIRWELL_SHARE * max(layout.area))
    return low <= layout.area[room] <= high and layout.depth[room] >= STAIRWELL_DEPTH


def _room_over(first: Layout, room: int, layout: Layout) -> int | None:
    """Returns the room of another storey that is at the place of one of the first, and alike."""
    if layout is first:
        return room
    shape = first.shape[room]
    shared = shapely.area(shapely.intersection(layout.shape, shape))
    over = int(shared.argmax())
    alike = shared[over] >= ALIKE * max(first.area[room], layout.area[over])
    return over if alike and layout.meeting[over] and _fits_stairs(layout, over) else None


# --- units ---


def draw_zones(
    layout: Layout, use: str, stairwell: int | None, is_house: bool, rng: np.random.Generator
) -> Zones:
    """Draws what the rooms of a storey are for.

    Args:
      layout: of the storey.
      use: of the building, see `draw_use`.
      stairwell: the room that the stairs are in, if any.
      is_house: whether stairs are part of the flat, if it is the only one.
      rng: source of randomness.
    """
    rooms = range(layout.num_rooms)
    kind = [""] * layout.num_rooms
    hub = _hub(layout)
    is_home = use == "home"
    if is_home and layout.num_rooms < rng.integers(*ONE_FLAT, endpoint=True):
        hub = None
    common = {}
    if hub is not None:
        common = dict.fromkeys(_passages(layout, hub), "corridor")
        common[hub] = "corridor" if _is_narrow(layout, hub) else "hall"
        if not is_home:
            common |= _shared_rooms(layout, [*common], stairwell, rng)
    if stairwell is not None and (hub is not None or not (is_home and is_house)):
        common[stairwell] = "stairwell"
    rest = [room for room in rooms if room not in common]
    gates = {room for room in rest if any(other in common for other in layout.meeting[room])}
    if hub is None or not gates:
        units = _pieces(layout, rest)
    else:
        size = FLAT_SIZE if is_home else DEPARTMENT_SIZE
        area = FLAT_AREA if is_home else np.inf
        units = _grouped(layout, rest, gates, size, area, rng)
    if is_home and common:
        units, bare = _livable(layout, units)
        common |= dict.fromkeys(bare, "storage")
    for members in units:
        others = [room for room in members if room != stairwell]
        drawn = _flat(layout, others, rng) if is_home else _department(layout, others, use, rng)
        for room, each in drawn.items():
            kind[room] = each
    for room, each in common.items():
        kind[room] = each
    if stairwell is not None:
        kind[stairwell] = "stairwell"
    unit = [len(units)] * layout.num_rooms
    for index, members in enumerate(units):
        for room in members:
            unit[room] = index
    unit_kind = ["flat" if is_home else "department"] * len(units)
    if not common:
        return Zones(kind, unit, unit_kind, None)
    return Zones(kind, unit, [*unit_kind, "common"], len(units))


def _livable(layout: Layout, units: list[list[int]]) -> tuple[list[list[int]], list[int]]:
    """Returns the flats that one can live in, and the rooms of the others."""
    flats = [unit for unit in units if max(layout.area[room] for room in unit) >= LIVABLE]
    return flats, [room for unit in units if unit not in flats for room in unit]


def _is_narrow(layout: Layout, room: int) -> bool:
    """Returns whether a room is a corridor by its shape."""
    return layout.depth[room] < 4.5 and layout.area[room] < 300


def _passages(layout: Layout, hub: int) -> list[int]:
    """Returns the long rooms beside a hub that many others meet: further corridors."""
    return [
        room
        for room in layout.meeting[hub]
        if len(layout.meeting[room]) >= HUB and layout.area[room] > 4 * layout.depth[room] ** 2
    ]


def _shared_rooms(
    layout: Layout, passages: Sequence[int], stairwell: int | None, rng: np.random.Generator
) -> dict[int, str]:
    """Draws bathrooms and a storage room at a corridor that departments share: small rooms."""
    beside = {room for passage in passages for room in layout.meeting[passage]}
    beside -= {*passages, stairwell}
    small = sorted((layout.area[room], room) for room in beside if 1.5 < layout.area[room] < 28)
    number = min(len(small) // 3 + 1, 1 + layout.num_rooms // 15)
    chosen = {room: "bathroom" for _, room in small[:number]}
    if len(small) > 2 * number and rng.random() < 0.5:
        chosen[small[number][1]] = "storage"
    return chosen


def _pieces(layout: Layout, rooms: Sequence[int]) -> list[list[int]]:
    """Returns the groups of rooms that hang together."""
    left, pieces = set(rooms), []
    for first in rooms:
        piece = [first] if first in left else []
        for room in piece:  # grows meanwhile
            left.discard(room)
            piece += [each for each in layout.meeting[room] if each in left - {*piece}]
        if piece:
            pieces.append(piece)
    return pieces


def _grouped(
    layout: Layout,
    rooms: Sequence[int],
    gates: set[int],
    size: tuple[int, int],
    area: float,
    rng: np.random.Generator,
) -> list[list[int]]:
    """Draws units that hang together: each starts beside the one before and grows to its size."""
    left, units = set(rooms), []
    place = layout.centre.tolist()
    at = place[min(gates)]

    def way(room: int) -> float:
        return (place[room][0] - at[0]) ** 2 + (place[room][1] - at[1]) ** 2

    while starts := sorted(left & gates):
        start = min(starts, key=way)
        at, number = place[start], int(rng.integers(*size, endpoint=True))
        members, extent = [start], layout.area[start]
        left.discard(start)
        while len(members) < number and extent < area:
            beside = {other for room in members for other in layout.meeting[room]} & left
            if not beside:
                break
            nearest = min(sorted(beside), key=way)
            members.append(nearest)
            extent += layout.area[nearest]
            left.discard(nearest)
        units.append(members)
    return _settled(layout, units, left)


def _settled(layout: Layout, units: list[list[int]], left: set[int]) -> list[list[int]]:
    """Gives units that are too small, and rooms that are left, to those beside them."""
    pieces = _pieces(layout, sorted(left))
    small = [u for u in units if sum(layout.area[room] for room in u) < SMALLEST_UNIT]
    kept = [u for u in units if u not in small]
    for piece in (*small, *pieces):
        beside = {other for room in piece for other in layout.meeting[room]}
        shared = [len(beside.intersection(u)) for u in kept]
        if any(shared):
            kept[int(np.argmax(shared))] += piece
        else:
            kept.append(piece)
    return kept


# --- kinds of rooms ---


def _flat(layout: Layout, rooms: Sequence[int], rng: np.random.Generator) -> dict[int, str]:
    """Draws the kinds of the rooms of a flat."""
    if not rooms:
        return {}
    left, kind = list(rooms), {}
    area, inside = layout.area, set(rooms)
    total = sum(area[room] for room in rooms)

    def take(room: int, name: str) -> None:
        kind[room] = name
        left.remove(room)

    def likeliest(rooms: Sequence[int], metres: float) -> int:
        return min(
            rooms,
            key=lambda room: (
                abs(np.log(area[room] / metres)) + 0.3 * doors[room] + 0.5 * rng.random()
            ),
        )

    largest = max(rooms, key=lambda room: area[room])
    doors = {room: len(inside.intersection(layout.meeting[room])) for room in rooms}
    if len(left) >= 4:
        hub = max(rooms, key=lambda room: (doors[room], -area[room]))
        if doors[hub] >= 3 and hub != largest and area[hub] < 0.35 * total:
            take(hub, "corridor")
    fits = [room for room in left if 1.2 < area[room] < 16 and room != largest]
    if fits:
        take(likeliest(fits, 3.0), "bathroom")
    fits = [room for room in left if 3.5 < area[room] < 25 and layout.depth[room] > 1.4]
    has_living_room = len(rooms) < 4 or not fits or rng.random() < LIVING_ROOMS
    if has_living_room and largest in left:
        take(largest, "living room")
        fits = [room for room in fits if room != largest]
    if fits and (
        len(rooms) >= 6 or not has_living_room or (len(rooms) >= 4 and rng.random() < 0.6)
    ):
        take(likeliest(fits, 8.0 if has_living_room else 12.0), "kitchen")
    for room in list(left):
        beside = {kind.get(other) for other in inside.intersection(layout.meeting[room])}
        is_behind = beside <= {"bathroom", "storage"}
        take(room, "storage" if is_behind else _further_room(layout, room, rng))
    return kind


def _further_room(layout: Layout, room: int, rng: np.random.Generator) -> str:
    """Draws the kind of a room of a flat that has the others that it needs."""
    area, at = layout.area[room], rng.random()
    is_outer = layout.free[layout.sides.room == room].any()
    if area < 12 and area > 2.2 * layout.depth[room] ** 2 and is_outer and at < 0.6:
        return "balcony"
    if area < 1.6:
        return "storage"
    if area < 5.0:
        return "bathroom" if at < 0.5 else "storage"
    if area < 6.0 or layout.depth[room] < 1.6:
        return "bedroom" if at < 0.4 else "storage" if at < 0.75 else "bathroom"
    return "bedroom" if at < 0.9 else "office" if at < 0.95 else "storage"


def _department(
    layout: Layout, rooms: Sequence[int], use: str, rng: np.random.Generator
) -> dict[int, str]:
    """Draws the kinds of the rooms of a department of an office or a school."""
    kind = {}
    taken: set[str] = set()
    for room in sorted(rooms, key=lambda room: -layout.area[room]):
        drawn = _workroom(layout.area[room], layout.depth[room], use, taken, rng)
        taken.add(drawn)
        kind[room] = drawn
    if len(rooms) >= 4 and "bathroom" not in taken and rng.random() < 0.3:
        small = [room for room in rooms if kind[room] == "storage" and layout.area[room] > 1.5]
        if small:
            kind[small[0]] = "bathroom"
    return kind


def _workroom(
    area: float, depth: float, use: str, taken: set[str], rng: np.random.Generator
) -> str:
    """Draws the kind of a room of an office or a school, given those of its larger neighbours."""
    at = rng.random()
    if area > CLASSROOM[1]:
        return "hall"
    if use == "school" and area >= CLASSROOM[0]:
        return "classroom" if at < 0.9 else "hall"
    if area < 5 or depth < 1.7:
        return "storage"
    if 12 <= area <= 60 and "meeting room" not in taken and at < 0.4:
        return "meeting room"
    if area < 18 and "kitchen" not in taken and at > 0.85:
        return "kitchen"
    return "office" if area >= 7 or at < 0.5 else "storage"
