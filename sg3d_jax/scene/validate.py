"""Checks on the host: is this a scene graph, and are these planes something to grow one from?

Every refusal is a `ValueError` of one sentence: where, which node or plane (counted from 0), which
field, what it holds, and what was expected.
"""

from typing import Final

import numpy as np

from sg3d_jax.scene.concepts import (
    CONCEPTS,
    NUM_CONCEPTS,
    NUM_RELATIONS,
    PART_OF,
    PART_OF_RULES,
    PLANE,
    RELATIONS,
)
from sg3d_jax.scene.graph import SceneGraph

GRAPH_UNIT_TOLERANCE: Final = 1e-3
PLANE_UNIT_TOLERANCE: Final = 1e-2  # users round their normals to two decimals
MAX_TILT: Final = 0.05  # |z| of a unit normal, about 3 degrees from vertical planes
DUPLICATE_DECIMALS: Final = 6  # micrometres
MAX_MEDIAN_WIDTH: Final = 100.0  # metres; a median wall of 100 m is 10 cm in millimetres
MAX_EXTENT: Final = 2000.0  # metres


def validate_graph(graph: SceneGraph, where: str, rules: bool = True) -> None:
    """Refuses a host graph that breaks the data model.

    Args:
      graph: unpadded numpy graph, metres.
      where: what the sentence starts with, such as "scenes.npz: graph 3".
      rules: whether edges must respect the hierarchy (`PART_OF_RULES`; proximity between planes
        only). A generated graph may break it and is still to be drawn and scored.

    Raises:
      ValueError: one sentence that names the field and what was expected.
    """
    _check_shapes(graph, where)
    _check_nodes(graph, where)
    _check_edges(graph, where)
    if rules:
        _check_rules(graph, where)


def validate_planes(
    position: np.ndarray, normal: np.ndarray, width: np.ndarray, where: str
) -> None:
    """Refuses planes that no scene graph can be grown from.

    Args:
      position: float[n, 3], centroids, metres.
      normal: float[n, 3], unit and horizontal.
      width: float[n], metres.
      where: what the sentence starts with, such as "planes.jsonl: scene 3".

    Raises:
      ValueError: one sentence that names the plane, the field and what was expected.
    """
    planes = {"centroid": position, "normal": normal, "width": width}
    _check_shape(where, "centroid", position, (len(width), 3))
    _check_shape(where, "normal", normal, (len(width), 3))
    _check_shape(where, "width", width, (len(width),))
    if len(width) < 2:
        held = "one plane" if len(width) else "no planes"
        raise ValueError(f"{where}: planes holds {held}, expected at least two to make a room of")
    for name, values in planes.items():
        finite = np.isfinite(values)
        _refuse(where, "planes", name, values, ~finite, "finite numbers")
    _refuse(where, "planes", "normal", normal, ~_is_unit(normal, PLANE_UNIT_TOLERANCE), "length 1")
    tilted = np.abs(normal[:, 2]) > MAX_TILT
    _refuse(where, "planes", "normal", normal, tilted, f"|z| <= {MAX_TILT}, as of vertical planes")
    _refuse(where, "planes", "width", width, width <= 0, "more than zero metres")
    _check_metres(position, width, where)
    _check_duplicates(np.column_stack([position, normal, width]), where)


def _check_shape(where: str, name: str, array: np.ndarray, expected: tuple[int, ...]) -> None:
    if np.shape(array) != expected:
        shape = list(np.shape(array))
        raise ValueError(f"{where}: {name} has shape {shape}, expected {list(expected)}")


def _check_shapes(graph: SceneGraph, where: str) -> None:
    nodes, edges = graph.nodes, graph.edges
    num_nodes, num_edges = np.size(nodes.label), np.size(graph.senders)
    vectors = ("position", "normal")
    for name, array in nodes._asdict().items():
        _check_shape(where, name, array, (num_nodes, 3) if name in vectors else (num_nodes,))
    pairs = {"senders": graph.senders, "receivers": graph.receivers, **edges._asdict()}
    for name, array in pairs.items():
        _check_shape(where, name, array, (num_edges,))
    for name, array in {"label": nodes.label, **pairs}.items():
        if not np.issubdtype(np.asarray(array).dtype, np.integer) and name != "mask":
            raise ValueError(f"{where}: {name} is {np.asarray(array).dtype}, expected integers")
    counts = {"n_node": (graph.n_node, num_nodes), "n_edge": (graph.n_edge, num_edges)}
    for name, (count, expected) in counts.items():
        if not np.array_equal(count, [expected]):
            raise ValueError(f"{where}: {name} is {_text(count)}, expected [{expected}]")
    if not (np.all(nodes.mask) and np.all(edges.mask)):
        raise ValueError(f"{where}: mask has False entries, expected an unpadded graph")


