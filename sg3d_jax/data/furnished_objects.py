"""The objects of rooms: what stands in a room of which kind, how large it is, and where.

Things stand against a wall or in the middle of a room, and chairs at tables and desks. Several
places are tried for each; one is taken if it is within the room, off the doors, and free.

Source: how often things are in homes follows the counts that DynamicScene publishes with its
DynamicGeneration, of some 10,000 houses of AI2-THOR's objects (1.2 beds, 1.1 dressers and 0.2 desks
a bedroom, 0.8 sofas a living room, 0.9 fridges a kitchen, 1.0 toilets and sinks a bathroom). A desk
has more room than the least that the Austrian AUVA asks for (8 square metres, 5 for each further
person). Sizes are those of First In Architecture, "Metric Data 08: Standard furniture sizes", and
what makers of bathrooms and kitchens state. What stands in workrooms how often is our own.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import shapely

from sg3d_jax.data.furnished_plan import Door, Layout

TRIES: Final = 5  # places of each thing
OFF_THE_WALL: Final = 0.03  # metres
DOOR_DEPTH: Final = 0.85  # metres before the middle of a door's wall that are kept free
SEAT: Final = 0.35  # metres from the edge of a table to the middle of a chair


class Size(NamedTuple):
    """The size of a kind of objects: ranges in metres."""

    along: tuple[float, float]  # its extent along the wall behind it,
    out: tuple[float, float]  # into the room,
    height: tuple[float, float]  # and up,
    lift: float = 0.0  # from so much over the floor


SIZES: Final[Mapping[str, Size]] = MappingProxyType(
    {
        "bed": Size((0.9, 1.8), (1.9, 2.1), (0.45, 0.6)),
        "table": Size((0.75, 1.95), (0.7, 0.95), (0.45, 0.76)),
        "chair": Size((0.42, 0.5), (0.42, 0.55), (0.8, 0.95)),
        "sofa": Size((1.5, 2.3), (0.8, 1.0), (0.7, 0.9)),
        "desk": Size((1.2, 1.8), (0.65, 0.8), (0.72, 0.76)),
        "cupboard": Size((0.6, 2.0), (0.4, 0.65), (0.8, 2.2)),
        "shelf": Size((0.6, 1.8), (0.25, 0.4), (1.2, 2.2)),
        "sink": Size((0.45, 0.8), (0.4, 0.6), (0.82, 0.92)),
        "toilet": Size((0.36, 0.4), (0.55, 0.72), (0.4, 0.8)),
        "bath": Size((0.8, 1.8), (0.7, 0.9), (0.15, 0.6)),
        "stove": Size((0.5, 0.9), (0.55, 0.65), (0.85, 0.95)),
        "fridge": Size((0.55, 0.9), (0.6, 0.75), (1.4, 2.0)),
        "washer": Size((0.5, 0.6), (0.5, 0.65), (0.83, 0.9)),
        "board": Size((1.2, 3.0), (0.04, 0.1), (1.0, 1.3), 0.85),
    }
)


class Item(NamedTuple):
    """How many objects of a kind a room has: their mean is `mean + per_metre * area`."""

    kind: str
    mean: float
    per_metre: float = 0.0  # a square metre
    most: int = 1
    is_free: bool = False  # whether it stands in the middle, and not at a wall
    chairs: float = 0.0  # mean number at each


_KITCHEN: Final = (
    Item("sink", 0.95),
    Item("stove", 0.95),
    Item("fridge", 0.93),
    Item("cupboard", 0.6, 0.06, 3),
)
ITEMS: Final[Mapping[str, tuple[Item, ...]]] = MappingProxyType(
    {
        "bedroom": (
            Item("bed", 0.9, 0.02, 3),
            Item("cupboard", 0.8, 0.02, 3),
            Item("desk", 0.2, chairs=0.9),
            Item("shelf", 0.2),
        ),
        "living room": (
            Item("sofa", 0.75, 0.006, 2),
            Item("table", 0.9, 0.01, 2, is_free=True, chairs=1.8),
            Item("cupboard", 0.8, 0.005, 2),
            Item("shelf", 0.3, 0.005, 2),
        ),
        "studio": (
            Item("bed", 0.9),
            *_KITCHEN,
            Item("table", 0.8, is_free=True, chairs=1.5),
            Item("sofa", 0.3),
        ),
        "open kitchen": (
            *_KITCHEN[:3],
            Item("sofa", 0.7),
            Item("table", 0.9, is_free=True, chairs=1.8),
            Item("cupboard", 0.6, 0.01, 2),
        ),
        "kitchen": (
            *_KITCHEN,
            Item("table", 0.1, 0.035, is_free=True, chairs=2.2),
            Item("washer", 0.15),
        ),
        "bathroom": (
            Item("bath", 0.75),
            Item("toilet", 0.98),
            Item("sink", 0.95),
            Item("washer", 0.25),
        ),
        "washroom": (Item("toilet", 0.9, 0.1, 4), Item("sink", 0.9, 0.06, 3)),
        "corridor": (Item("cupboard", 0.2), Item("shelf", 0.1)),
        "storage": (Item("shelf", 0.6, 0.08, 4), Item("cupboard", 0.3), Item("washer", 0.08)),
        "balcony": (Item("table", 0.2, is_free=True, chairs=1.0),),
        "office": (
            Item("desk", 0.5, 0.07, 4, chairs=0.95),
            Item("cupboard", 0.5, 0.01, 2),
            Item("shelf", 0.4, 0.01, 2),
        ),
        "meeting room": (
            Item("table", 1.0, 0.005, 2, is_free=True, chairs=3.6),
            Item("board", 0.7),
            Item("cupboard", 0.25),
        ),
        "classroom": (
            Item("board", 0.95),
            Item("table", 0.4, 0.05, 4, is_free=True, chairs=1.2),
            Item("desk", 0.85, chairs=0.9),
            Item("cupboard", 0.3),
        ),
        "hall": (
            Item("table", 0.2, 0.01, 3, is_free=True, chairs=1.2),
            Item("sofa", 0.4, 0.004, 2),
            Item("shelf", 0.2, 0.006, 3),
            Item("cupboard", 0.3),
        ),
        "stairwell": (),
    }
)


class Objects(NamedTuple):
    """The objects of a storey: `o` of them, metres."""

    kind: list[str]  # o of them
    room: np.ndarray  # int[o]
    place: np.ndarray  # float[o, 2], of their middles
    up: np.ndarray  # float[o], of their middles over the floor
    corners: np.ndarray  # float[o, 4, 2], their footprints

    @property
    def width(self) -> np.ndarray:
        """float[o], the greater horizontal extent."""
        sides = np.linalg.norm(self.corners[:, 1:3] - self.corners[:, :2], axis=-1)
        return sides.max(axis=-1, initial=0)


NO_OBJECTS: Final = Objects(
    [], np.zeros(0, int), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 4, 2))
)


class _Places(NamedTuple):
    """Places of `n` things, `TRIES` each."""

    corners: np.ndarray  # float[n, t, 4, 2]
    out: np.ndarray  # float[n, t, 2], unit, into the room


def draw_objects(
    layout: Layout,
    doors: Sequence[Door],
    items: Sequence[tuple[Item, ...]],
    most: int,
    rng: np.random.Generator,
) -> Objects:
    """Draws the objects of a storey.

    Args:
      layout: of the storey.
      doors: of the storey.
      items: what is in each room, none for an empty one.
      most: greatest number of objects of a room, chairs and all.
      rng: source of randomness.
    """
    wanted = [
        (room, item)
        for room, (of_room, area) in enumerate(zip(items, layout.area, strict=True))
        for item in of_room
        for _ in range(min(item.most, int(item.mean + item.per_metre * area + rng.random())))
    ]
    room = np.array([each for each, _ in wanted], int)
    size = _sizes([item.kind for _, item in wanted], rng)
    places = _places(layout, room, [item.is_free for _, item in wanted], size, rng)
    shapely.prepare(layout.shape)
    taken = _taken(layout, room, places.corners, _before_doors(doors), most)
    placed = np.flatnonzero(taken >= 0)
    chosen = _Places(*(field[placed, taken[placed]] for field in places))
    main = Objects(
        [wanted[index][1].kind for index in placed],
        room[placed],
        chosen.corners.mean(axis=1),
        size[placed, 2],
        chosen.corners,
    )
    means = [wanted[index][1].chairs for index in placed]
    chairs = _chairs(layout, doors, main, means, chosen.out, most, rng)
    return Objects(
        main.kind + chairs.kind,
        *(np.concatenate(both) for both in zip(main[1:], chairs[1:], strict=True)),
    )


def _sizes(kinds: Sequence[str], rng: np.random.Generator) -> np.ndarray:
    """Draws the sizes of things, float[n, 3]: along, out, and of their middle over the floor."""
    ranges = np.array([SIZES[kind][:3] for kind in kinds]).reshape(-1, 3, 2)
    lift = np.array([SIZES[kind].lift for kind in kinds])
    size = ranges[..., 0] + rng.random((len(kinds), 3)) * (ranges[..., 1] - ranges[..., 0])
    size[:, 2] = size[:, 2] / 2 + lift
    return size


def _places(
    layout: Layout,
    room: np.ndarray,
    is_free: Sequence[bool],
    size: np.ndarray,
    rng: np.random.Generator,
) -> _Places:
    """Draws places: at a wall, the longer the likelier, or around the middle of the room."""
    ends, normal, of = layout.sides
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    total = np.append(0, np.cumsum(length))
    first, last = (total[np.searchsorted(of, room, side)] for side in ("left", "right"))
    draws = rng.random((len(room), TRIES, 3))
    at = first[:, None] + draws[..., 0] * (last - first)[:, None]
    side = np.clip(np.searchsorted(total, at, "right") - 1, 0, len(length) - 1)
    out = normal[side]
    along = np.stack([out[..., 1], -out[..., 0]], axis=-1)
    slack = length[side] - size[:, None, 0]
    beyond = (draws[..., 1] - 0.5) * np.maximum(slack, 0)
    at_wall = ends[side].mean(axis=2) + beyond[..., None] * along
    at_wall += (size[:, None, 1, None] / 2 + OFF_THE_WALL) * out
    spread = 0.5 * np.sqrt(np.array(layout.area)[room])[:, None, None]
    amid = layout.centre[room][:, None] + spread * (draws[..., 1:] - 0.5)
    centre = np.where(np.array(is_free, bool)[:, None, None], amid, at_wall)
    return _Places(_corners(centre, along, out, size[:, None]), out)


def _corners(
    centre: np.ndarray, along: np.ndarray, out: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Returns the corners of boxes, float[..., 4, 2], in a ring."""
    reach = size[..., 0, None] / 2 * along
    deep = size[..., 1, None] / 2 * out
    corners = [centre - reach - deep, centre + reach - deep, centre + reach + deep]
    return np.stack([*corners, centre - reach + deep], axis=-2)


