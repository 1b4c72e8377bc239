"""Floors from the release of Modified Swiss Dwellings (MSD), with its own walls: M-F, M-B, M-C.

Read is the table of the release, `mds_V2_5.372k.csv`, a row a drawn thing: `apartment_id` (empty in
shared spaces), `building_id`, `floor_id`, `roomtype` and `geom` (WKT, metres); its other columns
(site_id, plan_id, unit_id, area_id, unit_usage, entity_type, entity_subtype, elevation, height,
zoning) are not needed, and neither are the pickled graphs and images beside it. `roomtype` is one
of nine kinds of room, Structure (walls, columns, shafts), Door, Entrance Door or Window.

The table of Swiss Dwellings, `geometries.csv`, is read as well: `geometry` is its `geom`, and
`entity_subtype` (BEDROOM, WALL, ...) becomes a roomtype as MSD makes it one; what is of
`entity_type` feature, such as a sink, is passed over.

A floor is an apartment of one storey. Every edge of a room is a plane. A wall is a Structure
polygon; it has the planes that its edges look at: each edge with a room before it counts for the
plane of that room whose centre is nearest.

Source: notebooks, `graphs.py` and `constants.py` of caspervanengelenburg/msd and snt-arg/msd, and
`graph_from_msd` in snt-arg/situational_graphs_datasets; columns also from public scripts that use
the table. The authors took the first 5,000 apartments, of which 3,467 have connected rooms.
Differs: they worked on an earlier version of the table (5.664k). An apartment with a polygon that
crosses itself, or with a roomtype not listed here, is left out.
Not tried: the release itself, which was not at hand; the tests write a small table of this form.
"""

import csv
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import shapely
from scipy.sparse.csgraph import connected_components

from sg3d_jax.data.buildings import Storey
from sg3d_jax.data.floorplan import Sides, check_corners, check_metres, sides_of, storey_of
from sg3d_jax.data.levels import Floor, Floors
from sg3d_jax.data.watching import watched

COLUMNS: Final = ("apartment_id", "building_id", "floor_id", "roomtype", "geom")
BALCONY: Final = "Balcony"
ROOM_TYPES: Final = (
    "Bedroom",
    "Livingroom",
    "Kitchen",
    "Dining",
    "Corridor",
    "Stairs",
    "Storeroom",
    "Bathroom",
    BALCONY,
)
STRUCTURE: Final = "Structure"
DOORS: Final = ("Door", "Entrance Door")
WINDOW: Final = "Window"
RAW_COLUMNS: Final = MappingProxyType({"geom": "geometry", "roomtype": "entity_subtype"})
RAW_TYPES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "Bedroom": ("ROOM", "BEDROOM"),
        "Livingroom": ("LIVING_ROOM", "LIVING_DINING"),
        "Kitchen": ("KITCHEN", "KITCHEN_DINING"),
        "Dining": ("DINING",),
        "Corridor": ("CORRIDOR", "CORRIDORS_AND_HALLS"),
        "Stairs": ("STAIRS", "STAIRCASE", "ELEVATOR", "VOID"),
        "Storeroom": ("STOREROOM",),
        "Bathroom": ("BATHROOM",),
        BALCONY: ("BALCONY", "TERRACE", "RAILING"),
        STRUCTURE: ("WALL", "COLUMN", "SHAFT"),
        "Door": ("DOOR",),
        "Entrance Door": ("ENTRANCE_DOOR",),
        WINDOW: ("WINDOW",),
    }
)
TYPE_OF: Final = MappingProxyType({raw: kind for kind, raws in RAW_TYPES.items() for raw in raws})
PASSED_OVER: Final = "feature"  # the entity_type of sinks, stoves and the like
MAX_APARTMENTS: Final = 5000  # the floor that reaches so many is the last
PASSAGE: Final = 0.04  # metres: rooms that are nearer have no wall between them
PROBE: Final = 0.01  # metres before an edge of a wall, where a room is looked for
MIN_PLANES: Final = 2  # of a wall
MAX_COORDINATE: Final = 1e6  # metres; sites have their own origin
MAX_BYTES: Final = 2**29  # of the table
MAX_DISTANCES: Final = 10_000_000  # from edges of walls to planes, of an apartment


class Thing(NamedTuple):
    """A row of the table."""

    apartment: str  # its id
    building: str  # its id
    floor: str  # its id
    kind: str  # such as a room type, or "Structure"
    geometry: str  # WKT
    where: str  # file and line


class Shapes(NamedTuple):
    """What is drawn of one apartment: arrays of polygons, metres."""

    rooms: np.ndarray  # with balconies
    balcony: np.ndarray  # bool[r], which rooms are balconies
    walls: np.ndarray  # structural elements
    doors: np.ndarray  # openings between rooms
    windows: np.ndarray  # openings to the outside


