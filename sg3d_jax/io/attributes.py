"""What else a file says of nodes: ids and whatever a user writes beside what we know.

Graphs hold numbers alone, so attributes travel beside them, a dict of JSON values a node: read with
a graph, mapped to the nodes of another one, and written with that. How sure a node is, from 0 to
1, is the attribute "confidence"; how sure the part-of edges are is an array of its own. How likely
each kind is for a node is the attribute "kinds".
"""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of, parts_first
from sg3d_jax.scene.ontology import Ontology

Attributes = Sequence[Mapping[str, Any]]

ID: Final = "id"
NAME: Final = "name"  # what a person calls a node
CONFIDENCE: Final = "confidence"  # of a node, and of an edge where a format says things of edges
KINDS: Final = "kinds"  # such as {"bedroom": 0.83, "office": 0.17}, the likeliest first
LEAST_CHANCE: Final = 0.005  # that a kind must have to be said


class Read(NamedTuple):
    """A graph as a file has it."""

    graph: SceneGraph  # on the host
    attributes: Attributes  # of each node
    edge_confidence: np.ndarray | None = None  # float[e], 0 to 1, of the rows of `parts_first`
    remarks: tuple[str, ...] = ()  # what of the file is not in it; a sentence each


def bare(graph: SceneGraph) -> Read:
    """Returns a graph of whose nodes and edges nothing else is said."""
    return Read(graph, [{}] * len(graph.nodes.label))


def own(ontology: Ontology) -> tuple[str, ...]:
    """Returns what documents of graphs say of a node beside its id."""
    return ("label", "position", *ontology.features)


def further(values: Mapping[str, Any], known: Sequence[str]) -> dict[str, Any]:
    """Returns what a mapping has beside known keys."""
    return {key: value for key, value in values.items() if key not in known}


def check_attributes(
    attributes: Attributes,
    ontology: Ontology,
    where: str,
    noun: str = "nodes",
    names: Sequence[str] = (),
) -> None:
    """Refuses attributes that a document of a graph cannot hold.

    Args:
      attributes: of each node.
      ontology: the concepts of the nodes.
      where: what the sentence starts with, such as "planes.json".
      noun: what the sentence calls the nodes.
      names: what a format says of a node itself, beside `own`.

    Raises:
      ValueError: one sentence that names the node and its attribute: a key that graphs use, ids
        that repeat or are none, values that are not JSON.
    """
    row_of_id: dict[int | str, int] = {}
    for row, held in enumerate(attributes):
        here = f"{where}: {noun}[{row}]"
        if taken := [key for key in (*own(ontology), *names) if key in held]:
            raise ValueError(
                f"{here} has {taken[0]!r}, which the result says itself, expected another name"
            )
        if ID in held:
            check_id(held[ID], row_of_id, here)
            row_of_id[held[ID]] = row
        try:
            json.dumps(held, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{here} is {held!r:.60}, expected JSON ({error})") from error


def check_id(value: Any, taken: Mapping[int | str, int], where: str) -> None:
    """Refuses what is no id of a node, or that of another one.

    Raises:
      ValueError: one sentence.
    """
    if not is_id(value):
        raise ValueError(f"{where}.id is {value!r:.40}, expected an integer or a name")
    if value in taken:
        raise ValueError(f"{where}.id is {value!r:.40} again, expected unique ids")


def is_id(value: Any) -> bool:
    """Returns whether a value can be the id of a node."""
    return isinstance(value, (int, str)) and not isinstance(value, bool)


def node_ids(attributes: Attributes) -> list[int | str]:
    """Returns the id of each node: its own, or its row number, or one beyond all others' ids."""
    given = [held.get(ID) for held in attributes]
    numbers = [name for name in given if isinstance(name, int)]
    first = next((row for row, name in enumerate(given) if name is None), 0)
    beyond = max(0, max(numbers, default=-1) + 1 - first)
    return [row + beyond if name is None else name for row, name in enumerate(given)]


def value_in(text: str, kinds: Sequence[Callable[[str], float]]) -> int | float | str:
    """Returns a number whose digits are those of a text; else the text.

    Args:
      text: such as a cell of a table.
      kinds: which numbers it may be: int, float.
    """
    for kind in kinds:
        try:
            value = kind(text)
        except ValueError:
            continue
        if str(value) == text and value - value == 0:  # finite: nan and inf are no JSON
            return value
    return text


def with_confidence(attributes: Attributes, confidence: Array | None) -> Attributes:
    """Returns the attributes of nodes with how sure each is.

    Args:
      attributes: of each node; one that has a confidence of its own, such as that of whatever found
        a plane, keeps it.
      confidence: float[n], 0 to 1; None if nothing is known.
    """
    if confidence is None:
        return attributes
    values = np.asarray(confidence, np.float64).tolist()
    return [{CONFIDENCE: value} | {**held} for value, held in zip(values, attributes, strict=True)]


def with_kinds(attributes: Attributes, graph: SceneGraph, chances: Array | None) -> Attributes:
    """Returns the attributes of nodes with how likely each kind is for those that were grown.

    Args:
      attributes: of each node.
      graph: unpadded.
      chances: float[grown, K] of `Completion.kinds`, of the last nodes; None if nothing is known.
    """
    if chances is None:
        return attributes
    concepts, first = ontology_of(graph).concepts, len(attributes) - len(chances)
    said = [*attributes[:first]]
    labels = np.asarray(graph.nodes.label)[first:].tolist()
    for held, label, row in zip(attributes[first:], labels, np.asarray(chances), strict=True):
        kinds = concepts[label].kinds
        likely = [place for place in np.argsort(-row, kind="stable") if row[place] > LEAST_CHANCE]
        shown = {kinds[place]: round(float(row[place]), 4) for place in likely}
        said.append({**held, KINDS: shown} if shown else held)
    return said


def node_confidence_of(attributes: Attributes) -> np.ndarray | None:
    """Returns how sure each node is said to be, float[n], 0 to 1; NaN for one that does not say.

    None if no node says so. Another "confidence", such as a word or a percentage, says nothing.
    """
    said = [held.get(CONFIDENCE) for held in attributes]
    values = np.array([value if _is_share(value) else np.nan for value in said], np.float64)
    return None if np.isnan(values).all() else values


def edge_confidence_of(pairs: Sequence[Sequence[int]], said: Sequence[Any]) -> np.ndarray | None:
    """Returns how sure the part-of edges of a graph are; None if not all of them say so.

    Args:
      pairs: the rows that they join, each edge once, in the order of a file.
      said: of each edge a number from 0 to 1, or anything else.

    Returns:
      float[e], in the order of `parts_first(graph)`.
    """
    if not pairs or not all(map(_is_share, said)):
        return None
    ends = np.sort(np.array(pairs), axis=1)
    return np.array(said, np.float64)[np.lexsort((ends[:, 1], ends[:, 0]))]


def check_edge_confidence(confidence: Array, graph: SceneGraph, where: str) -> None:
    """Refuses what is no number from 0 to 1 for each row of `parts_first(graph)`.

    Raises:
      ValueError: one sentence.
    """
    values, expected = np.asarray(confidence), len(parts_first(graph))
    if values.shape != (expected,):
        held = list(values.shape)
        raise ValueError(f"{where}: edge_confidence has shape {held}, expected [{expected}]")
    for row, value in enumerate(values.tolist()):
        if not _is_share(value):
            raise ValueError(f"{where}: edge_confidence[{row}] is {value!r}, expected 0 to 1")


def _is_share(value: Any) -> bool:
    numeric = isinstance(value, (int, float)) and not isinstance(value, bool)
    return numeric and bool(0 <= value <= 1)
