"""Scene graphs as Spark-DSG JSON, the format of Hydra; no package of theirs is needed.

A concept is a layer: PLANES 2, WALLS 3, ROOMS 4, FLOORS 5, BUILDINGS 6, CITIES 7. Spark-DSG takes
the higher layer for the parent, so floors need a number between ROOMS and BUILDINGS and the latter
are not 5 as in Hydra: look layers up by name. A node's id is its symbol, a letter and a row number
(`p0`, `w4`, `R5`, `F6`, `B7`, `C8`), from which the order of the nodes is restored. What Spark-DSG
has no field for is metadata: `normal` and `width` of a plane, `relation` of an edge. Numbers
survive exactly, also if their library saves the file again.

Source: MIT-SPARK/Spark-DSG 1.1.3, src/serialization/graph_json_serialization.cpp.
Differs: a plane with a wall and a room has two parents, which Spark-DSG stores but its
`get_parent()` does not return; `walls="metadata"` keeps the walls of a plane in its metadata
instead, so that every node has at most one parent.
"""

from collections.abc import Mapping
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from sg3d_jax.io.files import field, number, vector
from sg3d_jax.scene.ontology import CONCEPTS, PART_OF, PLANE, PROXIMITY, RELATIONS, ROOM, WALL
from sg3d_jax.scene.graph import SceneGraph, make_graph, undirected_edges
from sg3d_jax.scene.validate import validate_graph
from sg3d_jax.viz.style import STYLES

HEADER: Final = "SPARK_DSG_header"
VERSION: Final = {"major": 1, "minor": 1, "patch": 3}
LAYERS: Final = ("PLANES", "WALLS", "ROOMS", "FLOORS", "BUILDINGS", "CITIES")
FIRST_LAYER: Final = 2  # 0 is unused in Hydra, 1 is the mesh
LETTERS: Final = "pwRFBC"
NO_SEMANTIC_LABEL: Final = 2**32 - 1
NO_ROTATION: Final = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
NO_BOX: Final = np.zeros(3)
SYMBOL_BITS: Final = 56  # of the number in a symbol; its letter is above
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
    """What a node of a document says; None becomes zero."""

    id: int
    label: int
    position: list[float]
    normal: list[float]
    width: float
    walls: list[int]  # ids


def graph_to_spark_dsg(
    graph: SceneGraph, walls: Literal["edges", "metadata"] = "edges", **metadata: Any
) -> dict[str, Any]:
    """Returns a host graph as a Spark-DSG document.

    Args:
      graph: unpadded, metres.
      walls: where the edges between planes and walls go: "edges" like all others, or "metadata" of
        the plane as a list of wall ids, which leaves every node at most one parent.
      **metadata: what else the document should say of itself, such as `halt_reason`; JSON values.

    Returns:
      The document; every node but the planes is marked as predicted.

    Raises:
      ValueError: `walls` is neither of the two.
    """
    if walls not in ("edges", "metadata"):
        raise ValueError(f"walls is {walls!r:.40}, expected 'edges' or 'metadata'")
    keys = {name: {"layer": FIRST_LAYER + i, "partition": 0} for i, name in enumerate(LAYERS)}
    label = np.asarray(graph.nodes.label)
    ids = [_symbol(concept, row) for row, concept in enumerate(label.tolist())]
    part_of = _parent_first(undirected_edges(graph, PART_OF), label)
    hidden = np.zeros(len(part_of), bool)
    if walls == "metadata":
        hidden = (label[part_of] == (WALL, PLANE)).all(axis=-1)
    walls_of: dict[int, list[int]] = {}
    for wall, plane in part_of[hidden].tolist():
        walls_of.setdefault(plane, []).append(ids[wall])
    proximity = undirected_edges(graph, PROXIMITY)
    return {
        HEADER: {"project_name": "main", "version": VERSION},
        "directed": False,
        "multigraph": False,
        "metadata": {"generator": "sg3d_jax", "units": "m", **metadata},
        "layer_keys": list(keys.values()),
        "layer_names": keys,
        "nodes": _node_records(graph, ids, walls_of),
        "edges": [
            *(_edge_record(ids[i], ids[j], PART_OF) for i, j in part_of[~hidden].tolist()),
            *(_edge_record(ids[i], ids[j], PROXIMITY) for i, j in proximity.tolist()),
        ],
    }


