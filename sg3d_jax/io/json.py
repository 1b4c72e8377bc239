"""Scene graphs as JSON: one graph a .json file, or one a line of a .jsonl file.

`{"nodes": [{"id", "label", "position", "normal", "width"}, ...], "edges": [[u, v], ...], ...}`:
`label` is the name of a concept, `normal` and `width` are null for concepts that have none, `edges`
are the part-of edges, the part first, by id. Proximity edges, if the graph has any, are under
`proximity_edges`; concepts that are not the paper's under `ontology`. Numbers survive exactly.
Further keys of a node are its attributes (`io.attributes`), and so is an id that is not its row.
`edge_confidence`, if there is one, has a number from 0 to 1 for each of `edges`.
"""

from typing import Any, Final

import numpy as np

from sg3d_jax.io.attributes import (
    ID,
    Attributes,
    Read,
    check_id,
    edge_confidence_of,
    further,
    node_ids,
    own,
)
from sg3d_jax.io.files import vector
from sg3d_jax.io.records import Record, features_by_row, features_in, graph_of, ontology_in, stated
from sg3d_jax.scene.graph import (
    Array,
    SceneGraph,
    ontology_of,
    parts_first,
    undirected_edges,
)
from sg3d_jax.scene.ontology import PROXIMITY, Ontology
from sg3d_jax.scene.validate import validate_graph

SURE: Final = "edge_confidence"


def graph_to_dict(
    graph: SceneGraph,
    attributes: Attributes | None = None,
    edge_confidence: Array | None = None,
    **extra: Any,
) -> dict[str, Any]:
    """Returns a host graph as a JSON document.

    Args:
      graph: unpadded, metres.
      attributes: what else to say of each node, of `check_attributes`.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`.
      **extra: what else the document should say, such as `halt_reason`; JSON values.

    Returns:
      The document; node ids are row numbers, unless attributes say otherwise.
    """
    ontology = ontology_of(graph)
    names, absent = ontology.names, dict.fromkeys(ontology.features)
    columns = (np.asarray(field).tolist() for field in (graph.nodes.label, graph.nodes.position))
    held: Attributes = [{}] * len(graph.nodes.label) if attributes is None else attributes
    ids = node_ids(held)
    nodes = [
        {ID: name, "label": names[label], "position": position, **absent, **owned}
        | further(others, (ID,))
        for name, label, position, owned, others in zip(
            ids, *columns, features_by_row(graph), held, strict=True
        )
    ]
    edges, proximity = (
        [[ids[first], ids[second]] for first, second in pairs.tolist()]
        for pairs in (parts_first(graph), undirected_edges(graph, PROXIMITY))
    )
    optional = {"proximity_edges": proximity} if proximity else {}
    if edge_confidence is not None:
        optional |= {SURE: np.asarray(edge_confidence).tolist()}
    return dict(**stated(ontology), nodes=nodes, edges=edges, **optional, **extra)


def graph_from_dict(document: Any, where: str = "graph") -> SceneGraph:
    """Returns the host graph of a JSON document, as `read_dict` does, without attributes."""
    return read_dict(document, where).graph


def read_dict(document: Any, where: str = "graph") -> Read:
    """Returns the host graph of a JSON document, and further keys of its nodes.

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
    ontology, nodes = ontology_in(document, where), document["nodes"]
    rows = [_node(node, ontology, f"{where}: nodes[{index}]") for index, node in enumerate(nodes)]
    row_of_id = _rows_by_id(nodes, where)
    part_of = _pairs(document, "edges", row_of_id, where)
    proximity = _pairs(document, "proximity_edges", row_of_id, where)
    graph = graph_of(rows, ontology, part_of, proximity)
    validate_graph(graph, where, rules=False)
    said = document.get(SURE)
    fits = isinstance(said, list) and len(said) == len(part_of)
    sure = edge_confidence_of(part_of, said) if fits else None
    return Read(graph, [further(node, own(ontology)) for node in nodes], sure)


def _node(node: Any, ontology: Ontology, where: str) -> Record:
    if not isinstance(node, dict):
        raise ValueError(f"{where} is {node!r:.40}, expected an object")
    for key in ("id", "label", "position"):
        if key not in node:
            raise ValueError(f"{where} lacks {key!r}, expected id, label and position")
    if node["label"] not in ontology.names:
        names = ", ".join(ontology.names)
        raise ValueError(f"{where}.label is {node['label']!r:.40}, expected one of {names}")
    position = vector(node["position"], f"{where}.position")
    label = ontology.names.index(node["label"])
    return Record(label, position, features_in(node, where, ontology.concepts[label]))


def _rows_by_id(nodes: list[dict[str, Any]], where: str) -> dict[int | str, int]:
    row_of_id: dict[int | str, int] = {}
    for row, node in enumerate(nodes):
        check_id(node[ID], row_of_id, f"{where}: nodes[{row}]")
        row_of_id[node[ID]] = row
    return row_of_id


def _pairs(
    document: dict[str, Any], key: str, row_of_id: dict[int | str, int], where: str
) -> list[list[int]]:
    edges = document.get(key, [])
    if not isinstance(edges, list):
        raise ValueError(f"{where}: {key} is no list, expected pairs of node ids")
    return [_pair(edge, row_of_id, f"{where}: {key}[{i}]") for i, edge in enumerate(edges)]


def _pair(edge: Any, row_of_id: dict[int | str, int], where: str) -> list[int]:
    if not isinstance(edge, list) or len(edge) != 2:
        raise ValueError(f"{where} is {edge!r:.40}, expected a pair of node ids")
    for end in edge:
        if isinstance(end, (bool, float, list, dict)) or end not in row_of_id:
            raise ValueError(f"{where} names {end!r:.40}, expected the id of a node")
    return [row_of_id[end] for end in edge]
