"""Replays: how a robot's map of a complete graph comes about, step by step.

The robot goes from room to room, each time to the nearest that it has not been in. While it is in
a room, planes of it come into view one by one, first in part, then whole; each time that they are
seen their noise is averaged out some more. Planes on one line are mapped apart, then taken for
one. What it takes for planes (furniture, leaves of doors) comes and goes. If its odometry drifts,
what it maps in the later half of its way is off, until it is back where it began and the loop
closes. Walls may be gone, or new, when it comes back to them.

Which planes are seen at all, and how, is drawn as for views (`robot`), and the truth of the map
follows by their rules at every step.

Source: drift is that of odometries of LiDARs on the benchmark of KITTI, 0.5 to 2 % of the way and
0.001 to 0.01 degrees a metre.
Differs: `LOOP` turns more, since ways indoors are short. Where doors are is not known in our
graphs, so the way leads through walls.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.data.robot import LEAST_SIDES, surfaces_of, truth_of
from sg3d_jax.data.robot_effects import (
    CLIMB,
    WANDER,
    RobotConfig,
    SeenPlanes,
    displaced,
    double,
    litter,
    miss,
    on_one_line,
    parts_of,
    seen_ends,
    seen_whole,
    split,
    taken_for_one,
    turned,
    visit,
)
from sg3d_jax.scene.changes import Changes
from sg3d_jax.scene.graph import SceneGraph, features_of, make_graph, ontology_of, parts_first
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PLANE, ROOM, WALL

LEAST_STEPS: Final = 2  # in a room: what comes into view in part is whole a step later
_TAG: Final = 16  # keeps our random numbers apart from those of generators and views


@dataclass(frozen=True)
class ReplayConfig:
    """How a map comes about. Without arguments all is seen as it is, room by room.

    Attributes:
      seen: as for a view, but for what time does: a plane of which an end is not seen is whole a
        step later; noise is that of seeing a plane once; planes are taken for one a step after both
        are mapped, also the parts of one that is split.
      steps_a_room: range of the steps that a visit of a room takes.
      clutter_stays: range of the steps that clutter is there.
      drift: metres by which what is mapped is off, a metre of the later half of the way.
      turning: degrees by which it is turned, likewise.
      taken_down: number of the walls that are gone when the robot comes back.
      built: number of the walls that are there only when it comes back.

    Raises:
      ValueError: a range is empty or too low, or a number is negative.
    """

    seen: RobotConfig = field(default_factory=RobotConfig)
    steps_a_room: tuple[int, int] = (2, 4)
    clutter_stays: tuple[int, int] = (3, 12)
    drift: float = 0.0
    turning: float = 0.0
    taken_down: int = 0
    built: int = 0

    def __post_init__(self) -> None:
        """Refuses settings that no replay can be drawn with."""
        for name, least in (("steps_a_room", LEAST_STEPS), ("clutter_stays", 1)):
            low, high = getattr(self, name)
            if not least <= low <= high:
                raise ValueError(
                    f"{name} is ({low}, {high}), expected {least} <= least <= greatest"
                )
        for name in ("drift", "turning", "taken_down", "built"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name):g}, expected zero or more")

    @property
    def drifts(self) -> bool:
        """Whether there is a loop to close."""
        return self.drift > 0 or self.turning > 0


DRIVE: Final = ReplayConfig(
    RobotConfig(
        shortened=1.0,
        shortened_by=(0.1, 0.6),
        both_ends=0.3,
        merged=0.5,
        position_noise=0.05,
        heading_noise=2.0,
        height_noise=0.1,
        clutter=0.1,
    )
)
LOOP: Final = replace(DRIVE, drift=0.02, turning=0.05)
WORKS: Final = replace(DRIVE, taken_down=1, built=1)

REPLAYS: Final[Mapping[str, ReplayConfig]] = MappingProxyType(
    {"clean": ReplayConfig(), "drive": DRIVE, "loop": LOOP, "works": WORKS}
)


class Step(NamedTuple):
    """What a map is told at once, and what it then shows."""

    changes: Changes  # of its planes, whose ids are numbers
    ids: tuple[int, ...]  # of all planes that it then has
    truth: SceneGraph  # host graph: these planes, in order, and what of the truth they show
    rows: np.ndarray  # int[m], of each node behind the planes its row in the complete graph


class _Work(NamedTuple):
    """A wall that is taken down or built, and the step at which the robot sees it."""

    wall: int  # its node
    planes: np.ndarray  # int[p], nodes, of no other wall
    rooms: tuple[int, int]  # nodes, on its sides
    is_built: bool
    step: int = 0


class _Drive(NamedTuple):
    """The visits of rooms, v of them, that take t steps in all."""

    visits: np.ndarray  # int[v], nodes
    begin: np.ndarray  # int[v], first step of each
    length: np.ndarray  # int[v], steps that it takes
    way: np.ndarray  # float[t], metres that the robot has come at each step
    pivot: np.ndarray  # float[2], where it is half way
    closure: int  # step at which the loop closes; t if it does not
    works: tuple[_Work, ...]


class _Mapped(NamedTuple):
    """When and how each of k planes is mapped, clutter last."""

    planes: SeenPlanes  # whole, without noise
    first: np.ndarray  # int[k], step at which it comes into view
    last: np.ndarray  # int[k], step at which it is gone
    low: np.ndarray  # float[k], where what is seen of it first begins, metres from its middle
    high: np.ndarray  # float[k], where that ends
    views: np.ndarray  # int[t, k], how often it has been seen
    noise: np.ndarray  # float[k, v, 4], offset and heading after so many views, in deviations
    links: np.ndarray  # int[l, 2], planes that are taken for one
    heading: float  # radians, in which the map drifts


def replay(graph: SceneGraph, config: ReplayConfig, seed: int, index: int) -> list[Step]:
    """Draws how a robot comes to its map of a complete graph.

    Args:
      graph: unpadded host graph of the paper's concepts; its proximity edges are not looked at.
      config: how the map comes about.
      seed: names the data set.
      index: names the graph in it: the same (config, seed, index) gives the same.

    Returns:
      Steps in order, some of which change nothing. Where nothing is amiss, the truth of the last is
      the graph itself.

    Raises:
      ValueError: the graph has other concepts or no room, or nothing of it is seen.
    """
    _check_concepts(graph, index)
    rng = np.random.default_rng([seed, index, _TAG])
    planes = seen_whole(graph)
    for effect in (visit, miss, split, double):
        planes = effect(planes, config.seen, graph, rng)
    if not (graph.nodes.label == ROOM).any() or not len(planes.width):
        raise ValueError(f"graph {index}: nothing is seen of it, expected planes of a room")
    num_real = len(planes.width)
    planes = litter(planes, config.seen, graph, rng)
    room = _rooms_of(graph, planes)
    drive = _driven(graph, planes, room, config, rng)
    mapped = _mapped(graph, planes, num_real, room, drive, config, rng)
    steps: list[Step] = []
    known: dict[int, tuple[float, ...]] = {}
    for step in range(len(drive.way)):
        seen, ids, heir = _map_at(mapped, drive, config, step)
        surfaces = surfaces_of(seen.stretches, len(ids))
        complete = _complete_at(graph, mapped, drive, config, step)
        truth, rows = truth_of(complete, seen, seen.stretches, surfaces)
        changes, known = _changes(known, seen, ids, heir)
        steps.append(Step(changes, tuple(ids), truth, rows))
    return steps


def _check_concepts(graph: SceneGraph, index: int) -> None:
    """Refuses a graph of concepts of which we do not know how a map comes about."""
    if ontology_of(graph) != PAPER_ONTOLOGY:
        held = ", ".join(ontology_of(graph).names)
        raise ValueError(f"graph {index}: its concepts are {held}, expected the paper's")


def _rooms_of(graph: SceneGraph, planes: SeenPlanes) -> np.ndarray:
    """Returns the room from which each plane is seen, int[k]: its own, else the nearest."""
    label, (part, whole) = graph.nodes.label, parts_first(graph).T
    inside, rooms = label[whole] == ROOM, np.flatnonzero(label == ROOM)
    away = planes.position[:, None] - graph.nodes.position[rooms]
    nearest = rooms[np.argmin(np.linalg.norm(away * [1, 1, CLIMB], axis=-1), axis=1)]
    own = np.full(len(label), -1)
    own[part[inside]] = whole[inside]
    shown = _shown(planes)
    return np.where((shown >= 0) & (own[shown] >= 0), own[shown], nearest)


def _shown(planes: SeenPlanes) -> np.ndarray:
    """Returns the plane of the graph that each plane shows, int[k]; -1 for clutter."""
    shown = np.full(len(planes.width), -1)
    shown[planes.stretches.seen] = planes.stretches.plane
    return shown


def _driven(
    graph: SceneGraph,
    planes: SeenPlanes,
    room: np.ndarray,
    config: ReplayConfig,
    rng: np.random.Generator,
) -> _Drive:
    """Draws the way through the rooms that are seen, then back to the first and to works."""
    rooms = np.unique(room)
    place = graph.nodes.position[rooms] * [1, 1, CLIMB]
    order = rooms[_nearest_first(place, rng)]
    works = _works(graph, planes, rooms, config, rng)
    back = [work.rooms[0] for work in works]
    visits = np.concatenate([order, order[:1] if config.drifts else [], back]).astype(int)
    low, high = config.steps_a_room
    length = rng.integers(low, high, len(visits), endpoint=True)
    begin = np.cumsum(length) - length
    position = graph.nodes.position[visits]
    way = np.cumsum(np.linalg.norm(np.diff(position, axis=0, prepend=position[:1]), axis=1))
    half = int(np.searchsorted(way, way[-1] / 2))
    return _Drive(
        visits,
        begin,
        length,
        np.repeat(way, length),
        position[half, :2],
        int(begin[len(order)]) if config.drifts else int(length.sum()),
        tuple(
            work._replace(step=int(step))
            for work, step in zip(works, begin[len(visits) - len(works) :], strict=True)
        ),
    )


def _nearest_first(place: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns places in the order of a way that goes on to about the nearest, int[r]."""
    order, left = [int(rng.integers(len(place)))], np.ones(len(place), bool)
    while left[order[-1]]:
        left[order[-1]] = False
        away = np.linalg.norm(place - place[order[-1]], axis=1)
        away *= np.exp(rng.normal(0, WANDER, len(place)))
        if left.any():
            order.append(int(np.argmin(np.where(left, away, np.inf))))
    return np.array(order)


