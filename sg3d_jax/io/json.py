"""Scene graphs as JSON: one graph a .json file, or one a line of a .jsonl file.

`{"nodes": [{"id", "label", "position", "normal", "width"}, ...], "edges": [[u, v], ...], ...}`:
`normal` and `width` are null for all but planes, `edges` are the part-of edges, child first, by id.
Proximity edges, if the graph has any, are under `proximity_edges`. Numbers survive exactly.
"""

from typing import Any

import numpy as np

from sg3d_jax.io.files import (
    number,
    vector,
)
from sg3d_jax.scene.ontology import CONCEPTS, PART_OF, PLANE, PROXIMITY
from sg3d_jax.scene.graph import SceneGraph, make_graph, undirected_edges
from sg3d_jax.scene.validate import validate_graph


def graph_to_dict(graph: SceneGraph, **extra: Any) -> dict[str, Any]:
    """Returns a host graph as a JSON document.

    Args:
      graph: unpadded, metres.
      **extra: what else the document should say, such as `halt_reason`; JSON values.

    Returns:
      The document; node ids are row numbers.
    """
    label = np.asarray(graph.nodes.label)
    columns = (np.asarray(field).tolist() for field in graph.nodes[:4])
    nodes = [
        {
            "id": row,
            "label": CONCEPTS[concept],
            "position": position,
            "normal": normal if concept == PLANE else None,
            "width": width if concept == PLANE else None,
        }
        for row, (concept, position, normal, width) in enumerate(zip(*columns, strict=True))
    ]
    pairs = undirected_edges(graph, PART_OF)
    child_first = np.take_along_axis(pairs, np.argsort(label[pairs], axis=1, kind="stable"), axis=1)
    proximity = undirected_edges(graph, PROXIMITY).tolist()
    optional = {"proximity_edges": proximity} if proximity else {}
    return dict(nodes=nodes, edges=child_first.tolist(), **optional, **extra)


def graph_from_dict(document: Any, where: str = "graph") -> SceneGraph:
    """Returns the host graph of a JSON document; keys it does not know are ignored.

    A graph that breaks the hierarchy is returned all the same: models may draw such graphs, and
    they are to be scored and looked at. `validate_graph` refuses them.

    Args:
      document: parsed JSON, not yet trusted.
      where: what an error starts with, such as "graphs.jsonl: line 3".

    Raises:
      ValueError: one sentence that names the node or edge, the field and what was expected.
    """
    for key in ("nodes", "edges"):
        if not isinstance(document, dict) or not isinstance(document.get(key), list):
            raise ValueError(f"{where}: there is no list {key!r}, expected nodes and edges")
    nodes = document["nodes"]
    rows = [_node(node, f"{where}: nodes[{index}]") for index, node in enumerate(nodes)]
    label, position, normal, width = zip(*rows, strict=True) if rows else ((), (), (), ())
    row_of_id = _rows_by_id(nodes, where)
    graph = make_graph(
        label,
        np.asarray(position, np.float64),
        np.asarray(normal, np.float64),
        np.asarray(width, np.float64),
        part_of=_pairs(document, "edges", row_of_id, where),
        proximity=_pairs(document, "proximity_edges", row_of_id, where),
    )
    validate_graph(graph, where, rules=False)
    return graph


def _node(node: Any, where: str) -> tuple[int, list[float], list[float], float]:
    """Returns label, position, normal and width; null becomes zero."""
    if not isinstance(node, dict):
        raise ValueError(f"{where} is {node!r:.40}, expected an object")
    for key in ("id", "label", "position"):
        if key not in node:
            raise ValueError(f"{where} lacks {key!r}, expected id, label and position")
    if node["label"] not in CONCEPTS:
        names = ", ".join(CONCEPTS)
        raise ValueError(f"{where}.label is {node['label']!r:.40}, expected one of {names}")
    normal, width = node.get("normal"), node.get("width")
    return (
        CONCEPTS.index(node["label"]),
        vector(node["position"], f"{where}.position"),
        [0.0, 0.0, 0.0] if normal is None else vector(normal, f"{where}.normal"),
        0.0 if width is None else number(width, f"{where}.width"),
    )


def _rows_by_id(nodes: list[dict[str, Any]], where: str) -> dict[int | str, int]:
    row_of_id: dict[int | str, int] = {}
    for row, node in enumerate(nodes):
        name = node["id"]
        if isinstance(name, bool) or not isinstance(name, (int, str)):
            raise ValueError(f"{where}: nodes[{row}].id is {name!r:.40}, expected an integer")
        if name in row_of_id:
            raise ValueError(f"{where}: nodes[{row}].id is {name!r:.40} again, expected unique ids")
        row_of_id[name] = row
    return row_of_id


def _pairs(
    document: dict[str, Any], key: str, row_of_id: dict[int | str, int], where: str
) -> np.ndarray:
    edges = document.get(key, [])
    if not isinstance(edges, list):
        raise ValueError(f"{where}: {key} is no list, expected pairs of node ids")
    rows = [_pair(edge, row_of_id, f"{where}: {key}[{i}]") for i, edge in enumerate(edges)]
    return np.asarray(rows, np.int32).reshape(-1, 2)


def _pair(edge: Any, row_of_id: dict[int | str, int], where: str) -> list[int]:
    if not isinstance(edge, list) or len(edge) != 2:
        raise ValueError(f"{where} is {edge!r:.40}, expected a pair of node ids")
    for end in edge:
        if isinstance(end, (bool, float, list, dict)) or end not in row_of_id:
            raise ValueError(f"{where} names {end!r:.40}, expected the id of a node")
    return [row_of_id[end] for end in edge]
