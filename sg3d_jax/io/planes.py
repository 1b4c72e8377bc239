"""Observed planes as arrays, as JSON documents and as CSV files, one scene each.

JSON: `{"planes": [{"centroid": [x, y, z], "normal": [x, y, z], "width": w}, ...]}`. If the document
has an `ontology`, there is such a list for every concept that is observed, under its layer's name
in lower case, and what is in it has the features of the concept. Things with a class may be listed
under `objects` (`io.objects`).
CSV: a header `cx,cy,cz,nx,ny,nz,width`, in any order, or other names if it is said which is which,
then one plane a row; without `cz` or `nz`, these are 0. All in metres; normals point into the room.
Numbers are kept as they are given: what can be mended is mended on the way into `complete`. Further
keys and columns, such as `id`, are attributes (`io.attributes`).
"""

import csv
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.io.attributes import ID, Read, further, value_in
from sg3d_jax.io.files import read_text, vector, write_document
from sg3d_jax.io.objects import THINGS, is_thing, things_in
from sg3d_jax.io.records import (
    KIND,
    Record,
    feature,
    features_by_row,
    graph_of,
    observed_lists,
    ontology_in,
    stated,
)
from sg3d_jax.scene.graph import Array, SceneGraph, make_graph, observed_of, ontology_of
from sg3d_jax.scene.ontology import FEATURES, PAPER_ONTOLOGY, Concept, Ontology
from sg3d_jax.scene.validate import check_observed

COLUMNS: Final = ("cx", "cy", "cz", "nx", "ny", "nz", "width")
FLAT: Final = ("cz", "nz")  # columns that a plan has no need of
DELIMITERS: Final = ",;\t"


def planes(
    centroid: Array, normal: Array, width: Array, ontology: Ontology = PAPER_ONTOLOGY
) -> SceneGraph:
    """Returns observed planes as a host graph without edges.

    What they hold is not looked at here: `complete` refuses what nothing can be grown from.

    Args:
      centroid: float[n, 3], metres.
      normal: float[n, 3], unit, into the room.
      width: float[n], metres.
      ontology: whose first observed concept with normals and widths they are.

    Raises:
      ValueError: an array has another shape, or nothing that is observed has normals and widths.
    """
    having = ontology.is_observed & ontology.has("normal") & ontology.has("width")
    if not having.any():
        raise ValueError(
            "planes: nothing observed has normal and width, expected that something has"
        )
    given = {"centroid": (centroid, (3,)), "normal": (normal, (3,)), "width": (width, ())}
    arrays: list[np.ndarray] = []
    for name, (values, row) in given.items():
        array = _array(values, f"planes: {name}")
        count = len(arrays[0]) if arrays else array.shape[0] if array.ndim else 1
        if array.shape != (count, *row):
            held, expected = list(array.shape), [count, *row]
            raise ValueError(f"planes: {name} has shape {held}, expected {expected}")
        arrays.append(array)
    label = np.full(len(arrays[0]), having.argmax())
    return make_graph(label, *arrays, ontology=ontology)


def _array(values: Array, where: str) -> np.ndarray:
    try:
        return np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:  # ragged, or no numbers
        raise ValueError(f"{where} is no array of numbers, expected a row a plane") from error


