"""Documents of Spark-DSG as Hydra saves them, of whatever version, and ours put into one.

Spark-DSG names the layers of a document since 1.1.0, gives them partitions since 1.1.1, and lists
their keys since 1.1.2; before 1.0 there was no header, and the nodes of agents had a time stamp;
before 1.0.3 boxes had corners in place of a size. All are read as the newest, and one that ours are
put into becomes one, so that Spark-DSG opens it. Its binary files are not read.

Source: MIT-SPARK/Spark-DSG 1.1.3, src/serialization/graph_json_serialization.cpp.
"""

from collections import Counter
from collections.abc import Collection, Mapping
from typing import Any, Final

from sg3d_jax.io.attributes import further
from sg3d_jax.io.files import field, vector

HEADER: Final = "SPARK_DSG_header"
OLD_LAYERS: Final = "layer_ids"  # of a document before 1.1.2, where now `layer_keys` are
NEWEST: Final = {"project_name": "main", "version": {"major": 1, "minor": 1, "patch": 3}}
NUMBERS: Final = ("major", "minor", "patch")
OLD_NAMES: Final = {"AGENTS": 2, "OBJECTS": 2, "PLACES": 3, "ROOMS": 4, "BUILDINGS": 5}
SYMBOL_BITS: Final = 56  # of the number in a symbol; its letter is above

Key = tuple[int, int]  # layer and partition


def modern(document: Any, where: str) -> dict[str, Any]:
    """Returns a document as Spark-DSG 1.1.2 and newer write it.

    Args:
      document: parsed JSON, not yet trusted.
      where: what an error starts with.

    Raises:
      ValueError: it is no document of Spark-DSG; the sentence names what is missing.
    """
    if not isinstance(document, dict):
        raise ValueError(f"{where}: the document is {document!r:.40}, expected a Spark-DSG graph")
    if "layer_keys" not in document and isinstance(document.get(OLD_LAYERS), list):
        document = _upgraded(document)
    kinds = {HEADER: dict, "layer_keys": list, "layer_names": dict, "nodes": list, "edges": list}
    for key, kind in kinds.items():
        if not isinstance(document.get(key), kind):
            held = "is missing" if key not in document else f"is {document[key]!r:.40}"
            article = "an object" if kind is dict else "a list"
            raise ValueError(f"{where}: {key} {held}, expected {article} as Spark-DSG writes it")
    return document


def remarks_on_encoding(document: dict[str, Any]) -> list[str]:
    """Returns a remark that says by which version a document is written, if `modern` changes it."""
    if "layer_keys" in document:
        return []
    header = document.get(HEADER)
    version = header.get("version") if isinstance(header, dict) else None
    numbers = [version.get(part) for part in NUMBERS] if isinstance(version, dict) else []
    known = len(numbers) > 0 and all(type(number) is int for number in numbers)
    name = ".".join(map(str, numbers)) if known else "before 1.0 (no header)"
    return [f"read the encoding of Spark-DSG {name:.40} like the newest"]


def _upgraded(document: dict[str, Any]) -> dict[str, Any]:
    """Returns a document without `layer_keys` with them; what is broken in it stays so."""
    names, nodes = document.get("layer_names", OLD_NAMES), document.get("nodes")
    keys: list[Any] = [{"layer": layer, "partition": 0} for layer in document[OLD_LAYERS]]
    if isinstance(names, dict):
        names = {n: {"layer": v, "partition": 0} if type(v) is int else v for n, v in names.items()}
        keys += names.values()
    if isinstance(nodes, list):
        nodes = [_with_size(_with_partition(node)) for node in nodes]
        for node in filter(lambda node: isinstance(node, dict), nodes):
            key = {"layer": node.get("layer"), "partition": node["partition"]}
            keys += [key] if type(key["layer"]) is int and key not in keys else []
    newer = {"layer_keys": keys, "layer_names": names, "nodes": nodes}
    header = NEWEST if isinstance(document.get(HEADER, NEWEST), dict) else document[HEADER]
    return document | {HEADER: header} | newer


