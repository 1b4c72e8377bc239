"""What a robot does not see as it is: the effects that make up a view of a graph, one by one.

Each is a function (planes, settings, complete graph, source of randomness) -> planes, and `EFFECTS`
is their order. Planes carry with them what of the complete graph they show, and where.

Source: ten recordings of S-Graphs that its authors published (snt-arg/graph_matching): 3 to 8 of 14
to 22 planes bound several rooms, planes are up to 13.8 m wide, and some belong to nothing.
Differs: they do not tell how wide the gaps of doors, furniture and doubled planes are; our ranges
are those of doors (0.7 to 1 m) and of what stands before walls.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sg3d_jax.data.robot_things import ThingsConfig, check_strengths, is_surface
from sg3d_jax.scene.graph import SceneGraph, ontology_of, parts_first
from sg3d_jax.scene.ontology import Ontology

LEAST_SEEN: Final = 0.1  # metres of a plane, or half of it, that count as having seen it
LEAST_PART: Final = 0.2  # metres of each part of a plane that is cut in two
COPLANAR_ANGLE: Final = 1.0  # degrees between planes that are taken for one,
COPLANAR_OFFSET: Final = 0.05  # metres between their lines,
COPLANAR_HEIGHT: Final = 0.5  # and metres between their heights
CLIMB: Final = 4.0  # a room so much higher is as far to the robot as one this many times as far
WANDER: Final = 0.3  # standard deviation of the logarithm of the way to a room
FIRM_WIDTH: Final = 4.0  # metres of a plane beyond which its heading is the better known
CLUTTER_HEADING: Final = 5.0  # degrees, standard deviation from the nearest wall's or across it
ALONG_THE_WALL: Final = 0.6  # share of the clutter that faces as the nearest wall does
_SHARES: Final = (
    "unvisited",
    "missing",
    "shortened",
    "both_ends",
    "merged",
    "split",
    "doubled",
    "clutter",
)
_LENGTHS: Final = ("merged_gap", "position_noise", "heading_noise", "height_noise")
_RANGES: Final = ("shortened_by", "split_gap", "doubled_offset", "clutter_width")


@dataclass(frozen=True)
class RobotConfig:
    """What a robot does not see as it is. Without arguments it sees the graph as it is.

    Shares are chances, each plane on its own; a (least, greatest) range is drawn from uniformly;
    noise is normal, given by its standard deviation.

    Attributes:
      unvisited: share of the rooms that the robot has not been in, those farthest from where it
        began. Their planes are not seen.
      missing: share of the planes that are not seen.
      shortened: share of the planes of which an end is not seen.
      shortened_by: range of the share of its width that such a plane loses.
      both_ends: share of these that lose it at both ends, parted at random.
      merged: share of the gaps between planes on one line that are overlooked, so that the planes
        are taken for one.
      merged_gap: widest such gap, metres.
      split: share of the planes that a door or something before them cuts in two.
      split_gap: range of the width of what cuts them, metres.
      doubled: share of the planes that are mapped a second time, 40 % to all of their width.
      doubled_offset: range of how far in front or behind, metres.
      position_noise: of x and of y, metres.
      heading_noise: degrees; less for planes wider than `FIRM_WIDTH`, whose ends stray no farther
        than those of a plane so wide.
      height_noise: of z, metres.
      clutter: number of planes that belong to nothing, as a share of those seen.
      clutter_width: range of their width, metres.
      things: what is seen otherwise than it is of doors, objects and the like.

    Raises:
      ValueError: a share is not in 0..1, a range is empty, or a length is negative.
    """

    unvisited: float = 0.0
    missing: float = 0.0
    shortened: float = 0.0
    shortened_by: tuple[float, float] = (0.1, 0.4)
    both_ends: float = 0.0
    merged: float = 0.0
    merged_gap: float = 1.0
    split: float = 0.0
    split_gap: tuple[float, float] = (0.1, 1.0)
    doubled: float = 0.0
    doubled_offset: tuple[float, float] = (0.02, 0.1)
    position_noise: float = 0.0
    heading_noise: float = 0.0
    height_noise: float = 0.0
    clutter: float = 0.0
    clutter_width: tuple[float, float] = (0.2, 1.2)
    things: ThingsConfig = ThingsConfig()

    def __post_init__(self) -> None:
        """Refuses settings that nothing can be seen with."""
        check_strengths(self, _SHARES, _LENGTHS)
        for name in _RANGES:
            low, high = getattr(self, name)
            most = 1 if name == "shortened_by" else np.inf
            if not 0 <= low <= high <= most:
                held = f"{name} is ({low:g}, {high:g})"
                raise ValueError(f"{held}, expected 0 <= least <= greatest <= {most:g}")


class Stretches(NamedTuple):
    """What of a complete graph lies where on the seen planes, sorted by the latter; `s` of them."""

    seen: np.ndarray  # int[s], which seen plane
    plane: np.ndarray  # int[s], node of the complete graph, a plane that is seen there
    low: np.ndarray  # float[s], where it begins, metres along the seen plane from its middle
    high: np.ndarray  # float[s], where it ends


class SeenPlanes(NamedTuple):
    """Planes as they are seen; `k` of them, metres."""

    position: np.ndarray  # float[k, 3]
    normal: np.ndarray  # float[k, 2], unit
    width: np.ndarray  # float[k]
    stretches: Stretches  # on them

    @property
    def along(self) -> np.ndarray:
        """The direction in which each runs, float[k, 2], unit."""
        return along(self.normal)


def room_label(ontology: Ontology) -> int:
    """Returns which concept a surface is part of one of: that of rooms.

    Raises:
      ValueError: what is seen of graphs of such concepts we do not know: surfaces, which have a
        normal and a width, are not the lowest of them, or are not part of one room each.
    """
    surfaces = np.flatnonzero(ontology.is_observed & ontology.has("normal"))
    rooms = np.flatnonzero(ontology.has_one_whole[0])
    if surfaces.tolist() != [0] or not ontology.has("width")[0] or len(rooms) != 1:
        held = ", ".join(ontology.names)
        raise ValueError(
            f"its concepts are {held}, expected planes with a normal and a width as the lowest, "
            "each part of one room, and no others with a normal"
        )
    return int(rooms[0])


def seen_whole(graph: SceneGraph) -> SeenPlanes:
    """Returns the planes of a complete graph, all of them seen whole."""
    rows = np.flatnonzero(is_surface(graph))
    width = graph.nodes.width[rows]
    whole = Stretches(np.arange(len(rows)), rows, -width / 2, width / 2)
    return SeenPlanes(graph.nodes.position[rows], graph.nodes.normal[rows, :2], width, whole)


def visit(
    planes: SeenPlanes, config: RobotConfig, graph: SceneGraph, rng: np.random.Generator
) -> SeenPlanes:
    """Drops the planes of the rooms that are far from where the robot began; all are whole yet."""
    rooms = np.flatnonzero(graph.nodes.label == room_label(ontology_of(graph)))
    num_visited = max(1, round((1 - config.unvisited) * len(rooms)))
    if num_visited >= len(rooms):
        return planes
    place = graph.nodes.position[rooms] * [1, 1, CLIMB]
    way = np.linalg.norm(place - place[rng.integers(len(rooms))], axis=1)
    way *= np.exp(rng.normal(0, WANDER, len(rooms)))
    visited, others = np.split(rooms[np.argsort(way)], [num_visited])
    part, whole = parts_first(graph).T
    inside = np.setdiff1d(part[np.isin(whole, others)], part[np.isin(whole, visited)])
    return _where(planes, ~np.isin(planes.stretches.plane, inside))


def miss(
    planes: SeenPlanes, config: RobotConfig, graph: SceneGraph, rng: np.random.Generator
) -> SeenPlanes:
    """Drops planes."""
    return _where(planes, rng.random(len(planes.width)) >= config.missing)


def _shorten(
    planes: SeenPlanes, config: RobotConfig, graph: SceneGraph, rng: np.random.Generator
) -> SeenPlanes:
    """Takes away one end of planes, or both."""
    return parts_of(planes, np.arange(len(planes.width)), *seen_ends(planes, config, rng))


def seen_ends(
    planes: SeenPlanes, config: RobotConfig, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Returns where what is seen of each plane begins and ends, float[k], from its middle."""
    size = len(planes.width)
    lost = rng.uniform(*config.shortened_by, size) * (rng.random(size) < config.shortened)
    at_left = np.where(
        rng.random(size) < config.both_ends, rng.random(size), rng.integers(0, 2, size)
    )
    low = planes.width * (-0.5 + lost * (1 - at_left))
    high = planes.width * (0.5 - lost * at_left)
    return low, high