def _works(
    graph: SceneGraph,
    planes: SeenPlanes,
    rooms: np.ndarray,
    config: ReplayConfig,
    rng: np.random.Generator,
) -> list[_Work]:
    """Draws walls to take down and to build, no two of one room; as many as there are."""
    label, pairs, shown = graph.nodes.label, parts_first(graph), _shown(planes)
    bounded = pairs[label[pairs[:, 0]] == PLANE]
    of_walls = bounded[label[bounded[:, 1]] == WALL]
    of_rooms = bounded[label[bounded[:, 1]] == ROOM]
    works: list[_Work] = []
    for wall in rng.permutation(np.flatnonzero(label == WALL)).tolist():
        sides = of_walls[of_walls[:, 1] == wall, 0]
        around = np.unique(of_rooms[np.isin(of_rooms[:, 0], sides), 1])
        others = of_rooms[~np.isin(of_rooms[:, 0], sides), 1]
        taken = [room for work in works for room in work.rooms]
        if (
            len(works) < config.taken_down + config.built
            and len(around) == 2
            and np.isin(around, rooms).all()
            and not np.isin(around, taken).any()
            and np.isin(sides, shown).all()
            and np.isin(of_walls[:, 0], sides).sum() == len(sides)
            and all((others == room).sum() >= LEAST_SIDES for room in around)
        ):
            one, other = around.tolist()
            works.append(_Work(wall, sides, (one, other), len(works) >= config.taken_down))
    return works