def _with_partition(node: Any) -> Any:
    """Returns a node with its partition: a robot's nodes, which have a time, have its letter."""
    if not isinstance(node, dict):
        return node
    timed = "timestamp" in node and type(node.get("id")) is int
    return {"partition": node["id"] >> SYMBOL_BITS if timed else 0} | node


def _with_size(node: Any) -> Any:
    """Returns a node whose box has a size, if it has two corners that are vectors."""
    attributes = node.get("attributes") if isinstance(node, dict) else None
    box = attributes.get("bounding_box") if isinstance(attributes, dict) else None
    if not (isinstance(attributes, dict) and isinstance(box, dict)) or "dimensions" in box:
        return node
    try:
        low, high = (vector(box.get(corner), corner) for corner in ("min", "max"))
    except ValueError:
        return node
    size = [above - below for below, above in zip(low, high, strict=True)]
    return node | {"attributes": attributes | {"bounding_box": box | {"dimensions": size}}}


def layers_of(document: dict[str, Any], ours: Collection[str], where: str) -> dict[Key, str | None]:
    """Returns the names of the layers by layer and partition, None for one without a name.

    Args:
      document: of `modern`.
      ours: names of layers of which no two may be one.
      where: what an error starts with.

    Raises:
      ValueError: one sentence that names the layer.
    """
    keys = [key_of(k, f"{where}: layer_keys[{i}]") for i, k in enumerate(document["layer_keys"])]
    names: dict[Key, list[str]] = {}
    for name, value in document["layer_names"].items():
        here = f"{where}: layer_names[{name!r:.40}]"
        key = key_of(value, here)
        if key not in keys:
            raise ValueError(f"{here} is {key_text(key)}, expected one of layer_keys")
        names.setdefault(key, []).append(name)  # Hydra gives layer 2 two names
        taken = [other for other in names[key] if other in ours]
        if len(taken) > 1:
            held = f"{key_text(key)} like {taken[0]}"
            raise ValueError(f"{here} is {held}, expected a layer of its own")
    known = {
        key: next((name for name in several if name in ours), " and ".join(several))
        for key, several in names.items()
    }
    return dict.fromkeys(keys) | known


def key_of(value: Any, where: str) -> Key:
    """Returns the layer and the partition that an object names, or refuses.

    Raises:
      ValueError: one sentence.
    """
    if not isinstance(value, dict):
        raise ValueError(f"{where} is {value!r:.40}, expected an object with layer and partition")
    return integer(value, "layer", where), integer(value, "partition", where)


def known_key(record: Any, layers: Collection[Key], expected: Collection[str], where: str) -> Key:
    """Returns the layer and the partition of a node, or refuses.

    Raises:
      ValueError: the document has no such layer.
    """
    key = key_of(record, where)
    if key not in layers:
        raise ValueError(f"{where} lies in {key_text(key)}, expected one of {', '.join(expected)}")
    return key


def ends_of(record: Any, where: str) -> set[int]:
    """Returns the ids of both ends of an edge, or refuses.

    Raises:
      ValueError: one of them is no id.
    """
    return {integer(record, end, where) for end in ("source", "target")}


def key_text(key: Key) -> str:
    """Returns what a sentence calls a layer."""
    return f"layer {key[0]}, partition {key[1]}"


def integer(record: Any, key: str, where: str) -> int:
    """Returns what an object has under a key, or refuses.

    Raises:
      ValueError: it is no number of 64 bits.
    """
    value = field(record, key, where)
    if type(value) is int and 0 <= value < 2**64:  # True is no number here
        return value
    raise ValueError(f"{where}.{key} is {value!r:.40}, expected an integer below 2^64")


def remark_on_others(names: Mapping[Key, str | None], others: Counter[Key], mesh: bool) -> str:
    """Returns a sentence on what of a document is in no layer of ours."""
    held = [f"{n} of {names[key] or key_text(key)}" for key, n in others.most_common()]
    held += ["the mesh"] * mesh
    return f"left out what is in no layer of ours: {'; '.join(held)}"