def graph_from_spark_dsg(document: Any, where: str = "graph") -> SceneGraph:
    """Returns the host graph of a Spark-DSG document; attributes it does not know are ignored.

    Layers go by their names, so that rooms and buildings of Hydra are read too. An edge that does
    not tell its relation is part-of between layers, and proximity within one.

    Args:
      document: parsed JSON, not yet trusted.
      where: what an error starts with, such as "dsg.json".

    Returns:
      Nodes in the order of their symbols' numbers; if those repeat, by concept first.

    Raises:
      ValueError: one sentence that names the node or edge, the field and what was expected. A node
        of a layer that is no concept of ours, such as OBJECTS, is refused.
    """
    _check_document(document, where)
    layers = _layers(document, where)
    nodes = [
        _node(node, layers, f"{where}: nodes[{index}]")
        for index, node in enumerate(document["nodes"])
    ]
    row_of_id = _rows_by_id(nodes, where)
    pairs: tuple[list[list[int]], ...] = tuple([] for _ in RELATIONS)
    for index, edge in enumerate(document["edges"]):
        relation, pair = _edge(edge, nodes, row_of_id, f"{where}: edges[{index}]")
        pairs[relation].append(pair)
    pairs[PART_OF].extend(_hidden_pairs(nodes, row_of_id, where))
    graph = make_graph(
        [node.label for node in nodes],
        np.array([node.position for node in nodes], np.float64),
        np.array([node.normal for node in nodes], np.float64),
        np.array([node.width for node in nodes], np.float64),
        part_of=np.array(pairs[PART_OF], np.int32),
        proximity=np.array(pairs[PROXIMITY], np.int32),
    )
    validate_graph(graph, where, rules=False)
    return _in_order(graph, nodes)


def _symbol(concept: int, row: int) -> int:
    return (ord(LETTERS[concept]) << SYMBOL_BITS) | row


def _parent_first(pairs: np.ndarray, label: np.ndarray) -> np.ndarray:
    order = np.argsort(-label[pairs], axis=1, kind="stable")
    return np.take_along_axis(pairs, order, axis=1)


def _node_records(
    graph: SceneGraph, ids: list[int], walls_of: Mapping[int, list[int]]
) -> list[dict[str, Any]]:
    columns = (np.asarray(field).tolist() for field in graph.nodes[:4])
    boxes = _boxes(graph)
    records = []
    for row, (concept, position, normal, width) in enumerate(zip(*columns, strict=True)):
        metadata: dict[str, Any] = {}
        if concept == PLANE:
            metadata = {"normal": normal, "width": width}
        if row in walls_of:
            metadata["walls"] = walls_of[row]
        records.append(
            {
                "id": ids[row],
                "layer": FIRST_LAYER + concept,
                "partition": 0,
                "attributes": {
                    **_attributes(concept, f"{CONCEPTS[concept]} {row}"),
                    "position": position,
                    "bounding_box": _box(*boxes[row]),
                    "metadata": metadata,
                },
            }
        )
    return records


def _attributes(concept: int, name: str) -> dict[str, Any]:
    """Returns the attributes that do not depend on geometry, every field of their class."""
    red, green, blue = bytes.fromhex(STYLES[concept].colour[1:])
    room: dict[str, Any] = {"semantic_class_probabilities": {}} if concept == ROOM else {}
    return {
        "type": "RoomNodeAttributes" if concept == ROOM else "SemanticNodeAttributes",
        "name": name,
        "color": {"r": red, "g": green, "b": blue, "a": 255},
        "semantic_label": NO_SEMANTIC_LABEL,
        "semantic_feature": {"rows": 0, "cols": 0, "data": None},
        "is_active": False,
        "is_predicted": concept != PLANE,
        "last_update_time_ns": 0,
        **room,
    }


def _boxes(graph: SceneGraph) -> np.ndarray:
    """Returns the corners of the planes of every node, float64[n, 2, 3]; infinite without any."""
    label, position, normal, width = (np.asarray(field) for field in graph.nodes[:4])
    plane = label == PLANE
    half = np.abs(np.cross(np.array([0.0, 0.0, 1.0]), normal[plane])) * width[plane, None] / 2
    low, high = np.full(position.shape, np.inf), np.full(position.shape, -np.inf)
    low[plane], high[plane] = position[plane] - half, position[plane] + half
    pairs = _parent_first(undirected_edges(graph, PART_OF), label)
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


def _edge_record(source: int, target: int, relation: int) -> dict[str, Any]:
    info = {
        "type": "EdgeAttributes",
        "weighted": False,
        "weight": 1.0,
        "metadata": {"relation": RELATIONS[relation]},
    }
    return {"source": source, "target": target, "info": info}


def _check_document(document: Any, where: str) -> None:
    kinds = {HEADER: dict, "layer_keys": list, "layer_names": dict, "nodes": list, "edges": list}
    if not isinstance(document, dict):
        raise ValueError(f"{where}: the document is {document!r:.40}, expected a Spark-DSG graph")
    for key, kind in kinds.items():
        if not isinstance(document.get(key), kind):
            held = "is missing" if key not in document else f"is {document[key]!r:.40}"
            raise ValueError(
                f"{where}: {key} {held}, expected {_article(kind)} as Spark-DSG 1.1.2 and newer "
                "write it"
            )


def _article(kind: type) -> str:
    return "an object" if kind is dict else "a list"


