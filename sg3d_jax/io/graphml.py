"""Scene graphs as GraphML, the XML that networkx, Gephi, yEd, igraph and Neo4j read and write.

One graph a file. GEXF, in which Gephi saves, is read, too.

GraphML has scalars only, so that vectors are spread: nodes have `concept`, `x`, `y`, `z` and, if
planes, `normal_x`, `normal_y`, `normal_z`, `width`; edges have `kind`, and may have `confidence`;
the graph has `ontology`, as JSON, if its concepts are not the paper's. Numbers survive exactly.

What else a node has are its attributes (`io.attributes`). Numbers, truth values and printable texts
are written as they are; lists, objects, null and any other text, such as one that could be taken
for a list, as JSON. The id of a node is that of the XML; digits mean a number.
"""

import json
import math
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

from sg3d_jax.io.attributes import ID, Attributes, Read, further, value_in
from sg3d_jax.io.files import parsed, read_bytes, replacing
from sg3d_jax.io.networkx import NAMES as NODE_NAMES
from sg3d_jax.io.networkx import VECTORS, read_networkx, to_networkx
from sg3d_jax.scene.graph import Array, SceneGraph
from sg3d_jax.scene.validate import validate_graph

if TYPE_CHECKING:
    import networkx

NAMES: Final = (*NODE_NAMES, *chain(*VECTORS.values()))  # what nodes have beside features
JSON_STARTS: Final = ("[", "{", '"')
UNREADABLE: Final = ("self", "node_for_adding")  # names that networkx's reader trips over
NUMERIC: Final = ("int", "integer", "long", "float", "double")  # types of data
DATA: Final = "{*}data"  # children so called, in whatever namespace
MAX_BYTES: Final = 2**24  # of a file; parsed, it takes up to fifty times as much


def write_graphml(
    path: str | Path,
    graph: SceneGraph,
    attributes: Attributes | None = None,
    edge_confidence: Array | None = None,
) -> None:
    """Writes a host graph as a GraphML file.

    Args:
      path: the file to write.
      graph: unpadded, metres.
      attributes: what else to say of each node, of `check_attributes` with `NAMES`.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`.

    Raises:
      ValueError: the graph breaks the data model, or the file cannot be written.
    """
    import networkx

    validate_graph(graph, f"{path}", rules=False)
    held = None if attributes is None else [_written(of_node) for of_node in attributes]
    made = to_networkx(graph, held, edge_confidence)
    if "ontology" in made.graph:
        made.graph["ontology"] = json.dumps(made.graph["ontology"])
    for of_node in made.nodes.values():
        for vector, scalars in VECTORS.items():
            if vector in of_node:
                of_node.update(zip(scalars, of_node.pop(vector), strict=True))
        for unknown in [name for name, value in of_node.items() if value is None]:
            del of_node[unknown]  # such as a kind; attributes that are null are text by now
    with replacing(path) as temporary, temporary.open("wb") as file:
        networkx.write_graphml_xml(made, file)


def read_graphml(path: str | Path) -> Read:
    """Returns the host graph of a GraphML file, and what else it says of nodes and edges.

    Raises:
      ValueError: one sentence that names the file, the node or edge and the field.
    """
    import networkx

    root, made = _parsed(path, networkx.read_graphml, "GraphML")
    _check(root, f"{path}")
    keys = {one.get("id"): one.get("attr.name") for one in root.iter() if _tag(one) == "key"}
    for element in root.iter():
        if _tag(element) == "node":
            # What yEd says of where it draws a node has taken the names of where the node is.
            data = [(keys.get(one.get("key")), one.text) for one in element.iterfind(DATA)]
            made.nodes[element.get("id")].update((k, v) for k, v in data if k in VECTORS["pos"])
    return _read_all(made, f"{path}")


def read_gexf(path: str | Path) -> Read:
    """Returns the host graph of a GEXF file, as `read_graphml` does.

    Raises:
      ValueError: one sentence that names the file, the node or edge and the field.
    """
    import networkx

    _, made = _parsed(path, networkx.read_gexf, "GEXF")
    for of_node in made.nodes.values():
        if "concept" in of_node:
            of_node.pop("label", None)  # what Gephi shows
    return _read_all(made, f"{path}")


