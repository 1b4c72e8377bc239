"""Adjacency and Cytoscape documents, as networkx, Cytoscape and their friends write graphs.

Adjacency: `networkx.adjacency_data`, the neighbours of each node in its place. Cytoscape: what
`networkx.cytoscape_data`, Cytoscape.js and the export of Cytoscape (.cyjs) have in common, nodes
and edges under `elements`, each with its attributes under `data`. Attributes are as in
`io.networkx`. Both are read only.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from sg3d_jax.io.attributes import ID, NAME, Read, further
from sg3d_jax.io.files import field
from sg3d_jax.io.networkx import objects, read_nodes_and_edges
from sg3d_jax.io.records import ontology_in
from sg3d_jax.scene.ontology import Ontology

VALUE: Final = "value"  # what networkx calls the node itself, of which `id` is the text


def read_adjacency(document: Any, where: str) -> Read:
    """Returns the host graph of an adjacency document, and what else it says of nodes and edges.

    Args:
      document: parsed JSON, not yet trusted.
      where: what an error starts with.

    Raises:
      ValueError: one sentence that names the node or edge, the field and what was expected.
    """
    nodes, rows = objects(document, "nodes", (ID,), where), document["adjacency"]
    if not isinstance(rows, list) or len(rows) != len(nodes):
        raise ValueError(f"{where}: adjacency is {rows!r:.40}, expected a list for each node")
    edges = (
        (node[ID], other[ID], other)
        for index, node in enumerate(nodes)
        for other in objects({"adjacency": rows[index]}, "adjacency", (ID,), f"{where}: {index}")
    )
    ontology = _ontology(document.get("graph"), where)
    return read_nodes_and_edges(((node[ID], node) for node in nodes), edges, where, ontology)


def read_cytoscape(document: Any, where: str) -> Read:
    """Returns the host graph of a Cytoscape document, as `read_adjacency`.

    Args:
      document: parsed JSON, not yet trusted.
      where: what an error starts with.

    Raises:
      ValueError: one sentence that names the node or edge, the field and what was expected.
    """
    elements, here = document["elements"], f"{where}: elements"
    nodes = [*_data(elements, "nodes", (ID,), here)]
    edges = [*_data(elements, "edges", ("source", "target"), here)]
    name = VALUE if all(VALUE in node for node in nodes) else ID
    return read_nodes_and_edges(
        ((node[name], _own(node)) for node in nodes),
        ((edge["source"], edge["target"], edge) for edge in edges),
        where,
        _ontology(document.get("data"), where),
    )


def _data(elements: Any, key: str, fields: tuple[str, ...], where: str) -> Iterator[dict[str, Any]]:
    """Yields the attributes of nodes or edges."""
    told = objects({key: field(elements, key, where)}, key, ("data",), where)
    yield from objects({key: [item["data"] for item in told]}, key, fields, where)


def _own(node: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the attributes of a node but for those that networkx makes of its id."""
    known = [VALUE] if VALUE in node else []
    known += [NAME] if node.get(NAME) == node[ID] else []
    return further(node, known)


def _ontology(about: Any, where: str) -> Ontology:
    """Returns the ontology that a graph states, whose attributes are an object or a list."""
    if isinstance(about, list):
        pairs = [pair for pair in about if isinstance(pair, list) and len(pair) == 2]
        about = {key: value for key, value in pairs if isinstance(key, str)}
    return ontology_in(about if isinstance(about, dict) else {}, where)