def _merge(
    planes: SeenPlanes, config: RobotConfig, graph: SceneGraph, rng: np.random.Generator
) -> SeenPlanes:
    """Makes one plane of those that lie on one line with small gaps between them."""
    if not config.merged:
        return planes
    links = np.argwhere(on_one_line(planes, config.merged_gap))
    return taken_for_one(planes, links[rng.random(len(links)) < config.merged])[0]


def taken_for_one(planes: SeenPlanes, links: np.ndarray) -> tuple[SeenPlanes, np.ndarray]:
    """Makes one plane of those that are linked, directly or through others.

    It faces as the widest of them does and lies in the middle of their lines and heights.

    Args:
      planes: k of them.
      links: int[l, 2], pairs of them.

    Returns:
      The planes, in the order of the first of each, and which of them each has become, int[k].
    """
    size = len(planes.width)
    adjacency = coo_array((np.ones(len(links)), tuple(links.T)), (size, size))
    num_merged, merged = connected_components(adjacency, directed=False)
    widest = np.lexsort((-planes.width, merged))
    widest = widest[np.unique(merged[widest], return_index=True)[1]]
    normal, origin = planes.normal[widest], planes.position[widest]
    offset = planes.position - origin[merged]
    place = np.sum(offset[:, :2] * along(normal)[merged], axis=1)
    across = np.sum(offset[:, :2] * normal[merged], axis=1)
    low, high = np.full(num_merged, np.inf), np.full(num_merged, -np.inf)
    np.minimum.at(low, merged, place - planes.width / 2)
    np.maximum.at(high, merged, place + planes.width / 2)
    middle, count = (low + high) / 2, np.bincount(merged)
    position = origin + np.column_stack(
        [
            middle[:, None] * along(normal)
            + (np.bincount(merged, across) / count)[:, None] * normal,
            np.bincount(merged, offset[:, 2]) / count,
        ]
    )
    seen, plane, first, last = planes.stretches
    group, shift = merged[seen], place[seen] - middle[merged[seen]]
    order = np.lexsort((first + shift, group))
    stretches = Stretches(group, plane, first + shift, last + shift)
    stretches = Stretches(*(field[order] for field in stretches))
    return SeenPlanes(position, normal, high - low, stretches), merged