def read_csv(path: str | Path, columns: Mapping[str, str] | None = None) -> Read:
    """Returns the planes of a CSV file as a host graph without edges, and its further columns.

    A further column without a name is left out, and so are its empty cells; what reads like a
    number is one. Cells are parted by commas, semicolons or tabs, whichever the header has most of.

    Args:
      path: the file.
      columns: what columns of the file are called here, such as {"x": "cx", "length": "width"}.

    Raises:
      ValueError: one sentence that names the file, the line or plane, and the field.
    """
    lines = _lines(path)
    header = _renamed([cell.strip() for cell in lines[0][1]], columns or {}, f"{path}")
    for problem, names in _header_problems(header).items():
        if names:
            expected = ",".join(COLUMNS)
            raise ValueError(f"{path}: {problem} column {names[0]!r:.40}, expected {expected}")
    records = [
        dict(zip(header, _cells(cells, len(header), f"{path}: line {line}"), strict=True))
        for line, cells in lines[1:]
    ]
    flat = [name for name in FLAT if name not in header]
    rows = [
        [
            0.0 if column in flat else _number(record[column], f"{path}: line {line}: {column}")
            for column in COLUMNS
        ]
        for (line, _), record in zip(lines[1:], records, strict=True)
    ]
    table = np.array(rows, np.float64).reshape(-1, len(COLUMNS))
    graph = planes(table[:, :3], table[:, 3:6], table[:, 6])
    check_observed(graph, f"{path}")
    remarks = (f"has no column {' and '.join(flat)}, taken to be 0",) if flat else ()
    return Read(graph, [_attributes(record) for record in records], remarks=remarks)


def _renamed(header: list[str], columns: Mapping[str, str], where: str) -> list[str]:
    """Returns a header with our names for its columns."""
    for theirs, ours in columns.items():
        if theirs not in header:
            held = ",".join(header)
            raise ValueError(f"{where}: there is no column {theirs!r:.40}, expected of {held:.200}")
        if ours not in COLUMNS:
            expected = f"expected one of {', '.join(COLUMNS)}"
            raise ValueError(f"{where}: column {theirs!r:.40} is to be {ours!r:.40}, {expected}")
    return [columns.get(name, name) for name in header]


def planes_from_dict(document: Any, where: str) -> SceneGraph:
    """Returns the planes of a document as `read_planes_dict` does, without attributes."""
    return read_planes_dict(document, where).graph


def read_planes_dict(document: Any, where: str, ontology: Ontology = PAPER_ONTOLOGY) -> Read:
    """Returns the planes of `{"planes": [...]}` as a host graph without edges, and further keys.

    Args:
      document: parsed JSON, not yet trusted; with an `ontology`, a list for every concept that is
        observed.
      where: what an error starts with, such as "planes.jsonl: line 3".
      ontology: the concepts of a document that states none, which needs the first list alone.

    Returns:
      The nodes of each concept in their order, by concept.

    Raises:
      ValueError: one sentence that names the plane, the field and what was expected.
    """
    about = document if isinstance(document, dict) else {}
    is_stated = "ontology" in about
    ontology = ontology_in(about, where, ontology)
    lists = observed_lists(ontology)
    expected = ("ontology", *lists) if is_stated else (*lists,)
    optional = {THINGS} - {*lists} if is_stated else {THINGS, *expected[1:]}
    _check_keys(document, expected, f"{where}: the scene", exactly=True, optional=optional)
    for key in {*lists, THINGS} & document.keys():
        if not isinstance(document[key], list):
            raise ValueError(f"{where}: {key} is no list, expected a list of {key}")
    found, remarks = list[tuple[Record, dict[str, Any]]](), list[str]()
    if THINGS not in lists or is_thing(lists[THINGS][1]):
        lists.pop(THINGS, None)
        things = document.get(THINGS, [])
        found, remarks = things_in(things, ontology, f"{where}: {THINGS}")
    for key, (label, concept) in lists.items():
        known = ("centroid", *concept.features)
        found += [
            (
                observed_record(item, label, concept, f"{where}: {key}[{index}]"),
                further(item, known),
            )
            for index, item in enumerate(document.get(key, []))
        ]
    found.sort(key=lambda one: one[0].label)  # stable, and a thing may be of any concept
    graph = graph_of([record for record, _ in found], ontology)
    check_observed(graph, where)
    return Read(graph, [others for _, others in found], remarks=tuple(remarks))


