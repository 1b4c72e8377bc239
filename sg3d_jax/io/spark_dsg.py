"""Scene graphs as Spark-DSG JSON, the format of Hydra; no package of theirs is needed.

A concept is a layer. Spark-DSG takes the layer with the higher number for the parent, and two
partitions of one layer for siblings: PLANES are partition "p" of layer 2 and WALLS partition "w" of
it, so that the parent of a plane is its room, and walls, doors and objects stand beside it; ROOMS
4, FLOORS 5, BUILDINGS 6, CITIES 7. So every node but a door has one parent at most, and layers 2
and 3 themselves are left to Hydra's objects and places. Its buildings are 5, but floors need a
number between them and rooms: look layers up by name, as `get_layer("BUILDINGS")`.

A node's id is its symbol, a letter and a row number (`p0`, `w4`, `R5`, `F6`, `B7`, `C8`), from
which the order of the nodes is restored; its name is its attribute `name`, if it has one. What
Spark-DSG has no field for is metadata: `normal` and `width` of a plane, `relation` of an edge, and
of the document its `ontology`, if its concepts are not the paper's. Numbers survive exactly, also
if their library saves the file again. Further metadata of a node are its attributes
(`io.attributes`), its `id` among them; where symbols are not numbered as rows are, they are the ids
of nodes that have none. An edge may have a `confidence`.

Source: MIT-SPARK/Spark-DSG 1.1.3, src/serialization/graph_json_serialization.cpp.
"""

import functools
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import compress
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from sg3d_jax.io.attributes import (
    CONFIDENCE,
    ID,
    NAME,
    Attributes,
    Read,
    edge_confidence_of,
    further,
    own,
)
from sg3d_jax.io.files import field, vector
from sg3d_jax.io.objects import Thing, label_names, remarks_on, thing_seen
from sg3d_jax.io.records import Record, features_by_row, features_in, graph_of, ontology_in, stated
from sg3d_jax.io.spark_dsg_document import (
    HEADER,
    NEWEST,
    SYMBOL_BITS,
    Key,
    ends_of,
    integer,
    known_key,
    layers_of,
    modern,
    remark_on_others,
    remarks_on_encoding,
)
from sg3d_jax.scene.graph import (
    Array,
    SceneGraph,
    ontology_of,
    subgraph,
    undirected_edges,
)
from sg3d_jax.scene.ontology import (
    PAPER_ONTOLOGY,
    PART_OF,
    PROXIMITY,
    RELATIONS,
    Concept,
    Ontology,
)
from sg3d_jax.scene.validate import validate_graph

FIRST_LAYER: Final = 2  # 0 is unused in Hydra, 1 is its mesh
LAYER_OF_ROOMS: Final = "ROOMS"  # has a class of nodes of its own, as in Hydra
NO_SEMANTIC_LABEL: Final = 2**32 - 1
NO_ROTATION: Final = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
NO_BOX: Final = np.zeros(3)
ATTRIBUTES: Final = (
    "SemanticNodeAttributes",
    "RoomNodeAttributes",
    "ObjectNodeAttributes",
    "KhronosObjectAttributes",
    "PlaceNodeAttributes",
    "Place2dNodeAttributes",
    "TraversabilityNodeAttributes",
    "AgentNodeAttributes",
    "NodeAttributes",
)


class _Node(NamedTuple):
    """What a node of a document says."""

    id: int
    record: Record
    wholes: dict[int, list[int]]  # ids that its metadata names, by label
    metadata: dict[str, Any]
    thing: Thing | None = None  # what it is taken for, if it is an object of Hydra's


class _Edge(NamedTuple):
    """What an edge of a document says, or a node of an edge that it keeps in its metadata."""

    relation: int
    pair: list[int]  # rows
    confidence: Any  # not yet trusted


