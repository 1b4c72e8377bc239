"""Plans: a scene graph from above, floor by floor, as an architect draws it."""

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of
from sg3d_jax.scene.padding import unpad
from sg3d_jax.viz.figure import (
    CAPTION_SIZE,
    add_lines,
    colours_of,
    faint_handle,
    put_legend,
    save_figure,
)
from sg3d_jax.viz.outline import (
    PALETTE,
    Plan,
    area_colours,
    arranged,
    bar_length,
    caption_of,
    differences,
    middle_of,
    plan_of,
)
from sg3d_jax.viz.style import (
    CAPTION_COLOUR,
    INK,
    MISSING_COLOUR,
    are_segments,
    check_confidence,
    faded,
    floor_of,
    styles_of,
)

PICTURE_WIDTH: Final = 10.0  # inches, of few floors
LEAST_CELL: Final = 3.2  # inches, a floor of many
CAPTION_HEIGHT, LEGEND_HEIGHT = 0.3, 0.5  # inches
SEGMENT_WIDTH, LINE_WIDTH, DOT_WIDTH = 0.05, 0.1, 0.25  # metres
DOT_SIZE: Final = 6.0  # points, in the legend
THINNEST, THICKEST = 0.3, 2.0  # points, of these
SMALLEST, LARGEST = 2.5, 10.0  # points, of names
LETTER: Final = 0.65  # width of a letter, in its height
INCH: Final = 72.0  # points
SOUND: Final[dict[str, Any]] = {"edgecolor": "none", "zorder": 1}  # patches of areas
ODD: Final[dict[str, Any]] = {"edgecolor": "#ffffff", "linewidth": 0, "hatch": "///", "zorder": 1}
MISSING: Final[dict[str, Any]] = {
    "fill": False,
    "edgecolor": MISSING_COLOUR,
    "linestyle": "--",
    "zorder": 3.5,
}


def save_plan(
    graph: SceneGraph,
    path: str | Path,
    names: Sequence[int | str] | None = None,
    node_confidence: Array | None = None,
    truth: SceneGraph | None = None,
) -> None:
    """Draws a host graph from above to a .png, .pdf or .svg file, all its floors in one scale.

    Args:
      graph: metres.
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
    graph = unpad(graph)
    check_confidence(graph, node_confidence, None)
    plan, floor = plan_of(graph), floor_of(graph)
    if not len(plan.segments):
        observed = ontology_of(graph).observed_plural
        raise ValueError(f"{path}: there are no {observed} to draw, expected some for a plan")
    names = [str(name) for name in (range(len(floor)) if names is None else names)]
    odd, missing = (set(), []) if truth is None else differences(graph, plan, truth)
    floors, middles, span, columns = arranged(graph, plan)
    rows = math.ceil(len(floors) / columns)
    cell = max(LEAST_CELL, PICTURE_WIDTH / columns)
    height = cell * span[1] / span[0] + CAPTION_HEIGHT
    figure = Figure((cell * columns, height * rows + LEGEND_HEIGHT), layout="constrained")
    cells = figure.subplots(rows, columns, squeeze=False).flatten()
    for axes in cells:
        axes.set_axis_off()
    for axes, row, middle in zip(cells, floors, middles, strict=False):
        axes.set(aspect="equal")
        axes.set_xlim(middle[0] - span[0] / 2, middle[0] + span[0] / 2)
        axes.set_ylim(middle[1] - span[1] / 2, middle[1] + span[1] / 2)
        title = axes.set_title(caption_of(graph, row, names), fontsize=CAPTION_SIZE)
        title.set(color=CAPTION_COLOUR, parse_math=False)
        _draw(axes, graph, plan, floor == row, cell * INCH / span[0], names, node_confidence, odd)
        for area in missing:
            if row in floor[area.held][:1]:
                axes.add_patch(Polygon(area.corners, **MISSING))
    _add_scale(cells[0])
    _add_legend(figure, graph, plan, node_confidence is not None, truth is not None)
    save_figure(figure, path)


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
        place, room = middle_of(corners, graph.nodes.position[row, :2])
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
    for concept in _dotted(graph):
        chosen = np.flatnonzero(here & (label == concept))
        colours = colours_of(styles[concept].colour, confidence, chosen)
        points = float(np.clip(DOT_WIDTH * metre, THINNEST, LARGEST))
        axes.scatter(
            *graph.nodes.position[chosen, :2].T, points**2, colours, zorder=3, linewidths=0
        )


def _dotted(graph: SceneGraph) -> list[int]:
    """Returns the concepts that are drawn as dots: what is observed and no segment."""
    ontology = ontology_of(graph)
    dotted = ontology.is_observed & ~are_segments(ontology)
    return np.unique(graph.nodes.label[dotted[graph.nodes.label]]).tolist()


def _add_scale(axes: Axes) -> None:
    """Adds a bar that is as long as it says."""
    (left, right), bottom = axes.get_xlim(), axes.get_ylim()[0]
    bar = bar_length(right - left)
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
    for concept in _dotted(graph):
        handle = Line2D([], [], color=styles_of(ontology)[concept].colour, marker="o")
        handle.set(linestyle="none", markersize=DOT_SIZE, label=ontology.names[concept])
        handles.append(handle)
    for concept in np.unique(label[[*plan.areas]]).tolist() if plan.areas else ():
        handles.append(
            Patch(facecolor=PALETTE[0], label=f"{ontology.names[concept]}, with its name")
        )
    if judged:
        handles.append(Patch(facecolor=PALETTE[0], **ODD, label="not so in the truth"))
        handles.append(Patch(**MISSING, label="in the truth alone"))
    if unsure:
        handles.append(faint_handle())
    put_legend(figure, handles)