def on_one_line(planes: SeenPlanes, gap: float) -> np.ndarray:
    """Returns which pairs of planes, bool[k, k] above the diagonal, may be taken for one."""
    normal, width, height = planes.normal, planes.width, planes.position[:, 2]
    across = planes.position[:, :2] @ normal.T  # of the first, along the normal of the second
    level = np.abs(across - np.diag(across)) <= COPLANAR_OFFSET
    found = np.triu(level & level.T, 1)
    one, other = np.nonzero(found)
    near = np.sum(normal[one] * normal[other], axis=1) >= np.cos(np.radians(COPLANAR_ANGLE))
    near &= np.abs(height[one] - height[other]) <= COPLANAR_HEIGHT
    apart = np.linalg.norm(planes.position[one, :2] - planes.position[other, :2], axis=1)
    near &= apart - (width[one] + width[other]) / 2 < gap
    found[one, other] = near
    return found


def split(
    planes: SeenPlanes, config: RobotConfig, graph: SceneGraph, rng: np.random.Generator
) -> SeenPlanes:
    """Cuts planes in two, with a gap between the parts; those too short for it stay whole."""
    size = len(planes.width)
    gap = rng.uniform(*config.split_gap, size)
    room = planes.width - gap - 2 * LEAST_PART
    cut = (rng.random(size) < config.split) & (room >= 0)
    end = planes.width / 2
    first = np.where(cut, -end + LEAST_PART + rng.random(size) * room, end)  # where the gap begins
    row = np.concatenate([np.arange(size), np.flatnonzero(cut)])
    low = np.concatenate([-end, (first + gap)[cut]])
    high = np.concatenate([first, end[cut]])
    order = np.argsort(row, kind="stable")
    return parts_of(planes, row[order], low[order], high[order])


def double(
    planes: SeenPlanes, config: RobotConfig, graph: SceneGraph, rng: np.random.Generator
) -> SeenPlanes:
    """Puts a copy of a stretch of planes a little in front of them or behind."""
    size = len(planes.width)
    twice = np.flatnonzero(rng.random(size) < config.doubled)
    width = planes.width[twice] * rng.uniform(0.4, 1.0, len(twice))
    middle = (planes.width[twice] - width) * rng.uniform(-0.5, 0.5, len(twice))
    row = np.concatenate([np.arange(size), twice])
    low = np.concatenate([-planes.width / 2, middle - width / 2])
    high = np.concatenate([planes.width / 2, middle + width / 2])
    offset = rng.uniform(*config.doubled_offset, len(twice)) * rng.choice([-1, 1], len(twice))
    order = np.argsort(row, kind="stable")
    doubled = parts_of(planes, row[order], low[order], high[order])
    offset = np.concatenate([np.zeros(size), offset])[order]
    doubled.position[:, :2] += offset[:, None] * doubled.normal
    return doubled


def _blur(
    planes: SeenPlanes, config: RobotConfig, graph: SceneGraph, rng: np.random.Generator
) -> SeenPlanes:
    """Adds noise to positions, headings and heights."""
    size = len(planes.width)
    heading = rng.normal(0, 1, size)
    return displaced(planes, config, rng.normal(0, 1, (size, 3)), heading)


