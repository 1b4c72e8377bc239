"""Scene graphs as networkx graphs, and as the node-link documents that networkx reads and writes.

Nodes have `concept`, `pos` and, if planes, `normal` and `width`; edges have `kind`, "part_of" or
"proximity"; the graph has `ontology` if its concepts are not the paper's. Read, too, are the
attributes of the authors' graphs: `type`, `center`, `normal`, `length`, `limits`, and edges that do
not say what they are; directed graphs and multigraphs, if no edge is there twice; and what D3 and
other programs make of our attributes (`gathered`). Numbers survive exactly, and so does the order
of the nodes.

What else a node has are its attributes (`io.attributes`), but for `label`, `position`, `normal` and
`width`, which are names of ours in any format; its id is its key in the graph. An edge may have a
`confidence`.

Source: the authors' graphs, as snt-arg/situational_graphs_datasets makes them.
"""

import math
import reprlib
from collections.abc import Hashable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from sg3d_jax.io.attributes import (
    CONFIDENCE,
    ID,
    Attributes,
    Read,
    check_attributes,
    check_edge_confidence,
    edge_confidence_of,
    further,
    is_id,
    node_ids,
    own,
)
from sg3d_jax.io.files import number, parsed
from sg3d_jax.io.records import (
    KIND,
    Record,
    feature,
    features_by_row,
    graph_of,
    ontology_in,
    stated,
)
from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import (
    FEATURES,
    PAPER_ONTOLOGY,
    PART_OF,
    PROXIMITY,
    RELATIONS,
    Concept,
    Ontology,
)
from sg3d_jax.scene.padding import unpad
from sg3d_jax.scene.validate import validate_graph

if TYPE_CHECKING:
    import networkx

NAMES: Final = ("concept", "pos")  # what nodes have beside features
AUTHORS_NAMES: Final = ("type", "center", "length", "limits")
WALL_SURFACE: Final = "ws"  # how the authors call what is observed
LENGTH_TOLERANCE: Final = 1e-6  # metres


# What has no place in formats of scalars alone, and what they have in its stead.
VECTORS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {"pos": ("x", "y", "z")}
    | {
        name: tuple(f"{name}_{axis}" for axis in ("xyz" if shape == (3,) else range(*shape)))
        for name, shape in FEATURES.items()
        if shape
    }
)
SCALARS: Final = ("width", "length")  # numbers that some programs write as texts


class _Kind(NamedTuple):
    """What a reader has to know of a concept."""

    label: int
    concept: Concept
    owned: tuple[str, ...]  # features
    foreign: dict[str, list[str]]  # features that others have, and the layers of these


def to_networkx(
    graph: SceneGraph, attributes: Attributes | None = None, edge_confidence: Array | None = None
) -> "networkx.Graph":
    """Returns a graph as a networkx graph.

    Args:
      graph: metres; padding is left out.
      attributes: what else to say of each node, JSON values.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`.

    Returns:
      An undirected graph whose nodes are row numbers, unless attributes say otherwise; `pos` and
      `normal` are lists.

    Raises:
      ValueError: one sentence that names a node and its attribute, which a graph cannot hold, or
        the confidence of an edge.
    """
    import networkx

    graph = unpad(graph)
    held: Attributes = [{}] * len(graph.nodes.label) if attributes is None else attributes
    check_attributes(held, ontology_of(graph), "attributes", names=NAMES)
    if edge_confidence is not None:
        check_edge_confidence(edge_confidence, graph, "graph")
    made = networkx.Graph(**stated(ontology_of(graph)))
    made.add_nodes_from(_nodes(graph, held))
    made.add_edges_from(_edges(graph, node_ids(held), edge_confidence))
    return made


def from_networkx(graph: "networkx.Graph", where: str = "graph") -> SceneGraph:
    """Returns the host graph of a networkx graph as `read_networkx` does, without attributes."""
    return read_networkx(graph, where).graph