def _mapped(
    graph: SceneGraph,
    planes: SeenPlanes,
    num_real: int,
    room: np.ndarray,
    drive: _Drive,
    config: ReplayConfig,
    rng: np.random.Generator,
) -> _Mapped:
    """Draws when and how each plane is mapped."""
    size, num_steps = len(planes.width), len(drive.way)
    rooms, visit = np.unique(drive.visits, return_index=True)  # the first of each room
    visit = visit[np.searchsorted(rooms, room)]
    first = drive.begin[visit] + (_turns(room, rng) * (drive.length[visit] - 1)).astype(int)
    last = np.full(size, num_steps)
    stays = rng.integers(*config.clutter_stays, size, endpoint=True)
    last[num_real:] = (first + stays)[num_real:]
    of_works, shown = np.zeros(size, bool), _shown(planes)
    for work in drive.works:
        rows = np.isin(shown, work.planes)
        (first if work.is_built else last)[rows] = work.step
        of_works |= rows
    step = np.arange(num_steps)[:, None]
    here = np.repeat(drive.visits, drive.length)[:, None] == room
    views = np.cumsum(here & (first <= step) & (step < last), axis=0)
    drawn = rng.normal(0, 1, (size, max(1, int(views.max())), 4))
    noise = np.cumsum(drawn, axis=1) / np.arange(1, drawn.shape[1] + 1)[:, None]
    links = np.argwhere(on_one_line(planes, config.seen.merged_gap))
    links = links[rng.random(len(links)) < config.seen.merged]
    links = links[(links < num_real).all(axis=1) & ~of_works[links].any(axis=1)]
    ends, heading = seen_ends(planes, config.seen, rng), rng.uniform(0, 2 * np.pi)
    return _Mapped(planes, first, last, *ends, views, noise, links, heading)


