"""A scene graph in space, as plotly takes it: traces that are its layers, and the view of them.

A layer is one or two traces, so that cities stay fluid. Where a confidence is given, what is unsure
is faint. Then the points of a trace have colours of their own, of which the legend would show the
first or none: its keys are traces without points.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY
from sg3d_jax.viz.hover import escaped
from sg3d_jax.viz.style import (
    EDGE_COLOUR,
    FAINT,
    are_segments,
    check_confidence,
    crowding,
    drawn_metre,
    faded,
    lifted,
    plane_segments,
    project,
    styles_of,
    view_of,
)

PROXIMITY_COLOUR: Final = "#b794f4"
LINE_WIDTH: Final = 2.0  # pixels
DOT_SCALE: Final = 1.4  # pixels of a dot here, a point of its diameter in a picture
STRIP_HEIGHT: Final = 0.5  # drawn metres; a plane is drawn as a strip around its centroid
STRIP_OPACITY: Final = 0.35
NORMAL_LENGTH: Final = 0.3  # drawn metres
FILL: Final = 1.5  # plotly's units, the height of a scene that just fits its window
WIDE: Final = 1.1  # width of the place beside the plan, in heights
DISTANCE: Final = 2.0  # of the camera, in sizes of the scene; without effect on what is seen
MARGIN: Final = 0.5  # metres around a scene
DECIMALS: Final = 3  # of drawn coordinates, millimetres

AXIS: Final = {
    "title": {"text": ""},
    "ticksuffix": " m",
    "tickfont": {"color": "#98a2b3", "size": 11},
    "showbackground": False,
    "showgrid": False,
    "showline": True,
    "linecolor": "#d0d5dd",
    "ticks": "outside",
    "tickcolor": "#d0d5dd",
    "showspikes": False,
    "zeroline": False,
}


def graph_traces(
    graph: SceneGraph,
    concepts: Sequence[int] | None = None,
    node_confidence: Array | None = None,
    edge_confidence: Array | None = None,
) -> list[dict[str, Any]]:
    """Returns the plotly traces of a host graph: its edges, planes, then nodes.

    Args:
      graph: unpadded, metres.
      concepts: what gets a layer; None for all. A page gives all its graphs the same layers, empty
        or not, so that a hidden layer stays hidden when another graph is chosen.
      node_confidence: float[n], 0 to 1; None for all alike.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`; None for all alike.

    Returns:
      Traces whose `customdata` is the node that each point stands for; the page looks its text up,
      so that a text is stored once.

    Raises:
      ValueError: a confidence is not that of so many nodes or edges.
    """
    check_confidence(graph, node_confidence, edge_confidence)
    points, label = lifted(graph), np.asarray(graph.nodes.label)
    concepts = range(ontology_of(graph).num_concepts) if concepts is None else concepts
    rows = [(concept, np.flatnonzero(label == concept)) for concept in concepts]
    scale, thin = DOT_SCALE * crowding(graph), LINE_WIDTH * crowding(graph)
    part_of, proximity = (points[undirected_edges(graph, r)] for r in (PART_OF, PROXIMITY))
    dots = [_dots(graph, concept, points[chosen], chosen, scale) for concept, chosen in rows]
    edges = _lines("part of", part_of, EDGE_COLOUR, thin, legendrank=1001)
    planes, keys = _planes(graph), []
    if node_confidence is not None:
        keys += [_key(trace) for trace in dots]
        for trace in (*planes, *dots):
            _fade(trace, np.asarray(node_confidence)[np.array(trace["customdata"], int)])
    if edge_confidence is not None:
        keys.append(_key(edges))
        _fade(edges, np.repeat(edge_confidence, 3))
    return [
        _lines(
            "proximity", proximity, PROXIMITY_COLOUR, thin, visible="legendonly", legendrank=1002
        ),
        edges,
        *planes,
        *dots,
        *keys,
        *([_faint_key()] if keys else []),
    ]


def _planes(graph: SceneGraph) -> list[dict[str, Any]]:
    """Returns the strips of the planes, and a line along each with its normal, by concept."""
    concepts = np.flatnonzero(are_segments(ontology_of(graph))).tolist()
    return [trace for concept in concepts for trace in _planes_of(graph, concept, concepts[0])]


def _planes_of(graph: SceneGraph, concept: int, first: int) -> list[dict[str, Any]]:
    name = escaped(ontology_of(graph).names[concept])
    colour = styles_of(ontology_of(graph))[concept].colour
    ends, metre = plane_segments(graph, concept), drawn_metre(graph)
    middle = ends.mean(axis=1)
    rows = np.flatnonzero(np.asarray(graph.nodes.label) == concept)
    normal = np.asarray(graph.nodes.normal)[rows]
    normals = np.stack([middle, middle + NORMAL_LENGTH * metre * normal], axis=1)
    up = np.array([[[0.0, 0.0, STRIP_HEIGHT * metre / 2]]])
    corners = np.concatenate([ends - up, ends + up], axis=1).reshape(-1, 3)
    corner = 4 * np.arange(len(ends))[:, None]
    triangles = np.concatenate([corner + np.array([[0, 1, 2]]), corner + np.array([[1, 3, 2]])])
    strips = {
        "type": "mesh3d",
        "uid": "strips" if concept == first else f"{name} strips",
        "legendgroup": name,
        **_coordinates(corners),
        **dict(zip("ijk", triangles.T.tolist(), strict=True)),
        "color": colour,
        "opacity": STRIP_OPACITY,
        "flatshading": True,
        "lighting": {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0},
        "hoverinfo": "text",
        "customdata": np.repeat(rows, 4).tolist(),
    }
    lines = _lines(
        f"{name} lines",
        np.concatenate([ends, normals]),
        colour,
        LINE_WIDTH,
        legendgroup=name,
        showlegend=False,
        hoverinfo="text",
        customdata=np.tile(np.repeat(rows, 3), 2).tolist(),
    )
    return [strips, lines]


def _dots(
    graph: SceneGraph, concept: int, points: np.ndarray, rows: np.ndarray, scale: float
) -> dict[str, Any]:
    style, name = styles_of(ontology_of(graph))[concept], ontology_of(graph).names[concept]
    return {
        "type": "scatter3d",
        "uid": escaped(name),
        "legendgroup": escaped(name),
        "name": escaped(name),
        "mode": "markers",
        **_coordinates(points),
        "marker": {
            "color": style.colour,
            "size": round(style.size * scale, 2),
            "opacity": 1.0,
            "line": {"color": "#ffffff", "width": 1},
        },
        "hoverinfo": "text",
        "customdata": rows.tolist(),
    }


def _lines(
    name: str, ends: np.ndarray, colour: str, width: float, **options: Any
) -> dict[str, Any]:
    """Returns one trace of separate lines, float[n, 2, 3]."""
    gaps = np.full((len(ends), 1, 3), np.nan)
    return {
        "type": "scatter3d",
        "uid": name,
        "legendgroup": name,
        "name": name,
        "mode": "lines",
        **_coordinates(np.concatenate([ends, gaps], axis=1).reshape(-1, 3)),
        "line": {"color": colour, "width": round(width, 2)},
        "hoverinfo": "skip",
    } | options


def _fade(trace: dict[str, Any], confidence: np.ndarray) -> None:
    """Gives each point of a trace a colour of its own, the fainter the less sure it is."""
    if "color" in trace:  # a mesh
        trace["vertexcolor"] = faded(trace["color"], confidence)
        return
    paint = trace["line" if trace["mode"] == "lines" else "marker"]
    paint["color"] = faded(paint["color"], confidence)
    trace["showlegend"] = False


def _key(trace: dict[str, Any]) -> dict[str, Any]:
    """Returns what the legend shows for a trace: the same without points, in one colour."""
    own = ("type", "legendgroup", "name", "mode", "legendrank")
    paint = "line" if trace["mode"] == "lines" else "marker"
    return {
        **{name: trace[name] for name in own if name in trace},
        **{axis: [None] for axis in "xyz"},
        "uid": f"{trace['uid']} key",
        paint: dict(trace[paint]),
        "hoverinfo": "skip",
    }


def _faint_key() -> dict[str, Any]:
    """Returns the line of the legend that says what is faint."""
    (colour,) = faded(EDGE_COLOUR, np.array([0.5]))
    nothing = np.zeros((0, 2, 3))
    return _key(_lines(FAINT, nothing, colour, LINE_WIDTH, uid="faint", legendrank=1003))


def _coordinates(points: np.ndarray) -> dict[str, list[float | None]]:
    """Returns x, y and z; NaN, which ends a line, is null in JSON."""
    columns = (np.round(points, DECIMALS) + 0.0).T.tolist()
    return {
        axis: [None if np.isnan(value) else value for value in column]
        for axis, column in zip("xyz", columns, strict=True)
    }


def layout_of(graph: SceneGraph, marks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the plotly layout of a page that shows a host graph, and traces of marks."""
    return {
        "scene": _scene(graph, marks),
        "font": {"family": "system-ui, sans-serif"},
        "hoverlabel": {"align": "left", "bgcolor": "#ffffff", "font": {"size": 13}},
        "legend": {"font": {"size": 15}, "itemsizing": "constant", "x": 0.01, "y": 0.99},
        "margin": {"b": 0, "l": 0, "r": 0, "t": 0},
        "modebar": {"bgcolor": "#ffffff", "color": "#98a2b3", "activecolor": "#475467"},
        "uirevision": "kept",  # another graph of the page keeps the layers and the view
    }


def _scene(graph: SceneGraph, marks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the view: fixed ranges, so that nothing moves when a layer is hidden."""
    azimuth = view_of(graph)
    marked = [np.array([mark[axis] for axis in "xyz"], float).T.reshape(-1, 3) for mark in marks]
    points = np.concatenate([lifted(graph), plane_segments(graph).reshape(-1, 3), *marked])
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    seen = project(points - (low + high)[None] / 2, azimuth)
    width, height = np.ptp(seen, axis=0) + 2 * MARGIN
    scale = FILL / max(width / WIDE, height)
    axes = project(np.eye(3), azimuth)  # right and up, as columns
    centre = axes @ (seen.min(axis=0) + seen.max(axis=0)) / 2 * scale
    eye = centre + DISTANCE * np.cross(axes[:, 0], axes[:, 1])
    ranges = [{"range": np.round(ends, DECIMALS).tolist()} for ends in zip(low, high, strict=True)]
    return {
        "aspectmode": "manual",
        "aspectratio": _by_axis((high - low) * scale),
        "camera": {
            "center": _by_axis(centre),
            "eye": _by_axis(eye),
            "projection": {"type": "orthographic"},
        },
        "dragmode": "turntable",
        "xaxis": AXIS | ranges[0],
        "yaxis": AXIS | ranges[1],
        "zaxis": {"visible": False} | ranges[2],
    }


def _by_axis(values: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", np.round(values, 6).tolist(), strict=True))
