"""Checks on the host: is this a scene graph, and are these planes something to grow one from?

Every refusal is a `ValueError` of one sentence: where, which node or plane (counted from 0), which
field, what it holds, and what was expected.
"""

from typing import Final

import numpy as np

from sg3d_jax.scene.graph import FEATURES, SceneGraph, ontology_of
from sg3d_jax.scene.ontology import NUM_RELATIONS, PART_OF, RELATIONS, Ontology

UNIT_TOLERANCE: Final = 1e-3
LEAST_OBSERVED: Final = 2
MAX_MEDIAN_WIDTH: Final = 100.0  # metres; a median wall of 100 m is 10 cm in millimetres
MAX_EXTENT: Final = 2000.0  # metres
MAX_COORDINATE: Final = 1e9  # metres; float64 counts micrometres there, and no square overflows


def validate_graph(graph: SceneGraph, where: str, rules: bool = True) -> None:
    """Refuses a host graph that breaks the data model.

    Args:
      graph: unpadded numpy graph, metres.
      where: what the sentence starts with, such as "scenes.npz: graph 3".
      rules: whether edges must respect the hierarchy: the rules of the ontology, and proximity
        between observed nodes only; and whether normals must have length 1, and not any but zero.
        A graph that was generated or observed may break either, and is still to be drawn, scored
        and grown from.

    Raises:
      ValueError: one sentence that names the field and what was expected.
    """
    _check_shapes(graph, where)
    _check_nodes(graph, where, rules)
    _check_edges(graph, where)
    if rules:
        _check_rules(graph, where)


def check_observed(graph: SceneGraph, where: str) -> None:
    """Refuses a host graph from whose observed nodes nothing can be grown.

    The one check of what is observed, for every reader and for `complete`: numbers that are none,
    normals that point nowhere. What can be mended is mended on the way in (`infer.intake`).

    Args:
      graph: unpadded; what is not observed is not looked at.
      where: what the sentence starts with, such as "planes.jsonl: scene 3".

    Raises:
      ValueError: one sentence that names the plane (counted among the observed nodes of its
        concept), the field and what was expected.
    """
    _check_shapes(graph, where)
    ontology, nodes = ontology_of(graph), graph.nodes
    label, position = np.asarray(nodes.label), np.asarray(nodes.position)
    _refuse(where, "nodes", "label", label, ~_is_known(graph), _known_labels(graph))
    kinds = [kind for kind in range(ontology.num_concepts) if ontology.is_observed[kind]]
    observed = np.isin(label, kinds)
    check_count(label[observed], ontology, where)
    for kind in kinds:
        concept = ontology.concepts[kind]
        _check_intake(graph, label == kind, concept.features, where, concept.layer.lower())
    _check_featureless(graph, observed, where)
    _check_kinds(graph, observed, where)
    width = np.asarray(nodes.width)[observed]
    _check_metres(position[observed], width, where, ontology.observed_plural)


def check_count(label: np.ndarray, ontology: Ontology, where: str, without: str = "") -> None:
    """Refuses fewer observed nodes than can be grouped.

    Args:
      label: int[n], of what is observed.
      ontology: the concepts.
      where: what the sentence starts with.
      without: what became of others, such as ", having left out 3".

    Raises:
      ValueError: there are fewer than two.
    """
    if len(label) < LEAST_OBSERVED:
        plural = ontology.observed_plural
        held = f"one {ontology.names[label[0]]}" if len(label) else f"no {plural}"
        raise ValueError(f"{where}: {plural} holds {held}{without}, expected at least two to group")


def _check_intake(
    graph: SceneGraph, rows: np.ndarray, features: tuple[str, ...], where: str, plural: str
) -> None:
    """Refuses observed nodes of one concept that are nowhere, or whose features make no sense."""
    columns = {"centroid": graph.nodes.position} | {
        name: getattr(graph.nodes, name) for name in features
    }
    columns = {name: np.asarray(column)[rows] for name, column in columns.items()}
    for name, values in columns.items():
        _refuse(where, plural, name, values, ~np.isfinite(values), "finite numbers")
        far = (np.abs(values) > MAX_COORDINATE) & (name != "normal")  # of which the way counts
        _refuse(where, plural, name, values, far, f"numbers within {MAX_COORDINATE:g}")
    if "normal" in features:
        normal = columns["normal"]
        _refuse(where, plural, "normal", normal, ~normal.any(axis=-1), "length 1")
    if "width" in features:
        width = columns["width"]
        _refuse(where, plural, "width", width, width < 0, "zero metres or more")


def _check_shape(where: str, name: str, array: np.ndarray, expected: tuple[int, ...]) -> None:
    if np.shape(array) != expected:
        shape = list(np.shape(array))
        raise ValueError(f"{where}: {name} has shape {shape}, expected {list(expected)}")


def _check_shapes(graph: SceneGraph, where: str) -> None:
    nodes, edges = graph.nodes, graph.edges
    num_nodes, num_edges = np.size(nodes.label), np.size(graph.senders)
    rows = {"position": (3,), **FEATURES}
    for name, array in nodes._asdict().items():
        _check_shape(where, name, array, (num_nodes, *rows.get(name, ())))
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