def read_networkx(graph: "networkx.Graph", where: str = "graph") -> Read:
    """Returns the host graph of a networkx graph, and what else it says of nodes and edges.

    Args:
      graph: nodes in the order that the rows are to have, with our attributes or the authors';
        positions in metres.
      where: what an error starts with.

    Raises:
      ValueError: one sentence that names the node or edge, the field and what was expected.
    """
    ontology = ontology_in(graph.graph, where)
    return read_nodes_and_edges(graph.nodes(data=True), graph.edges(data=True), where, ontology)


def graph_to_node_link(
    graph: SceneGraph,
    attributes: Attributes | None = None,
    edge_confidence: Array | None = None,
    **about: Any,
) -> dict[str, Any]:
    """Returns a host graph as what `networkx.node_link_graph(document, edges="edges")` reads.

    Args:
      graph: unpadded, metres.
      attributes: what else to say of each node, of `check_attributes` with `NAMES`.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`.
      **about: the graph, such as `halt_reason`; JSON values.

    Returns:
      A JSON document; node ids are row numbers, unless attributes say otherwise.
    """
    held: Attributes = [{}] * len(graph.nodes.label) if attributes is None else attributes
    edges = [
        {**said, "source": source, "target": target}
        for source, target, said in _edges(graph, node_ids(held), edge_confidence)
    ]
    nodes = [node | {ID: name} for name, node in _nodes(graph, held)]
    kind = {"directed": False, "multigraph": False}
    about = {**stated(ontology_of(graph)), **about}
    return kind | {"graph": about, "nodes": nodes, "edges": edges}


def graph_from_node_link(document: Any, where: str = "graph") -> SceneGraph:
    """Returns the host graph of a node-link document as `read_node_link`, without attributes."""
    return read_node_link(document, where).graph


def read_node_link(document: Any, where: str = "graph") -> Read:
    """Returns the host graph of a node-link document, and what else it says of nodes and edges.

    Args:
      document: parsed JSON, not yet trusted; edges are under `edges` or, as D3 has it and networkx
        once had, `links`. A node without an id has its place in the list. Keys of the document and
        of edges that it does not know are ignored.
      where: what an error starts with, such as "graphs.jsonl: line 3".

    Raises:
      ValueError: one sentence that names the node or edge, the field and what was expected.
    """
    if not isinstance(document, dict):
        raise ValueError(f"{where}: there is {_text(document)}, expected an object")
    if document.get("edges") is not None and document.get("links"):
        raise ValueError(f"{where}: there are both edges and links, expected either")
    links = "links" if "edges" not in document and "links" in document else "edges"
    # D3 does without ids and does not say of what kind a graph is; networkx always does.
    nodes = objects(document, "nodes", (ID,) if "multigraph" in document else (), where)
    edges = objects(document, links, ("source", "target"), where)
    about = document.get("graph")
    return read_nodes_and_edges(
        ((node.get(ID, row), node) for row, node in enumerate(nodes)),
        ((_name_of(edge["source"]), _name_of(edge["target"]), edge) for edge in edges),
        where,
        ontology_in(about if isinstance(about, dict) else {}, where),
    )


def _name_of(end: Any) -> Any:
    """Returns the id of an end of an edge, in whose place D3 puts the node."""
    names = [end[key] for key in (ID, "index") if key in end] if isinstance(end, dict) else [end]
    return names[0] if names else end