def read_floors(path: str | Path, max_apartments: int = MAX_APARTMENTS) -> Floors:
    """Reads the apartments of one storey whose rooms are connected.

    Args:
      path: the table, a .csv file.
      max_apartments: with the floor that reaches so many, connected or not, reading ends.

    Returns:
      A floor an apartment, in the order of the table's floors, and a sentence for each apartment
      of one storey that makes none.

    Raises:
      ValueError: the table is broken: one sentence that names the line and the column.
    """
    drawn_in: dict[str, list[Thing]] = {name: [] for name in _chosen(path, max_apartments)}
    for thing in _things(path):
        if thing.apartment in drawn_in:
            drawn_in[thing.apartment].append(thing)
    floors, left_out = [], []
    for apartment, things in watched([*drawn_in.items()], "floors"):
        building, floor = things[0].building, things[0].floor
        origin = f"{floor}_{apartment}"
        drawn = [_parse(thing) for thing in things]
        try:
            kinds = [thing.kind for thing in things]
            storey = storey_of_apartment(_sorted_shapes(kinds, np.array(drawn)))
            rooms = tuple(kind for kind in kinds if kind in ROOM_TYPES)
            floors.append(Floor(building, origin, storey, rooms))
        except ValueError as error:
            left_out.append(f"{origin}: {error}")
    return Floors(floors, left_out)


def storey_of_apartment(shapes: Shapes) -> Storey:
    """Turns an apartment into planes, walls and rooms.

    Raises:
      ValueError: it has no rooms, or they are not connected.
    """
    if not len(shapes.rooms):
        raise ValueError("there are no rooms, expected at least one")
    check_corners(sum(int(shapely.get_num_coordinates(drawn).sum()) for drawn in shapes[::2]))
    check_metres(shapes.rooms)
    num_parts, _ = connected_components(adjacent_rooms(shapes), directed=False)
    if num_parts > 1:
        raise ValueError(f"the rooms are in {num_parts} parts, expected connected rooms")
    sides = sides_of(_filled(shapes.rooms))
    wall, used = wall_planes(sides, shapes)
    wall_centre = shapely.get_coordinates(shapely.centroid(shapes.walls[used]))
    return storey_of(sides, shapes.rooms, wall, wall_centre)


def adjacent_rooms(shapes: Shapes) -> np.ndarray:
    """Returns which rooms one can see from another, bool[r, r].

    They are less than 4 cm apart, or a door turned by a right angle reaches both, or a window
    turned likewise and shrunk to half does and one of them is a balcony.

    Source: connect_rooms_by_proximity in snt-arg/msd.
    """
    tree = shapely.STRtree(shapes.rooms)
    near = _incidence(tree.query(shapes.rooms, "dwithin", PASSAGE), shapes.rooms, shapes)
    door = _incidence(tree.query(_turned(shapes.doors, 1.0), "intersects"), shapes.doors, shapes)
    half = _turned(shapes.windows, 0.5)
    window = _incidence(tree.query(half, "intersects"), shapes.windows, shapes)
    outside = shapes.balcony[:, None] | shapes.balcony
    return near | (door.T @ door) | (window.T @ window & outside)


def wall_planes(sides: Sides, shapes: Shapes) -> tuple[np.ndarray, np.ndarray]:
    """Returns the planes of each wall that has at least two.

    Returns:
      int[k, 2], pairs (plane, wall), sorted, with walls counted anew; and the index of each wall
      among the Structure polygons, int[w].

    Source: add_other_geometry in snt-arg/msd; graph_from_msd in situational_graphs_datasets.
    """
    if not len(shapes.walls):
        return np.zeros((0, 2), int), np.zeros(0, int)
    edges = sides_of(_filled(shapes.walls))
    middle = edges.ends.mean(axis=1)
    probes = shapely.points(middle - PROBE * edges.normal)
    edge, room = shapely.STRtree(shapes.rooms).query(probes, predicate="within")
    plane_centre = sides.ends.mean(axis=1)
    if len(edge) * len(plane_centre) > MAX_DISTANCES:
        raise ValueError(
            f"{len(edge)} edges of walls are before rooms, expected rooms side by side"
        )
    distance = np.linalg.norm(middle[edge][:, None] - plane_centre[None], axis=-1)
    plane = np.where(sides.room == room[:, None], distance, np.inf).argmin(axis=1)
    members = np.unique(np.column_stack([plane, edges.room[edge]]), axis=0)
    num_planes = np.bincount(members[:, 1], minlength=len(shapes.walls))
    members = members[num_planes[members[:, 1]] >= MIN_PLANES]
    used, anew = np.unique(members[:, 1], return_inverse=True)
    return np.column_stack([members[:, 0], anew]), used


def _chosen(path: str | Path, max_apartments: int) -> list[str]:
    """Returns the apartments of one storey, floor after floor."""
    floors_of: dict[str, set[str]] = {}
    for thing in _things(path):
        floors_of.setdefault(thing.apartment, set()).add(thing.floor)
    by_floor: dict[str, list[str]] = {}
    for apartment, floors in floors_of.items():
        if len(floors) == 1:
            by_floor.setdefault(*floors, []).append(apartment)
    chosen: list[str] = []
    for apartments in by_floor.values():
        if len(chosen) >= max_apartments:
            break
        chosen += apartments
    return chosen


