"""What changes in a map as lines: JSON Lines of what is observed in, of the graph above it out.

In, a line an update, any of: a list for each concept that is observed, under its layer's name in
lower case, of what is new or has moved, as in `io.planes` but that each has an `id`; `removed`,
the ids of what is gone; `merged`, pairs of an id that is gone and that of its heir; `confirmed` and
`forbidden`, ids of grown nodes; `think`, to have the whole map drawn again. Or a whole PlanesData
message of S-Graphs: what is new, has moved or is gone follows from the message before.

Out, a line an update: `{"update": n, "added": [...], "changed": [...], "removed": [...], "events":
[...], "remarks": [...]}`; or the whole graph as in `io.json`, in which the ids of grown nodes begin
with their concept, such as "room-7": a mere number may be the caller's.
"""

import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.io.attributes import CONFIDENCE, ID, check_id, further, is_id
from sg3d_jax.io.files import field, parsed
from sg3d_jax.io.json import graph_to_dict
from sg3d_jax.io.planes import observed_record
from sg3d_jax.io.records import Record, features_by_row, graph_of, observed_lists
from sg3d_jax.io.s_graphs import AXES, read_message
from sg3d_jax.scene.changes import Changes, Event, GraphChanges, GrownNode
from sg3d_jax.scene.graph import SceneGraph, ontology_of, subgraph
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.validate import LEAST_OBSERVED, validate_graph

STANDARD_INPUT: Final = "-"
# By how much the back end of S-Graphs shifts and turns what is as good as still: centroid, metres;
# normal; width, metres.
STILL: Final = (*[1e-3] * 3, *[1e-4] * 3, 1e-3)
BESIDE: Final = ("removed", "merged", "confirmed", "forbidden")  # lists of ids in a line
THINK: Final = "think"
# What a line says of a grown node that a whole graph says itself.
IN_GRAPH: Final = (ID, "label", "position", "observed", "parts")

Document = dict[str, Any]


class Heard(NamedTuple):
    """What a reader keeps of the messages before: the last that it told of each plane."""

    names: tuple[int | str, ...] = ()
    table: np.ndarray = np.zeros((0, 7))  # float64[n, 7], centroid, normal and width of each


def lines_of(source: str) -> Generator[tuple[str, bytes]]:
    """Returns the lines of a file, or of standard input ("-"), as they come, and where each is.

    Empty ones are left out.

    Raises:
      ValueError: there is no such file.
    """
    path = Path(source)
    if source != STANDARD_INPUT and (path.is_dir() or not path.exists()):
        raise ValueError(f"{source}: no such file, expected one to read, or - for standard input")
    return _numbered(source)


def _numbered(source: str) -> Generator[tuple[str, bytes]]:
    standard = source == STANDARD_INPUT
    name = "standard input" if standard else source
    with nullcontext(sys.stdin.buffer) if standard else Path(source).open("rb") as lines:
        for number, line in enumerate(lines, 1):
            if line.strip():
                yield f"{name}: line {number}", line.strip()


def document_of(line: bytes, where: str) -> Any:
    """Returns what a line holds.

    Raises:
      ValueError: it is no JSON in UTF-8.
    """
    try:
        return parsed(line.decode(), where)
    except UnicodeDecodeError as error:
        raise ValueError(f"{where}: byte {error.start} is not UTF-8, expected JSON") from error


def read_changes(
    document: Any, ontology: Ontology, heard: Heard, where: str
) -> tuple[Changes, Heard]:
    """Returns the changes that a line tells of, and what to read the next line with.

    Args:
      document: of a line, not yet trusted.
      ontology: the concepts of the map.
      heard: what came back with the line before; `Heard()` at first.
      where: what an error starts with, such as "drive.jsonl: line 3".

    Raises:
      ValueError: one sentence that names the field and what was expected.
    """
    if isinstance(document, dict) and document.keys() & {*AXES}:
        return _read_message(document, ontology, heard, where)
    lists = observed_lists(ontology)
    expected = (*lists, *BESIDE, THINK)
    if not isinstance(document, dict):
        raise ValueError(f"{where} is {document!r:.40}, expected an object of changes")
    if odd := further(document, expected):
        raise ValueError(f"{where} has {min(odd)!r:.40}, expected any of {', '.join(expected)}")
    records: list[Record] = []
    row_of_id: dict[int | str, int] = {}
    for key, (label, concept) in lists.items():
        for index, item in enumerate(_list(document, key, where)):
            here = f"{where}: {key}[{index}]"
            check_id(field(item, ID, here), row_of_id, here)
            row_of_id[item[ID]] = len(records)
            records.append(observed_record(item, label, concept, here))
    observed = graph_of(records, ontology) if records else None
    if observed is not None:
        validate_graph(observed, where, rules=False)
    merged = _list(document, "merged", where)
    for index, pair in enumerate(merged):
        if not (isinstance(pair, list) and len(pair) == 2 and all(map(is_id, pair))):
            expected = "the id that is gone and that of its heir"
            raise ValueError(f"{where}: merged[{index}] is {pair!r:.40}, expected {expected}")
    changes = Changes(
        observed,
        (*row_of_id,),
        _ids(document, "removed", where, (int, str)),
        tuple((gone, heir) for gone, heir in merged),
        _ids(document, "confirmed", where, (int,)),
        _ids(document, "forbidden", where, (int,)),
        _flag(document, THINK, where),
    )
    return changes, heard


