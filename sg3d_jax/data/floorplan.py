"""Floors from room polygons: planes, walls and rooms as a robot would know them.

Every straight side of a room is one plane, its normal into the room. Walls are read by one rule,
here and in the sets that are drawn as wide as the world: two planes face each other if they are of
different rooms and stand back to back, with a gap of up to 0.6 m, over a length of 0.1 m or more,
and no other room is in the gap. A wall is all planes that such pairs join, directly or in a chain.
So a corridor against three offices is one wall of four planes, also where the strip between them
changes its thickness, as at a lining or a shaft; a plane belongs to one wall at most, as in
S-Graphs; and a line has two walls where nothing faces across, as where another wall crosses it.

Source: paper, Sec. "Datasets" (M-F), and the authors' conversion of MSD, which has one plane an
edge of a room polygon and walls of two or more planes.
Differs: walls are found from the rooms, because plans of other sources come without wall polygons;
holes in a room have planes too; corners flatter than a centimetre are no corners.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sg3d_jax.data.buildings import Storey
from sg3d_jax.data.levels import Floor, Floors
from sg3d_jax.data.plans import MIN_SIDES, Plan, read_plans
from sg3d_jax.data.watching import watched

MIN_PIECE: Final = 0.9  # of a room's area that must stay in one piece when it is repaired
TOUCHING: Final = 0.01  # metres: rooms closer than this are drawn without a wall between them
NEGLIGIBLE_LENGTH: Final = 1e-9  # metres: a corner so near to the next one repeats it
NEGLIGIBLE_AREA: Final = 1e-6  # square metres: rooms that share an edge overlap by rounding
MITRE_LIMIT: Final = 10.0  # corners sharper than about 11 degrees are cut off when inset
MIN_ROOMS: Final = 2
LEAST_AREA: Final = 0.2  # square metres, of half of the rooms of a plan in metres;
MOST_AREA: Final = 1e4  # others are in pixels, millimetres or kilometres
MAX_CORNERS: Final = 4000  # of a floor: sides are compared in pairs,
MAX_CORNERS_OF_ROOM: Final = 500  # as are those of a room that may cross itself,
MAX_OVERLAPS: Final = 50  # and of so many rooms each


@dataclass(frozen=True)
class FloorplanConfig:
    """How rooms become planes and walls.

    Attributes:
      max_thickness: greatest distance of planes that stand back to back, metres.
      max_angle: greatest angle between them, degrees; hand-drawn plans are a little askew.
      min_overlap: least length along the wall over which they face each other, metres.
      inset: by so much a room shrinks that touches another one, metres: half the thickness of a
        wall that was drawn as a line.
      flatness: a corner that stands out by less is no corner, metres.

    Raises:
      ValueError: one of them is negative.
    """

    max_thickness: float = 0.6
    max_angle: float = 10.0
    min_overlap: float = 0.1
    inset: float = 0.06
    flatness: float = 0.01

    def __post_init__(self) -> None:
        """Refuses settings that nothing can be measured with."""
        for name, value in asdict(self).items():
            if not value >= 0:
                raise ValueError(f"{name} is {value:g}, expected zero or more")


RULES: Final = FloorplanConfig()


class RoomFault(ValueError):
    """That one room of a plan cannot be told."""

    def __init__(self, room: int, problem: str) -> None:
        """Names the room by its place among those of the plan."""
        super().__init__(f"rooms[{room}] {problem}")
        self.room, self.problem = room, problem


class Sides(NamedTuple):
    """The planes of a floor: `p` sides of rooms, metres."""

    ends: np.ndarray  # float[p, 2, 2], from start to end the room is on the left
    normal: np.ndarray  # float[p, 2], unit, into the room
    room: np.ndarray  # int[p]


class Facing(NamedTuple):
    """Pairs of planes that stand back to back: `f` pairs, metres."""

    planes: np.ndarray  # int[f, 2]
    thickness: np.ndarray  # float[f], of the strip between them
    middle: np.ndarray  # float[f, 2, 2], the ends of the line through the middle of the strip


def read_floors(path: str | Path, config: FloorplanConfig = RULES) -> Floors:
    """Reads floors from a .jsonl or .jsonl.gz file and turns them into planes, walls and rooms.

    A floor drawn so that nobody could tell its rooms is left out, and a sentence says why.

    Args:
      path: the file.
      config: how rooms become planes and walls.

    Raises:
      ValueError: the file is broken: one sentence that names the line, the room and the field.
    """
    floors, left_out = [], []
    for plan in watched(read_plans(path), "floors"):
        try:
            storey = storey_of_rooms(plan.rooms, config)
            floors.append(Floor(plan.building, plan.origin, storey, plan.names))
        except ValueError as error:
            left_out.append(f"{plan.origin}: {error}")
    return Floors(floors, left_out)


def floors_of(plans: Sequence[Plan], scale: float, config: FloorplanConfig = RULES) -> Floors:
    """Turns plans of the user's own into planes, walls and rooms, without the rooms that are odd.

    Args:
      plans: of `read_plans`.
      scale: how many metres one of their unit is.
      config: how rooms become planes and walls.

    Returns:
      The floors, and a sentence for each room, and each floor, that is not among them.
    """
    floors, left_out = [], []
    for plan in watched(plans, "floors"):
        faults, kept = list(plan.faults), list(range(len(plan.rooms)))
        try:
            while True:
                try:
                    storey = storey_of_rooms([scale * plan.rooms[room] for room in kept], config)
                    break
                except RoomFault as fault:
                    place = plan.places[kept.pop(fault.room)]
                    faults.append(f"rooms[{place}] {fault.problem}")
            names = tuple(plan.names[room] for room in kept)
            floors.append(Floor(plan.building, plan.origin, storey, names))
        except ValueError as error:
            faults.append(f"{error}")
        left_out += [f"{plan.origin}: {fault}" for fault in faults]
    return Floors(floors, left_out)


def storey_of_rooms(rooms: Sequence[np.ndarray], config: FloorplanConfig = RULES) -> Storey:
    """Turns the rooms of one floor into planes, walls, rooms and the centre of the floor.

    Args:
      rooms: float[v, 2] each, corners in order of either sense, metres.
      config: how rooms become planes and walls.

    Raises:
      ValueError: the rooms make no floor; the sentence names the room.
    """
    check_corners(sum(map(len, rooms)))
    shapes = tidy_rooms(rooms, config)
    check_metres(shapes)
    sides = sides_of(shapes, config.flatness)
    check_corners(len(sides.room))
    wall, wall_centre = find_walls(sides, shapes, config)
    return storey_of(sides, shapes, wall, wall_centre)


def check_corners(count: int) -> None:
    """Refuses a floor that is too large to be read.

    Raises:
      ValueError: it has too many corners.
    """
    if count > MAX_CORNERS:
        raise ValueError(f"there are {count} corners, expected at most {MAX_CORNERS} on a floor")


def check_metres(shapes: np.ndarray) -> None:
    """Refuses rooms that are drawn in another unit than metres.

    Args:
      shapes: their polygons.

    Raises:
      ValueError: half of them are smaller than a cupboard, or larger than a field.
    """
    area = float(np.median(shapely.area(shapes)))
    if not LEAST_AREA <= area <= MOST_AREA:
        raise ValueError(
            f"the median room has {area:.6g} square metres, expected {LEAST_AREA:g} to "
            f"{MOST_AREA:g}: corners are to be in metres"
        )


def storey_of(
    sides: Sides, shapes: np.ndarray, wall: np.ndarray, wall_centre: np.ndarray
) -> Storey:
    """Puts a storey together from its planes, room polygons and walls.

    Args:
      sides: planes.
      shapes: polygons of the rooms.
      wall: int[k, 2], pairs (plane, wall).
      wall_centre: float[w, 2], metres.
    """
    room_centre = shapely.get_coordinates(shapely.centroid(shapes))
    return Storey(
        plane=sides.ends.mean(axis=1),
        normal=sides.normal,
        width=np.linalg.norm(sides.ends[:, 1] - sides.ends[:, 0], axis=1),
        room=sides.room,
        room_centre=room_centre,
        wall=wall,
        wall_centre=wall_centre,
        centre=room_centre.mean(axis=0),
    )


def tidy_rooms(rooms: Sequence[np.ndarray], config: FloorplanConfig) -> np.ndarray:
    """Returns polygons that do not overlap, with walls between them and without flat corners.

    A polygon that crosses itself keeps its greatest piece, if that is nearly all; of two that
    overlap the greater gives way (so a room around another one gets a hole); a room that touches
    another one is inset.

    Args:
      rooms: float[v, 2] each, metres.
      config: how rooms become planes and walls.

    Raises:
      ValueError: a room falls apart or vanishes, or there are too few.
    """
    if len(rooms) < MIN_ROOMS:
        raise ValueError(f"there are {len(rooms)} rooms, expected at least {MIN_ROOMS}")
    for index, corners in enumerate(rooms):
        if len(corners) > MAX_CORNERS_OF_ROOM:
            expected = f"expected {MAX_CORNERS_OF_ROOM} at most"
            raise RoomFault(index, f"has {len(corners)} corners, {expected}")
    with np.errstate(divide="ignore", invalid="ignore"):  # GEOS leaves its flags set
        shapes = _repaired(_polygons(rooms))
        inset = shapely.buffer(shapes, -config.inset, join_style="mitre", mitre_limit=MITRE_LIMIT)
        shapes = np.where(_touching(shapes), inset, shapes)
        shapes = _greatest_pieces(shapes, f"is in places narrower than {2 * config.inset:g} m")
        return shapely.simplify(shapely.normalize(shapes), config.flatness)


def repaired_rooms(rooms: Sequence[np.ndarray]) -> np.ndarray:
    """Returns which rooms of a plan cross themselves or cover others, bool[r].

    Args:
      rooms: float[v, 2] each, metres.

    Raises:
      ValueError: a room falls apart or vanishes.
    """
    drawn = _polygons(rooms)
    with np.errstate(divide="ignore", invalid="ignore"):
        lost = shapely.area(drawn) - shapely.area(_repaired(drawn))
    return ~shapely.is_valid(drawn) | (lost > NEGLIGIBLE_AREA)


def _polygons(rooms: Sequence[np.ndarray]) -> np.ndarray:
    # GEOS 3.14 simplifies a triangle with a corner at 1e-323 for ever.
    snapped = [np.where(np.abs(each) < NEGLIGIBLE_LENGTH, 0, each) for each in rooms]
    return shapely.polygons([shapely.linearrings(corners) for corners in snapped])


def _repaired(drawn: np.ndarray) -> np.ndarray:
    """Returns polygons that neither cross themselves nor cover each other."""
    valid = shapely.make_valid(drawn, method="structure", keep_collapsed=False)
    shapes = _greatest_pieces(valid, "crosses itself")
    return _greatest_pieces(_without_overlap(shapes), "is cut up by smaller rooms")


def _greatest_pieces(shapes: np.ndarray, problem: str) -> np.ndarray:
    """Returns the greatest polygon of each shape, if that is nearly all of it."""
    pieces, owner = shapely.get_parts(shapes, return_index=True)
    area = shapely.area(pieces)
    whole = np.bincount(owner, area, minlength=len(shapes))
    order = np.argsort(area, kind="stable")
    greatest = np.full(len(shapes), -1)
    greatest[owner[order]] = order  # of several pieces the last one written stays
    lost = (greatest < 0) | (area[greatest] <= MIN_PIECE * whole)
    if lost.any():
        raise RoomFault(int(np.argmax(lost)), f"{problem}, expected one piece")
    return pieces[greatest]


def _without_overlap(shapes: np.ndarray) -> np.ndarray:
    """Cuts from each polygon what smaller ones cover."""
    rank = np.empty(len(shapes), int)
    rank[np.argsort(shapely.area(shapes), kind="stable")] = np.arange(len(shapes))
    great, small = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    great, small = great[rank[great] > rank[small]], small[rank[great] > rank[small]]
    if len(great) > MAX_OVERLAPS * len(shapes):
        raise ValueError(f"{len(shapes)} rooms meet in {len(great)} pairs, expected side by side")
    common = shapely.area(shapely.intersection(shapes[great], shapes[small]))
    great, small = great[common > NEGLIGIBLE_AREA], small[common > NEGLIGIBLE_AREA]
    shapes = shapes.copy()
    for room in np.unique(great):
        smaller = shapely.union_all(shapes[small[great == room]])
        shapes[room] = shapely.difference(shapes[room], smaller)
    return shapes


def _touching(shapes: np.ndarray) -> np.ndarray:
    """Returns which rooms have no wall towards some other room."""
    one, other = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=TOUCHING)
    return np.isin(np.arange(len(shapes)), one[one != other])


def sides_of(shapes: np.ndarray, flatness: float = 0.0) -> Sides:
    """Returns a plane for every edge of every ring of some polygons.

    Args:
      shapes: polygons, of either sense; metres.
      flatness: the corner that a ring starts at is dropped if it stands out by less, metres: it is
        the one that simplifying a ring leaves alone.

    Raises:
      ValueError: a polygon has too few sides.
    """
    rings, room = shapely.get_rings(shapely.orient_polygons(shapes), return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1) > NEGLIGIBLE_LENGTH
    opened = np.append(moved & (ring[1:] == ring[:-1]), False)  # the last repeats the first
    points, ring = points[opened], ring[opened]
    size = np.bincount(ring, minlength=len(rings))
    if (size < MIN_SIDES).any():
        held = f"polygon {room[np.argmin(size)]} has {size.min()} sides"
        raise ValueError(f"{held}, expected at least {MIN_SIDES}")
    last = np.cumsum(size) - 1
    first = last - size + 1
    flat = _distance_to_line(points[first], points[last], points[first + 1]) < flatness
    flat &= size > MIN_SIDES
    kept = np.ones(len(points), bool)
    kept[first[flat]] = False
    points, ring, size = points[kept], ring[kept], size - flat
    following = np.arange(1, len(points) + 1)
    following[np.cumsum(size) - 1] -= size
    ends = np.stack([points, points[following]], axis=1)
    along = _unit(ends[:, 1] - ends[:, 0])
    return Sides(ends=ends, normal=_left(along), room=room[ring])


def find_walls(
    sides: Sides, shapes: np.ndarray, config: FloorplanConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the walls between rooms.

    A wall is a set of planes that facing pairs join, directly or in a chain; so a plane belongs to
    one wall at most, however the strip behind it changes its thickness.

    Args:
      sides: planes.
      shapes: polygons of the rooms, metres.
      config: what counts as back to back.

    Returns:
      int[k, 2], pairs (plane, wall), sorted, and the walls' centres, float[w, 2], metres: the
      centroid of their strips.
    """
    facing = _without_rooms_between(facing_pairs(sides, config), shapes)
    one, other = facing.planes.T
    num_planes = len(sides.room)
    links = coo_array((np.ones(len(one)), (one, other)), shape=(num_planes, num_planes))
    _, chain = connected_components(links, directed=False)
    planes = np.unique(facing.planes)
    chains, number = np.unique(chain[planes], return_inverse=True)  # each a wall
    wall, num_walls = np.zeros(num_planes, int), len(chains)
    wall[planes] = number
    of_pair = wall[one]
    length = np.linalg.norm(facing.middle[:, 1] - facing.middle[:, 0], axis=1)
    weighted = length * facing.middle.mean(axis=1).T
    total = np.bincount(of_pair, length, num_walls)
    centre = [np.bincount(of_pair, part, num_walls) / total for part in weighted]
    return np.column_stack([planes, wall[planes]]), np.column_stack(centre)


