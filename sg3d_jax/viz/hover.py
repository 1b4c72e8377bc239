"""What a page says of a node when a pointer rests on it."""

import html
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from sg3d_jax.io.records import KIND, kind_name
from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of, parts_first
from sg3d_jax.scene.ontology import FEATURES
from sg3d_jax.viz.style import called, check_confidence

IDS_SHOWN: Final = 12
UNITS: Final = {"width": " m"}  # of features


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
    own = range(len(label)) if node_names is None else node_names
    names = [
        escaped(called(ontology.names[concept], name))
        for concept, name in zip(label, own, strict=True)
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


def escaped(name: str) -> str:
    """Returns a name from a file as text: plotly takes some tags for markup."""
    return html.escape(name, quote=False)