def _before_doors(doors: Sequence[Door]) -> np.ndarray:
    """Returns what is kept free on both sides of doors, float[d, 4, 2]."""
    if not doors:
        return np.zeros((0, 4, 2))
    along = np.stack([door.along for door in doors])
    out = np.column_stack([-along[:, 1], along[:, 0]])
    size = np.array([(door.width, 2 * DOOR_DEPTH) for door in doors])
    return _corners(np.stack([door.place for door in doors]), along, out, size)


def _taken(
    layout: Layout, room: np.ndarray, corners: np.ndarray, kept_free: np.ndarray, most: int
) -> np.ndarray:
    """Chooses a place for each thing, one after the other.

    Args:
      layout: its shapes are prepared.
      room: int[n], of each thing.
      corners: float[n, t, 4, 2], its places.
      kept_free: float[k, 4, 2], boxes that things keep off.
      most: greatest number of things of a room.

    Returns:
      int[n], which place it has; -1 if none is free, or the room is full.
    """
    number, tries = corners.shape[:2]
    if not number:
        return np.zeros(0, int)
    boxes = shapely.polygons(corners.reshape(-1, 4, 2))
    fits = shapely.covers(layout.shape[np.repeat(room, tries)], boxes)
    places = np.flatnonzero(fits)
    boxes = np.append(boxes[places], shapely.polygons(kept_free))
    one, other = shapely.STRtree(boxes).query(boxes[: len(places)], "intersects")
    fits[places[one[other >= len(places)]]] = False
    one, other = places[one[other < len(places)]], places[other[other < len(places)]]
    near = one // tries != other // tries
    hits: dict[int, list[int]] = {}
    for place, blocked in zip(one[near].tolist(), other[near].tolist(), strict=True):
        hits.setdefault(place, []).append(blocked)
    is_free = fits.tolist()
    count = [0] * layout.num_rooms
    taken = np.full(number, -1)
    for index, of in enumerate(room.tolist()):
        first = index * tries
        place = next((p for p in range(first, first + tries) if is_free[p]), None)
        if place is None or count[of] == most:
            continue
        taken[index] = place - first
        count[of] += 1
        for blocked in hits.get(place, ()):
            is_free[blocked] = False
    return taken