def facing_pairs(sides: Sides, config: FloorplanConfig) -> Facing:
    """Returns the pairs of planes of different rooms that stand back to back across a gap.

    Each lies behind the other, their normals are opposite, and where both are, along the wall, the
    strip between them is no thicker than a wall. Thickness is taken in the middle of the strip,
    because the planes of a hand-drawn wall are not parallel.
    """
    ends, normal, _ = sides
    planes = _near_pairs(sides, config)
    across = _unit(normal[planes[:, 0]] - normal[planes[:, 1]])  # from the second to the first
    along = -_left(across)
    reach = np.einsum("fped,fd->fpe", ends[planes], along)
    offset = np.einsum("fped,fd->fpe", ends[planes], across)
    start = np.minimum(reach[..., 0], reach[..., 1])
    end = np.maximum(reach[..., 0], reach[..., 1])
    low, high = np.maximum(start[:, 0], start[:, 1]), np.minimum(end[:, 0], end[:, 1])
    middle = (low + high) / 2
    slope = (offset[..., 1] - offset[..., 0]) / (reach[..., 1] - reach[..., 0])
    at_middle = offset[..., 0] + slope * (middle[:, None] - reach[..., 0])
    thickness = at_middle[:, 0] - at_middle[:, 1]
    near = (thickness >= 0) & (thickness <= config.max_thickness)
    found = near & (high - low >= config.min_overlap)
    line = np.stack([low, high], axis=1)[..., None] * along[:, None]
    line += (at_middle.mean(axis=1)[:, None] * across)[:, None]
    return Facing(planes[found], thickness[found], line[found])