def graph_to_spark_dsg(
    graph: SceneGraph,
    walls: Literal["edges", "metadata"] = "edges",
    attributes: Attributes | None = None,
    edge_confidence: Array | None = None,
    **metadata: Any,
) -> dict[str, Any]:
    """Returns a host graph as a Spark-DSG document.

    Args:
      graph: unpadded, metres.
      walls: where the edges between planes and walls go, and between any other part and a whole of
        which it may have several: "edges" like all others, or "metadata" of the part as a list of
        ids under the whole's layer, `walls`, which leaves every node at most one parent.
      attributes: what else to say of each node, of `check_attributes` with `names_in_metadata`.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`.
      **metadata: what else the document should say of itself, such as `halt_reason`; JSON values.

    Returns:
      The document; every node that is not observed is marked as predicted.

    Raises:
      ValueError: `walls` is neither of the two.
    """
    if walls not in ("edges", "metadata"):
        raise ValueError(f"walls is {walls!r:.40}, expected 'edges' or 'metadata'")
    ontology, label = ontology_of(graph), np.asarray(graph.nodes.label)
    layers = [concept.layer for concept in ontology.concepts]
    keys = dict(zip(layers, _layer_keys(ontology), strict=True))
    ids = [_symbol(ontology.concepts[kind], row) for row, kind in enumerate(label.tolist())]
    part_of, proximity = _wholes_first(graph), undirected_edges(graph, PROXIMITY)
    hidden = np.zeros(len(part_of), bool)
    if walls == "metadata":
        hidden = _any_number(ontology)[tuple(label[part_of].T)]
    sure = np.full(len(part_of), None) if edge_confidence is None else np.asarray(edge_confidence)
    edges = [(*ends, c) for ends, c in zip(part_of.tolist(), sure.tolist(), strict=True)]
    held: Attributes = [{}] * len(ids) if attributes is None else attributes
    kept = dict(_kept_wholes(ontology))
    said: list[dict[str, Any]] = [dict(of_node) for of_node in held]
    for whole, part, confidence in compress(edges, hidden):
        name = kept[label[whole]]
        said[part].setdefault(name, []).append(ids[whole])
        if confidence is not None:
            said[part].setdefault(_sure_of(name), []).append(confidence)
    about = {"generator": "sg3d_jax", "units": "m", **stated(ontology), **metadata}
    return {
        HEADER: NEWEST,
        "directed": False,
        "multigraph": False,
        "metadata": about,
        "layer_keys": list(keys.values()),
        "layer_names": keys,
        "nodes": _node_records(graph, ids, said),
        "edges": [
            *(_edge_record(ids[i], ids[j], PART_OF, c) for i, j, c in compress(edges, ~hidden)),
            *(_edge_record(ids[i], ids[j], PROXIMITY) for i, j in proximity.tolist()),
        ],
    }


def names_in_metadata(ontology: Ontology) -> tuple[str, ...]:
    """Returns what the metadata of a node may say that is not its own, such as its walls."""
    names = [name for _, name in _kept_wholes(ontology)]
    return (*names, *map(_sure_of, names))


def graph_from_spark_dsg(document: Any, where: str = "graph") -> SceneGraph:
    """Returns the host graph of a Spark-DSG document as `read_spark_dsg`, without attributes."""
    return read_spark_dsg(document, where).graph


