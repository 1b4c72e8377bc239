"""Scenes as wide as the world: floors, buildings and cities of every kind (G-F, G-B, G-C).

A building has a footprint, a frame and two thicknesses of walls; its storeys divide the footprint
anew or are like the one below. See `wide_rooms` for the kinds of floors, `wide_plan` for angles and
walls; walls are those of floor plans (`floorplan.find_walls`), gaps are as thick as drawn, widths
true and room centres centroids. Not in the paper.
"""

from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.data.buildings import Building, Storey, city_graph, move, outline, place
from sg3d_jax.data.levels import num_nodes
from sg3d_jax.data.wide import WideConfig
from sg3d_jax.data.wide_plan import Frame, Thickness, draw_frame, storey_of_labels
from sg3d_jax.data.wide_rooms import FOOTPRINTS, Footprint, draw_footprint, draw_rooms
from sg3d_jax.scene.graph import SceneGraph

NODES_A_ROOM: Final = 8.0  # planes, walls and the room itself, about
LOWEST_STOREY: Final = 12.0  # nodes of a storey that are aimed at, at least
MIN_BUILDING: Final = 25.0  # nodes of a building of several that are aimed at, at least
TRIES: Final = 20  # of a building that has no rooms or too many nodes, each smaller
SETBACK: Final = 0.2  # probability that a storey and those above it lack the wings
CUT_ROOMS: Final = 0.3  # share of the rooms that are cut on a floor with such rooms
MIN_ROOMS: Final = {"few": 1, "home": 3, "corridor": 5, "core": 10, "hall": 1}
MAX_ROOMS: Final = {"few": 3, "home": 20, "corridor": 60, "core": 60, "hall": 30}


class _Shell(NamedTuple):
    """What the storeys of a building share."""

    footprint: Footprint
    frame: Frame
    thickness: Thickness


def draw_scene(config: WideConfig, rng: np.random.Generator) -> SceneGraph:
    """Draws a scene as a host graph, without proximity edges.

    Source: `buildings.city_graph` says where floors, buildings and the city stand.
    """
    return city_graph(draw_buildings(config, rng), config.top)


def draw_buildings(config: WideConfig, rng: np.random.Generator) -> list[Building]:
    """Draws the buildings of a scene where they stand."""
    nodes = config.size[0] * (config.size[1] / config.size[0]) ** rng.random()
    most = min(config.buildings[1], max(config.buildings[0], int(nodes // MIN_BUILDING)))
    number = int(rng.integers(config.buildings[0], most, endpoint=True))
    share = rng.uniform(0.5, 1.5, number)
    buildings: list[Building] = []
    total = 0
    for aim in (nodes * share / share.sum()).tolist():
        building = _draw_building(config, aim, config.max_nodes - total, rng)
        if building is None:
            continue
        total += _size(building)
        buildings.append(_placed(building, buildings, config, rng))
    return buildings


def _size(building: Building) -> int:
    """Returns the number of nodes of a building."""
    return 1 + sum(num_nodes(storey) for storey in building.storeys)


def _draw_building(
    config: WideConfig, aim: float, most: int, rng: np.random.Generator
) -> Building | None:
    """Draws a building at its own place, of about so many nodes; None if it has too many."""
    for _ in range(TRIES):
        tallest = min(config.storeys[1], max(config.storeys[0], int(aim // LOWEST_STOREY)))
        number = int(rng.integers(config.storeys[0], tallest, endpoint=True))
        num_rooms = np.clip(aim / number / NODES_A_ROOM, 1, max(MAX_ROOMS.values()))
        shell = _draw_shell(config, float(num_rooms), rng)
        storeys = _draw_storeys(config, shell, number, rng)
        if storeys:
            building = Building(storeys, _heights(config, number, rng))
            if _size(building) <= most:
                return building
        aim *= 0.7
    return None


def _draw_shell(config: WideConfig, num_rooms: float, rng: np.random.Generator) -> _Shell:
    """Draws what the storeys of a building share, for about so many rooms a storey."""
    names = list(FOOTPRINTS)
    fits = [MIN_ROOMS[name] <= num_rooms <= MAX_ROOMS[name] for name in names]
    weight = np.cumsum(np.where(fits, config.kinds, 0))
    kind = names[int(np.searchsorted(weight, rng.random() * weight[-1], "right"))]
    thin, thickest = config.thickness
    most = thin * (thickest / thin) ** rng.random()
    thick = most * (thickest / most) ** rng.random()
    footprint = draw_footprint(kind, num_rooms, thick, rng)
    along = [
        np.where(rng.random(number + 1) < config.thick_walls, thick, most)
        for number in footprint.size
    ]
    frame = draw_frame(footprint.size, footprint.step, config.askew, rng)
    return _Shell(footprint, frame, Thickness(*along, oblique=most, lined=config.lined))


def _draw_storeys(
    config: WideConfig, shell: _Shell, number: int, rng: np.random.Generator
) -> tuple[Storey, ...] | None:
    """Draws the storeys of a building; None if one of them has no rooms."""
    footprint = shell.footprint
    storeys: list[Storey] = []
    for level in range(number):
        if level and rng.random() < config.alike:
            storeys.append(storeys[-1])
            continue
        if level and len(footprint.parts) > 1 and rng.random() < SETBACK:
            footprint = footprint._replace(parts=footprint.parts[:1], links=())
        coarser = 1.0 if number == 1 or rng.random() < 0.8 else 4.0
        cut = CUT_ROOMS * float(rng.random() < config.cut_floors)
        coarse = footprint._replace(room=footprint.room * coarser)
        drawn = (
            storey_of_labels(draw_rooms(coarse, rng), shell.frame, shell.thickness, cut, rng)
            for _ in range(TRIES)
        )
        storey = next((storey for storey in drawn if storey is not None), None)
        if storey is None:
            return None
        storeys.append(storey)
    return tuple(storeys)


def _heights(config: WideConfig, number: int, rng: np.random.Generator) -> tuple[float, ...]:
    """Returns the z of each storey over the ground, metres."""
    usual, ground = rng.uniform(*config.storey_height, 2)
    if rng.random() >= config.tall_ground:
        ground = usual
    return (0.0, *(ground + usual * np.arange(number - 1)).tolist())


def _placed(
    building: Building, others: list[Building], config: WideConfig, rng: np.random.Generator
) -> Building:
    """Turns a building and sets it down beside the others, on ground of its own height."""
    corners, centre = outline(building.storeys), building.storeys[0].centre
    if not others:
        angle = rng.uniform(0, 2 * np.pi)
        turned = (move(storey, angle, centre, -centre) for storey in building.storeys)
        return building._replace(storeys=tuple(turned))
    placed = [outline(other.storeys) for other in others]
    reach = np.ptp(corners, axis=0).max() + max(np.ptp(other, axis=0).max() for other in placed)
    motion = place(corners, centre, placed, np.zeros(2), 0.6 * reach + 10, rng)
    lift = rng.uniform(-config.unevenness, config.unevenness)
    return Building(
        tuple(move(storey, *motion) for storey in building.storeys),
        tuple(lift + height for height in building.heights),
    )
