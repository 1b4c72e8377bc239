"""Plans: a scene graph from above, floor by floor, as an architect draws it.

What holds observed segments and shares none of them, such as a room, is an area that they outline;
what shares them, such as a wall, is a line between them. Neighbouring areas differ in colour, by
colours that the colour-blind can tell apart. Which concept is which is read from the ontology.

Source: the colours of areas are of the "light" scheme of Paul Tol, Colour Schemes, 2021, which is
made to lie under text.
"""

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.path import Path as Outline

from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of, parts_first
from sg3d_jax.viz.figure import (
    CAPTION_COLOUR,
    CAPTION_SIZE,
    add_lines,
    colours_of,
    faint_handle,
    save_figure,
)
from sg3d_jax.viz.style import (
    are_segments,
    check_confidence,
    faded,
    floor_of,
    plane_segments,
    styles_of,
)

PALETTE: Final = (
    "#77aadd",  # light blue
    "#eedd88",  # light yellow
    "#ffaabb",  # pink
    "#44bb99",  # mint
    "#ee8866",  # orange
    "#99ddff",  # light cyan
    "#bbcc33",  # pear
)
INK: Final = "#1f2937"
PICTURE_WIDTH: Final = 10.0  # inches, of few floors
LEAST_CELL: Final = 3.2  # inches, a floor of many
WIDE: Final = 1.5  # width of a picture of many floors, in heights
CAPTION_HEIGHT, LEGEND_HEIGHT = 0.3, 0.5  # inches
MARGIN: Final = 1.0  # metres around a floor
SEGMENT_WIDTH, LINE_WIDTH = 0.05, 0.1  # metres
THINNEST, THICKEST = 0.3, 2.0  # points, of these
SMALLEST, LARGEST = 2.5, 10.0  # points, of names
LETTER: Final = 0.65  # width of a letter, in its height
FINE: Final = 24  # places across an area at which its name may stand
SLANTED: Final = 0.5  # sine of the least angle between two segments that meet in a corner
BARS: Final = (1, 2, 5, 10, 20, 50, 100)  # metres, of the scale
INCH: Final = 72.0  # points
SOUND: Final[dict[str, Any]] = {"edgecolor": "none", "zorder": 1}  # patches of areas
ODD: Final[dict[str, Any]] = {"edgecolor": "#ffffff", "linewidth": 0, "hatch": "///", "zorder": 1}
MISSING: Final[dict[str, Any]] = {
    "fill": False,
    "edgecolor": "#111111",
    "linestyle": "--",
    "zorder": 3.5,
}


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