def _near_pairs(sides: Sides, config: FloorplanConfig) -> np.ndarray:
    """Returns the pairs of opposite planes of different rooms that are not too far apart to face.

    Across a strip it is from the middle of one plane to that of the other no farther than half of
    each and the thickness of the strip.
    """
    ends, normal, room = sides
    middle = ends.mean(axis=1) - ends.mean(axis=(0, 1))
    half = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / 2
    length = np.sum(middle**2, axis=1)
    reach = half[:, None] + half + config.max_thickness
    near = length[:, None] + length - 2 * (middle @ middle.T) <= reach**2
    near &= normal @ normal.T <= -np.cos(np.radians(config.max_angle))
    one, other = np.nonzero(near)
    kept = (one < other) & (room[one] != room[other])
    return np.column_stack([one[kept], other[kept]])


def _without_rooms_between(facing: Facing, shapes: np.ndarray) -> Facing:
    """Drops the pairs with another room in their strip: a niche narrower than a wall."""
    lines = shapely.linestrings(facing.middle)
    line, room = shapely.STRtree(shapes).query(lines, predicate="intersects")
    hidden = shapely.length(shapely.intersection(lines[line], shapes[room])) > TOUCHING
    clear = ~np.isin(np.arange(len(lines)), line[hidden])
    return Facing(*(field[clear] for field in facing))


def _distance_to_line(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Returns the distance of points from lines, float[n]."""
    return np.abs(np.sum((points - start) * _left(_unit(end - start)), axis=1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _left(vectors: np.ndarray) -> np.ndarray:
    """Turns vectors of the plane by a right angle counter-clockwise."""
    return np.column_stack([-vectors[:, 1], vectors[:, 0]])
