"""Scene graphs as one interactive page: turn it, switch layers on and off, read what nodes hold.

Beside a graph in space stands its plan (`plan_page`), floor by floor.

A page is one file that works offline: plotly's program (about 5 MB; its smaller bundles do not come
with the Python package) is inside, and the page's own policy forbids it to load anything else. The
same graphs give the same bytes. A layer is one or two traces, so that cities stay fluid; a graph is
read only when it is chosen, so that a page of a hundred opens like one of one.

Where a confidence is given, what is unsure is faint. Then the points of a trace have colours of
their own, of which the legend would show the first or none: its keys are traces without points.
"""

import html
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.io.files import replacing
from sg3d_jax.io.records import KIND, kind_name
from sg3d_jax.scene.graph import (
    Array,
    SceneGraph,
    ontology_of,
    parts_first,
    undirected_edges,
)
from sg3d_jax.scene.ontology import FEATURES, PART_OF, PROXIMITY
from sg3d_jax.viz.compare import is_missing, mark_traces, matched
from sg3d_jax.viz.plan_page import plan_of_page
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
IDS_SHOWN: Final = 12
DECIMALS: Final = 3  # of drawn coordinates, millimetres
UNITS: Final = {"width": " m"}  # of features

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
BUTTONS: Final = ["toImage", "pan3d", "orbitRotation", "tableRotation", "resetCameraDefault3d"]
CONFIG: Final = {
    "modeBarButtons": [BUTTONS],
    "displaylogo": False,
    "responsive": True,
    "scrollZoom": True,
    "showTips": False,
}
FLAT: Final = CONFIG | {"displayModeBar": False}  # of plans
MARKS: Final = "hatched: not so in the truth; dashed: in the truth alone"


def save_page(
    graphs: Sequence[SceneGraph],
    path: str | Path,
    title: str | None = None,
    names: Sequence[str] | None = None,
    node_confidence: Sequence[Array | None] | None = None,
    edge_confidence: Sequence[Array | None] | None = None,
    reload: float | None = None,
    node_names: Sequence[Sequence[int | str]] | None = None,
    truth: Sequence[SceneGraph] | None = None,
    truth_names: Sequence[Sequence[int | str]] | None = None,
) -> None:
    """Writes host graphs as one self-contained interactive HTML page.

    Args:
      graphs: unpadded, metres; one is shown at a time, chosen from a list.
      path: the file to write.
      title: of the page; plain text.
      names: of the graphs in the list, such as "truth" and "grown"; numbered by default.
      node_confidence: of each graph float[n], 0 to 1: nodes are the fainter the less sure they are,
        and say it; None for one whose nodes are alike.
      edge_confidence: likewise float[e], of the rows of `parts_first(graph)`.
      reload: seconds after which the page loads itself again, if it is written again and again: it
        then keeps the view; 0 for the last such page. None for a page that stays.
      node_names: of each graph what its nodes are called, such as their ids; their rows by default.
      truth: of each graph that of the same segments which is true: its plan is shown below, and
        what differs is marked in space and in the plan above it.
      truth_names: of each truth what its nodes are called; their rows by default.

    Raises:
      ValueError: there is nothing to show, names or truths are too few or too many, the graphs have
        different ontologies, so that they share no layers, a confidence is not that of so many
        nodes or edges, or the file cannot be written.
    """
    from plotly.offline import get_plotlyjs

    if not graphs:
        raise ValueError(f"{path}: there are no graphs, expected at least one to show")
    if names is None:
        names = [f"graph {index}" for index in range(len(graphs))]
    nothing = [None] * len(graphs)
    if node_names is None:
        node_names = [_rows(graph) for graph in graphs]
    truths = nothing if truth is None else truth
    if truth_names is None:
        truth_names = [() if true is None else _rows(true) for true in truths]
    for what, given in (("names", names), ("truths", truths), ("names of truths", truth_names)):
        if len(given) != len(graphs):
            counts = f"{len(given)} {what} for {len(graphs)} graphs"
            raise ValueError(f"{path}: {counts}, expected one each")
    if any(ontology_of(graph) != ontology_of(graphs[0]) for graph in graphs):
        raise ValueError(f"{path}: graphs have different ontologies, expected one a page")
    used = sorted(
        {concept for graph in graphs for concept in np.unique(graph.nodes.label).tolist()}
    )
    of_nodes = nothing if node_confidence is None else node_confidence
    of_edges = nothing if edge_confidence is None else edge_confidence
    marks = [_marks(*each) for each in zip(graphs, truths, truth_names, strict=True)]
    shown = [
        {
            "counts": _counts(graph),
            "text": hover_text(graph, *sure, called) + texts,
            "data": graph_traces(graph, used, *sure) + traces,
            "layout": _layout(graph, traces),
            "plans": _plans(graph, called, sure[0], true, true_called),
        }
        for graph, called, true, true_called, (texts, traces), *sure in zip(
            graphs, node_names, truths, truth_names, marks, of_nodes, of_edges, strict=True
        )
    ]
    again = {} if reload is None else {"reload": reload}
    parts = {
        "title": html.escape(title or "scene graph"),
        "data": _script_json({"names": [*names], "config": CONFIG, "flat": FLAT, **again}),
        "graphs": "\n".join(_script(graph) for graph in shown),
        "plotly": get_plotlyjs(),
    }
    page = resources.files("sg3d_jax.viz").joinpath("page.html").read_text(encoding="utf-8")
    pieces = page.replace("}}", "{{").split("{{")  # text, name, text, name, ..., text
    with replacing(path) as temporary:
        text = "".join(parts[piece] if i % 2 else piece for i, piece in enumerate(pieces))
        temporary.write_text(text, encoding="utf-8", newline="\n")