def save_plan(
    graph: SceneGraph,
    path: str | Path,
    names: Sequence[int | str] | None = None,
    node_confidence: Array | None = None,
    truth: SceneGraph | None = None,
) -> None:
    """Draws a host graph from above to a .png, .pdf or .svg file, all its floors in one scale.

    Args:
      graph: unpadded, metres.
      path: the file to write.
      names: of the nodes, such as their ids; areas and floors show theirs. None for their rows.
      node_confidence: float[n], 0 to 1; nodes are the fainter the less sure they are. None for all
        alike.
      truth: a host graph of the same segments. Areas that hold others than any of its areas does
        are hatched; of those of its areas that the graph lacks there is a dashed outline.

    Raises:
      ValueError: there is nothing that is seen from above, the format is unknown, the file cannot
        be written, or a confidence is not that of so many nodes.
    """
    check_confidence(graph, node_confidence, None)
    plan, floor = plan_of(graph), floor_of(graph)
    if not len(plan.segments):
        observed = ontology_of(graph).observed_plural
        raise ValueError(f"{path}: there are no {observed} to draw, expected some for a plan")
    names = [str(name) for name in (range(len(floor)) if names is None else names)]
    odd, missing = (set(), []) if truth is None else _differences(graph, plan, truth)
    floors = _in_order(graph, np.unique(floor[plan.segment_rows]))
    seen = [plan.segments[floor[plan.segment_rows] == row].reshape(-1, 2) for row in floors]
    low, high = (
        np.array([reduce(points, axis=0) for points in seen]) for reduce in (np.min, np.max)
    )
    span = (high - low).max(axis=0) + 2 * MARGIN
    columns = _columns(len(floors), span[0] / span[1])
    rows = math.ceil(len(floors) / columns)
    cell = max(LEAST_CELL, PICTURE_WIDTH / columns)
    height = cell * span[1] / span[0] + CAPTION_HEIGHT
    figure = Figure((cell * columns, height * rows + LEGEND_HEIGHT), layout="constrained")
    cells = figure.subplots(rows, columns, squeeze=False).flatten()
    for axes in cells:
        axes.set_axis_off()
    for axes, row, middle in zip(cells, floors, (low + high) / 2, strict=False):
        axes.set(aspect="equal")
        axes.set_xlim(middle[0] - span[0] / 2, middle[0] + span[0] / 2)
        axes.set_ylim(middle[1] - span[1] / 2, middle[1] + span[1] / 2)
        title = axes.set_title(_caption(graph, row, names), fontsize=CAPTION_SIZE)
        title.set(color=CAPTION_COLOUR, parse_math=False)
        _draw(axes, graph, plan, floor == row, cell * INCH / span[0], names, node_confidence, odd)
        for area in missing:
            if row in floor[area.held][:1]:
                axes.add_patch(Polygon(area.corners, **MISSING))
    _add_scale(cells[0])
    _add_legend(figure, graph, plan, node_confidence is not None, truth is not None)
    save_figure(figure, path)


def _differences(graph: SceneGraph, plan: Plan, truth: SceneGraph) -> tuple[set[int], list[Area]]:
    """Returns the nodes whose areas the truth lacks, and the areas of the truth that are lacking.

    The segments of an area of the truth are told by those of the graph that are in their place.
    """
    rows = {_place(graph, row): row for row in plan.segment_rows.tolist()}
    true = []
    for corners, held in plan_of(truth).areas.values():
        found = [rows.get(_place(truth, row)) for row in held.tolist()]
        true.append(Area(corners, np.array([row for row in found if row is not None], int)))
    ours, theirs = (
        [frozenset(area.held.tolist()) for area in areas] for areas in (plan.areas.values(), true)
    )
    odd = {row for row, held in zip(plan.areas, ours, strict=True) if held not in theirs}
    return odd, [area for area, held in zip(true, theirs, strict=True) if held not in ours]


def _place(graph: SceneGraph, row: int) -> tuple[float, ...]:
    """Returns where a node is, in whole millimetres."""
    return tuple(np.round(graph.nodes.position[row] * 1000).tolist())


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


def _columns(count: int, wide: float) -> int:
    """Returns how many of some floors are drawn in a row, given the width of each, in heights."""

    def odd(columns: int) -> float:
        rows = math.ceil(count / columns)
        return abs(math.log(columns * wide / rows / WIDE)) + (rows * columns - count) / count

    return min(range(1, count + 1), key=odd)


def _in_order(graph: SceneGraph, floors: np.ndarray) -> list[int]:
    """Returns floors by what they are part of, and bottom-up."""
    above = dict(parts_first(graph).tolist())
    height = graph.nodes.position[:, 2]
    return sorted(floors.tolist(), key=lambda row: (above.get(row, -1), height[row], row))


def _caption(graph: SceneGraph, floor: int, names: Sequence[str]) -> str:
    """Returns what is printed above a floor: its name, and that of what it is part of."""
    if floor < 0:
        return ""
    concepts, label = ontology_of(graph).names, graph.nodes.label
    wholes = [whole for part, whole in parts_first(graph).tolist() if part == floor]
    return ", ".join(f"{concepts[label[row]]} {names[row]}" for row in (*wholes, floor))