def read_spark_dsg(
    document: Any, where: str = "graph", ontology: Ontology = PAPER_ONTOLOGY
) -> Read:
    """Returns the host graph of a Spark-DSG document, and further metadata of its nodes and edges.

    Layers go by their names, so that rooms and buildings of Hydra are read too, and its objects
    (`io.objects`) where they are a concept. An edge that does not tell its relation is part-of
    between layers, and proximity within one and between what is observed.

    Args:
      document: parsed JSON, not yet trusted.
      where: what an error starts with, such as "dsg.json".
      ontology: the concepts of a document that states none.

    Returns:
      Nodes in the order of their symbols' numbers; if those repeat, by concept first. Layers that
      are no concepts of ours, such as PLACES, are left out, and a remark counts their nodes.

    Raises:
      ValueError: one sentence that names the node or edge, the field and what was expected.
    """
    given, document = document, modern(document, where)
    about = document.get("metadata")
    ontology = ontology_in(about if isinstance(about, dict) else {}, where, ontology)
    labels, kept = _labels(ontology), _kept_wholes(ontology)
    layers = layers_of(document, labels, where)
    called = {key: label_names(about, *key) for key in layers}
    nodes, others, skipped = list[_Node](), Counter[Key](), set[int]()
    for index, record in enumerate(document["nodes"]):
        here = f"{where}: nodes[{index}]"
        key = known_key(record, layers, labels, here)
        if (label := labels.get(f"{layers[key]}")) is not None:
            nodes.append(_node(record, label, ontology, kept, called[key], here))
        else:
            others[key] += 1
            skipped.add(integer(record, "id", here))
    remarks = [remark_on_others(layers, others, "mesh" in document)] if others else []
    remarks += remarks_on_encoding(given)
    remarks += remarks_on([node.thing for node in nodes if node.thing], ontology)
    if others and not nodes:
        raise ValueError(f"{where}: {remarks[0]}, expected nodes of {', '.join(labels)}")
    row_of_id = _rows_by_id(nodes, where)
    edges = [
        _edge(edge, nodes, row_of_id, ontology.is_observed, f"{where}: edges[{index}]")
        for index, edge in enumerate(document["edges"])
        if not (skipped and ends_of(edge, f"{where}: edges[{index}]") & skipped)
    ]
    edges += _hidden_edges(nodes, row_of_id, ontology, where)
    part_of = [edge for edge in edges if edge.relation == PART_OF]
    pairs = [edge.pair for edge in part_of]
    proximity = [edge.pair for edge in edges if edge.relation == PROXIMITY]
    graph = graph_of([node.record for node in nodes], ontology, pairs, proximity)
    validate_graph(graph, where, rules=False)
    order = _order(nodes)
    rows = np.argsort(order)[np.array(pairs, int)].tolist()
    sure = edge_confidence_of(rows, [edge.confidence for edge in part_of])
    held = _attributes_of([nodes[row] for row in order], ontology, bool(others))
    return Read(subgraph(graph, order), held, sure, tuple(remarks))


def _attributes_of(nodes: Sequence[_Node], ontology: Ontology, foreign: bool) -> Attributes:
    """Returns what else nodes say, in the order of their rows."""
    known = (*own(ontology), *names_in_metadata(ontology))
    as_rows = all(node.id % 2**SYMBOL_BITS == row for row, node in enumerate(nodes))
    as_rows &= not foreign  # in a file of others a symbol is a name that they know
    return [({} if as_rows else {ID: node.id}) | further(node.metadata, known) for node in nodes]


def _symbol(concept: Concept, row: int) -> int:
    return (ord(concept.letter) << SYMBOL_BITS) | row


def _wholes_first(graph: SceneGraph) -> np.ndarray:
    """Returns the part-of edges, the upper concept first; between two of one, the lower row."""
    label, pairs = np.asarray(graph.nodes.label), undirected_edges(graph, PART_OF)
    order = np.argsort(-label[pairs], axis=1, kind="stable")
    return np.take_along_axis(pairs, order, axis=1)


def _any_number(ontology: Ontology) -> np.ndarray:
    """Returns bool[C, C], whether a part (column) may have any number of a whole (row)."""
    table = ontology.may_be_part.T.copy()
    for part, whole in ontology.single_wholes:
        table[whole, part] = False
    return table


@functools.lru_cache
def _layer_keys(ontology: Ontology) -> tuple[dict[str, int], ...]:
    """Returns the layer and the partition of each concept.

    Numbers rise with the concepts; but what is observed and has no parts has the first, and a whole
    of which a part may have several, such as a wall, that of the part: neither is a second parent.
    """
    several, keys = _any_number(ontology), list[dict[str, int]]()
    for label, concept in enumerate(ontology.concepts):
        has_parts = ontology.may_be_part[:, label].any()
        number = FIRST_LAYER if concept.observed and not has_parts else label + FIRST_LAYER
        aside = several[label].any() and not ontology.has_one_whole[:, label].any()
        if aside:
            number = keys[np.flatnonzero(several[label]).max()]["layer"]
        partition = ord(concept.letter) if aside or concept.observed else 0
        keys.append({"layer": number, "partition": partition})
    return tuple(keys)


@functools.lru_cache
def _labels(ontology: Ontology) -> Mapping[str, int]:
    """Returns the labels of the concepts by layer."""
    return {concept.layer: label for label, concept in enumerate(ontology.concepts)}


@functools.lru_cache
def _kept_wholes(ontology: Ontology) -> tuple[tuple[int, str], ...]:
    """Returns the labels of the wholes that metadata may keep, and under which keys."""
    labels = np.flatnonzero(_any_number(ontology).any(axis=1)).tolist()
    return tuple((label, ontology.concepts[label].layer.lower()) for label in labels)


