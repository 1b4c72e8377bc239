"""What else a file says of nodes: ids and whatever a user writes beside what we know.

Graphs hold numbers alone, so attributes travel beside them, a dict of JSON values a node: read with
a graph, mapped to the nodes of another one, and written with that.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import FEATURES

Attributes = Sequence[Mapping[str, Any]]

ID: Final = "id"
OWN: Final = ("label", "position", *FEATURES)  # what documents of graphs say of a node beside it


class Read(NamedTuple):
    """A graph as a file has it."""

    graph: SceneGraph  # on the host
    attributes: Attributes  # of each node


def further(values: Mapping[str, Any], known: Sequence[str]) -> dict[str, Any]:
    """Returns what a mapping has beside known keys."""
    return {key: value for key, value in values.items() if key not in known}


def check_attributes(attributes: Attributes, where: str, noun: str = "nodes") -> None:
    """Refuses attributes that a document of a graph cannot hold.

    Args:
      attributes: of each node.
      where: what the sentence starts with, such as "planes.json".
      noun: what the sentence calls the nodes.

    Raises:
      ValueError: one sentence that names the node and its attribute: a key that graphs use, ids
        that repeat or are none, values that are not JSON.
    """
    row_of_id: dict[int | str, int] = {}
    for row, held in enumerate(attributes):
        here = f"{where}: {noun}[{row}]"
        if taken := [key for key in OWN if key in held]:
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
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise ValueError(f"{where}.id is {value!r:.40}, expected an integer or a name")
    if value in taken:
        raise ValueError(f"{where}.id is {value!r:.40} again, expected unique ids")


def node_ids(attributes: Attributes) -> list[int | str]:
    """Returns the id of each node: its own, or its row number, or one beyond all others' ids."""
    given = [held.get(ID) for held in attributes]
    numbers = [name for name in given if isinstance(name, int)]
    first = next((row for row, name in enumerate(given) if name is None), 0)
    beyond = max(0, max(numbers, default=-1) + 1 - first)
    return [row + beyond if name is None else name for row, name in enumerate(given)]
