"""What of a scene graph is seen from above: segments, lines between them, and areas they outline.

What holds observed segments and shares none of them, such as a room, is an area that they outline;
what shares them, such as a wall, is a line between them. Neighbouring areas differ in colour, by
colours that the colour-blind can tell apart. Which concept is which is read from the ontology.

Source: the colours of areas are of the "light" scheme of Paul Tol, Colour Schemes, 2021, which is
made to lie under text.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, ontology_of, parts_first
from sg3d_jax.viz.compare import is_missing, is_odd, matched
from sg3d_jax.viz.style import are_segments, called, floor_of, plane_segments

PALETTE: Final = (
    "#77aadd",  # light blue
    "#eedd88",  # light yellow
    "#ffaabb",  # pink
    "#44bb99",  # mint
    "#ee8866",  # orange
    "#99ddff",  # light cyan
    "#bbcc33",  # pear
)
BARS: Final = (1, 2, 5, 10, 20, 50, 100)  # metres, of a scale
MARGIN: Final = 1.0  # metres around a floor
WIDE: Final = 1.5  # width of a drawing of many floors, in heights
FINE: Final = 24  # places across an area at which its name may stand
SLANTED: Final = 0.5  # sine of the least angle between two segments that meet in a corner


class Area(NamedTuple):
    """What segments outline, such as a room."""

    corners: np.ndarray  # float[k, 2], metres
    held: np.ndarray  # int[h], the nodes of the segments


class Plan(NamedTuple):
    """What of a host graph is seen from above; metres."""

    segment_rows: np.ndarray  # int[s], the nodes that are segments
    segments: np.ndarray  # float[s, 2, 2], their ends: what they face is on the left of the way
    line_rows: np.ndarray  # int[l], the nodes that are lines between segments
    lines: np.ndarray  # float[l, 2, 2], their ends
    areas: dict[int, Area]  # by node


def plan_of(graph: SceneGraph) -> Plan:
    """Returns what of a host graph is seen from above.

    Args:
      graph: unpadded, metres. It may break the hierarchy.
    """
    ontology, label = ontology_of(graph), np.asarray(graph.nodes.label)
    rows = np.flatnonzero(are_segments(ontology)[label])
    segments = plane_segments(graph)[:, ::-1, :2]
    place = np.full(len(label), -1)
    place[rows] = np.arange(len(rows))
    parts, wholes = parts_first(graph).T
    held = place[parts] >= 0
    areas: dict[int, Area] = {}
    line_rows, lines = [], []
    for row in np.unique(wholes[held]).tolist():
        own = place[parts[held & (wholes == row)]]
        if ontology.has_one_whole[label[rows[own]], label[row]].all():
            areas[row] = Area(outline(segments[own]), rows[own])
        else:
            line_rows.append(row)
            lines.append(_line_between(segments[own], graph.nodes.position[row, :2]))
    ends = np.array(lines).reshape(-1, 2, 2)
    return Plan(rows, segments, np.array(line_rows, int), ends, areas)


def outline(segments: np.ndarray) -> np.ndarray:
    """Returns the corners of an area that segments outline, float[k, 2], metres.

    Segments are joined end to start around the area, by the shortest gaps that are found; two that
    meet at an angle are prolonged or cut to their corner, so that one which goes on behind the next
    is not followed out of the area.

    Args:
      segments: float[s, 2, 2], each from its start to its end, with the area on its left.
    """
    gap = np.linalg.norm(segments[:, None, 1] - segments[None, :, 0], axis=-1)
    ways = [_way(gap, first) for first in range(len(segments))]
    way = min(ways, key=lambda way: float(gap[way, np.roll(way, -1)].sum()))
    pairs = zip(segments[way], segments[np.roll(way, -1)], strict=True)
    return np.concatenate([_corner(one, following) for one, following in pairs])


def _way(gap: np.ndarray, first: int) -> list[int]:
    """Returns an order of segments that goes from each to the nearest that is left."""
    way, far = [first], gap.copy()
    for _ in range(len(gap) - 1):
        far[:, way[-1]] = np.inf
        way.append(int(np.argmin(far[way[-1]])))
    return way


def _corner(one: np.ndarray, following: np.ndarray) -> np.ndarray:
    """Returns where a segment leads to the following: a corner, or from its end to a start."""
    (start, end), (other, other_end) = one, following
    straight = np.stack([end, other])
    along, onward = end - start, other_end - other
    turn = _cross(along, onward)
    if abs(turn) < SLANTED * np.linalg.norm(along) * np.linalg.norm(onward):
        return straight
    there, here = _cross(other - start, onward) / turn, _cross(other - start, along) / turn
    corner = start + there * along
    reach = np.linalg.norm(other - end)
    beyond = max((there - 1) * np.linalg.norm(along), -here * np.linalg.norm(onward))
    return corner[None] if there > 0 and here < 1 and beyond <= reach else straight


def _cross(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def _line_between(segments: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Returns a line through a position, along segments, as far as those of both sides overlap."""
    ways = segments[:, 1] - segments[:, 0]
    longest = ways[np.argmax(np.linalg.norm(ways, axis=1))]
    along = longest / max(float(np.linalg.norm(longest)), 1e-9)
    places = np.sort((segments - position) @ along, axis=1)
    sides = [places[(ways @ along > 0) == side] for side in (True, False)]
    ends = np.array([(side[:, 0].min(), side[:, 1].max()) for side in sides if len(side)])
    low, high = ends[:, 0].max(), ends[:, 1].min()
    if low >= high:  # the sides do not face each other
        low, high = ends.min(), ends.max()
    return position + np.outer((low, high), along)


