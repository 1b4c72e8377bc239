"""What the documents of all formats share: nodes as records, and the ontology that they state.

A document without an ontology means the paper's. What a node may have beside its position is in
`FEATURES`, and which concepts have it in the ontology: no format names either.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.io.files import number, vector
from sg3d_jax.scene.graph import SceneGraph, features_of, make_graph, ontology_of
from sg3d_jax.scene.ontology import FEATURES, PAPER_ONTOLOGY, Ontology, ontology_from_dict

_ZERO: Final = {name: np.zeros(shape).tolist() for name, shape in FEATURES.items()}


class Record(NamedTuple):
    """What a document says of a node."""

    label: int  # place among the concepts
    position: list[float]  # metres
    features: Mapping[str, Any]  # by name, as `FEATURES` has them; what is missing is zero


def features_by_row(graph: SceneGraph) -> list[dict[str, Any]]:
    """Returns the features that each node of a host graph has by its concept, as JSON values."""
    columns = {name: np.asarray(array).tolist() for name, array in features_of(graph).items()}
    owned = [
        [name for name in FEATURES if name in concept.features]
        for concept in ontology_of(graph).concepts
    ]
    return [
        {name: columns[name][row] for name in owned[label]}
        for row, label in enumerate(np.asarray(graph.nodes.label).tolist())
    ]


def feature(name: str, value: Any, where: str) -> float | list[float]:
    """Returns a feature of a parsed document.

    Raises:
      ValueError: it is not as many numbers as `FEATURES` says.
    """
    shape = FEATURES[name]
    return vector(value, where, *shape) if shape else number(value, where)


def features_in(values: Mapping[str, Any], where: str) -> dict[str, float | list[float]]:
    """Returns the features that an object of a parsed document has; null is none.

    Raises:
      ValueError: one of them is not as many numbers as `FEATURES` says.
    """
    features = {}
    for name in _ZERO:
        if (value := values.get(name)) is not None:
            features[name] = feature(name, value, f"{where}.{name}")
    return features


def graph_of(
    records: Sequence[Record],
    ontology: Ontology,
    part_of: Sequence[Sequence[int]] = (),
    proximity: Sequence[Sequence[int]] = (),
) -> SceneGraph:
    """Returns the host graph of records, which nobody has validated yet.

    Args:
      records: of the nodes, in the order of their rows.
      ontology: the concepts.
      part_of: pairs of rows.
      proximity: pairs of rows.
    """
    features = {
        name: np.array([record.features.get(name, zero) for record in records], np.float64)
        for name, zero in _ZERO.items()
    }
    return make_graph(
        [record.label for record in records],
        np.array([record.position for record in records], np.float64),
        **features,
        part_of=part_of,
        proximity=proximity,
        ontology=ontology,
    )


def stated(ontology: Ontology) -> dict[str, Any]:
    """Returns what a document says of its concepts: nothing if they are the paper's."""
    return {} if ontology == PAPER_ONTOLOGY else {"ontology": ontology.to_dict()}


def ontology_in(document: Mapping[str, Any], where: str) -> Ontology:
    """Returns the ontology that a parsed document states; of one that states none, the paper's.

    Args:
      document: what `stated` is part of, not yet trusted.
      where: what an error starts with.

    Raises:
      ValueError: one sentence that says what is wrong with it.
    """
    return ontology_from_dict(document.get("ontology"), where)