def displaced(
    planes: SeenPlanes, config: RobotConfig, offset: np.ndarray, heading: np.ndarray
) -> SeenPlanes:
    """Moves and turns planes by so many standard deviations of the noise.

    Args:
      planes: k of them.
      config: the noise.
      offset: float[k, 3], of the position.
      heading: float[k], counter-clockwise.
    """
    noise = [config.position_noise, config.position_noise, config.height_noise]
    angle = np.radians(config.heading_noise * heading)
    angle *= FIRM_WIDTH / np.maximum(planes.width, FIRM_WIDTH)
    return planes._replace(
        position=planes.position + offset * noise, normal=turned(planes.normal, angle)
    )


def litter(
    planes: SeenPlanes, config: RobotConfig, graph: SceneGraph, rng: np.random.Generator
) -> SeenPlanes:
    """Adds short planes that belong to nothing, between walls that are seen and their rooms."""
    count = rng.binomial(len(planes.width), config.clutter)
    pairs = parts_first(graph)
    pairs = pairs[np.isin(pairs[:, 0], planes.stretches.plane)]
    pairs = pairs[graph.nodes.label[pairs[:, 1]] == room_label(ontology_of(graph))]
    if not (count and len(pairs)):
        return planes
    wall, room = pairs[rng.integers(len(pairs), size=count)].T
    normal, position = graph.nodes.normal[wall, :2], graph.nodes.position[wall].copy()
    beside = graph.nodes.width[wall] * rng.uniform(-0.5, 0.5, count)
    position[:, :2] += beside[:, None] * along(normal)
    inward = graph.nodes.position[room, :2] - position[:, :2]
    position[:, :2] += rng.uniform(0.1, 0.8, count)[:, None] * inward
    position[:, 2] += rng.normal(0, config.height_noise, count)
    quarters = np.where(rng.random(count) < ALONG_THE_WALL, 0, rng.integers(1, 4, count))
    angle = quarters * np.pi / 2 + np.radians(rng.normal(0, CLUTTER_HEADING, count))
    return SeenPlanes(
        np.concatenate([planes.position, position]),
        np.concatenate([planes.normal, turned(normal, angle)]),
        np.concatenate([planes.width, rng.uniform(*config.clutter_width, count)]),
        planes.stretches,
    )


_Effect = Callable[[SeenPlanes, RobotConfig, SceneGraph, np.random.Generator], SeenPlanes]
EFFECTS: Final[tuple[_Effect, ...]] = (
    visit,
    miss,
    _shorten,
    _merge,
    split,
    double,
    _blur,
    litter,
)


def _where(planes: SeenPlanes, chosen: np.ndarray) -> SeenPlanes:
    """Returns some of the planes, bool[k]."""
    row = np.flatnonzero(chosen)
    end = planes.width[row] / 2
    return parts_of(planes, row, -end, end)


def parts_of(planes: SeenPlanes, row: np.ndarray, low: np.ndarray, high: np.ndarray) -> SeenPlanes:
    """Returns parts of planes; a plane of the graph that hardly shows on one is not seen there.

    Args:
      planes: whole.
      row: int[k], which of them each part is of.
      low: float[k], where it begins, metres from the middle of the plane.
      high: float[k], where it ends.
    """
    middle = (low + high) / 2
    position = planes.position[row]
    position[:, :2] += middle[:, None] * planes.along[row]
    part, at = matches(planes.stretches.seen, row)
    _, plane, first, last = (field[at] for field in planes.stretches)
    begin, end = np.maximum(first, low[part]), np.minimum(last, high[part])
    shows = end - begin >= np.minimum(LEAST_SEEN, (last - first) / 2)
    stretches = Stretches(part, plane, begin - middle[part], end - middle[part])
    stretches = Stretches(*(field[shows] for field in stretches))
    return SeenPlanes(position, planes.normal[row], high - low, stretches)


def matches(keys: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns which wanted keys are found where: places in `wanted`, and in the sorted `keys`."""
    first = np.searchsorted(keys, wanted, "left")
    count = np.searchsorted(keys, wanted, "right") - first
    which = np.repeat(np.arange(len(wanted)), count)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(count) - count - first, count)


def along(normal: np.ndarray) -> np.ndarray:
    """Returns the direction of planes of these normals, float[k, 2]: to the left of them."""
    return np.column_stack([-normal[:, 1], normal[:, 0]])


def turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Turns each vector of the plane by its angle, counter-clockwise, radians."""
    return np.cos(angle)[:, None] * vectors + np.sin(angle)[:, None] * along(vectors)