def _draw(
    axes: Axes,
    graph: SceneGraph,
    plan: Plan,
    here: np.ndarray,
    metre: float,
    names: Sequence[str],
    confidence: Array | None,
    odd: Collection[int],
) -> None:
    """Draws one floor.

    Args:
      axes: where to draw.
      graph: the host graph.
      plan: of all its floors.
      here: bool[n], the nodes of this one.
      metre: its length, points.
      names: of all nodes.
      confidence: float[n], or None.
      odd: nodes whose areas are hatched.
    """
    label, styles = graph.nodes.label, styles_of(ontology_of(graph))
    areas = {row: area.corners for row, area in plan.areas.items() if here[row]}
    for (row, corners), colour in zip(areas.items(), area_colours([*areas.values()]), strict=True):
        shade = colour if confidence is None else faded(colour, confidence[[row]])[0]
        axes.add_patch(Polygon(corners, facecolor=shade, **(ODD if row in odd else SOUND)))
        place, room = _middle(corners, graph.nodes.position[row, :2])
        size = min(1.6, 2.4 / (LETTER * len(names[row]))) * room * metre
        text = axes.text(
            place[0], place[1], names[row], size=float(np.clip(size, SMALLEST, LARGEST))
        )
        text.set(color=INK, ha="center", va="center", zorder=4, parse_math=False)
    for rows, ends, width, zorder in (
        (plan.segment_rows, plan.segments, SEGMENT_WIDTH, 2),
        (plan.line_rows, plan.lines, LINE_WIDTH, 3),
    ):
        for concept in np.unique(label[rows]).tolist():
            chosen = here[rows] & (label[rows] == concept)
            colours = colours_of(styles[concept].colour, confidence, rows[chosen])
            points = float(np.clip(width * metre, THINNEST, THICKEST))
            add_lines(axes, ends[chosen], colours, points, zorder)


def _middle(corners: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns the place inside an area with most room around it, and how much it is, metres.

    Of places with about as much, that next to the position of its node.
    """
    across, up = np.linspace(corners.min(axis=0), corners.max(axis=0), FINE).T
    places = np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
    places = np.concatenate([places, position[None]])
    room = _distance(places, corners) * Outline(corners).contains_points(places)
    best = np.argmax(room - np.linalg.norm(places - position, axis=1) / FINE)
    return places[best], float(room[best])


def _add_scale(axes: Axes) -> None:
    """Adds a bar that is as long as it says."""
    (left, right), bottom = axes.get_xlim(), axes.get_ylim()[0]
    bar = max((length for length in BARS if length <= (right - left) / 4), default=BARS[0])
    axes.plot([left, left + bar], [bottom, bottom], color=INK, linewidth=2, solid_capstyle="butt")
    axes.text(left + bar / 2, bottom, f"{bar} m", size=CAPTION_SIZE - 2, ha="center", va="bottom")


def _add_legend(figure: Figure, graph: SceneGraph, plan: Plan, unsure: bool, judged: bool) -> None:
    """Adds a legend of what is drawn, bottom-up, below everything."""
    ontology, label = ontology_of(graph), graph.nodes.label
    handles: list[Line2D | Patch] = []
    for rows in (plan.segment_rows, plan.line_rows):
        for concept in np.unique(label[rows]).tolist():
            colour, name = styles_of(ontology)[concept].colour, ontology.names[concept]
            handles.append(Line2D([], [], color=colour, linewidth=THICKEST, label=name))
    for concept in np.unique(label[[*plan.areas]]).tolist() if plan.areas else ():
        handles.append(
            Patch(facecolor=PALETTE[0], label=f"{ontology.names[concept]}, with its name")
        )
    if judged:
        handles.append(Patch(facecolor=PALETTE[0], **ODD, label="not so in the truth"))
        handles.append(Patch(**MISSING, label="in the truth alone"))
    if unsure:
        handles.append(faint_handle())
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