def read_nodes_and_edges(
    nodes: Iterable[tuple[Any, Mapping[str, Any]]],
    edges: Iterable[tuple[Any, Any, Mapping[str, Any]]],
    where: str,
    ontology: Ontology = PAPER_ONTOLOGY,
) -> Read:
    """Returns the host graph of nodes and edges with attributes, ours or the authors', and these.

    Args:
      nodes: id and attributes of each node, in the order that the rows are to have; see `gathered`
        for other forms of them.
      edges: ids of both ends and attributes of each edge, each pair once, or once in each direction
        with the same meaning. An edge without `kind` is told by its ends: what is observed is near
        each other, a part is part of its whole.
      where: what an error starts with.
      ontology: the concepts.

    Raises:
      ValueError: one sentence that names the node or edge, the field and what was expected.
    """
    row_of_id: dict[Any, int] = {}
    rows: list[Record] = []
    held: list[dict[str, Any]] = []
    kinds = _kinds(ontology)
    for name, attributes in nodes:
        if not isinstance(name, Hashable):
            raise ValueError(f"{where}: a node has id {_text(name)}, expected a number or a name")
        if row_of_id.setdefault(name, len(rows)) != len(rows):
            raise ValueError(f"{where}: node {_text(name)} is there twice, expected unique ids")
        here = f"{where}: node {_plain(name)!r:.40}"
        said = gathered(attributes, here)
        rows.append(_row(said, kinds, here))
        held.append(_further(name, said, ontology))
    pairs: tuple[list[list[int]], ...] = tuple([] for _ in RELATIONS)
    sure: tuple[list[Any], ...] = tuple([] for _ in RELATIONS)
    directions: dict[tuple[int, int], int] = {}
    for source, target, attributes in edges:
        ends = [_end(row_of_id, end, where) for end in (source, target)]
        edge = f"{where}: edge ({_plain(source)!r:.40}, {_plain(target)!r:.40})"
        labels = [rows[end].label for end in ends]
        relation = _relation(attributes, labels, ontology, edge)
        one, other = ends
        again = directions.setdefault((one, other), relation) != relation
        if directions.get((other, one)) == relation and one != other and not again:
            continue  # the other direction of an edge that is known
        pairs[relation].append(ends)
        sure[relation].append(_plain(attributes.get(CONFIDENCE)))
    graph = graph_of(rows, ontology, pairs[PART_OF], pairs[PROXIMITY])
    validate_graph(graph, where, rules=False)
    return Read(graph, held, edge_confidence_of(pairs[PART_OF], sure[PART_OF]))


