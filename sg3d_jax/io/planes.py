"""Observed planes as JSON documents and as CSV files, one scene each.

JSON: `{"planes": [{"centroid": [x, y, z], "normal": [x, y, z], "width": w}, ...]}`.
CSV: a header `cx,cy,cz,nx,ny,nz,width`, in any order, then one plane a row. All in metres; normals
point into the room. Numbers are kept as they are given, so that planes leave as they came.
"""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.io.files import number, read_text, vector, write_document
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.graph import SceneGraph, make_graph, observed_of
from sg3d_jax.scene.validate import validate_planes

COLUMNS: Final = ("cx", "cy", "cz", "nx", "ny", "nz", "width")
FIELDS: Final = ("centroid", "normal", "width")


def planes_from_csv(path: str | Path) -> SceneGraph:
    """Returns the planes of a CSV file as a host graph without edges.

    Raises:
      ValueError: one sentence that names the file, the line or plane, and the field.
    """
    return _scene(_read_rows(path), f"{path}")


def planes_from_dict(document: Any, where: str) -> SceneGraph:
    """Returns the planes of `{"planes": [...]}` as a host graph without edges.

    Args:
      document: parsed JSON, not yet trusted.
      where: what an error starts with, such as "planes.jsonl: line 3".

    Raises:
      ValueError: one sentence that names the plane, the field and what was expected.
    """
    _check_keys(document, ("planes",), f"{where}: the scene")
    if not isinstance(document["planes"], list):
        raise ValueError(f"{where}: planes is no list, expected a list of planes")
    return _scene([_row(plane, where, i) for i, plane in enumerate(document["planes"])], where)


def planes_to_dict(graph: SceneGraph) -> dict[str, Any]:
    """Returns the planes of a host graph as `{"planes": [...]}`."""
    nodes = observed_of(graph).nodes
    columns = (np.asarray(field).tolist() for field in (nodes.position, nodes.normal, nodes.width))
    planes = [dict(zip(FIELDS, plane, strict=True)) for plane in zip(*columns, strict=True)]
    return {"planes": planes}


def write_planes(path: str | Path, graph: SceneGraph) -> None:
    """Writes the planes of a host graph as JSON, exactly."""
    write_document(path, planes_to_dict(graph))


def _scene(rows: Sequence[Sequence[float]], where: str) -> SceneGraph:
    """Returns checked planes as a graph; a row is centroid, normal, width."""
    table = np.asarray(rows, np.float64).reshape(-1, len(COLUMNS))
    position, normal, width = table[:, :3], table[:, 3:6], table[:, 6]
    validate_planes(position, normal, width, where)
    no_edges = np.zeros((0, 2), np.int32)
    return make_graph([PLANE] * len(width), position, normal, width, no_edges)


def _row(plane: Any, where: str, index: int) -> list[float]:
    where = f"{where}: planes[{index}]"
    _check_keys(plane, FIELDS, where)
    centroid = vector(plane["centroid"], f"{where}.centroid")
    normal = vector(plane["normal"], f"{where}.normal")
    return [*centroid, *normal, number(plane["width"], f"{where}.width")]


def _check_keys(item: Any, expected: Sequence[str], where: str) -> None:
    names = ", ".join(expected)
    if not isinstance(item, dict):
        raise ValueError(f"{where} is {item!r:.40}, expected an object with {names}")
    for problem, keys in (("lacks", set(expected) - set(item)), ("has", set(item) - set(expected))):
        if keys:
            raise ValueError(f"{where} {problem} {min(keys)!r:.40}, expected exactly {names}")


def _read_rows(path: str | Path) -> list[list[float]]:
    """Returns the rows of a CSV file, their cells in the order of `COLUMNS`."""
    reader = csv.reader(read_text(path).split("\n"), strict=True)
    try:
        lines = [(reader.line_num, cells) for cells in reader if any(map(str.strip, cells))]
    except csv.Error as error:
        raise ValueError(f"{path}: line {reader.line_num} is not CSV ({error})") from error
    expected = ",".join(COLUMNS)
    if not lines:
        raise ValueError(f"{path}: the file is empty, expected a header {expected}")
    header = [cell.strip() for cell in lines[0][1]]
    for problem, names in _header_problems(header).items():
        if names:
            raise ValueError(f"{path}: {problem} column {names[0]!r:.40}, expected {expected}")
    order = [header.index(column) for column in COLUMNS]
    return [_cells(cells, order, f"{path}: line {line}") for line, cells in lines[1:]]


def _header_problems(header: list[str]) -> dict[str, list[str]]:
    return {
        "unknown": [name for name in header if name not in COLUMNS],
        "missing": [name for name in COLUMNS if name not in header],
        "repeated": [name for name in COLUMNS if header.count(name) > 1],
    }


def _cells(cells: list[str], order: list[int], where: str) -> list[float]:
    if len(cells) != len(order):
        raise ValueError(f"{where} has {len(cells)} cells, expected {len(order)}")
    return [
        _cell(cells[place], f"{where}: {column}")
        for column, place in zip(COLUMNS, order, strict=True)
    ]


def _cell(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"{where} is {text!r:.40}, expected a number") from error
