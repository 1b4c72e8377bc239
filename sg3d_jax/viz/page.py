"""Scene graphs as one interactive page: turn it, switch layers on and off, read what nodes hold.

Beside a graph in space (`space`) stands its plan (`plan_page`), floor by floor.

A page is one file that works offline: plotly's program (about 5 MB; its smaller bundles do not come
with the Python package) is inside, and the page's own policy forbids it to load anything else. The
same graphs give the same bytes. A graph is read only when it is chosen, so that a page of a hundred
opens like one of one.
"""

import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.io.files import replacing
from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of
from sg3d_jax.scene.padding import unpad_all
from sg3d_jax.viz.compare import is_missing, mark_traces, matched
from sg3d_jax.viz.hover import hover_text
from sg3d_jax.viz.plan_page import plan_of_page
from sg3d_jax.viz.space import DOT_SCALE, graph_traces, layout_of
from sg3d_jax.viz.style import crowding

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
    """Writes graphs as one self-contained interactive HTML page.

    Args:
      graphs: metres; one is shown at a time, chosen from a list.
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

    graphs = unpad_all(graphs)
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
            "layout": layout_of(graph, traces),
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


def _counts(graph: SceneGraph) -> str:
    names = ontology_of(graph).names
    counts = np.bincount(graph.nodes.label, minlength=len(names)).tolist()
    named = zip(counts, names, strict=True)
    return " · ".join(f"{name} {count}" for count, name in named if count)


def _script(value: object) -> str:
    """Returns an element that holds JSON, which no browser reads before it is asked to."""
    return f'<script class="graph" type="application/json">{_script_json(value)}</script>'


def _script_json(value: object) -> str:
    """Returns JSON that cannot end the script element that holds it."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
