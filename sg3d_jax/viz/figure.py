"""Pictures of scene graphs, as in the paper: matplotlib, no display needed.

What is observed with normal and width is drawn as segments; every concept has dots in its own
colour, lifted apart in z so that the hierarchy can be read (the lift is drawn, it is not part of
the graph).

Source: paper, Fig. 1 and the figure of qualitative results.
Differs: a parallel projection, so that parallel walls stay parallel and every scene fills its frame
(the 3D axes of matplotlib clip large scenes and centre small ones in white).
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from sg3d_jax.io.files import replacing
from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, Ontology
from sg3d_jax.scene.padding import unpad, unpad_all
from sg3d_jax.viz.style import (
    CAPTION_COLOUR,
    EDGE_COLOUR,
    FAINT,
    LEAST_SIZE,
    are_segments,
    check_confidence,
    crowding,
    faded,
    lifted,
    plane_segments,
    project,
    styles_of,
    view_of,
)

EDGE_WIDTH: Final = 0.7  # points
PLANE_WIDTH: Final = 1.5  # points
RESOLUTION: Final = 200  # dots per inch
PICTURE_WIDTH: Final = 8.0  # inches
CELL_WIDTH: Final = 3.0  # inches, one graph of a contact sheet
SHEET_COLUMNS: Final = 6
LEGEND_HEIGHT: Final = 0.6  # inches
LEGEND_MARK, LEGEND_LETTER = 0.55, 0.09  # inches, of an entry
CAPTION_SIZE: Final = 9  # points


class _Drawn(NamedTuple):
    """A host graph, and how sure it is, 0 to 1."""

    graph: SceneGraph
    node_confidence: Array | None = None  # float[n]
    edge_confidence: Array | None = None  # float[e]


def draw_graph(
    graph: SceneGraph,
    axes: Axes | None = None,
    scale: float = 1.0,
    node_confidence: Array | None = None,
    edge_confidence: Array | None = None,
) -> Axes:
    """Draws a graph.

    Args:
      graph: metres.
      axes: where to draw; None for the axes of a new figure.
      scale: of lines and dots; 1 suits a picture 8 inches wide. Those of large graphs are smaller.
      node_confidence: float[n], 0 to 1; nodes are the fainter the less sure they are. None for all
        alike.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`, likewise.

    Returns:
      The axes, without ticks or frame, a metre equally long in every direction.

    Raises:
      ValueError: it is no graph, or a confidence is not that of so many nodes or edges.
    """
    graph = unpad(graph)
    check_confidence(graph, node_confidence, edge_confidence)
    if axes is None:
        axes = Figure(layout="constrained").add_subplot()
    label, styles = np.asarray(graph.nodes.label), styles_of(ontology_of(graph))
    azimuth, scale = view_of(graph), scale * crowding(graph)
    nodes = project(lifted(graph), azimuth)
    edges = nodes[undirected_edges(graph, PART_OF)]
    add_lines(axes, edges, colours_of(EDGE_COLOUR, edge_confidence), EDGE_WIDTH * scale, zorder=1)
    sure = None if node_confidence is None else np.asarray(node_confidence)
    for concept in np.flatnonzero(are_segments(ontology_of(graph))).tolist():
        planes = project(plane_segments(graph, concept), azimuth)
        colours = colours_of(styles[concept].colour, sure, label == concept)
        add_lines(axes, planes, colours, PLANE_WIDTH * scale, zorder=2)
    for concept in sorted(set(label.tolist())):
        style, dots = styles[concept], nodes[label == concept].T
        colours = colours_of(style.colour, sure, label == concept)
        drawn = axes.scatter(*dots, s=(style.size * scale) ** 2, c=colours)
        drawn.set(edgecolor="white", linewidth=0.7 * scale, zorder=3 + concept)
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    axes.margins(0.04)
    return axes


def save_picture(
    graph: SceneGraph,
    path: str | Path,
    title: str | None = None,
    node_confidence: Array | None = None,
    edge_confidence: Array | None = None,
) -> None:
    """Draws a graph with a legend to a file whose suffix names the format (.png, .pdf, .svg).

    Args:
      graph: metres.
      path: the file to write.
      title: printed above the picture.
      node_confidence: float[n], 0 to 1; nodes are the fainter the less sure they are. None for all
        alike.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`, likewise.

    Raises:
      ValueError: it is no graph, the format is unknown, the file cannot be written, or a confidence
        is not that of so many nodes or edges.
    """
    figure = _draw_rows([[_Drawn(unpad(graph), node_confidence, edge_confidence)]], PICTURE_WIDTH)
    if title:
        figure.suptitle(title)
    save_figure(figure, path)


def contact_sheet(
    rows: Sequence[tuple[str, Sequence[SceneGraph]]],
    path: str | Path,
    captions: Sequence[str] = (),
) -> None:
    """Draws rows of host graphs, such as true and generated ones, above one another.

    Args:
      rows: a title and the graphs of each row, left to right; empty rows are left out.
      path: the file to write.
      captions: small print above each graph, in reading order; none by default.

    Raises:
      ValueError: there is nothing to draw, the format is unknown or the file cannot be written.
    """
    rows = [(title, row) for title, row in rows if row]
    if not rows:
        raise ValueError(f"{path}: there are no graphs, expected at least one to draw")
    figure = _draw_rows(
        [[_Drawn(graph) for graph in unpad_all(row)] for _, row in rows], CELL_WIDTH
    )
    firsts = np.cumsum([0] + [len(row) for _, row in rows[:-1]])
    for first, (title, _) in zip(firsts, rows, strict=True):
        figure.axes[first].set_ylabel(title)
    for axes, caption in zip(figure.axes, captions, strict=False):
        axes.set_adjustable("datalim")  # every axes fills its cell, so that captions align
        axes.set_title(caption, fontsize=CAPTION_SIZE, color=CAPTION_COLOUR)
    save_figure(figure, path)


def dataset_sheet(
    graphs: Sequence[SceneGraph], path: str | Path, first: int = 0, columns: int = SHEET_COLUMNS
) -> None:
    """Draws host graphs of a data set as a contact sheet; captions give index and node count.

    Args:
      graphs: unpadded, metres; of any sizes.
      path: the file to write.
      first: the index of the first graph in its data set.
      columns: graphs in a row.

    Raises:
      ValueError: there is nothing to draw, the format is unknown or the file cannot be written.
    """
    rows = [("", graphs[start : start + columns]) for start in range(0, len(graphs), columns)]
    captions = [f"{i}: |V| = {len(graph.nodes.label)}" for i, graph in enumerate(graphs, first)]
    contact_sheet(rows, path, captions)


def _draw_rows(rows: Sequence[Sequence[_Drawn]], width: float) -> Figure:
    """Returns a figure of rows of graphs, each `width` inches wide, with one legend below."""
    figure = Figure(layout="constrained")
    columns = max(len(row) for row in rows)
    grid = figure.add_gridspec(len(rows), columns)
    heights = []
    for index, row in enumerate(rows):
        drawn = [figure.add_subplot(grid[index, column]) for column in range(len(row))]
        for axes, (graph, *confidence) in zip(drawn, row, strict=True):
            draw_graph(graph, axes, (width / PICTURE_WIDTH) ** 0.5, *confidence)
        heights.append(width * max(_height_by_width(axes) for axes in drawn))
    grid.set_height_ratios(heights)
    figure.set_size_inches(width * columns, sum(heights) + LEGEND_HEIGHT)
    _add_legend(figure, [drawn for row in rows for drawn in row])
    return figure


def _height_by_width(axes: Axes) -> float:
    width, height = axes.dataLim.size
    return float(np.clip(height / max(width, 1e-9), 0.4, 1.2))


def colours_of(
    colour: str, confidence: np.ndarray | None, chosen: np.ndarray | slice = slice(None)
) -> str | list[str]:
    """Returns one colour for all, or that of each chosen one."""
    return colour if confidence is None else faded(colour, np.asarray(confidence)[chosen])


def add_lines(
    axes: Axes, ends: np.ndarray, colours: str | list[str], width: float, zorder: int
) -> None:
    """Draws lines between pairs of points, float[n, 2, 2]."""
    lines = LineCollection(list(ends), colors=colours, linewidths=width, zorder=zorder)
    lines.set_capstyle("round")
    axes.add_collection(lines)


def _add_legend(figure: Figure, drawn: Sequence[_Drawn]) -> None:
    """Adds one legend of the concepts that occur, in their order, below everything."""
    present: dict[str, tuple[int, Line2D]] = {}
    for graph, *_ in drawn:
        for label in np.unique(graph.nodes.label).tolist():
            name = ontology_of(graph).names[label]
            present.setdefault(name, (label, _handle(ontology_of(graph), label)))
    handles = [handle for _, handle in sorted(present.values(), key=lambda pair: pair[0])]
    if any(part is not None for _, *confidence in drawn for part in confidence):
        handles.append(faint_handle())
    put_legend(figure, handles)


def put_legend(figure: Figure, handles: Sequence[Line2D | Patch]) -> None:
    """Puts a legend below everything, in as many rows as it needs."""
    letters = sum(len(f"{handle.get_label()}") for handle in handles)
    length = LEGEND_MARK * len(handles) + LEGEND_LETTER * letters
    columns = math.ceil(len(handles) / math.ceil(length / figure.get_figwidth()))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)


def _handle(ontology: Ontology, concept: int) -> Line2D:
    style, name = styles_of(ontology)[concept], ontology.names[concept]
    handle = Line2D([], [], color=style.colour, label=name, linewidth=PLANE_WIDTH)
    handle.set(marker="o", markersize=style.size, markeredgewidth=0)
    handle.set_linestyle("solid" if are_segments(ontology)[concept] else "none")
    return handle


def faint_handle() -> Line2D:
    """Returns the line of a legend that says what is faint."""
    (colour,) = faded(EDGE_COLOUR, np.array([0.5]))
    handle = Line2D([], [], color=colour, label=FAINT, linewidth=PLANE_WIDTH)
    handle.set(marker="o", markersize=LEAST_SIZE, markeredgewidth=0)
    return handle


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure to a file whose suffix names the format.

    Raises:
      ValueError: the format is unknown or the file cannot be written.
    """
    suffix = Path(path).suffix[1:].lower()
    known = figure.canvas.get_supported_filetypes()
    if suffix not in known:
        raise ValueError(f"{path}: {suffix!r} is no picture format, expected {', '.join(known)}")
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=RESOLUTION)