def _parsed(path: str | Path, read: Callable[..., Any], kind: str) -> tuple[Any, Any]:
    """Returns the XML of a file, and the networkx graph that it describes."""
    data = read_bytes(path, MAX_BYTES)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Neo4j states no types: all is text
            return ElementTree.fromstring(data), read(BytesIO(data))
    except Exception as error:  # networkx lets through whatever its parser meets with
        raise ValueError(f"{path}: not {kind} that can be read ({error!r:.80})") from error


def _read_all(made: "networkx.Graph", where: str) -> Read:
    """Returns what a networkx graph of scalars says."""
    if "ontology" in made.graph:
        made.graph["ontology"] = parsed(f"{made.graph['ontology']}", f"{where}: ontology")
    read = read_networkx(made, where)
    return read._replace(attributes=[_read(of_node) for of_node in read.attributes])


def _check(root: ElementTree.Element, where: str) -> None:
    """Refuses what networkx reads as if it were not there.

    Raises:
      ValueError: there are several graphs, an id is missing, it or an attribute is there twice, or
        a number is in digits that only Python reads.
    """
    elements = [(_tag(element), element) for element in root.iter()]
    graphs = sum(tag == "graph" for tag, _ in elements)
    if graphs != 1:
        raise ValueError(f"{where}: holds {graphs} graphs, expected one")
    for kind in ("key", "node"):
        _check_once([one.get("id") for tag, one in elements if tag == kind], f"{where}: {kind}")
    keys = {one.get("id"): one for tag, one in elements if tag == "key"}
    for tag, element in elements:
        if tag == "node" and element.get("id") is None:
            raise ValueError(f"{where}: a node has no id, expected one")
        here = f"{where}: {tag} {element.get('id')!r:.40}"
        data = [(keys.get(one.get("key"), one), one.text or "") for one in element.iterfind(DATA)]
        named = [name for key, _ in data if (name := key.get("attr.name")) is not None]
        _check_once(named, f"{here} has")
        for key, text in data:
            if key.get("attr.type") in NUMERIC and ("_" in text or not text.isascii()):
                raise ValueError(f"{here} has {text!r:.40}, expected a number")


def _tag(element: ElementTree.Element) -> str:
    """Returns the name of an element, without its namespace; of a comment, nothing."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _check_once(values: Sequence[Any], where: str) -> None:
    for value, count in Counter(values).most_common(1):
        if count > 1:
            raise ValueError(f"{where} {value!r:.40} twice, expected once")


def _written(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Returns attributes of a node of which each is a scalar that XML can hold."""
    name = attributes.get(ID)
    if isinstance(name, str):
        name = json.dumps(name) if value_in(name, (int,)) != name else _text_of(name)
    others = further(attributes, (ID,)).items()
    named = {} if name is None else {ID: name}
    return named | {_name_of(key): _scalar_of(value) for key, value in others}


def _read(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what the attributes of a node were before they were written."""
    name = value_in(attributes[ID], (int,))
    others = further(attributes, (ID,)).items()
    named = {ID: _text_in(name) if isinstance(name, str) else name}
    return named | {_text_in(key): _value_of(value) for key, value in others}


def _scalar_of(value: Any) -> bool | int | float | str:
    """Returns a number as it is, and anything else as text from which it is told."""
    if isinstance(value, (bool, int, float)):
        return value
    return _text_of(value) if isinstance(value, str) else json.dumps(value)


def _name_of(key: str) -> str:
    return json.dumps(key) if key in UNREADABLE else _text_of(key)


def _text_of(text: str) -> str:
    """Returns a text as it is or, if XML could not hold it or it looks like JSON, as JSON."""
    plain = text.isprintable() and text != "null" and not text.startswith(JSON_STARTS)
    return text if plain else json.dumps(text)


def _text_in(text: str) -> str:
    value = _value_of(text)
    return value if isinstance(value, str) else text


def _value_of(value: Any) -> Any:
    """Returns what a scalar of a file stands for; no number that JSON has not."""
    if isinstance(value, float) and not math.isfinite(value):
        return f"{value}"
    if not isinstance(value, str) or not (value == "null" or value.startswith(JSON_STARTS)):
        return value
    try:
        return json.loads(value)
    except (ValueError, RecursionError):  # text of others that only begins like JSON
        return value