def planes_to_dict(graph: SceneGraph) -> dict[str, Any]:
    """Returns the planes of a host graph as `{"planes": [...]}`, and what else is observed."""
    observed = observed_of(graph)
    concepts = ontology_of(graph).concepts
    lists: dict[str, list[Any]] = {key: [] for key in observed_lists(ontology_of(graph))}
    columns = observed.nodes.label.tolist(), observed.nodes.position.tolist()
    for label, centroid, owned in zip(*columns, features_by_row(observed), strict=True):
        lists[concepts[label].layer.lower()].append({"centroid": centroid, **owned})
    return {**stated(ontology_of(graph)), **lists}


def write_planes(path: str | Path, graph: SceneGraph) -> None:
    """Writes the planes of a host graph, and what else is observed, as JSON, exactly."""
    write_document(path, planes_to_dict(graph))


def observed_record(item: Any, label: int, concept: Concept, where: str) -> Record:
    """Returns the record of an object of a parsed document that is observed; more keys may be.

    Args:
      item: not yet trusted.
      label: of the concept.
      concept: of the node.
      where: what an error starts with, such as "planes.json: planes[3]".

    Raises:
      ValueError: it lacks a field, has a feature that the concept has not, or one that is no such.
    """
    names = [name for name in FEATURES if name in concept.features]
    _check_keys(item, ("centroid", *names), where)
    centroid = vector(item["centroid"], f"{where}.centroid")
    features = {name: feature(name, item[name], f"{where}.{name}", concept) for name in names}
    return Record(label, centroid, features)


def _check_keys(
    item: Any,
    expected: Sequence[str],
    where: str,
    exactly: bool = False,
    optional: Collection[str] = (),
) -> None:
    names = ", ".join(expected)
    if not isinstance(item, dict):
        raise ValueError(f"{where} is {item!r:.40}, expected an object with {names}")
    known = f"exactly {names}" if exactly else names
    if lacking := [key for key in expected if key not in item and key not in optional]:
        raise ValueError(f"{where} lacks {lacking[0]!r:.40}, expected {known}")
    others = further(item, (*expected, *optional))
    if odd := [key for key in others if exactly or (key in FEATURES and key != KIND)]:
        raise ValueError(f"{where} has {min(odd)!r:.40}, expected {known}")


def _lines(path: str | Path) -> list[tuple[int, list[str]]]:
    """Returns the lines of a CSV file that are not empty, at least one, with their numbers."""
    text = read_text(path).split("\n")
    first = next(filter(str.strip, text), "")
    reader = csv.reader(text, strict=True, delimiter=max(DELIMITERS, key=first.count))
    try:
        lines = [(reader.line_num, cells) for cells in reader if any(map(str.strip, cells))]
    except csv.Error as error:
        raise ValueError(f"{path}: line {reader.line_num} is not CSV ({error})") from error
    if not lines:
        raise ValueError(f"{path}: the file is empty, expected a header {','.join(COLUMNS)}")
    return lines


def _header_problems(header: list[str]) -> dict[str, list[str]]:
    return {
        "missing": [name for name in COLUMNS if name not in header and name not in FLAT],
        "repeated": [name for name in header if name and header.count(name) > 1],
    }


def _cells(cells: list[str], count: int, where: str) -> list[str]:
    if len(cells) != count:
        raise ValueError(f"{where} has {len(cells)} cells, expected {count}")
    return [cell.strip() for cell in cells]


def _number(text: str, where: str) -> float:
    try:
        if text.isascii() and "_" not in text:  # Python reads 1_0 and the digits of any script
            return float(text)
    except ValueError:
        pass
    raise ValueError(f"{where} is {text!r:.40}, expected a number")


def _attributes(record: dict[str, str]) -> dict[str, int | float | str]:
    """Returns the further columns of a row."""
    cells = further(record, ("", *COLUMNS)).items()
    return {
        name: value_in(text, (int,) if name == ID else (int, float)) for name, text in cells if text
    }
