"""Storeys, buildings and cities: floors in the xy plane, stacked, placed side by side, as a graph.

Source: paper, Sec. "Datasets" (S-C, M-B, M-C); constants as in the settings and graphs that the
authors published (snt-arg/situational_graphs_datasets).
Differs: a building that finds no free place is tried ever farther away instead of being dropped,
which floors much larger than the radius would suffer often and the authors' S-C never does.
"""

import itertools
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import Array, SceneGraph, make_graph
from sg3d_jax.scene.ontology import BUILDING, CITY, FLOOR, PAPER_ONTOLOGY, PLANE, ROOM, WALL

BUILDING_ABOVE_FLOOR: Final = 2.0  # metres above the highest floor of the building
CITY_ABOVE_BUILDING: Final = 4.0  # metres above the highest building node
CLEARANCE: Final = 2.0  # metres kept free around the box of each building
TRIES: Final = 300  # places tried before the radius is doubled


class Storey(NamedTuple):
    """One floor in the xy plane: `p` planes, `w` walls, `r` rooms; metres."""

    plane: np.ndarray  # float[p, 2], centroids
    normal: np.ndarray  # float[p, 2], unit, into the room
    width: np.ndarray  # float[p]
    room: np.ndarray  # int[p], the room of each plane
    room_centre: np.ndarray  # float[r, 2]
    wall: np.ndarray  # int[k, 2], pairs (plane, wall): the planes of each wall
    wall_centre: np.ndarray  # float[w, 2]
    centre: np.ndarray  # float[2], of the floor node


class Building(NamedTuple):
    """Storeys above one another."""

    storeys: tuple[Storey, ...]  # from below
    heights: tuple[float, ...]  # z of each storey, metres


class Motion(NamedTuple):
    """A rigid motion in the plane: a turn, then a shift."""

    angle: float  # counter-clockwise, radians
    about: np.ndarray  # float[2], the fixed point of the turn
    shift: np.ndarray  # float[2]


def turn(vectors: np.ndarray, angle: float) -> np.ndarray:
    """Turns vectors of the plane, float[..., 2], counter-clockwise about the origin."""
    cos, sin = np.cos(angle), np.sin(angle)
    return vectors @ np.array([[cos, sin], [-sin, cos]])


