"""What the documents of all formats share: nodes as records, and the ontology that they state.

A document without an ontology means the paper's. What a node may have beside its position is in
`FEATURES`, and which concepts have it in the ontology: no format names either.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.io.files import number, vector
from sg3d_jax.scene.graph import SceneGraph, features_of, make_graph, ontology_of
from sg3d_jax.scene.ontology import (
    FEATURES,
    PAPER_ONTOLOGY,
    Concept,
    Ontology,
    ontology_from_dict,
)

KIND: Final = "kind"  # the feature that documents hold as a word
_ZERO: Final = {name: np.zeros(shape).tolist() for name, shape in FEATURES.items()}


class Record(NamedTuple):
    """What a document says of a node."""

    label: int  # place among the concepts
    position: list[float]  # metres
    features: Mapping[str, Any]  # by name, as `FEATURES` has them; what is missing is zero


def features_by_row(graph: SceneGraph) -> list[dict[str, Any]]:
    """Returns the features that each node of a host graph has by its concept, as JSON values.

    A kind is its name, or null.
    """
    columns = {name: np.asarray(array).tolist() for name, array in features_of(graph).items()}
    concepts = ontology_of(graph).concepts
    owned = [[name for name in FEATURES if name in concept.features] for concept in concepts]
    label = np.asarray(graph.nodes.label).tolist()
    columns[KIND] = [kind_name(concepts[of], columns[KIND][row]) for row, of in enumerate(label)]
    return [{name: columns[name][row] for name in owned[of]} for row, of in enumerate(label)]


def observed_lists(ontology: Ontology) -> dict[str, tuple[int, Concept]]:
    """Returns the keys of documents that list what is observed, with its labels and concepts."""
    return {
        concept.layer.lower(): (label, concept)
        for label, concept in enumerate(ontology.concepts)
        if concept.observed
    }


def kind_name(concept: Concept, kind: float) -> str | None:
    """Returns the name of a kind of a concept, None if it is unknown."""
    return concept.kinds[int(kind) - 1] if kind else None


def feature(name: str, value: Any, where: str, concept: Concept) -> float | list[float]:
    """Returns a feature of a parsed document.

    Args:
      name: of the feature.
      value: not yet trusted.
      where: what an error starts with.
      concept: of the node.

    Raises:
      ValueError: it is not as many numbers as `FEATURES` says, or no kind of the concept.
    """
    shape = FEATURES[name]
    if name == KIND:
        if value is not None and value not in concept.kinds:
            known = ", ".join(concept.kinds)
            raise ValueError(f"{where} is {value!r:.40}, expected null or one of {known}")
        return 0.0 if value is None else 1.0 + concept.kinds.index(value)
    return vector(value, where, *shape) if shape else number(value, where)


def features_in(
    values: Mapping[str, Any], where: str, concept: Concept
) -> dict[str, float | list[float]]:
    """Returns the features that an object of a parsed document has; null is none.

    Where a concept has no kinds, `kind` is a word like any other.

    Raises:
      ValueError: one of them is not what `feature` expects.
    """
    features = {}
    for name in (name for name in FEATURES if name != KIND or concept.kinds):
        if (value := values.get(name)) is not None:
            features[name] = feature(name, value, f"{where}.{name}", concept)
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


def ontology_in(
    document: Mapping[str, Any], where: str, default: Ontology = PAPER_ONTOLOGY
) -> Ontology:
    """Returns the ontology that a parsed document states, if it states one.

    Args:
      document: what `stated` is part of, not yet trusted.
      where: what an error starts with.
      default: of one that states none.

    Raises:
      ValueError: one sentence that says what is wrong with it.
    """
    said = document.get("ontology")
    return default if said is None else ontology_from_dict(said, where)


def in_terms_of(graph: SceneGraph, ontology: Ontology) -> SceneGraph:
    """Returns a host graph of the paper's concepts as one of others that have the same names.

    Any other graph is returned as it is, and so is one with a concept that is not among them, or
    has other features there than a kind.

    Args:
      graph: unpadded.
      ontology: the concepts.
    """
    own, label = ontology_of(graph), np.asarray(graph.nodes.label)
    places = np.zeros(own.num_concepts, np.int32)
    for place in np.unique(label).tolist():
        concept = own.concepts[place]
        same = [o for o in ontology.concepts if o.name == concept.name and _alike(concept, o)]
        if own != PAPER_ONTOLOGY or not same:
            return graph
        places[place] = ontology.concepts.index(same[0])
    return graph._replace(nodes=graph.nodes._replace(label=places[label]), globals=ontology)


def _alike(concept: Concept, other: Concept) -> bool:
    """Returns whether nodes of a concept are nodes of another one."""
    same = {*concept.features} == {*other.features} - {KIND}
    return same and concept.observed == other.observed
