"""Synthetic scenes: the floors of the paper's S-F-square and S-F, the cities of S-C, and more.

A city is drawn floor by floor as plans, which are stacked and placed first. Proximity edges join
the planes as drawn; rooms merge afterwards, in each storey differently, and floors, buildings and
the city stay where they were.

Source: paper, Sec. "Datasets"; rules and constants as observed in the graphs and settings that the
authors published (snt-arg/situational_graphs_datasets).
Differs: see `synthetic_floor` and `buildings`. S-B, a building alone, and `LARGE` are our own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

import numpy as np

from sg3d_jax.data.buildings import Building, Motion, city_graph, place, raised
from sg3d_jax.data.furnished import FurnishedConfig
from sg3d_jax.data.synthetic_floor import (
    Plan,
    SyntheticConfig,
    draw_plan,
    fit_plan,
    merge_rooms,
    move_plan,
    storey_of,
    without_removed,
)
from sg3d_jax.data.wide import WideConfig
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import BUILDING, CITY, FLOOR
from sg3d_jax.scene.proximity import NEIGHBOURS


@dataclass(frozen=True)
class CityConfig:
    """How buildings and cities are drawn.

    Attributes:
      floor: how each floor is drawn. Its rooms merge last of all; `rotate` turns the base building.
      storeys: least and greatest number of storeys of the base building, which are alike but for
        the merging of their rooms.
      extra_buildings: least and greatest number of further buildings, each of its own ground floor
        and, in the box of this, its own upper floors.
      extra_storeys: least and greatest number of storeys of a further building.
      storey_height: metres from floor to floor.
      radius: of the disc around the base building in which the others are placed, metres.
      unevenness: greatest height of a further building above or below the base building, metres.
      top: highest concept of the graph, `BUILDING` or `CITY`.

    Raises:
      ValueError: a range is empty, a length is not positive, or several buildings have no city.
    """

    floor: SyntheticConfig = SyntheticConfig(merge_ratio=0.5)
    storeys: tuple[int, int] = (2, 2)
    extra_buildings: tuple[int, int] = (1, 1)
    extra_storeys: tuple[int, int] = (1, 2)
    storey_height: float = 3.0
    radius: float = 20.0
    unevenness: float = 2.0
    top: int = CITY

    def __post_init__(self) -> None:
        """Refuses settings that no city can be drawn with."""
        for name, fewest in (("storeys", 1), ("extra_buildings", 0), ("extra_storeys", 1)):
            low, high = getattr(self, name)
            if not fewest <= low <= high:
                raise ValueError(
                    f"{name} is ({low}, {high}), expected {fewest} <= least <= greatest"
                )
        for name in ("storey_height", "radius"):
            metres = getattr(self, name)
            if not 0 < metres < np.inf:
                raise ValueError(f"{name} is {metres:g}, expected a positive number of metres")
        if not 0 <= self.unevenness < np.inf:
            raise ValueError(f"unevenness is {self.unevenness:g}, expected 0 m or more")
        if self.top not in (BUILDING, CITY):
            raise ValueError(f"top is {self.top}, expected {BUILDING} (building) or {CITY} (city)")
        if self.top == BUILDING and self.extra_buildings[1]:
            raise ValueError(
                f"extra_buildings reaches {self.extra_buildings[1]} below a building as the "
                "highest concept, expected 0"
            )


S_F_SQUARE: Final = SyntheticConfig(room_cells=(10, 100), rotate=True)
S_F: Final = SyntheticConfig(merge_ratio=0.7)
S_C: Final = CityConfig()
S_B: Final = CityConfig(extra_buildings=(0, 0), top=BUILDING)
# As S_F, true widths, and planes of one wall 0.05 to 0.45 m apart instead of 0.08 to 0.10 m.
S_F_THICK: Final = replace(S_F, wall_thickness=(0.1, 0.9), stale_width=False)
# About 330 nodes, three times those of S-C.
LARGE: Final = CityConfig(storeys=(2, 5), extra_buildings=(1, 3), extra_storeys=(2, 5), radius=40.0)


def make_scene(
    config: SyntheticConfig | CityConfig | WideConfig | FurnishedConfig, seed: int, index: int
) -> SceneGraph:
    """Draws one scene as a host graph; the same (config, seed, index) gives the same graph.

    Args:
      config: what to draw, e.g. `S_F`, `S_C` or `wide.G_F`.
      seed: names the data set.
      index: names the graph in it.

    Returns:
      Planes, walls, rooms, floors, buildings and city, in this order, float64. A floor ends at its
      floor node, lies at z = 0 and has part-of edges only; buildings and cities have the
      proximity edges of the published S-C too: the 10 nearest planes of each plane before rooms
      merge, and pairs that share a room or a wall. Wide and furnished scenes have part-of edges
      only; the latter have concepts of their own.
    """
    rng = np.random.default_rng([seed, index])
    if isinstance(config, WideConfig):
        from sg3d_jax.data.wide_scene import draw_scene  # brings shapely

        return draw_scene(config, rng)
    if isinstance(config, FurnishedConfig):
        from sg3d_jax.data import furnished_scene  # brings shapely

        return furnished_scene.draw_scene(config, rng)
    if isinstance(config, SyntheticConfig):
        return _draw_floor(config, rng)
    return _draw_city(config, rng)


def _draw_floor(config: SyntheticConfig, rng: np.random.Generator) -> SceneGraph:
    """Draws a floor whose rooms merge before it turns."""
    plan = draw_plan(config, rng)
    if config.merge_ratio:
        plan = without_removed(merge_rooms(plan, config.merge_ratio, config.stale_width, rng))
    plan = _turned(plan, config, rng)
    return city_graph([Building((storey_of(plan),), (0.0,))], FLOOR)


def _turned(plan: Plan, config: SyntheticConfig, rng: np.random.Generator) -> Plan:
    """Turns a plan about the origin by a uniform angle, if the settings say so."""
    if not config.rotate:
        return plan
    return move_plan(plan, Motion(rng.uniform(0, 2 * np.pi), np.zeros(2), np.zeros(2)))


def _draw_city(config: CityConfig, rng: np.random.Generator) -> SceneGraph:
    """Draws buildings, joins their planes by proximity, then merges the rooms of each storey."""
    buildings = _draw_buildings(config, rng)
    ground = [0.0, *rng.uniform(-config.unevenness, config.unevenness, size=len(buildings) - 1)]
    heights = [
        z + config.storey_height * np.arange(len(plans))
        for z, plans in zip(ground, buildings, strict=True)
    ]
    floor = config.floor
    merged = [
        [merge_rooms(plan, floor.merge_ratio, floor.stale_width, rng) for plan in plans]
        for plans in buildings
    ]
    return city_graph(
        [_building(*parts) for parts in zip(buildings, merged, heights, strict=True)],
        config.top,
        _proximity(buildings, merged, heights),
    )


def _draw_buildings(config: CityConfig, rng: np.random.Generator) -> list[list[Plan]]:
    """Draws the plans of each building, placed; the base building comes first."""
    base = _turned(draw_plan(config.floor, rng), config.floor, rng)
    buildings = [[base] * int(rng.integers(*config.storeys, endpoint=True))]
    for _ in range(rng.integers(*config.extra_buildings, endpoint=True)):
        plans = _draw_extra_building(config, rng)
        motion = place(
            _corners(plans),
            about=_middle(plans),
            placed=[_corners(others) for others in buildings],
            centre=_middle(buildings[0]),
            radius=config.radius,
            rng=rng,
        )
        buildings.append([move_plan(plan, motion) for plan in plans])
    return buildings


def _draw_extra_building(config: CityConfig, rng: np.random.Generator) -> list[Plan]:
    """Draws a ground floor and upper floors that fit in its box."""
    num_storeys = rng.integers(*config.extra_storeys, endpoint=True)
    plans = [draw_plan(config.floor, rng) for _ in range(num_storeys)]
    upper = [fit_plan(plan, plans[0], config.floor.stale_width) for plan in plans[1:]]
    return [plans[0], *upper]


def _corners(plans: Sequence[Plan]) -> np.ndarray:
    """Returns the end points of all planes of a building, float[n, 2]."""
    return np.concatenate([plan.ends for plan in plans]).reshape(-1, 2)


def _middle(plans: Sequence[Plan]) -> np.ndarray:
    """Returns the mean xy of the floor nodes of a building, float[2]."""
    return np.mean([plan.centre.mean(axis=0) for plan in plans], axis=0)


def _building(plans: Sequence[Plan], merged: Sequence[Plan], heights: np.ndarray) -> Building:
    """Returns a building of merged rooms whose floor nodes are where they were before."""
    storeys = [
        storey_of(without_removed(after))._replace(centre=before.centre.mean(axis=0))
        for before, after in zip(plans, merged, strict=True)
    ]
    return Building(tuple(storeys), tuple(heights.tolist()))


def _proximity(
    buildings: Sequence[Sequence[Plan]],
    merged: Sequence[Sequence[Plan]],
    heights: Sequence[np.ndarray],
) -> np.ndarray:
    """Returns the proximity edges of a city, pairs of the planes that merging leaves, int[e, 2].

    Source: the authors' graphs. Near planes are joined before rooms merge, and merging joins those
    that come into one room or wall; in further buildings all planes of a room or wall are joined.
    """
    plans = list(chain(*buildings))
    adjacency = _nearest(
        raised([plan.ends.mean(axis=1) for plan in plans], np.concatenate(heights))
    )
    first = 0
    for index, (before, after) in enumerate(zip(plans, chain(*merged), strict=True)):
        own = slice(first, first := first + len(before.room))
        in_base_building = index < len(buildings[0])
        adjacency[own, own] |= _sharing(after) & ~(in_base_building & _sharing(before))
    kept = np.concatenate([after.room for after in chain(*merged)]) >= 0
    return np.argwhere(np.triu(adjacency[kept][:, kept], 1))


def _nearest(position: np.ndarray) -> np.ndarray:
    """Returns the symmetric adjacency, bool[p, p], of the union of 10-nearest-neighbour lists."""
    squared = ((position[:, None] - position[None]) ** 2).sum(axis=-1)
    np.fill_diagonal(squared, np.inf)
    # A plane sorts itself last, so that at most ten others means all of them.
    nearest = np.argsort(squared, axis=1, kind="stable")[:, : min(NEIGHBOURS, len(position) - 1)]
    adjacency = np.zeros(squared.shape, bool)
    np.put_along_axis(adjacency, nearest, True, axis=1)
    return adjacency | adjacency.T


def _sharing(plan: Plan) -> np.ndarray:
    """Returns which planes, bool[p, p], share a room or a wall."""
    sharing = plan.room[:, None] == plan.room
    one, other = plan.wall[plan.wall[:, 0] >= 0].T
    sharing[one, other] = sharing[other, one] = True
    return sharing