def _things(path: str | Path) -> Iterator[Thing]:
    """Yields the rows of the table that belong to an apartment."""
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise ValueError(f"{path}: the file is too large, expected {MAX_BYTES} bytes at most")
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, strict=True)
            names = reader.fieldnames or ()
            raw = not RAW_COLUMNS.keys() & set(names) and {*RAW_COLUMNS.values()} <= set(names)
            if not raw:
                _check_columns(names, path)
            for row in reader:
                if raw and row.get("entity_type") == PASSED_OVER:
                    continue
                released = _released(row) if raw else row
                if thing := _thing(released, f"{path}: line {reader.line_num}"):
                    yield thing
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}, expected a file to read") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not UTF-8 text, expected a table") from error
    except csv.Error as error:
        raise ValueError(f"{path}: not a table ({error})") from error


def _released(row: Mapping[str | None, str | None]) -> dict[str | None, str | None]:
    """Returns a row of Swiss Dwellings as MSD would have it."""
    kind = row[RAW_COLUMNS["roomtype"]] or ""
    return {**row, "geom": row[RAW_COLUMNS["geom"]], "roomtype": TYPE_OF.get(kind, kind)}


def _check_columns(names: Collection[str], path: str | Path) -> None:
    for column in COLUMNS:
        if column not in names:
            raise ValueError(f"{path}: there is no column {column}, expected {', '.join(COLUMNS)}")


def _thing(row: Mapping[str | None, str | None], where: str) -> Thing | None:
    """Returns a row, or None if it belongs to no apartment."""
    if None in row or None in row.values():
        raise ValueError(f"{where} has not as many cells as the header, expected a cell a column")
    apartment, building, floor, kind, geometry = (row[column] or "" for column in COLUMNS)
    if not apartment:
        return None
    if not f"{floor}{apartment}".isprintable():
        ids = f"{floor!r:.40} and {apartment!r:.40}"
        raise ValueError(f"{where}: floor_id and apartment_id are {ids}, expected printable ones")
    if not building or not floor:
        empty = "floor_id" if building else "building_id"
        raise ValueError(f"{where}: {empty} is empty, expected that of apartment {apartment:.40}")
    return Thing(apartment, building, floor, kind, geometry, where)


def _parse(thing: Thing) -> shapely.Geometry:
    """Returns the geometry of a row."""
    held = f"{thing.where}: geom is {thing.geometry!r:.40}"
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # GEOS leaves its flags set
            geometry = shapely.from_wkt(thing.geometry)
    except (shapely.GEOSException, NotImplementedError) as error:  # the latter of curves
        raise ValueError(f"{held}, expected WKT without curves") from error
    if not (np.abs(shapely.get_coordinates(geometry)) <= MAX_COORDINATE).all():  # false for nan
        raise ValueError(f"{held}, expected metres within {MAX_COORDINATE:g}")
    return geometry


def _sorted_shapes(kinds: list[str], drawn: np.ndarray) -> Shapes:
    """Sorts what is drawn of an apartment by kind.

    Raises:
      ValueError: of unknown kind, no polygon, or one that crosses itself.
    """
    for kind, shape in zip(kinds, drawn, strict=True):
        if kind not in (*ROOM_TYPES, STRUCTURE, *DOORS, WINDOW):
            raise ValueError(f"roomtype {kind!r:.40} is not one of MSD's")
        if not isinstance(shape, shapely.Polygon) or not shape.is_valid or shape.is_empty:
            raise ValueError(f"a {kind} is no simple polygon")
    kind = np.array(kinds)
    is_room = np.isin(kind, ROOM_TYPES)
    return Shapes(
        rooms=drawn[is_room],
        balcony=kind[is_room] == BALCONY,
        walls=drawn[kind == STRUCTURE],
        doors=drawn[np.isin(kind, DOORS)],
        windows=drawn[kind == WINDOW],
    )


def _filled(shapes: np.ndarray) -> np.ndarray:
    """Returns polygons without their holes: only outer edges are planes."""
    return shapely.polygons(shapely.get_exterior_ring(shapes))


def _turned(shapes: np.ndarray, scale: float) -> np.ndarray:
    """Turns each shape about its centroid by a right angle and scales it."""
    points, owner = shapely.get_coordinates(shapes, return_index=True)
    centre = shapely.get_coordinates(shapely.centroid(shapes))[owner]
    x, y = (points - centre).T
    return shapely.set_coordinates(shapes.copy(), centre + scale * np.column_stack([-y, x]))


def _incidence(pairs: np.ndarray, shapes: np.ndarray, apartment: Shapes) -> np.ndarray:
    """Returns pairs (shape, room) as a matrix, bool[n, r]."""
    met = np.zeros((len(shapes), len(apartment.rooms)), bool)
    met[pairs[0], pairs[1]] = True
    return met
