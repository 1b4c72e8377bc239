"""Furnished scenes: floors and cities of rooms of a kind, with doors, stairs, objects and units.

Rooms, storeys and buildings are those of the wide sets (`wide_scene`); `furnished_rooms` says what
rooms are for, `furnished_plan` where doors are, `furnished_objects` what stands in them. Planes,
walls and rooms of a storey have its height; what is furnished has its own. Not in the paper.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.data.buildings import Building, city_graph
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY, FurnishedConfig
from sg3d_jax.data.furnished_objects import ITEMS, Item, Objects, draw_objects
from sg3d_jax.data.furnished_plan import Door, Layout, draw_doors, layout_of
from sg3d_jax.data.furnished_rooms import (
    FEW_ROOMS,
    HOUSE,
    Zones,
    draw_use,
    draw_zones,
    find_stairwells,
)
from sg3d_jax.data.wide_scene import draw_buildings
from sg3d_jax.scene.graph import SceneGraph, make_graph, parts_first
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, ROOM

DOOR_MIDDLE: Final = 1.0  # metres over the floor
FLIGHT: Final = (2.0, 4.5)  # metres that stairs are long, if the stairwell is longer,
LANDING: Final = 0.5  # by so much
BESIDE: Final = 0.25  # metres at most in x and in y from the middle of stairs to that of their room
LONE_RISE: Final = 3.0  # metres to a storey that is not in the graph


class Stairs(NamedTuple):
    """Stairs, metres."""

    place: np.ndarray  # float[3]
    width: float
    rooms: tuple[int, ...]  # the stairwells that they join, counted through all storeys


class Furniture(NamedTuple):
    """What a storey has beside its planes, walls and rooms."""

    zones: Zones
    doors: list[Door]
    objects: Objects


def draw_scene(config: FurnishedConfig, rng: np.random.Generator) -> SceneGraph:
    """Draws a furnished scene as a host graph of `FURNISHED_ONTOLOGY`, without proximity edges."""
    buildings = draw_buildings(config.scene, rng)
    furniture: list[Furniture] = []
    stairs: list[Stairs] = []
    first_room = 0
    for building in buildings:
        layouts = [layout_of(storey) for storey in building.storeys]
        storeys, wells = _furnish(layouts, config, rng)
        rooms = first_room + np.cumsum([0, *(layout.num_rooms for layout in layouts)])
        stairs += _draw_stairs(building, layouts, wells, rooms.tolist(), rng)
        furniture += storeys
        first_room = int(rooms[-1])
    heights = [height for building in buildings for height in building.heights]
    return furnished(city_graph(buildings, config.scene.top), heights, furniture, stairs)


def _furnish(
    layouts: Sequence[Layout], config: FurnishedConfig, rng: np.random.Generator
) -> tuple[list[Furniture], list[int | None]]:
    """Draws the furniture of the storeys of a building, and which room of each has the stairs."""
    use = draw_use(layouts, rng)
    wells: list[int | None] = [None] * len(layouts)
    is_cut_out = config.scene.top == FLOOR and layouts[0].num_rooms >= FEW_ROOMS - 1
    if len(layouts) > 1 or (is_cut_out and rng.random() < config.stairwells):
        wells = find_stairwells(layouts, rng)
    storeys = []
    for level, (layout, well) in enumerate(zip(layouts, wells, strict=True)):
        zones = draw_zones(layout, use, well, len(layouts) <= HOUSE, rng)
        is_entered = level == 0 or well is None
        doors = draw_doors(
            layout, zones.kind, zones.unit, zones.common, is_entered, config.inner_doors, rng
        )
        items = [each if rng.random() < config.furnished else () for each in _items(layout, zones)]
        objects = draw_objects(layout, doors, items, config.max_objects, rng)
        storeys.append(Furniture(zones, doors, objects))
    return storeys, wells


def _items(layout: Layout, zones: Zones) -> list[tuple[Item, ...]]:
    """Returns what may be in each room."""
    units = [[] for _ in zones.unit_kind]
    for kind, unit in zip(zones.kind, zones.unit, strict=True):
        units[unit].append(kind)
    items = []
    for kind, unit in zip(zones.kind, zones.unit, strict=True):
        name = kind
        if kind == "living room" and "kitchen" not in units[unit]:
            name = "open kitchen" if "bedroom" in units[unit] else "studio"
        elif kind == "bathroom" and zones.unit_kind[unit] != "flat":
            name = "washroom"
        items.append(ITEMS[name])
    return items


def _draw_stairs(
    building: Building,
    layouts: Sequence[Layout],
    wells: Sequence[int | None],
    rooms: Sequence[int],
    rng: np.random.Generator,
) -> list[Stairs]:
    """Draws the stairs of a building: of each two stairwells above one another.

    Args:
      building: where it stands.
      layouts: of its storeys.
      wells: the stairwell of each; one that is alone has stairs to a storey that is not seen.
      rooms: number of rooms before those of each storey.
      rng: source of randomness.
    """
    found = [(level, well) for level, well in enumerate(wells) if well is not None]
    flights = [pair for pair in pairwise(found) if pair[1][0] == pair[0][0] + 1]
    if len(wells) == 1:
        flights = [(where, where) for where in found]
    stairs = []
    for (low, below), (high, over) in flights:
        joined = sorted({rooms[low] + below, rooms[high] + over})
        centre = (layouts[low].centre[below] + layouts[high].centre[over]) / 2
        rise = building.heights[high] - building.heights[low] or LONE_RISE
        beside = rng.uniform(-BESIDE, BESIDE, 2)
        place = np.append(centre + beside, building.heights[low] + rise / 2)
        length = layouts[low].area[below] / layouts[low].depth[below] - LANDING
        width = rng.uniform(FLIGHT[0], np.clip(length, *FLIGHT))
        stairs.append(Stairs(place, float(width), tuple(joined)))
    return stairs


def furnished(
    graph: SceneGraph,
    heights: Sequence[float],
    furniture: Sequence[Furniture],
    stairs: Sequence[Stairs],
) -> SceneGraph:
    """Adds furniture to a graph of the paper's concepts.

    Args:
      graph: planes, walls, rooms, floors and what is above, in this order; its part-of edges.
      heights: z of each floor, metres.
      furniture: of each floor, whose rooms come in its order.
      stairs: between them.

    Returns:
      A host graph of `FURNISHED_ONTOLOGY`, concept by concept. A unit stands in the middle of its
      rooms.
    """
    nodes, pairs = graph.nodes, parts_first(graph)
    rooms, floors = (np.flatnonzero(nodes.label == label) for label in (ROOM, FLOOR))
    kept = (nodes.label[pairs] != [ROOM, FLOOR]).any(axis=1)
    kind = np.zeros(len(nodes.label))
    kind[rooms] = _kinds("room", [each for storey in furniture for each in storey.zones.kind])
    first = np.cumsum([0, *(len(storey.zones.kind) for storey in furniture)])[:-1]
    of_floor = list(zip(furniture, heights, first.tolist(), strict=True))
    layers = [_doors(of_floor), _stairs(stairs), _objects(of_floor)]
    units, of_units = _units(furniture, nodes.position[rooms], first)
    sizes = np.cumsum([len(nodes.label), *(len(layer.width) for layer in (*layers, units))])
    edges = [pairs[kept]]
    edges += [
        np.column_stack([start + layer.rooms[:, 0], rooms[layer.rooms[:, 1]]])
        for layer, start in zip((*layers, units), sizes[:-1], strict=True)
    ]
    edges.append(np.column_stack([sizes[-2] + np.arange(len(of_units)), floors[of_units]]))
    added = (*layers, units)
    own = np.array([FURNISHED_ONTOLOGY.label_of(name) for name in PAPER_ONTOLOGY.names])
    label = np.concatenate([own[nodes.label], *(layer.label for layer in added)])
    order = np.argsort(label, kind="stable")
    place = np.empty(len(order), int)
    place[order] = np.arange(len(order))
    return make_graph(
        label[order],
        np.concatenate([nodes.position, *(layer.position for layer in added)])[order],
        normal=np.pad(nodes.normal, [(0, len(order) - len(kind)), (0, 0)])[order],
        width=np.concatenate([nodes.width, *(layer.width for layer in added)])[order],
        kind=np.concatenate([kind, *(layer.kind for layer in added)])[order],
        part_of=place[np.concatenate(edges)],
        ontology=FURNISHED_ONTOLOGY,
    )


class _Layer(NamedTuple):
    """Nodes of one concept: `k` of them."""

    label: np.ndarray  # int[k]
    position: np.ndarray  # float[k, 3], metres
    width: np.ndarray  # float[k], metres
    kind: np.ndarray  # float[k], from 1
    rooms: np.ndarray  # int[e, 2], pairs of one of them and a room


def _layer(
    name: str,
    position: Sequence[np.ndarray],
    width: Sequence[float],
    kind: Sequence[str],
    rooms: Sequence[tuple[int, int]],
) -> _Layer:
    return _Layer(
        np.full(len(position), FURNISHED_ONTOLOGY.label_of(name)),
        np.array(position, float).reshape(-1, 3),
        np.array(width, float),
        _kinds(name, kind) if kind else np.zeros(len(position)),
        np.array(rooms, int).reshape(-1, 2),
    )


def _kinds(name: str, kinds: Sequence[str]) -> np.ndarray:
    """Returns the places of kinds among those of a concept, from 1; 0 of "", which is unknown."""
    known = ("", *FURNISHED_ONTOLOGY.concepts[FURNISHED_ONTOLOGY.label_of(name)].kinds)
    return np.array([float(known.index(kind)) for kind in kinds])


def _doors(of_floor: Sequence[tuple[Furniture, float, int]]) -> _Layer:
    """Returns the doors of all floors, each with its height and number of rooms before it."""
    doors = [(door, height, start) for storey, height, start in of_floor for door in storey.doors]
    rooms = [[start + room for room in door.rooms] for door, _, start in doors]
    return _layer(
        "door",
        [np.append(door.place, height + DOOR_MIDDLE) for door, height, _ in doors],
        [door.width for door, *_ in doors],
        [],
        [(index, room) for index, joined in enumerate(rooms) for room in joined],
    )


def _stairs(stairs: Sequence[Stairs]) -> _Layer:
    return _layer(
        "stairs",
        [each.place for each in stairs],
        [each.width for each in stairs],
        [],
        [(index, room) for index, each in enumerate(stairs) for room in each.rooms],
    )


def _objects(of_floor: Sequence[tuple[Furniture, float, int]]) -> _Layer:
    """Returns the objects of all floors, each with its height and number of rooms before it."""
    objects = [(storey.objects, height, start) for storey, height, start in of_floor]
    position = [np.column_stack([each.place, each.up + height]) for each, height, _ in objects]
    room = np.concatenate([each.room + start for each, _, start in objects])
    return _layer(
        "object",
        list(np.concatenate(position)),
        np.concatenate([each.width for each, *_ in objects]).tolist(),
        [kind for each, *_ in objects for kind in each.kind],
        list(enumerate(room.tolist())),
    )


def _units(
    furniture: Sequence[Furniture], centre: np.ndarray, first: np.ndarray
) -> tuple[_Layer, np.ndarray]:
    """Returns the units of all floors and the floor of each, int[u].

    Args:
      furniture: of each floor.
      centre: float[r, 3], of all rooms.
      first: number of rooms before each floor.
    """
    number = [len(storey.zones.unit_kind) for storey in furniture]
    before = np.cumsum([0, *number])[:-1]
    unit = np.concatenate(
        [start + storey.zones.unit for storey, start in zip(furniture, before, strict=True)]
    )
    count = np.bincount(unit)
    position = np.stack([np.bincount(unit, axis) / count for axis in centre.T], axis=1)
    layer = _layer(
        "unit",
        list(position),
        [0.0] * len(position),
        [kind for storey in furniture for kind in storey.zones.unit_kind],
        list(zip(unit.tolist(), range(len(unit)), strict=True)),
    )
    return layer, np.repeat(np.arange(len(furniture)), number)