def move_points(
    points: np.ndarray, angle: float, about: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """Moves points of the plane, float[..., 2]; the arguments are those of a `Motion`."""
    return turn(points - about, angle) + (about + shift)


def move(storey: Storey, angle: float, about: np.ndarray, shift: np.ndarray) -> Storey:
    """Moves a storey rigidly in the plane; the arguments are those of a `Motion`."""
    plane, room_centre, wall_centre, centre = (
        move_points(points, angle, about, shift)
        for points in (storey.plane, storey.room_centre, storey.wall_centre, storey.centre)
    )
    return storey._replace(
        plane=plane,
        normal=turn(storey.normal, angle),
        room_centre=room_centre,
        wall_centre=wall_centre,
        centre=centre,
    )


def outline(storeys: Sequence[Storey]) -> np.ndarray:
    """Returns the end points of all planes of some storeys, float[n, 2], from their widths."""
    ends = []
    for storey in storeys:
        half = storey.width[:, None] / 2 * turn(storey.normal, np.pi / 2)
        ends += [storey.plane - half, storey.plane + half]
    return np.concatenate(ends)


def place(
    points: np.ndarray,
    about: np.ndarray,
    placed: Sequence[np.ndarray],
    centre: np.ndarray,
    radius: float,
    rng: np.random.Generator,
) -> Motion:
    """Draws a turn and a place for a building such that it keeps clear of those already placed.

    Args:
      points: float[n, 2], outline of the building, metres.
      about: float[2], its centre.
      placed: outlines of the buildings that stand already.
      centre: float[2], of the disc that `about` is placed in, uniformly.
      radius: of the disc, metres; doubled after every `TRIES` places that were not free.
      rng: source of randomness.

    Returns:
      A motion after which the axis-aligned box of the building, grown by `CLEARANCE`, meets none
      of the boxes of the others, grown likewise.

    Source: add_buildings of the authors' generator.
    Differs: see the module; they give up after 300 places.
    """
    reaches = (radius * 2 ** (attempt // TRIES) for attempt in itertools.count())
    motions = (_draw_motion(about, centre, reach, rng) for reach in reaches)
    return next(
        motion
        for motion in motions
        if not any(_boxes_meet(move_points(points, *motion), other) for other in placed)
    )


def _draw_motion(
    about: np.ndarray, centre: np.ndarray, radius: float, rng: np.random.Generator
) -> Motion:
    """Draws a turn about a point and a shift of it to a uniform place in a disc."""
    angle, bearing = rng.uniform(0, 2 * np.pi, size=2)
    distance = radius * np.sqrt(rng.random())
    target = centre + distance * np.array([np.cos(bearing), np.sin(bearing)])
    return Motion(angle, about, target - about)


def _boxes_meet(one: np.ndarray, other: np.ndarray) -> bool:
    """Returns whether the boxes around two point sets, grown by `CLEARANCE` each, overlap."""
    gap = np.maximum(one.min(axis=0) - other.max(axis=0), other.min(axis=0) - one.max(axis=0))
    return bool((gap <= 2 * CLEARANCE).all())


def city_graph(buildings: Sequence[Building], top: int = CITY, proximity: Array = ()) -> SceneGraph:
    """Turns buildings into a scene graph.

    Args:
      buildings: what stands there; one with one storey for a floor.
      top: highest concept of the graph: FLOOR, BUILDING or CITY.
      proximity: int[e, 2], pairs of planes, counted through all storeys.

    Returns:
      Planes, walls, rooms, floors, buildings and the city, in this order, float64. Planes, walls,
      rooms and floor of a storey have its height. A building node lies at the mean xy of its
      floors, 2 m above the highest; the city node at the mean xy of the buildings, 4 m above the
      highest building node.

    Raises:
      ValueError: the graph would have several nodes of its highest concept, so be unconnected.
    """
    storeys = [storey for building in buildings for storey in building.storeys]
    heights = np.concatenate([building.heights for building in buildings]).astype(float)
    building_of_floor = np.repeat(np.arange(len(buildings)), [len(b.storeys) for b in buildings])
    floor = raised([storey.centre[None] for storey in storeys], heights)
    building = np.stack(
        [_above(floor[building_of_floor == b], BUILDING_ABOVE_FLOOR) for b in range(len(buildings))]
    )
    layers = [
        raised([storey.plane for storey in storeys], heights),
        raised([storey.wall_centre for storey in storeys], heights),
        raised([storey.room_centre for storey in storeys], heights),
        floor,
        building,
        _above(building, CITY_ABOVE_BUILDING)[None],
    ][: top + 1]
    if len(layers[top]) != 1:
        held = f"{len(layers[top])} {PAPER_ONTOLOGY.names[top]} nodes"
        raise ValueError(f"{held}, expected one as the highest of a graph")
    sizes = [len(layer) for layer in layers]
    first = _first(sizes)
    links = _links(storeys, building_of_floor)
    part_of = [links[kind] + first[list(kind)] for kind in links if max(kind) <= top]
    others = sum(sizes[1:])
    return make_graph(
        label=np.repeat(np.arange(top + 1), sizes),
        position=np.concatenate(layers),
        normal=np.pad(np.concatenate([s.normal for s in storeys]), [(0, others), (0, 1)]),
        width=np.pad(np.concatenate([s.width for s in storeys]), (0, others)),
        part_of=np.concatenate(part_of),
        proximity=proximity,
    )


def raised(layers: Sequence[np.ndarray], heights: np.ndarray) -> np.ndarray:
    """Returns the points of all storeys, float[n, 3], each at the height of its storey."""
    z = np.repeat(heights, [len(layer) for layer in layers])
    return np.column_stack([np.concatenate(layers), z])


def _above(points: np.ndarray, height: float) -> np.ndarray:
    """Returns the point over the middle of others, float[3], so much above the highest."""
    return np.append(points[:, :2].mean(axis=0), points[:, 2].max() + height)


def _first(sizes: Sequence[int]) -> np.ndarray:
    """Returns the index of the first item of each group."""
    return np.cumsum([0, *sizes[:-1]])


def _links(
    storeys: Sequence[Storey], building_of_floor: np.ndarray
) -> dict[tuple[int, int], np.ndarray]:
    """Returns the part-of edges by (child, parent), int[e, 2], each concept counted from zero."""
    num_planes = [len(storey.plane) for storey in storeys]
    num_rooms = [len(storey.room_centre) for storey in storeys]
    planes, rooms = _first(num_planes), _first(num_rooms)
    walls = _first([len(storey.wall_centre) for storey in storeys])
    wall_of = [
        s.wall + pair for s, pair in zip(storeys, np.column_stack([planes, walls]), strict=True)
    ]
    room_of = [storey.room + first for storey, first in zip(storeys, rooms, strict=True)]
    num_buildings = building_of_floor[-1] + 1
    return {
        (PLANE, WALL): np.concatenate(wall_of).reshape(-1, 2),
        (PLANE, ROOM): _numbered(np.concatenate(room_of)),
        (ROOM, FLOOR): _numbered(np.repeat(np.arange(len(storeys)), num_rooms)),
        (FLOOR, BUILDING): _numbered(building_of_floor),
        (BUILDING, CITY): _numbered(np.zeros(num_buildings, int)),
    }


def _numbered(parent: np.ndarray) -> np.ndarray:
    """Returns pairs (child, parent), int[n, 2], from the parent of each child."""
    return np.column_stack([np.arange(len(parent)), parent])