def _rows(graph: SceneGraph) -> range:
    return range(len(graph.nodes.label))


def _marks(
    graph: SceneGraph, truth: SceneGraph | None, truth_names: Sequence[int | str]
) -> tuple[list[str], list[dict[str, Any]]]:
    """Returns what marks in space what a truth has otherwise: texts of its nodes, and traces."""
    if truth is None:
        return [], []
    match, texts = matched(graph, truth), hover_text(truth, node_names=truth_names)
    traces = mark_traces(graph, truth, match, DOT_SCALE * crowding(graph))
    return [texts[row] for row in np.flatnonzero(is_missing(truth, match))], traces


def _plans(
    graph: SceneGraph,
    names: Sequence[int | str],
    node_confidence: Array | None,
    truth: SceneGraph | None,
    truth_names: Sequence[int | str],
) -> list[dict[str, Any]]:
    """Returns the plan of a graph, and that of the truth below it; none of what is not seen so."""
    plans = [plan_of_page(graph, "", names, node_confidence, truth)]
    if truth is not None:
        plans[0] = plans[0] and {**plans[0], "title": MARKS}
        below = plan_of_page(truth, "truth", truth_names)
        plans.append(below and {**below, "text": hover_text(truth, node_names=truth_names)})
    return [plan for plan in plans if plan is not None]


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


def hover_text(
    graph: SceneGraph,
    node_confidence: Array | None = None,
    edge_confidence: Array | None = None,
    node_names: Sequence[int | str] | None = None,
) -> list[str]:
    """Returns what a page says about each node of a host graph, in plotly's few HTML tags.

    Args:
      graph: unpadded, metres.
      node_confidence: float[n], 0 to 1; NaN for nodes of which it is not known.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`.
      node_names: what nodes are called, behind the name of their concept; None for their rows.

    Raises:
      ValueError: a confidence is not that of so many nodes or edges.
    """
    check_confidence(graph, node_confidence, edge_confidence)
    label, ontology = np.asarray(graph.nodes.label).tolist(), ontology_of(graph)
    pairs = parts_first(graph).tolist()
    sure = (
        [""] * len(pairs) if edge_confidence is None else [f" ({c:.2f})" for c in edge_confidence]
    )
    children: list[dict[int, str]] = [{} for _ in label]
    parents: list[dict[int, str]] = [{} for _ in label]
    for (child, parent), said in zip(pairs, sure, strict=True):
        children[parent][child] = said
        parents[child][parent] = said
    called = range(len(label)) if node_names is None else node_names
    names = [
        _escaped(f"{ontology.names[concept]} {name}")
        for concept, name in zip(label, called, strict=True)
    ]
    numbers_first = sorted(FEATURES, key=lambda name: len(FEATURES[name]))
    texts = []
    for row, concept in enumerate(label):
        lines = [f"<b>{names[row]}</b>", f"centroid {_vector(graph.nodes.position[row])} m"]
        for feature in numbers_first:
            if feature in ontology.concepts[concept].features:
                value = np.asarray(getattr(graph.nodes, feature)[row])
                shown = _vector(value) if value.ndim else f"{value:.2f}"
                if feature == KIND:
                    shown = kind_name(ontology.concepts[concept], float(value)) or "unknown"
                lines.append(f"{feature} {shown}{UNITS.get(feature, '')}")
        if node_confidence is not None and not np.isnan(node_confidence[row]):
            lines.append(f"confidence {node_confidence[row]:.2f}")
        number = "1 child" if len(children[row]) == 1 else f"{len(children[row])} children"
        lines += _kin("part of", parents[row], names) + _kin(f"{number}:", children[row], names)
        texts.append("<br>".join(lines))
    return texts


def _kin(heading: str, kin: Mapping[int, str], names: Sequence[str]) -> list[str]:
    """Returns a line that names other nodes, by row with what to say of each, or none."""
    if not kin:
        return []
    named = [names[row] + kin[row] for row in sorted(kin)[:IDS_SHOWN]]
    more = [f"{len(kin) - IDS_SHOWN} more"] if len(kin) > IDS_SHOWN else []
    return [f"{heading} {', '.join(named + more)}"]


def _vector(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in np.round(values, 2)) + ")"


def _escaped(name: str) -> str:
    """Returns a name from a file as text: plotly takes some tags for markup."""
    return html.escape(name, quote=False)


def _counts(graph: SceneGraph) -> str:
    names = ontology_of(graph).names
    counts = np.bincount(graph.nodes.label, minlength=len(names)).tolist()
    named = zip(counts, names, strict=True)
    return " · ".join(f"{name} {count}" for count, name in named if count)


def _planes(graph: SceneGraph) -> list[dict[str, Any]]:
    """Returns the strips of the planes, and a line along each with its normal, by concept."""
    concepts = np.flatnonzero(are_segments(ontology_of(graph))).tolist()
    return [trace for concept in concepts for trace in _planes_of(graph, concept, concepts[0])]


def _planes_of(graph: SceneGraph, concept: int, first: int) -> list[dict[str, Any]]:
    name = _escaped(ontology_of(graph).names[concept])
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
        "uid": _escaped(name),
        "legendgroup": _escaped(name),
        "name": _escaped(name),
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


def _layout(graph: SceneGraph, marks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
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


def _script(value: object) -> str:
    """Returns an element that holds JSON, which no browser reads before it is asked to."""
    return f'<script class="graph" type="application/json">{_script_json(value)}</script>'


def _script_json(value: object) -> str:
    """Returns JSON that cannot end the script element that holds it."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