def changes_to_dict(changes: Changes) -> Document:
    """Returns the document of a line that tells of changes, and of nothing else."""
    document: Document = {}
    if changes.observed is not None:
        concepts, nodes = ontology_of(changes.observed).concepts, changes.observed.nodes
        columns = changes.ids, nodes.label.tolist(), nodes.position.tolist()
        features = features_by_row(changes.observed)
        for name, label, centroid, owned in zip(*columns, features, strict=True):
            record = {ID: name, "centroid": centroid, **owned}
            document.setdefault(concepts[label].layer.lower(), []).append(record)
    for key in BESIDE:
        if told := getattr(changes, key):
            document[key] = [list(each) if isinstance(each, tuple) else each for each in told]
    return document | ({THINK: True} if changes.think else {})


def graph_changes_to_dict(changes: GraphChanges, ontology: Ontology, update: int) -> Document:
    """Returns the document of a line that tells what an update did to the graph.

    Args:
      changes: of the update.
      ontology: the concepts of the map.
      update: its number, from 1. A node tells the number of the one that it came `since`, which
        stays, and not its age.
    """
    nodes = {
        name: [_node(node, ontology, update) for node in getattr(changes, name)]
        for name in ("added", "changed")
    }
    events = [_event(event) for event in changes.events]
    lists = {"removed": [*changes.removed], "events": events, "remarks": [*changes.remarks]}
    return {"update": update, **nodes, **lists}


def applied(nodes: Mapping[int, Document], document: Mapping[str, Any]) -> dict[int, Document]:
    """Returns the grown nodes of a graph, by id, after what a line tells of.

    Args:
      nodes: before it; none at first.
      document: of `graph_changes_to_dict`.
    """
    told = {node[ID]: node for name in ("added", "changed") for node in document[name]}
    gone = {*document["removed"]}
    return {name: node for name, node in {**nodes, **told}.items() if name not in gone}


def map_to_dict(
    graph: SceneGraph, ids: Sequence[int | str], nodes: Iterable[GrownNode], update: int
) -> Document:
    """Returns the whole graph of a map as the document of a line.

    Args:
      graph: on the host, what is observed first.
      ids: of its nodes; no two are alike.
      nodes: those that have grown, in order.
      update: the number of the last one, from 1.
    """
    grown = [further(_node(node, ontology_of(graph), update), IN_GRAPH) for node in nodes]
    said = [*[{}] * (len(ids) - len(grown)), *grown]
    attributes = [{ID: name} | of_node for name, of_node in zip(ids, said, strict=True)]
    return graph_to_dict(graph, attributes, update=update)


def _read_message(
    message: Any, ontology: Ontology, heard: Heard, where: str
) -> tuple[Changes, Heard]:
    """Returns what a PlanesData message tells that the one before has not.

    Nothing grows from fewer than two planes: a message with so few is as one without.
    """
    for axis in AXES:
        field(message, axis, where)
    records = [record for axis in AXES for record in _list(message, axis, where)]
    # The one list of a record is that of its points.
    with_points = [each for each in records if isinstance(each, dict) and [] not in each.values()]
    if len(with_points) < LEAST_OBSERVED:
        return Changes(removed=heard.names), Heard()
    graph, attributes = read_message(message, where)[:2]
    if ontology_of(graph) != ontology:
        known = ", ".join(ontology.names)
        raise ValueError(f"{where} is a message of S-Graphs, expected changes of {known}")
    names = tuple(each[ID] for each in attributes)
    there, before = {*names}, {name: row for row, name in enumerate(heard.names)}
    table = np.column_stack([graph.nodes.position, graph.nodes.normal, graph.nodes.width])
    place = np.array([before.get(name, -1) for name in names])
    still = place >= 0
    off = np.abs(table[still] - heard.table[place[still]])
    still[still] = (off <= STILL).all(axis=1)
    table[still] = heard.table[place[still]]
    rows = np.flatnonzero(~still)
    changes = Changes(
        observed=subgraph(graph, rows) if len(rows) else None,
        ids=tuple(names[row] for row in rows.tolist()),
        removed=tuple(name for name in heard.names if name not in there),
    )
    return changes, Heard(names, table)


def _list(document: Mapping[str, Any], key: str, where: str) -> list[Any]:
    """Returns the list under a key; none if there is no such key."""
    value = document.get(key, [])
    if not isinstance(value, list):
        raise ValueError(f"{where}: {key} is {value!r:.40}, expected a list")
    return value


def _flag(document: Mapping[str, Any], key: str, where: str) -> bool:
    value = document.get(key, False)
    if not isinstance(value, bool):
        raise ValueError(f"{where}: {key} is {value!r:.40}, expected true or false")
    return value


def _ids(document: Mapping[str, Any], key: str, where: str, kinds: tuple[type, ...]) -> tuple:
    ids = _list(document, key, where)
    for index, name in enumerate(ids):
        if not (is_id(name) and isinstance(name, kinds)):
            expected = "an id" if str in kinds else "the id of a grown node, a number"
            raise ValueError(f"{where}: {key}[{index}] is {name!r:.40}, expected {expected}")
    return tuple(ids)


def _node(node: GrownNode, ontology: Ontology, update: int) -> Document:
    return {
        ID: node.id,
        "label": ontology.names[node.label],
        "position": [*node.position],
        "observed": [*node.observed],
        "parts": [*node.parts],
        "since": update - node.age,
        CONFIDENCE: node.confidence,
    }


def _event(event: Event) -> Document:
    return {"kind": event.kind, ID: event.id, "others": [*event.others]}