def put_into(theirs: Any, ours: dict[str, Any], where: str) -> tuple[dict[str, Any], list[str]]:
    """Adds the layers of one of our documents to a document of Hydra's.

    Layers of the same name, such as ROOMS, are replaced by ours. A node of ours whose attribute
    `id` is the symbol of a node that it replaces, as it is if it was read from there, keeps the
    symbol, and with it the edges to layers that are not ours, such as PLACES. Other nodes of ours
    are numbered on from theirs. Everything else of the file stays as it is, the mesh, too.

    Args:
      theirs: parsed JSON, not yet trusted.
      ours: as `graph_to_spark_dsg` makes it, with walls as edges.
      where: what an error starts with, such as "dsg.json".

    Returns:
      The document, and remarks: a sentence on what of theirs is gone.

    Raises:
      ValueError: one sentence that says what is wrong with theirs.
    """
    theirs, names = modern(theirs, where), ours["layer_names"]
    layers = layers_of(theirs, names, where)
    taken = {key_of(key, where): name for name, key in names.items()}
    for key, name in layers.items():
        if key in taken and name not in names:
            held = f"{where}: {key_text(key)} is {name or 'a layer without a name'}"
            raise ValueError(f"{held}, expected it free for {taken[key]}")
    key_of_id = {}
    for index, node in enumerate(theirs["nodes"]):
        here = f"{where}: nodes[{index}]"
        if (symbol := integer(node, "id", here)) in key_of_id:
            raise ValueError(f"{here}.id is {symbol}, expected one that no node before it has")
        key_of_id[symbol] = known_key(node, layers, names, here)
    foreign = {name for name, key in key_of_id.items() if layers.get(key) not in names}
    replaced = key_of_id.keys() - foreign
    renamed = _renamed(ours["nodes"], key_of_id.keys(), replaced, where)
    kept, lost = foreign | (replaced & {*renamed.values()}), 0
    edges = []
    for index, edge in enumerate(theirs["edges"]):
        ends = ends_of(edge, f"{where}: edges[{index}]")
        if ends & foreign and ends <= kept:
            edges.append(edge)
        lost += bool(ends & foreign) and not ends <= kept
    for edge in ours["edges"]:
        moved = {end: renamed[edge[end]] for end in ("source", "target")}
        edges.append(edge | moved)
    remarks = []
    if gone := len(replaced - kept):
        edges_too = f", and left out {lost} of their edges" if lost else ""
        remarks.append(f"{where}: replaced {gone} of its nodes by ours{edges_too}")
    stay = [key for key in theirs["layer_keys"] if layers[key_of(key, where)] not in names]
    said = theirs.get("metadata")
    about = further(said if isinstance(said, dict) else {}, ("ontology",))  # ours is what counts
    return theirs | {
        "metadata": about | ours["metadata"],
        "layer_keys": stay + ours["layer_keys"],
        "layer_names": theirs["layer_names"] | names,
        "nodes": [n for n in theirs["nodes"] if n["id"] in foreign]
        + [node | {"id": renamed[node["id"]]} for node in ours["nodes"]],
        "edges": edges,
    }, remarks


def _renamed(
    nodes: list[dict[str, Any]], taken: Collection[int], replaced: Collection[int], where: str
) -> dict[int, int]:
    """Returns the symbol of each of our nodes in a document that has some already."""
    bits = 2**SYMBOL_BITS
    first = 1 + max((symbol % bits for symbol in taken), default=-1)
    if first + len(nodes) > bits:
        raise ValueError(f"{where}: a node has the number {first - 1}, expected smaller ones")
    renamed = {}
    for row, node in enumerate(nodes):
        name = node["attributes"]["metadata"].get("id")
        letter = node["id"] >> SYMBOL_BITS
        known = type(name) is int and name in replaced and name >> SYMBOL_BITS == letter
        renamed[node["id"]] = name if known else letter * bits + first + row
    return renamed
