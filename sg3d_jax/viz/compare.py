"""What a scene graph has otherwise than a truth, and how it is marked in space.

What is grown stands for its concept and the segments below it: it is right if the truth has a node
that stands for the same. Nodes of which the truth has none are framed; those that the truth alone
has are empty circles, with dashed edges.
"""

from collections import Counter
from collections.abc import Hashable, Set
from typing import Any, Final

import numpy as np

from sg3d_jax.metrics.calibration import observed_below
from sg3d_jax.scene.graph import SceneGraph, ontology_of, parts_first
from sg3d_jax.viz.style import MISSING_COLOUR, are_segments, drawn_metre, lifted, styles_of

ODD: Final = "not so in the truth"
MISSING: Final = "in the truth alone"
FRAME: Final = 1.6  # size, in that of a dot
LINE_WIDTH: Final = 2.0  # pixels
AS_DIAMETER: Final = 0.5  # plotly halves sizes that are a list, and no single one


def matched(graph: SceneGraph, truth: SceneGraph) -> np.ndarray:
    """Returns the node of a host graph that stands for the same as each node of a truth.

    Args:
      graph: unpadded, metres.
      truth: the like, of the same segments, in any order; what it has beyond them counts for
        nothing.

    Returns:
      int64[m], -1 for nodes of the truth that the graph has none for.
    """
    known = {_place(graph, row) for row in np.flatnonzero(graph.nodes.observed).tolist()}
    rows = {stands_for: row for row, stands_for in enumerate(_identities(graph, known))}
    return np.array([rows.get(stands_for, -1) for stands_for in _identities(truth, known)], int)


def is_odd(graph: SceneGraph, match: np.ndarray) -> np.ndarray:
    """Returns bool[n], the grown nodes of a graph that are not so in a truth.

    Args:
      graph: unpadded.
      match: what `matched` returned for it.
    """
    odd = ~np.asarray(graph.nodes.observed)
    odd[match[match >= 0]] = False
    return odd


def is_missing(truth: SceneGraph, match: np.ndarray) -> np.ndarray:
    """Returns bool[m], the grown nodes of a truth that a graph has none for."""
    return (match < 0) & ~np.asarray(truth.nodes.observed)


def mark_traces(
    graph: SceneGraph, truth: SceneGraph, match: np.ndarray, scale: float
) -> list[dict[str, Any]]:
    """Returns the plotly traces that mark in space what differs.

    Args:
      graph: unpadded, metres.
      truth: of the same segments.
      match: what `matched` returned for them.
      scale: pixels of a dot, for each point of its diameter in a picture.

    Returns:
      Frames, empty circles and dashed edges. In `customdata`, a missing node of the truth follows
      all of the graph: the first of them is n.
    """
    odd = np.flatnonzero(is_odd(graph, match))
    missing = np.flatnonzero(is_missing(truth, match))
    places, pairs = _places(graph, truth, match), parts_first(truth)
    edges = places[pairs[np.isin(pairs, missing).any(axis=1)]]
    edges = edges[np.isfinite(edges).all(axis=(1, 2))]
    gaps = np.full((len(edges), 1, 3), np.nan)
    frames, circles = (
        {
            "mode": "markers",
            "hoverinfo": "text",
            "marker": {
                "symbol": symbol,
                "color": MISSING_COLOUR,
                "size": np.round(sizes * scale, 2).tolist(),
                "sizeref": AS_DIAMETER,
                "line": {"color": MISSING_COLOUR, "width": LINE_WIDTH},
            },
        }
        for symbol, sizes in (
            ("diamond-open", FRAME * _sizes(graph)[odd]),
            ("circle-open", _sizes(truth)[missing]),
        )
    )
    dashes = {
        "mode": "lines",
        "showlegend": False,
        "hoverinfo": "skip",
        "line": {"color": MISSING_COLOUR, "width": LINE_WIDTH, "dash": "dash"},
    }
    after = len(graph.nodes.label) + np.arange(len(missing))
    return [
        _trace("odd", ODD, lifted(graph)[odd]) | frames | {"customdata": odd.tolist()},
        _trace("missing", MISSING, places[missing]) | circles | {"customdata": after.tolist()},
        _trace("missing edges", MISSING, np.concatenate([edges, gaps], axis=1).reshape(-1, 3))
        | dashes,
    ]


def _place(graph: SceneGraph, row: int) -> tuple[float, ...]:
    """Returns where a node is, in whole millimetres."""
    return tuple(np.round(graph.nodes.position[row] * 1000).tolist())


def _identities(graph: SceneGraph, known: Set[tuple[float, ...]]) -> list[Hashable]:
    """Returns what each node stands for, and how many such came before it.

    Args:
      graph: unpadded.
      known: the places of segments that count.
    """
    names, observed = ontology_of(graph).names, np.flatnonzero(graph.nodes.observed)
    places = [_place(graph, row) for row in observed.tolist()]
    counted = are_segments(ontology_of(graph))[graph.nodes.label[observed]]
    counted &= np.array([place in known for place in places], bool)
    own = dict(zip(observed.tolist(), places, strict=True))
    before, found = Counter[Hashable](), list[Hashable]()
    for row, below in enumerate(observed_below(graph) & counted):
        over = frozenset(places[place] for place in np.flatnonzero(below).tolist())
        stands_for = names[graph.nodes.label[row]], own.get(row, over)
        found.append((stands_for, before[stands_for]))
        before[stands_for] += 1
    return found


def _places(graph: SceneGraph, truth: SceneGraph, match: np.ndarray) -> np.ndarray:
    """Returns where the nodes of a truth are drawn beside a graph, float64[m, 3], metres.

    Those that the graph has are where it has them, others on the storey of what is below them; NaN
    for what is observed in the truth alone.
    """
    drawn, label = lifted(graph), np.asarray(truth.nodes.label)
    raised = np.append(drawn[:, 2] - graph.nodes.position[:, 2], 0.0)  # the last for -1
    observed = np.flatnonzero(truth.nodes.observed)
    storeys = np.where(observed_below(truth), raised[match[observed]], 0.0).max(axis=1, initial=0)
    lifts = np.array([style.lift for style in styles_of(ontology_of(truth))])[label]
    places = np.array(truth.nodes.position, np.float64)
    places[:, 2] += storeys + lifts * drawn_metre(graph)
    places[observed] = np.nan
    places[match >= 0] = drawn[match[match >= 0]]
    return places


def _sizes(graph: SceneGraph) -> np.ndarray:
    """Returns how large the dot of each node is in a picture, points."""
    sizes = np.array([style.size for style in styles_of(ontology_of(graph))])
    return sizes[np.asarray(graph.nodes.label)]


def _trace(uid: str, name: str, points: np.ndarray) -> dict[str, Any]:
    columns = np.round(points, 3).T.tolist()
    axes = [[None if np.isnan(value) else value for value in column] for column in columns]
    named = {"uid": uid, "legendgroup": name, "name": name, "legendrank": 1004}
    return {"type": "scatter3d", **named, **dict(zip("xyz", axes, strict=True))}