def _check_nodes(graph: SceneGraph, where: str) -> None:
    label, position, normal, width, _ = (np.asarray(field) for field in graph.nodes)
    if not len(label):
        raise ValueError(f"{where}: nodes is empty, expected at least one")
    known = (label >= 0) & (label < NUM_CONCEPTS)
    _refuse(where, "nodes", "label", label, ~known, f"0 to {NUM_CONCEPTS - 1}")
    for name, values in (("position", position), ("normal", normal), ("width", width)):
        _refuse(where, "nodes", name, values, ~np.isfinite(values), "finite numbers")
    plane = label == PLANE
    skewed = plane & ~_is_unit(normal, GRAPH_UNIT_TOLERANCE)
    _refuse(where, "nodes", "normal", normal, skewed, "length 1, as of a plane")
    _refuse(where, "nodes", "width", width, plane & (width < 0), "zero metres or more")
    expected = "zero: only planes have one"
    _refuse(where, "nodes", "normal", normal, ~plane & normal.any(axis=-1), expected)
    _refuse(where, "nodes", "width", width, ~plane & (width != 0), expected)


def _check_edges(graph: SceneGraph, where: str) -> None:
    senders, receivers = np.asarray(graph.senders), np.asarray(graph.receivers)
    relation, num_nodes = np.asarray(graph.edges.relation), len(graph.nodes.label)
    ends = np.stack([senders, receivers], axis=-1)
    missing = np.any((ends < 0) | (ends >= num_nodes), axis=-1)
    _refuse_edge(where, ends, missing, f"joins a missing node, expected 0 to {num_nodes - 1}")
    unknown = ~np.isin(relation, range(NUM_RELATIONS))
    _refuse_edge(where, ends, unknown, f"has an unknown relation, expected one of {RELATIONS}")
    _refuse_edge(where, ends, ends[:, 0] == ends[:, 1], "is a loop, expected two nodes")
    code = senders.astype(np.int64) * num_nodes + receivers
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    repeated = np.isin(np.arange(len(code)), first[count > 1])
    _refuse_edge(where, ends, repeated, "is there twice, expected once")
    there = code * NUM_RELATIONS + relation
    back = (receivers.astype(np.int64) * num_nodes + senders) * NUM_RELATIONS + relation
    _refuse_edge(where, ends, ~np.isin(back, there), "has no opposite, expected both directions")


def _check_rules(graph: SceneGraph, where: str) -> None:
    ends = np.stack([graph.senders, graph.receivers], axis=-1)
    kinds = np.sort(np.asarray(graph.nodes.label)[ends], axis=-1)
    part_of = np.asarray(graph.edges.relation) == PART_OF
    allowed = np.zeros((NUM_CONCEPTS, NUM_CONCEPTS), bool)
    allowed[tuple(zip(*PART_OF_RULES, strict=True))] = True
    wrong = np.where(part_of, ~allowed[kinds[:, 0], kinds[:, 1]], (kinds != PLANE).any(axis=-1))
    if wrong.any():
        edge = int(np.argmax(wrong))
        low, high = (CONCEPTS[kind] for kind in kinds[edge])
        expected = "a child and its parent" if part_of[edge] else "two planes"
        problem = f"joins {low} and {high} as {RELATIONS[int(part_of[edge])]}, expected {expected}"
        _refuse_edge(where, ends, wrong, problem)


def _check_metres(position: np.ndarray, width: np.ndarray, where: str) -> None:
    with np.errstate(over="ignore"):
        extent = float(np.ptp(position, axis=0).max())
    median = float(np.median(width))
    if median > MAX_MEDIAN_WIDTH or extent > MAX_EXTENT:
        raise ValueError(
            f"{where}: planes spans {extent:.6g} with a median width of {median:.6g}, which looks "
            "like millimetres, expected centroid and width in metres"
        )


def _check_duplicates(rows: np.ndarray, where: str) -> None:
    rounded = np.round(rows, DUPLICATE_DECIMALS) + 0.0  # + 0.0 makes -0.0 and 0.0 the same
    _, first, group = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    original = first[group.reshape(-1)]
    repeats = np.flatnonzero(original != np.arange(len(rows)))
    if repeats.size:
        raise ValueError(
            f"{where}: planes[{repeats[0]}] repeats planes[{original[repeats[0]]}], expected a "
            "different centroid, normal or width"
        )


def _is_unit(normal: np.ndarray, tolerance: float) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.abs(np.linalg.norm(normal, axis=-1) - 1) <= tolerance


def _refuse(
    where: str, items: str, name: str, values: np.ndarray, wrong: np.ndarray, expected: str
) -> None:
    """Raises for the first wrong row, if any."""
    rows = wrong.reshape(len(wrong), -1).any(axis=-1)
    if rows.any():
        index = int(np.argmax(rows))
        held = _text(values[index])
        raise ValueError(f"{where}: {items}[{index}].{name} is {held}, expected {expected}")


def _refuse_edge(where: str, ends: np.ndarray, wrong: np.ndarray, problem: str) -> None:
    """Raises for the first wrong edge, if any."""
    if wrong.any():
        sender, receiver = ends[int(np.argmax(wrong))]
        raise ValueError(f"{where}: edge [{sender}, {receiver}] {problem}")


def _text(value: np.ndarray | np.generic) -> str:
    """Returns a number or vector as a user would write it."""
    plain = np.asarray(value).tolist()
    numbers = plain if isinstance(plain, list) else [plain]
    listed = ", ".join(f"{number:.6g}" for number in numbers)
    return f"[{listed}]" if isinstance(plain, list) else listed