def differences(graph: SceneGraph, plan: Plan, truth: SceneGraph) -> tuple[set[int], list[Area]]:
    """Returns the nodes whose areas the truth lacks, and the areas of the truth that are lacking.

    The segments of an area of the truth are told by those of the graph that are in their place.
    """
    match = matched(graph, truth)
    odd, missing = is_odd(graph, match), is_missing(truth, match)
    return {row for row in plan.areas if odd[row]}, [
        Area(area.corners, match[area.held][match[area.held] >= 0])
        for row, area in plan_of(truth).areas.items()
        if missing[row]
    ]


def area_colours(areas: Sequence[np.ndarray]) -> list[str]:
    """Returns a colour for each area: from the longest on, that whose areas are farthest away.

    Args:
      areas: of one floor, the corners of each, float[k, 2].
    """
    lengths = [np.linalg.norm(_sides(corners), axis=1).sum() for corners in areas]
    chosen: dict[int, int] = {}
    for row in np.argsort(lengths, kind="stable")[::-1].tolist():
        away = np.full(len(PALETTE), np.inf)
        for other, colour in chosen.items():
            pair = areas[row], areas[other]
            apart = min(_distance(*pair).min(), _distance(*pair[::-1]).min())
            away[colour] = min(away[colour], apart)
        chosen[row] = int(np.argmax(away))
    return [PALETTE[chosen[row]] for row in range(len(areas))]


def _sides(corners: np.ndarray) -> np.ndarray:
    """Returns the way from each corner of an area to the next, float[k, 2]."""
    return np.roll(corners, -1, axis=0) - corners


def _distance(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Returns how far places, float[p, 2], are from the outline of an area, float[p], metres."""
    sides = _sides(corners)
    away = places[:, None] - corners
    share = np.sum(away * sides, axis=-1) / np.maximum(np.sum(sides**2, axis=-1), 1e-12)
    nearest = np.clip(share, 0, 1)[..., None] * sides
    return np.linalg.norm(away - nearest, axis=-1).min(axis=1)


def _inside(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Returns bool[p], whether places, float[p, 2], are inside of an area: by its sides beyond."""
    x, y = places.T[:, :, None]
    ends = corners + _sides(corners)
    crosses = (corners[:, 1] > y) != (ends[:, 1] > y)
    rise = np.where(ends[:, 1] == corners[:, 1], 1.0, ends[:, 1] - corners[:, 1])
    beyond = corners[:, 0] + (y - corners[:, 1]) * (ends[:, 0] - corners[:, 0]) / rise > x
    return np.sum(crosses & beyond, axis=1) % 2 == 1


def middle_of(corners: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns the place inside an area with most room around it, and how much it is, metres.

    Of places with about as much, that next to the position of its node.
    """
    across, up = np.linspace(corners.min(axis=0), corners.max(axis=0), FINE).T
    places = np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
    places = np.concatenate([places, position[None]])
    room = _distance(places, corners) * _inside(places, corners)
    best = np.argmax(room - np.linalg.norm(places - position, axis=1) / FINE)
    return places[best], float(room[best])


def _in_order(graph: SceneGraph, floors: np.ndarray) -> list[int]:
    """Returns floors by what they are part of, and bottom-up."""
    above = dict(parts_first(graph).tolist())
    height = graph.nodes.position[:, 2]
    return sorted(floors.tolist(), key=lambda row: (above.get(row, -1), height[row], row))


class Arranged(NamedTuple):
    """Floors side by side in cells of one size; metres."""

    floors: list[int]  # nodes, left to right, then down; -1 for what is on none
    middles: np.ndarray  # float[f, 2], of what each shows
    span: np.ndarray  # float[2], of a cell
    columns: int


def arranged(graph: SceneGraph, plan: Plan) -> Arranged:
    """Returns the floors of a host graph side by side, by what they are part of, and bottom-up."""
    floor = floor_of(graph)[plan.segment_rows]
    floors = _in_order(graph, np.unique(floor))
    seen = [plan.segments[floor == row].reshape(-1, 2) for row in floors]
    low, high = (
        np.array([reduce(points, axis=0) for points in seen]) for reduce in (np.min, np.max)
    )
    span = (high - low).max(axis=0) + 2 * MARGIN
    return Arranged(floors, (low + high) / 2, span, _columns(len(floors), span[0] / span[1]))


def _columns(count: int, wide: float) -> int:
    """Returns how many of some floors are drawn in a row, given the width of each, in heights."""

    def odd(columns: int) -> float:
        rows = math.ceil(count / columns)
        return abs(math.log(columns * wide / rows / WIDE)) + (rows * columns - count) / count

    return min(range(1, count + 1), key=odd)


def bar_length(width: float) -> int:
    """Returns how long the bar of a scale is, metres, in a drawing that is so wide."""
    return max((length for length in BARS if length <= width / 4), default=BARS[0])


def caption_of(graph: SceneGraph, floor: int, names: Sequence[str], between: str = ", ") -> str:
    """Returns what is printed above a floor: the name of what it is part of, and its own."""
    if floor < 0:
        return ""
    concepts, label = ontology_of(graph).names, graph.nodes.label
    wholes = [whole for part, whole in parts_first(graph).tolist() if part == floor]
    return between.join(called(concepts[label[row]], names[row]) for row in (*wholes, floor))