def gathered(attributes: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Returns attributes of a node in our form, if they are in one of other programs.

    Formats without lists have `x`, `y`, `z` for `pos`, `normal_x` and so on for `normal`, or a list
    as text; some have numbers as texts; igraph gives every node every attribute, empty or NaN. Our
    own JSON calls `label` and `position` what is `concept` and `pos` here.

    Args:
      attributes: not yet trusted.
      where: what an error starts with.

    Raises:
      ValueError: one part of a vector is missing.
    """
    made = dict(attributes)
    if not {"concept", "type"} & made.keys() and {"label", "position"} <= made.keys():
        made["concept"], made["pos"] = made.pop("label"), made.pop("position")
    for vector, scalars in VECTORS.items():
        value = made.get(vector)
        if isinstance(value, str) and value.startswith("["):
            made[vector] = parsed(value, f"{where}: {vector}")
        if value is not None or "concept" not in made:  # of the authors' x is something else
            continue
        missing = [scalar for scalar in scalars if _is_nothing(made.get(scalar))]
        if 0 < len(missing) < len(scalars):
            raise ValueError(f"{where} lacks {missing[0]!r}, expected {', '.join(scalars)}")
        given = [_number_in(made.pop(scalar, None)) for scalar in scalars]
        if not missing:
            made[vector] = given
    for name in SCALARS:
        if name in made:
            # A plane of the authors has a length: one that is NaN is broken, and refused.
            is_none = _is_nothing(made[name]) and name == "width"
            made[name] = None if is_none else _number_in(made[name])
    return made


def _is_nothing(value: Any) -> bool:
    return value is None or value == "" or (isinstance(value, float) and math.isnan(value))


def _number_in(value: Any) -> Any:
    """Returns the number that a text is, and anything else as it is."""
    try:
        plain = isinstance(value, str) and value.isascii() and "_" not in value
        return float(value) if plain else value
    except ValueError:
        return value


def _kinds(ontology: Ontology) -> dict[str, _Kind]:
    """Returns the kinds of nodes by the names that they may have, ours and the authors'."""
    kinds = {}
    for label, concept in enumerate(ontology.concepts):
        owned = tuple(name for name in FEATURES if name in concept.features)
        foreign = {
            name: [each.layer.lower() for each in ontology.concepts if name in each.features]
            for name in ontology.features
            if name not in owned
        }
        kinds[concept.name] = _Kind(label, concept, owned, foreign)
    observed = ontology.names[int(ontology.is_observed.argmax())]
    return {WALL_SURFACE: kinds[observed]} | kinds


def _nodes(graph: SceneGraph, held: Attributes) -> list[tuple[int | str, dict[str, Any]]]:
    """Returns the id and the attributes of each node."""
    names = ontology_of(graph).names
    columns = (np.asarray(field).tolist() for field in (graph.nodes.label, graph.nodes.position))
    rows = zip(node_ids(held), *columns, features_by_row(graph), held, strict=True)
    return [
        (name, {"concept": names[label], "pos": position} | owned | further(others, (ID,)))
        for name, label, position, owned, others in rows
    ]


def _edges(
    graph: SceneGraph, ids: Sequence[int | str], confidence: Array | None
) -> list[tuple[int | str, int | str, dict[str, Any]]]:
    """Returns the ids of both ends and the attributes of each edge."""
    part_of, proximity = (
        [(ids[first], ids[second]) for first, second in undirected_edges(graph, relation).tolist()]
        for relation in (PART_OF, PROXIMITY)
    )
    sure = [] if confidence is None else np.asarray(confidence).tolist()
    said = [{CONFIDENCE: value} for value in sure] or [{}] * len(part_of)
    return [
        *(
            (*pair, {"kind": RELATIONS[PART_OF], **of_edge})
            for pair, of_edge in zip(part_of, said, strict=True)
        ),
        *((*pair, {"kind": RELATIONS[PROXIMITY]}) for pair in proximity),
    ]


def _further(name: Any, attributes: Mapping[str, Any], ontology: Ontology) -> dict[str, Any]:
    """Returns the id of a node, if it can be one of a document, and what we do not know of it."""
    known = NAMES if "concept" in attributes else AUTHORS_NAMES
    others = further(attributes, (ID, *known, *own(ontology))).items()
    name = _plain(name)
    return ({ID: name} if is_id(name) else {}) | {key: _plain(value) for key, value in others}


def objects(
    document: dict[str, Any], key: str, fields: tuple[str, ...], where: str
) -> list[dict[str, Any]]:
    """Returns a list of objects of a document that all have some fields, or refuses.

    Raises:
      ValueError: one sentence.
    """
    items = document.get(key)
    if not isinstance(items, list):
        raise ValueError(f"{where}: there is no list {key!r}, expected nodes and edges")
    for index, item in enumerate(items):
        if not isinstance(item, dict) or not set(fields) <= set(item):
            expected = f"an object with {' and '.join(fields)}" if fields else "an object"
            raise ValueError(f"{where}: {key}[{index}] is {_text(item)}, expected {expected}")
    return items


def _row(attributes: Mapping[str, Any], kinds: Mapping[str, _Kind], where: str) -> Record:
    """Returns what the attributes of a node say."""
    ours = "concept" in attributes
    field = "concept" if ours else "type"
    concept = attributes.get(field)
    if not isinstance(concept, str) or concept not in kinds:
        expected = f"one of {', '.join(name for name in kinds if name != WALL_SURFACE)}"
        if field not in attributes:
            raise ValueError(f"{where} lacks both 'concept' and 'type', expected {expected}")
        raise ValueError(f"{where}: {field} is {_text(concept)}, expected {expected}")
    kind = kinds[concept]
    position = _numbers(attributes, "pos" if ours else "center", (3,), where)
    for name, owners in kind.foreign.items() if ours else ():  # the authors' rooms have some
        if attributes.get(name) is not None:
            expected = f"none: only {' and '.join(owners) or 'others'} have one"
            raise ValueError(f"{where}: {name} is {_text(attributes[name])}, expected {expected}")
    features = {
        name: _width(attributes, where)
        if name == "width" and not ours
        else feature(KIND, _plain(attributes.get(KIND)), f"{where}: {KIND}", kind.concept)
        if name == KIND
        else _numbers(attributes, name, FEATURES[name], where)
        for name in kind.owned
    }
    return Record(kind.label, position, features)


def _width(attributes: Mapping[str, Any], where: str) -> float:
    """Returns the width of one of the authors' planes: `length`, or how far its ends are apart.

    A merged or copied plane keeps the length it had; that is the published width. Not so a length
    that is missing or zero, or counts x only, as the authors' last step on recordings has it.
    """
    length, limits = attributes.get("length"), _points(attributes.get("limits"))
    if limits is None:
        return _number(_get(attributes, "length", where), "length", where)
    first, last = ([_number(item, "limits", where) for item in point] for point in limits)
    distance = math.dist(first, last)
    if length is None:
        return distance
    length = _number(length, "length", where)
    wrong = length == 0 or abs(length - abs(last[0] - first[0])) <= LENGTH_TOLERANCE
    return distance if wrong and distance > length + LENGTH_TOLERANCE else length


def _points(limits: Any) -> list[Any] | None:
    """Returns two points of three coordinates, or None: some files state the ends otherwise."""
    limits = _plain(limits)
    if not isinstance(limits, (list, tuple)) or len(limits) != 2:
        return None
    points = [_plain(point) for point in limits]
    fits = all(isinstance(point, (list, tuple)) and len(point) == 3 for point in points)
    return points if fits else None


def _get(attributes: Mapping[str, Any], field: str, where: str) -> Any:
    if attributes.get(field) is None:
        raise ValueError(f"{where} lacks {field!r}, expected every node to have it")
    return attributes[field]


def _numbers(attributes: Mapping[str, Any], field: str, shape: tuple[int, ...], where: str) -> Any:
    """Returns a number, or a list of as many as its shape says."""
    value = _plain(_get(attributes, field, where))
    if not shape:
        return _number(value, field, where)
    (length,) = shape
    if not isinstance(value, (list, tuple)) or len(value) != length:
        many = "three" if length == 3 else length
        raise ValueError(f"{where}: {field} is {_text(value)}, expected {many} numbers")
    return [item if type(item) is float else _number(item, field, where) for item in value]


def _number(value: Any, field: str, where: str) -> float:
    value = _plain(value)
    if not isinstance(value, (int, float)):
        raise ValueError(f"{where}: {field} is {_text(value)}, expected a number")
    return number(value, f"{where}: {field}")


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def _end(row_of_id: Mapping[Any, int], name: Any, where: str) -> int:
    if not isinstance(name, Hashable) or name not in row_of_id:
        raise ValueError(f"{where}: an edge names {_text(name)}, expected the id of a node")
    return row_of_id[name]


def _relation(
    attributes: Mapping[str, Any], labels: list[int], ontology: Ontology, where: str
) -> int:
    kind = attributes.get("kind")
    if kind is not None:
        if kind not in RELATIONS:
            names = " or ".join(RELATIONS)
            raise ValueError(f"{where}: kind is {_text(kind)}, expected {names}")
        return RELATIONS.index(kind)
    low, high = sorted(labels)
    if ontology.may_be_part[low, high]:
        return PART_OF
    if ontology.is_observed[low] and ontology.is_observed[high]:
        return PROXIMITY
    joined = f"joins {ontology.names[low]} and {ontology.names[high]}"
    raise ValueError(f"{where} {joined}, expected two that are observed, or a part and its whole")


def _text(value: Any) -> str:
    """Returns how a value looks, shortened without looking at all of it: it may be endless."""
    return f"{reprlib.repr(value):.40}"