def _check_nodes(graph: SceneGraph, where: str, unit: bool) -> None:
    nodes, ontology = graph.nodes, ontology_of(graph)
    label = np.asarray(nodes.label)
    if not len(label):
        raise ValueError(f"{where}: nodes is empty, expected at least one")
    _refuse(where, "nodes", "label", label, ~_is_known(graph), _known_labels(graph))
    for name in ("position", *FEATURES):
        values = np.asarray(getattr(nodes, name))
        _refuse(where, "nodes", name, values, ~np.isfinite(values), "finite numbers")
        far = (np.abs(values) > MAX_COORDINATE) & (name != "normal")  # of which the way counts
        _refuse(where, "nodes", name, values, far, f"numbers within {MAX_COORDINATE:g}")
    facing, wide = (ontology.has(name)[label] for name in ("normal", "width"))
    normal, width = np.asarray(nodes.normal), np.asarray(nodes.width)
    skewed = ~_is_unit(normal) if unit else ~normal.any(axis=-1)
    _refuse(where, "nodes", "normal", normal, facing & skewed, "length 1")
    _refuse(where, "nodes", "width", width, wide & (width < 0), "zero metres or more")
    _check_featureless(graph, np.ones(len(label), bool), where)
    _check_kinds(graph, np.ones(len(label), bool), where)
    wrong = np.asarray(nodes.observed) != ontology.is_observed[label]
    _refuse(where, "nodes", "observed", np.asarray(nodes.observed), wrong, "what its label says")


def _check_featureless(graph: SceneGraph, rows: np.ndarray, where: str) -> None:
    """Refuses nodes that have a feature which their concept has not."""
    ontology, label = ontology_of(graph), np.asarray(graph.nodes.label)
    for name in FEATURES:
        values, having = np.asarray(getattr(graph.nodes, name)), ontology.has(name)[label]
        owners = " and ".join(c.layer.lower() for c in ontology.concepts if name in c.features)
        astray = rows & ~having & _rows_with_any(values != 0)
        _refuse(where, "nodes", name, values, astray, f"zero: only {owners or 'others'} have one")


def _check_kinds(graph: SceneGraph, rows: np.ndarray, where: str) -> None:
    """Refuses kinds that the concept of a node has not."""
    most = ontology_of(graph).num_kinds[np.asarray(graph.nodes.label)]
    kind = np.asarray(graph.nodes.kind)
    wrong = rows & ~np.isin(kind, range(int(most.max(initial=0)) + 1)) | rows & (kind > most)
    expected = f"0 to {most[np.argmax(wrong)]}" if len(most) else ""
    _refuse(where, "nodes", "kind", kind, wrong, expected)


def _is_known(graph: SceneGraph) -> np.ndarray:
    label = np.asarray(graph.nodes.label)
    return (label >= 0) & (label < ontology_of(graph).num_concepts)


def _known_labels(graph: SceneGraph) -> str:
    return f"0 to {ontology_of(graph).num_concepts - 1}"


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
    ontology, ends = ontology_of(graph), np.stack([graph.senders, graph.receivers], axis=-1)
    kinds = np.sort(np.asarray(graph.nodes.label)[ends], axis=-1)
    part_of = np.asarray(graph.edges.relation) == PART_OF
    allowed = ontology.may_be_part[kinds[:, 0], kinds[:, 1]]
    wrong = np.where(part_of, ~allowed, ~ontology.is_observed[kinds].all(axis=-1))
    if wrong.any():
        edge = int(np.argmax(wrong))
        low, high = (ontology.names[kind] for kind in kinds[edge])
        expected = "a part and its whole" if part_of[edge] else "two that are observed"
        problem = f"joins {low} and {high} as {RELATIONS[int(part_of[edge])]}, expected {expected}"
        _refuse_edge(where, ends, wrong, problem)


def seems_not_in_metres(graph: SceneGraph) -> bool:
    """Returns whether a sound graph is larger than any in metres."""
    nodes, observed = graph.nodes, np.asarray(graph.nodes.observed)
    extent, median = _size(np.asarray(nodes.position), np.asarray(nodes.width)[observed])
    return median > MAX_MEDIAN_WIDTH or extent > MAX_EXTENT


def _size(position: np.ndarray, width: np.ndarray) -> tuple[float, float]:
    """Returns how far positions are apart, and the median width."""
    with np.errstate(over="ignore"):
        extent = float(np.ptp(position, axis=0).max()) if len(position) else 0.0
    return extent, float(np.median(width[width > 0])) if (width > 0).any() else 0.0


def _check_metres(position: np.ndarray, width: np.ndarray, where: str, plural: str) -> None:
    extent, median = _size(position, width)
    if median > MAX_MEDIAN_WIDTH or extent > MAX_EXTENT:
        raise ValueError(
            f"{where}: {plural} spans {extent:.6g} with a median width of {median:.6g}, which "
            "looks like millimetres, expected centroid and width in metres"
        )


def _is_unit(normal: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.abs(np.linalg.norm(normal, axis=-1) - 1) <= UNIT_TOLERANCE


def _rows_with_any(array: np.ndarray) -> np.ndarray:
    """Returns bool[n], whether anything of a row is True; there may be no rows."""
    return np.asarray(array.any(axis=tuple(range(1, array.ndim))))


def _refuse(
    where: str, items: str, name: str, values: np.ndarray, wrong: np.ndarray, expected: str
) -> None:
    """Raises for the first wrong row, if any."""
    rows = _rows_with_any(wrong)
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
