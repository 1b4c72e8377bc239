"""Scenes of three levels from floors: the floors, buildings and cities stacked from them.

Floors are dealt to train, validation and test by building before anything is stacked, and a city
takes its second building from the part of its first, so that no floor is in two parts, at whatever
level. The same seed gives the same parts at every level. Floors of fewer than five buildings are
all for test.

Source: paper, Sec. "Datasets" (M-F, M-B, M-C), and the settings that the authors published: two
identical storeys 4 m apart; a city adds one building of one or two identical storeys.
Differs: their limits on the size of a floor, 200 nodes for a building and 150 for a city, count
doors, windows and helper surfaces; `MAX_NODES` counts the nodes of the floor's own graph. It was
chosen from the paper's table: the limits bring the mean floor from 95 nodes to 79 and 63.
"""

from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.data.buildings import Building, Storey, city_graph, move, outline, place
from sg3d_jax.data.splits import split_groups
from sg3d_jax.data.watching import watched
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import BUILDING, CITY, FLOOR, ROOM

STOREY_HEIGHT: Final = 4.0  # metres
NUM_STOREYS: Final = 2
MAX_EXTRA_STOREYS: Final = 2
RADIUS: Final = 20.0  # metres, of the disc that the second building of a city is placed in
MAX_SHIFT: Final = 2.0  # metres that it stands higher or lower than the first
MAX_NODES: Final = MappingProxyType({BUILDING: 110, CITY: 80})  # of a floor that is stacked


class Floor(NamedTuple):
    """A floor to make scenes of."""

    building: str  # floors of one building go to one part
    origin: str  # the floor's own name
    storey: Storey  # its geometry
    rooms: tuple[str | None, ...] = ()  # what its rooms are called, if anything is known


class Floors(NamedTuple):
    """The floors of a file."""

    floors: list[Floor]  # in its order
    left_out: list[str]  # a sentence for each floor that is not among them


class Scene(NamedTuple):
    """A scene and what it is made of."""

    graph: SceneGraph  # complete, on the host
    origin: str  # names of the floors in it
    buildings: tuple[tuple[Floor, int], ...]  # of each the floor that is stacked, and how often


class Imported(NamedTuple):
    """Scenes, the part of each and the floors that it is made of."""

    graphs: list[SceneGraph]  # complete host graphs
    parts: list[str]  # "train", "validation" or "test"
    origins: list[str]  # names of the floors in each
    names: list[dict[int, str]]  # of rooms, floors and buildings of each, by row


def floor_scenes(floors: Sequence[Floor], seed: int = 0, rotate: bool = True) -> Imported:
    """Makes a scene of every floor (as M-F, P-F).

    Args:
      floors: at least one.
      seed: of the parts and the rotations.
      rotate: whether every scene is turned by a uniform angle.

    Raises:
      ValueError: there are no floors, or all are too large.
    """

    def scene(index: int, pool: np.ndarray, rng: np.random.Generator) -> Scene:
        base = _turned(floors[index].storey, rotate, rng)
        graph = city_graph([Building((base,), (0.0,))], FLOOR)
        return Scene(graph, floors[index].origin, ((floors[index], 1),))

    return _scenes(floors, seed, FLOOR, scene)


def building_scenes(floors: Sequence[Floor], seed: int = 0, rotate: bool = True) -> Imported:
    """Makes a building of two storeys of every floor that is not too large (as M-B, P-B).

    The arguments are those of `floor_scenes`.

    Raises:
      ValueError: there are no floors, or all are too large.
    """

    def scene(index: int, pool: np.ndarray, rng: np.random.Generator) -> Scene:
        base = stacked(_turned(floors[index].storey, rotate, rng), NUM_STOREYS)
        origin = f"{floors[index].origin} (x {NUM_STOREYS})"
        return Scene(city_graph([base], BUILDING), origin, ((floors[index], NUM_STOREYS),))

    return _scenes(floors, seed, BUILDING, scene)