def _sure_of(name: str) -> str:
    """Returns under which key metadata say how sure what is kept under another is."""
    return f"{name}_{CONFIDENCE}"


def _node_records(
    graph: SceneGraph, ids: list[int], said: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    columns = (np.asarray(field).tolist() for field in (graph.nodes.label, graph.nodes.position))
    owned, boxes = features_by_row(graph), _boxes(graph)
    concepts, keys = ontology_of(graph).concepts, _layer_keys(ontology_of(graph))
    return [
        {
            "id": ids[row],
            **keys[label],
            "attributes": {
                **_attributes(concepts[label], row, said[row]),
                "position": position,
                "bounding_box": _box(*boxes[row]),
                "metadata": owned[row] | said[row],
            },
        }
        for row, (label, position) in enumerate(zip(*columns, strict=True))
    ]


def _attributes(concept: Concept, row: int, said: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the attributes that do not depend on geometry, every field of their class."""
    red, green, blue = bytes.fromhex(concept.colour[1:])
    is_room = concept.layer == LAYER_OF_ROOMS
    room: dict[str, Any] = {"semantic_class_probabilities": {}} if is_room else {}
    return {
        "type": "RoomNodeAttributes" if is_room else "SemanticNodeAttributes",
        "name": f"{said.get(NAME, f'{concept.name} {row}')}",
        "color": {"r": red, "g": green, "b": blue, "a": 255},
        "semantic_label": NO_SEMANTIC_LABEL,
        "semantic_feature": {"rows": 0, "cols": 0, "data": None},
        "is_active": False,
        "is_predicted": not concept.observed,
        "last_update_time_ns": 0,
        **room,
    }


def _boxes(graph: SceneGraph) -> np.ndarray:
    """Returns the corners of what is observed of every node, float64[n, 2, 3].

    They are infinite where nothing is.
    """
    nodes, observed = graph.nodes, np.asarray(graph.nodes.observed)
    label, position = np.asarray(nodes.label), np.asarray(nodes.position)
    normal, width = np.asarray(nodes.normal)[observed], np.asarray(nodes.width)[observed]
    half = np.abs(np.cross(np.array([0.0, 0.0, 1.0]), normal)) * width[:, None] / 2
    low, high = np.full(position.shape, np.inf), np.full(position.shape, -np.inf)
    low[observed], high[observed] = position[observed] - half, position[observed] + half
    pairs = _wholes_first(graph)
    for parent, child in pairs[np.argsort(label[pairs[:, 1]], kind="stable")]:
        low[parent] = np.minimum(low[parent], low[child])
        high[parent] = np.maximum(high[parent], high[child])
    return np.stack([low, high], axis=1)


def _box(low: np.ndarray, high: np.ndarray) -> dict[str, Any]:
    known = bool(np.isfinite(low).all())
    size, centre = (high - low, (low + high) / 2) if known else (NO_BOX, NO_BOX)
    return {
        "type": "AABB" if known else "INVALID",
        "dimensions": size.tolist(),
        "world_P_center": centre.tolist(),
        "world_R_center": NO_ROTATION,
    }


def _edge_record(
    source: int, target: int, relation: int, confidence: float | None = None
) -> dict[str, Any]:
    sure = {} if confidence is None else {CONFIDENCE: confidence}
    info = {
        "type": "EdgeAttributes",
        "weighted": False,
        "weight": 1.0,
        "metadata": {"relation": RELATIONS[relation], **sure},
    }
    return {"source": source, "target": target, "info": info}


def _node(
    record: Any,
    label: int,
    ontology: Ontology,
    kept: tuple[tuple[int, str], ...],
    names: Mapping[int, str],
    where: str,
) -> _Node:
    attributes, inside = field(record, "attributes", where), f"{where}.attributes"
    kind = field(attributes, "type", inside)
    if kind not in ATTRIBUTES:
        known = ", ".join(ATTRIBUTES)
        raise ValueError(f"{inside}.type is {kind!r:.40}, expected one of {known}")
    position = vector(field(attributes, "position", inside), f"{inside}.position")
    metadata, inside = _metadata(attributes, inside), f"{inside}.metadata"
    metadata = _named(attributes.get(NAME), ontology.concepts[label]) | metadata
    features = features_in(metadata, inside, ontology.concepts[label])
    wholes: dict[int, list[int]] = {}
    for whole, name in kept:
        if (named := metadata.get(name)) is not None:
            if not isinstance(named, list):
                raise ValueError(f"{inside}.{name} is {named!r:.40}, expected a list of node ids")
            wholes[whole] = named
    made = Record(label, position, features)
    if seen := None if features else thing_seen(made, attributes, names, ontology):
        made, metadata = seen.record, seen.said | metadata
    return _Node(integer(record, "id", where), made, wholes, metadata, seen)


def _named(name: Any, concept: Concept) -> dict[str, str]:
    """Returns the name that a node has, if it is more than a concept and a number."""
    given = isinstance(name, str) and name.removeprefix(f"{concept.name} ").strip("0123456789")
    return {NAME: name} if given else {}


def _metadata(record: dict[str, Any], where: str) -> dict[str, Any]:
    """Returns the metadata of attributes, which older files lack and empty ones have as null."""
    metadata = record.get("metadata")
    if not isinstance(metadata, (dict, type(None))):
        raise ValueError(f"{where}.metadata is {metadata!r:.40}, expected an object")
    return metadata or {}


def _rows_by_id(nodes: list[_Node], where: str) -> dict[int, int]:
    row_of_id: dict[int, int] = {}
    for row, node in enumerate(nodes):
        if node.id in row_of_id:
            raise ValueError(f"{where}: nodes[{row}].id is {node.id} again, expected unique ids")
        row_of_id[node.id] = row
    return row_of_id


def _edge(
    record: Any,
    nodes: list[_Node],
    row_of_id: Mapping[int, int],
    observed: np.ndarray,
    where: str,
) -> _Edge:
    pair = []
    for end in ("source", "target"):
        name = integer(record, end, where)
        if name not in row_of_id:
            raise ValueError(f"{where}.{end} is {name}, expected the id of a node")
        pair.append(row_of_id[name])
    info = field(record, "info", where)
    if not isinstance(info, dict):
        raise ValueError(f"{where}.info is {info!r:.40}, expected an object")
    first, second = (nodes[row].record.label for row in pair)
    beside = first == second or observed[[first, second]].all()
    default = RELATIONS[PROXIMITY if beside else PART_OF]
    metadata = _metadata(info, f"{where}.info")
    relation = metadata.get("relation", default)
    if relation not in RELATIONS:
        names = " or ".join(RELATIONS)
        raise ValueError(f"{where}.info.metadata.relation is {relation!r:.40}, expected {names}")
    return _Edge(RELATIONS.index(relation), pair, metadata.get(CONFIDENCE))


def _hidden_edges(
    nodes: list[_Node], row_of_id: Mapping[int, int], ontology: Ontology, where: str
) -> list[_Edge]:
    """Returns the edges from parts to wholes that are kept in metadata."""
    edges = []
    for row, node in enumerate(nodes):
        for label, names in node.wholes.items():
            said = node.metadata.get(_sure_of(ontology.concepts[label].layer.lower()))
            fits = isinstance(said, list) and len(said) == len(names)
            sure = said if fits else [None] * len(names)
            for index, name in enumerate(names):
                known = isinstance(name, int) and not isinstance(name, bool) and name in row_of_id
                if not known or nodes[row_of_id[name]].record.label != label:
                    concept = ontology.concepts[label]
                    place = f"nodes[{row}].attributes.metadata.{concept.layer.lower()}[{index}]"
                    expected = f"the id of a {concept.name}"
                    raise ValueError(f"{where}: {place} is {name!r:.40}, expected {expected}")
                edges.append(_Edge(PART_OF, [row, row_of_id[name]], sure[index]))
    return edges


def _order(nodes: list[_Node]) -> np.ndarray:
    """Returns the nodes in the order in which their symbols are numbered."""
    numbers = np.array([node.id % 2**SYMBOL_BITS for node in nodes])
    unique = len(np.unique(numbers)) == len(numbers)
    labels = np.array([node.record.label for node in nodes])
    return np.argsort(numbers) if unique else np.lexsort((numbers, labels))