def _layers(document: dict[str, Any], where: str) -> dict[tuple[int, int], str]:
    """Returns the names of the layers by layer and partition; Hydra gives layer 2 two names."""
    keys = [_key(key, f"{where}: layer_keys[{i}]") for i, key in enumerate(document["layer_keys"])]
    names: dict[tuple[int, int], list[str]] = {}
    for name, value in document["layer_names"].items():
        here = f"{where}: layer_names[{name!r:.40}]"
        key = _key(value, here)
        if key not in keys:
            raise ValueError(f"{here} is {_text(key)}, expected one of layer_keys")
        names.setdefault(key, []).append(name)
        ours = [other for other in names[key] if other in LAYERS]
        if len(ours) > 1:
            raise ValueError(f"{here} is {_text(key)} like {ours[0]}, expected a layer of its own")
    return {key: min(several, key=_is_foreign) for key, several in names.items()}


def _is_foreign(layer: str) -> bool:
    return layer not in LAYERS


def _key(value: Any, where: str) -> tuple[int, int]:
    if not isinstance(value, dict):
        raise ValueError(f"{where} is {value!r:.40}, expected an object with layer and partition")
    return _integer(value, "layer", where), _integer(value, "partition", where)


def _text(key: tuple[int, int]) -> str:
    return f"layer {key[0]}, partition {key[1]}"


def _integer(record: Any, key: str, where: str) -> int:
    value = field(record, key, where)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**64:
        raise ValueError(f"{where}.{key} is {value!r:.40}, expected an integer below 2^64")
    return value


def _node(record: Any, layers: Mapping[tuple[int, int], str], where: str) -> _Node:
    label = _concept(record, layers, where)
    attributes, inside = field(record, "attributes", where), f"{where}.attributes"
    kind = field(attributes, "type", inside)
    if kind not in ATTRIBUTES:
        known = ", ".join(ATTRIBUTES)
        raise ValueError(f"{inside}.type is {kind!r:.40}, expected one of {known}")
    position = vector(field(attributes, "position", inside), f"{inside}.position")
    metadata, inside = _metadata(attributes, inside), f"{inside}.metadata"
    normal, width, walls = (metadata.get(name) for name in ("normal", "width", "walls"))
    if not isinstance(walls, (list, type(None))):
        raise ValueError(f"{inside}.walls is {walls!r:.40}, expected a list of node ids")
    return _Node(
        id=_integer(record, "id", where),
        label=label,
        position=position,
        normal=[0.0, 0.0, 0.0] if normal is None else vector(normal, f"{inside}.normal"),
        width=0.0 if width is None else number(width, f"{inside}.width"),
        walls=walls or [],
    )


def _concept(record: Any, layers: Mapping[tuple[int, int], str], where: str) -> int:
    key = _key(record, where)
    if layers.get(key) not in LAYERS:
        named = f" ({layers[key]:.40})" if key in layers else ""
        known = ", ".join(LAYERS)
        raise ValueError(f"{where} lies in {_text(key)}{named}, expected one of {known}")
    return LAYERS.index(layers[key])


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
    record: Any, nodes: list[_Node], row_of_id: Mapping[int, int], where: str
) -> tuple[int, list[int]]:
    """Returns the relation of an edge and its rows."""
    pair = []
    for end in ("source", "target"):
        name = _integer(record, end, where)
        if name not in row_of_id:
            raise ValueError(f"{where}.{end} is {name}, expected the id of a node")
        pair.append(row_of_id[name])
    info = field(record, "info", where)
    if not isinstance(info, dict):
        raise ValueError(f"{where}.info is {info!r:.40}, expected an object")
    within = nodes[pair[0]].label == nodes[pair[1]].label
    default = RELATIONS[PROXIMITY if within else PART_OF]
    relation = _metadata(info, f"{where}.info").get("relation", default)
    if relation not in RELATIONS:
        names = " or ".join(RELATIONS)
        raise ValueError(f"{where}.info.metadata.relation is {relation!r:.40}, expected {names}")
    return RELATIONS.index(relation), pair


def _hidden_pairs(nodes: list[_Node], row_of_id: Mapping[int, int], where: str) -> list[list[int]]:
    """Returns the pairs (node, wall) that are kept in metadata, as rows."""
    pairs = []
    for row, node in enumerate(nodes):
        for index, name in enumerate(node.walls):
            known = isinstance(name, int) and not isinstance(name, bool) and name in row_of_id
            if not known or nodes[row_of_id[name]].label != WALL:
                raise ValueError(
                    f"{where}: nodes[{row}].attributes.metadata.walls[{index}] is {name!r:.40}, "
                    "expected the id of a wall"
                )
            pairs.append([row, row_of_id[name]])
    return pairs


def _in_order(graph: SceneGraph, nodes: list[_Node]) -> SceneGraph:
    """Renumbers the nodes as their symbols are numbered."""
    label = np.asarray(graph.nodes.label)
    numbers = np.array([node.id % 2**SYMBOL_BITS for node in nodes])
    unique = len(np.unique(numbers)) == len(numbers)
    order = np.argsort(numbers) if unique else np.lexsort((numbers, label))
    row = np.argsort(order)
    fields = (np.asarray(field)[order] for field in graph.nodes[:4])
    part_of, proximity = (row[undirected_edges(graph, kind)] for kind in (PART_OF, PROXIMITY))
    return make_graph(*fields, part_of, proximity)