def city_scenes(floors: Sequence[Floor], seed: int = 0, rotate: bool = True) -> Imported:
    """Makes a city of every floor that is not too large (as M-C, P-C).

    Beside a building of two such storeys stands one of one or two storeys of another floor of the
    same part. The arguments are those of `floor_scenes`.

    Raises:
      ValueError: a part has but one floor.
    """

    def scene(index: int, pool: np.ndarray, rng: np.random.Generator) -> Scene:
        others = pool[pool != index]
        if not len(others):
            raise ValueError(f"{floors[index].origin} is alone in its part, expected more floors")
        other = floors[rng.choice(others)]
        num_extra = int(rng.integers(1, MAX_EXTRA_STOREYS, endpoint=True))
        base = stacked(_turned(floors[index].storey, rotate, rng), NUM_STOREYS)
        extra = _beside(base, other.storey, num_extra, rng)
        origin = f"{floors[index].origin} (x {NUM_STOREYS}) and {other.origin} (x {num_extra})"
        made_of = ((floors[index], NUM_STOREYS), (other, num_extra))
        return Scene(city_graph([base, extra], CITY), origin, made_of)

    return _scenes(floors, seed, CITY, scene)


LEVELS: Final = MappingProxyType(
    {"floor": floor_scenes, "building": building_scenes, "city": city_scenes}
)


def num_nodes(storey: Storey) -> int:
    """Returns the number of nodes of the graph of one floor."""
    return len(storey.plane) + len(storey.wall_centre) + len(storey.room_centre) + 1


def stacked(storey: Storey, num_storeys: int, lift: float = 0.0) -> Building:
    """Returns a building of identical storeys, the lowest at the height `lift`, metres."""
    heights = tuple(lift + STOREY_HEIGHT * level for level in range(num_storeys))
    return Building((storey,) * num_storeys, heights)


def _scenes(
    floors: Sequence[Floor],
    seed: int,
    level: int,
    scene: Callable[[int, np.ndarray, np.random.Generator], Scene],
) -> Imported:
    """Makes a scene of each floor that fits, given the floors that fit of the same part."""
    if not floors:
        raise ValueError("there are no floors, expected at least one")
    parts = np.array(split_groups([floor.building for floor in floors], seed))
    size = np.array([num_nodes(floor.storey) for floor in floors])
    fits = size <= MAX_NODES.get(level, size.max())
    if not fits.any():
        raise ValueError(
            f"all floors have more than {MAX_NODES[level]} nodes, expected smaller ones"
        )
    made = [
        scene(index, np.flatnonzero(fits & (parts == parts[index])), _generator(seed, index))
        for index in watched(np.flatnonzero(fits).tolist(), "graphs")
    ]
    graphs, origins = [one.graph for one in made], [one.origin for one in made]
    return Imported(graphs, parts[fits].tolist(), origins, [_names(one) for one in made])


def _names(scene: Scene) -> dict[int, str]:
    """Returns what rooms, floors and buildings are called, by row."""
    storeys = [floor for floor, count in scene.buildings for _ in range(count)]
    called = {
        ROOM: [name for floor in storeys for name in floor.rooms or [None] * _num_rooms(floor)],
        FLOOR: [floor.origin for floor in storeys],
        BUILDING: [floor.building for floor, _ in scene.buildings],
    }
    label = scene.graph.nodes.label
    return {
        row: name
        for concept, names in called.items()
        for row, name in zip(np.flatnonzero(label == concept).tolist(), names, strict=False)
        if name
    }


def _num_rooms(floor: Floor) -> int:
    return len(floor.storey.room_centre)


def _generator(seed: int, index: int) -> np.random.Generator:
    """Returns the source of randomness of one scene, so that it depends on no other."""
    return np.random.default_rng([seed, index])


def _turned(storey: Storey, rotate: bool, rng: np.random.Generator) -> Storey:
    """Turns a storey about its centre by a random angle."""
    if not rotate:
        return storey
    return move(storey, rng.uniform(0, 2 * np.pi), storey.centre, np.zeros(2))


def _beside(base: Building, storey: Storey, num_storeys: int, rng: np.random.Generator) -> Building:
    """Returns another building, turned and placed at random where it keeps clear of the first."""
    placed = [outline(base.storeys[:1])]
    centre = base.storeys[0].centre
    motion = place(outline([storey]), storey.centre, placed, centre, RADIUS, rng)
    return stacked(move(storey, *motion), num_storeys, rng.uniform(-MAX_SHIFT, MAX_SHIFT))
