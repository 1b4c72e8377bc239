"""Scene graphs in a file: numpy's npz, version 1, never a pickle.

The arrays of all graphs are concatenated; graph g owns nodes `node_offset[g]:node_offset[g + 1]`
and edges `edge_offset[g]:edge_offset[g + 1]`. An edge is a pair of node indices of its own graph
and stands for both directions. `header` is a JSON object: what the data are and how they were made,
and their `ontology`, if that is not the paper's. A feature that a file lacks is zero; an array of
any other name is refused.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.io.archive import read_arrays
from sg3d_jax.io.files import MAX_GRAPHS, parsed, replacing
from sg3d_jax.io.records import ontology_in, stated
from sg3d_jax.scene.graph import SceneGraph, make_graph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import FEATURES, NUM_RELATIONS, PART_OF, PROXIMITY, Ontology
from sg3d_jax.scene.validate import validate_graph

VERSION: Final = 1
UNITS: Final = "metres"

# Type and shape of one row of each array; `g` graphs, `n` nodes, `e` undirected edges.
FIELDS: Final[Mapping[str, tuple[str, tuple[int, ...]]]] = {
    "node_offset": ("int64", ()),  # [g + 1]
    "edge_offset": ("int64", ()),  # [g + 1]
    "label": ("int32", ()),  # [n]
    "position": ("float64", (3,)),  # [n, 3], metres
    **{name: ("float64", shape) for name, shape in FEATURES.items()},  # [n, ...]
    "edges": ("int32", (2,)),  # [e, 2]
    "relation": ("int32", ()),  # [e]
}
NODE_FIELDS: Final = ("label", "position", *FEATURES)
EDGE_FIELDS: Final = ("edges", "relation")

Arrays = dict[str, np.ndarray]


class Dataset(NamedTuple):
    """Host graphs and what their file says about them."""

    graphs: list[SceneGraph]  # in the order of the file
    header: dict[str, Any]  # JSON values, such as name, source, seed, and parts (`splits.split_of`)


def save(
    path: str | Path,
    graphs: Sequence[SceneGraph],
    header: Mapping[str, Any],
    rules: bool = True,
) -> None:
    """Writes host graphs to a file; the same graphs and header give the same bytes.

    Args:
      path: of the file; it is replaced whole or left as it was.
      graphs: unpadded.
      header: JSON values, such as name, source, generator settings and seed. Schema version
        and units are added, and the ontology of the graphs.
      rules: whether edges must respect the hierarchy, as in `validate_graph`.

    Raises:
      ValueError: a graph is not sound or has another ontology than the first, there are too many,
        or there is no place for the file; nothing is written.
      OSError: the file cannot be written.
    """
    path = Path(path)
    _check_number(len(graphs), path)
    for index, graph in enumerate(graphs):
        validate_graph(graph, f"{path}: graph {index}", rules)
        if ontology_of(graph) != ontology_of(graphs[0]):
            problem = "has another ontology than graph 0, expected one a file"
            raise ValueError(f"{path}: graph {index} {problem}")
    about = {key: value for key, value in header.items() if key != "ontology"}
    about |= {"schema": VERSION, "units": UNITS}
    about |= stated(ontology_of(graphs[0])) if graphs else {}
    arrays: dict[str, Any] = {"header": np.array(json.dumps(about)), **_concatenate(graphs)}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load(path: str | Path, rules: bool = True) -> Dataset:
    """Reads the graphs and the header of a file.

    Args:
      path: of a file that `save` wrote.
      rules: whether edges must respect the hierarchy, as in `validate_graph`.

    Returns:
      Host graphs in float64, and the header.

    Raises:
      ValueError: one sentence that names the file and, where it applies, graph and field.
    """
    content = read_arrays(path, ("header", *FIELDS).__contains__)
    header = _header(content, path)
    ontology = ontology_in(header, f"{path}: header")
    arrays = _checked(content, path)
    num_graphs = len(arrays["node_offset"]) - 1
    _check_number(num_graphs, path)
    graphs = []
    for index in range(num_graphs):
        where = f"{path}: graph {index}"
        graph = _graph(arrays, index, ontology, where)
        validate_graph(graph, where, rules)
        graphs.append(graph)
    return Dataset(graphs, header)


def _concatenate(graphs: Sequence[SceneGraph]) -> Arrays:
    """Returns the arrays of a file."""
    kinds = (PROXIMITY, PART_OF)
    pairs = [[undirected_edges(graph, kind) for kind in kinds] for graph in graphs]
    counts = [[len(pair) for pair in of_graph] for of_graph in pairs]
    parts = {name: [getattr(graph.nodes, name) for graph in graphs] for name in NODE_FIELDS}
    parts["node_offset"] = [np.cumsum([0, *(len(label) for label in parts["label"])])]
    parts["edge_offset"] = [np.cumsum([0, *map(sum, counts)])]
    parts["edges"] = [pair for of_graph in pairs for pair in of_graph]
    parts["relation"] = [np.repeat(kinds, of_graph) for of_graph in counts]
    return {
        name: np.concatenate([np.zeros((0, *row), dtype), *parts[name]]).astype(dtype)
        for name, (dtype, row) in FIELDS.items()
    }


def _check_number(num_graphs: int, path: str | Path) -> None:
    if num_graphs > MAX_GRAPHS:
        raise ValueError(f"{path}: there are {num_graphs} graphs, expected {MAX_GRAPHS} at most")


def _header(content: Mapping[str, np.ndarray], path: str | Path) -> dict[str, Any]:
    """Returns the header of a file of this version."""
    try:
        header = parsed(str(content["header"]), "header")
        version, units = header["schema"], header["units"]
    except (KeyError, TypeError, ValueError) as error:
        expected = "a JSON object with schema and units, as sg3d_jax writes it"
        raise ValueError(f"{path}: header is missing or unreadable, expected {expected}") from error
    for name, value, expected in (("schema", version, VERSION), ("units", units, UNITS)):
        if value != expected:
            raise ValueError(f"{path}: header has {name} {value!r}, expected {expected!r}")
    return header


def _checked(content: Mapping[str, np.ndarray], path: str | Path) -> Arrays:
    """Returns the arrays of a file if their types and sizes fit together."""
    num_nodes = np.size(content.get("label", ()))
    missing = {name: np.zeros((num_nodes, *shape)) for name, shape in FEATURES.items()}
    content = missing | dict(content)
    for name, (dtype, row) in FIELDS.items():
        if name not in content:
            raise ValueError(f"{path}: array {name} is missing")
        array = content[name]
        if array.dtype != dtype or array.ndim != 1 + len(row) or array.shape[1:] != row:
            sizes = ", ".join(["n", *map(str, row)])
            held = f"{array.dtype}{list(array.shape)}"
            raise ValueError(f"{path}: array {name} is {held}, expected {dtype}[{sizes}]")
    arrays = {name: content[name] for name in FIELDS}
    for offset, names in (("node_offset", NODE_FIELDS), ("edge_offset", EDGE_FIELDS)):
        for name in names:
            _check_offset(arrays[offset], len(arrays[name]), f"{path}: {offset}", name)
    by_nodes, by_edges = len(arrays["node_offset"]) - 1, len(arrays["edge_offset"]) - 1
    if by_nodes != by_edges:
        raise ValueError(f"{path}: edge_offset is of {by_edges} graphs, node_offset of {by_nodes}")
    return arrays


def _check_offset(offset: np.ndarray, num_rows: int, where: str, name: str) -> None:
    if not len(offset) or offset[0] != 0 or offset[-1] != num_rows or (np.diff(offset) < 0).any():
        raise ValueError(f"{where} does not rise from 0 to {num_rows}, the length of {name}")


def _graph(arrays: Arrays, index: int, ontology: Ontology, where: str) -> SceneGraph:
    """Returns one graph of a file; what its values mean is not checked yet, save the relations."""
    nodes = slice(*arrays["node_offset"][index : index + 2])
    edges = slice(*arrays["edge_offset"][index : index + 2])
    pairs, relation = arrays["edges"][edges], arrays["relation"][edges]
    unknown = (relation < 0) | (relation >= NUM_RELATIONS)
    if unknown.any():
        held = f"relation {relation[unknown][0]}, expected 0 to {NUM_RELATIONS - 1}"
        raise ValueError(f"{where}: edge {pairs[unknown][0].tolist()} has {held}")
    return make_graph(
        **{name: arrays[name][nodes] for name in NODE_FIELDS},
        part_of=pairs[relation == PART_OF],
        proximity=pairs[relation == PROXIMITY],
        ontology=ontology,
    )
