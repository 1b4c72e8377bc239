"""Plans for a page: what `plan` draws, as traces of plotly.

Every point knows its node, as in `page`: of an area the place of its name, of a line its ends and
its middle. Where a confidence is given, what is unsure is faint, in steps of a tenth.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of
from sg3d_jax.viz.outline import (
    Arranged,
    Plan,
    area_colours,
    arranged,
    bar_length,
    caption_of,
    differences,
    middle_of,
    plan_of,
)
from sg3d_jax.viz.style import CAPTION_COLOUR, INK, MISSING_COLOUR, faded, floor_of, styles_of

NAME_SIZE, CAPTION_SIZE = 11, 13  # pixels
SEGMENT_WIDTH, LINE_WIDTH = 1.5, 3.0  # pixels
CAPTION_ROOM: Final = 0.15  # height of a line of a caption, in that of what a cell shows
NEW_LINE: Final = "<br>"  # of plotly
DECIMALS: Final = 3  # millimetres
HATCH: Final = {"shape": "/", "fgcolor": "#ffffff"}
HIDDEN: Final = {"visible": False}


def plan_of_page(
    graph: SceneGraph,
    title: str,
    names: Sequence[int | str],
    node_confidence: Array | None = None,
    truth: SceneGraph | None = None,
) -> dict[str, Any] | None:
    """Returns the plan of a host graph: its title, plotly's traces and layout; None without any.

    Args:
      graph: unpadded, metres.
      title: printed above it.
      names: of the nodes; areas and floors show theirs.
      node_confidence: float[n], 0 to 1; None for all alike.
      truth: a host graph of the same segments: areas that hold others than any of its areas does
        are hatched, those of its areas that the graph lacks have a dashed outline.
    """
    plan = plan_of(graph)
    if not len(plan.segments):
        return None
    cells, texts = arranged(graph, plan), [str(name) for name in names]
    captions = [caption_of(graph, row, texts, NEW_LINE) for row in cells.floors]
    lines = 1 + max(caption.count(NEW_LINE) for caption in captions)
    cells = cells._replace(span=cells.span * np.array([1.0, 1.0 + CAPTION_ROOM * lines]))
    odd, missing = (set(), []) if truth is None else differences(graph, plan, truth)
    floor, middles = floor_of(graph), dict(zip(cells.floors, _shifts(cells), strict=True))
    shift = np.array([middles.get(row, (np.nan, np.nan)) for row in floor.tolist()])
    sure = np.ones(len(floor)) if node_confidence is None else np.round(node_confidence, 1)
    outlines = [area.corners + shift[area.held[0]] for area in missing]
    width, height = np.array([cells.columns, -(-len(cells.floors) // cells.columns)]) * cells.span
    data = [
        *_areas(plan, floor, shift, sure, odd),
        *_lines(graph, plan.segment_rows, plan.segments, shift, sure, SEGMENT_WIDTH),
        *_lines(graph, plan.line_rows, plan.lines, shift, sure, LINE_WIDTH),
        _trace(_closed(outlines), line={"color": MISSING_COLOUR, "dash": "dash", "width": 2}),
        *_texts(graph, plan, cells, shift, texts, captions),
        _bar(float(width), float(height)),
    ]
    return {"title": title, "data": data, "layout": _layout(float(width), float(height))}


def _shifts(cells: Arranged) -> np.ndarray:
    """Returns by how much each floor is moved into its cell, float[f, 2]; the first is at 0, 0."""
    place = np.arange(len(cells.floors))
    corner = np.stack([place % cells.columns, -(place // cells.columns) - 1], axis=1) * cells.span
    return corner + cells.span / 2 - cells.middles


def _areas(
    plan: Plan, floor: np.ndarray, shift: np.ndarray, sure: np.ndarray, odd: set[int]
) -> list[dict[str, Any]]:
    """Returns a trace for each shade of areas, hatched or not."""
    shades: defaultdict[tuple[str, bool], list[np.ndarray]] = defaultdict(list)
    for row in np.unique(floor[[*plan.areas]]).tolist() if plan.areas else ():
        here = [area for area in plan.areas if floor[area] == row]
        colours = area_colours([plan.areas[area].corners for area in here])
        for area, colour in zip(here, colours, strict=True):
            (shade,) = faded(colour, sure[[area]])
            shades[shade, area in odd].append(plan.areas[area].corners + shift[area])
    return [
        _trace(_closed(corners), fill="toself", fillcolor=shade, line={"width": 0})
        | ({"fillpattern": HATCH | {"bgcolor": shade}} if hatched else {})
        for (shade, hatched), corners in shades.items()
    ]


def _lines(
    graph: SceneGraph,
    rows: np.ndarray,
    ends: np.ndarray,
    shift: np.ndarray,
    sure: np.ndarray,
    width: float,
) -> list[dict[str, Any]]:
    """Returns a trace for each shade of lines; each has a point in its middle, to be hovered."""
    shades: defaultdict[str, list[int]] = defaultdict(list)
    styles = styles_of(ontology_of(graph))
    for place, row in enumerate(rows.tolist()):
        colour = styles[graph.nodes.label[row]].colour
        shades[faded(colour, sure[[row]])[0]].append(place)
    return [
        _trace(
            _with_gaps(
                (ends[place, 0], ends[place].mean(axis=0), ends[place, 1]) + shift[rows[place]]
                for place in places
            ),
            np.repeat(rows[places], 4).tolist(),
            line={"color": shade, "width": width},
        )
        for shade, places in shades.items()
    ]


def _texts(
    graph: SceneGraph,
    plan: Plan,
    cells: Arranged,
    shift: np.ndarray,
    names: Sequence[str],
    captions: Sequence[str],
) -> list[dict[str, Any]]:
    """Returns the names of areas, and the captions of floors."""
    areas = [
        middle_of(area.corners, graph.nodes.position[row, :2])[0] + shift[row]
        for row, area in plan.areas.items()
    ]
    tops = _shifts(cells) + cells.middles + cells.span * np.array([0.0, 0.48])
    return [
        _trace(np.array(areas).reshape(-1, 2), [*plan.areas], mode="text")
        | {
            "text": [names[row] for row in plan.areas],
            "textfont": {"size": NAME_SIZE, "color": INK},
        },
        _trace(tops, mode="text", textposition="bottom center")
        | {
            "text": [*captions],
            "textfont": {"size": CAPTION_SIZE, "color": CAPTION_COLOUR},
        },
    ]


def _bar(width: float, height: float) -> dict[str, Any]:
    """Returns a bar that is as long as it says."""
    bar = bar_length(width)
    ends = np.array([[0.02 * width, -0.99 * height]]) + np.array([[0.0, 0.0], [bar, 0.0]])
    return _trace(ends, mode="lines+text", line={"color": INK, "width": 2}) | {
        "text": [f"{bar} m", ""],
        "textposition": "top right",
        "textfont": {"size": NAME_SIZE},
    }


def _closed(corners: Iterable[np.ndarray]) -> np.ndarray:
    return _with_gaps(np.concatenate([one, one[:1]]) for one in corners)


def _with_gaps(lines: Iterable[np.ndarray]) -> np.ndarray:
    """Returns the points of lines, float[p, 2], with NaN behind each."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate([np.zeros((0, 2)), *(part for line in lines for part in (line, gap))])


def _trace(
    points: np.ndarray, rows: Sequence[int] | None = None, mode: str = "lines", **options: Any
) -> dict[str, Any]:
    """Returns one trace; what has nodes says them when it is hovered over."""
    x, y = (
        [None if np.isnan(value) else value for value in column]
        for column in (np.round(points, DECIMALS) + 0.0).T.tolist()
    )
    hover = {"hoverinfo": "skip"} if rows is None else {"hoverinfo": "text", "customdata": rows}
    return {"type": "scatter", "mode": mode, "x": x, "y": y, **hover, **options}


def _layout(width: float, height: float) -> dict[str, Any]:
    return {
        "xaxis": {"range": [0, width], **HIDDEN},
        "yaxis": {"range": [-height, 0], "scaleanchor": "x", **HIDDEN},
        "font": {"family": "system-ui, sans-serif"},
        "hoverlabel": {"align": "left", "bgcolor": "#ffffff", "font": {"size": 13}},
        "hovermode": "closest",
        "dragmode": "pan",
        "showlegend": False,
        "margin": {"b": 0, "l": 0, "r": 0, "t": 0},
    }