def _turns(room: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns when the turn of each plane among those of its room comes, float[k], 0 to below 1."""
    order = np.lexsort((rng.random(len(room)), room))
    _, begin, place, count = np.unique(
        room[order], return_index=True, return_inverse=True, return_counts=True
    )
    turn = np.empty(len(room))
    turn[order] = (np.arange(len(room)) - begin[place]) / count[place]
    return turn


def _map_at(
    mapped: _Mapped, drive: _Drive, config: ReplayConfig, step: int
) -> tuple[SeenPlanes, list[int], dict[int, int]]:
    """Returns the planes of the map at a step, their ids, and the id that each plane goes by."""
    rows = np.flatnonzero((mapped.first <= step) & (step < mapped.last))
    half, partly = mapped.planes.width[rows] / 2, mapped.first[rows] == step
    low = np.where(partly, mapped.low[rows], -half)
    high = np.where(partly, mapped.high[rows], half)
    seen = parts_of(mapped.planes, rows, low, high)
    noise = mapped.noise[rows, np.maximum(mapped.views[step, rows], 1) - 1]
    seen = displaced(seen, config.seen, noise[:, :3], noise[:, 3])
    if step < drive.closure and config.drifts:
        way = drive.way[mapped.first[rows]]
        position, angle = _drifted(seen.position, way, mapped, drive, config)
        seen = seen._replace(position=position, normal=turned(seen.normal, angle))
    place = np.full(len(mapped.first), -1)
    place[rows] = np.arange(len(rows))
    links = place[mapped.links[(mapped.first[mapped.links] < step).all(axis=1)]]
    seen, group = taken_for_one(seen, links[(links >= 0).all(axis=1)])
    eldest = np.lexsort((rows, mapped.first[rows], group))
    ids = rows[eldest[np.unique(group[eldest], return_index=True)[1]]]
    return seen, ids.tolist(), dict(zip(rows.tolist(), ids[group].tolist(), strict=True))


def _drifted(
    position: np.ndarray, way: np.ndarray, mapped: _Mapped, drive: _Drive, config: ReplayConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Returns where drift puts what is mapped after so many metres, and by how much it turns it."""
    beyond = np.maximum(way - drive.way[-1] / 2, 0)
    angle = np.radians(config.turning) * beyond
    aside = np.array([np.cos(mapped.heading), np.sin(mapped.heading)])
    moved = drive.pivot + turned(position[:, :2] - drive.pivot, angle)
    moved += config.drift * beyond[:, None] * aside
    moved = np.where(beyond[:, None] > 0, moved, position[:, :2])  # bit for bit where it was
    return np.column_stack([moved, position[:, 2]]), angle


def _complete_at(
    graph: SceneGraph, mapped: _Mapped, drive: _Drive, config: ReplayConfig, step: int
) -> SceneGraph:
    """Returns the complete graph as it is at a step, and where the map has it by its drift."""
    for work in drive.works:
        if (step < work.step) == work.is_built:
            graph = _without_wall(graph, work)
    if step >= drive.closure or not config.drifts:
        return graph
    way = np.full(len(graph.nodes.label), np.nan)
    shown = _shown(mapped.planes)
    way[shown[shown >= 0]] = drive.way[mapped.first[shown >= 0]]
    part, whole = parts_first(graph).T
    for kind in np.unique(graph.nodes.label[whole]):
        known = (graph.nodes.label[whole] == kind) & ~np.isnan(way[part])
        count = np.bincount(whole[known], minlength=len(way))
        total = np.bincount(whole[known], way[part[known]], len(way))
        way[count > 0] = (total / np.maximum(count, 1))[count > 0]
    position, _ = _drifted(graph.nodes.position, np.nan_to_num(way), mapped, drive, config)
    return graph._replace(nodes=graph.nodes._replace(position=position))


def _without_wall(graph: SceneGraph, work: _Work) -> SceneGraph:
    """Returns a graph in which the rooms beside a wall are one, in the middle of its planes."""
    one, other = work.rooms
    pairs = parts_first(graph)
    pairs = pairs[~np.isin(pairs[:, 0], [*work.planes, other]) & (pairs[:, 1] != work.wall)]
    pairs[pairs == other] = one
    position = graph.nodes.position.copy()
    around = position[pairs[pairs[:, 1] == one, 0], :2]
    position[one, :2] = (around.min(axis=0) + around.max(axis=0)) / 2
    return make_graph(
        graph.nodes.label,
        position,
        **features_of(graph),
        part_of=pairs,
        ontology=ontology_of(graph),
    )


def _changes(
    known: Mapping[int, tuple[float, ...]], seen: SeenPlanes, ids: list[int], heir: dict[int, int]
) -> tuple[Changes, dict[int, tuple[float, ...]]]:
    """Returns what is other than it was, and what is known now, by id."""
    normal = np.pad(seen.normal, [(0, 0), (0, 1)])
    table = np.column_stack([seen.position, normal, seen.width])
    now = dict(zip(ids, map(tuple, table.tolist()), strict=True))
    rows = [row for row, name in enumerate(ids) if known.get(name) != now[name]]
    gone = [name for name in known if name not in now]
    changes = Changes(
        observed=make_graph(
            np.full(len(rows), PLANE), seen.position[rows], normal[rows], seen.width[rows]
        )
        if rows
        else None,
        ids=tuple(ids[row] for row in rows),
        removed=tuple(name for name in gone if name not in heir),
        merged=tuple((name, heir[name]) for name in gone if name in heir),
    )
    return changes, now