def _chairs(
    layout: Layout,
    doors: Sequence[Door],
    main: Objects,
    means: Sequence[float],
    out: np.ndarray,
    most: int,
    rng: np.random.Generator,
) -> Objects:
    """Draws chairs at tables and desks: before those at a wall, around those that stand free."""
    number = np.array([int(mean + rng.random()) for mean in means], int)
    at = np.repeat(np.arange(len(number)), number)
    size = _sizes(["chair"] * len(at), rng)
    turn = np.arange(len(at)) - np.repeat(np.cumsum(number) - number, number)
    long = np.linalg.norm(main.corners[:, 1] - main.corners[:, 0], axis=-1)
    deep = np.linalg.norm(main.corners[:, 2] - main.corners[:, 1], axis=-1)
    seats = (turn[:, None] + np.arange(4)) % 4
    forward = out[at][:, None]
    sideways = np.stack([forward[..., 1], -forward[..., 0]], axis=-1)
    signs = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])[seats]
    facing = signs[..., :1] * forward + signs[..., 1:] * sideways
    reach = np.where(seats < 2, deep[at][:, None], long[at][:, None]) / 2 + SEAT
    centre = main.place[at][:, None] + reach[..., None] * facing
    along = np.stack([facing[..., 1], -facing[..., 0]], axis=-1)
    corners = _corners(centre, along, facing, size[:, None])
    obstacles = np.concatenate([_before_doors(doors), main.corners])
    room = main.room[at]
    taken = _taken(layout, room, corners, obstacles, most)
    full = np.bincount(main.room, minlength=layout.num_rooms)
    placed = np.flatnonzero(taken >= 0)
    rank = _rank(room[placed])
    placed = placed[rank + full[room[placed]] < most]
    chosen = corners[placed, taken[placed]]
    return Objects(
        ["chair"] * len(placed), room[placed], chosen.mean(axis=1), size[placed, 2], chosen
    )


def _rank(group: np.ndarray) -> np.ndarray:
    """Returns how many of its group come before each item; groups lie side by side or not."""
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    rank = np.empty(len(group), int)
    rank[order] = np.arange(len(group)) - np.searchsorted(ordered, ordered)
    return rank
