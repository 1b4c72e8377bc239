"""What is unusual about the graphs of a data set, though each is a sound scene graph.

`validate_graph` refuses what no model could read. Here is what a model can read and is seldom
meant: real recordings have some of it, a faulty conversion has much of it.
"""

import enum
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sg3d_jax.scene.graph import SceneGraph, ontology_of, parts_first
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.padding import unpad_all
from sg3d_jax.scene.validate import seems_not_in_metres

NUMERALS: Final = ("no", "one", "two", "three", "four", "five", "six")


class Oddity(enum.Enum):
    """How a node can be unusual."""

    WITHOUT_WHOLE = enum.auto()  # it lacks the one whole that the graph's highest concept asks for
    SEVERAL_WHOLES = enum.auto()  # it is part of more than one such
    TOO_FEW_PARTS = enum.auto()  # it has fewer parts than its concept should
    APART = enum.auto()  # it is outside the largest piece that part-of edges hold together
    REPEATED = enum.auto()  # observed twice: position and features are those of another
    IMMENSE = enum.auto()  # its graph is larger than any in metres


class Odd(NamedTuple):
    """An oddity, and the concepts that it is about."""

    kind: Oddity  # what is odd
    concept: str | None = None  # of the nodes; None for those of any
    whole: str | None = None  # what they should be part of, once

    def text(self, ontology: Ontology) -> str:
        """Returns what to call it, such as "room without a floor"."""
        match self.kind:
            case Oddity.WITHOUT_WHOLE:
                return f"{self.concept} without a {self.whole}"
            case Oddity.SEVERAL_WHOLES:
                return f"{self.concept} with more than one {self.whole}"
            case Oddity.TOO_FEW_PARTS:
                return _text_of_too_few(ontology, str(self.concept))
            case Oddity.APART:
                return "node apart from the rest"
            case Oddity.REPEATED:
                return f"repeated {self.concept}"
            case Oddity.IMMENSE:
                return "node of a graph too large to be in metres"


class Remark(NamedTuple):
    """One thing that is unusual about some graphs."""

    what: str  # such as "empty room"
    nodes: int  # how often in all
    graphs: int  # in how many graphs
    first: int  # the first of them


def check(graphs: Iterable[SceneGraph]) -> list[Remark]:
    """Returns what is unusual, the most frequent first; empty for a clean data set.

    With the paper's ontology:

    - a plane, room, floor or building "without" the parent that the graph's highest concept asks
      for, or "with more than one";
    - a wall with fewer than two planes, an "empty" room, floor, building or city;
    - a node outside the largest piece that part-of edges hold together ("apart from the rest");
    - two planes with equal centroid, normal and width ("repeated plane");
    - all nodes of a graph that spans kilometres ("too large to be in metres").

    Args:
      graphs: host graphs of one ontology, or padded ones.
    """
    graphs = unpad_all(graphs)
    found = [oddities(graph) for graph in graphs]
    total = sum(found, Counter())
    remarks = []
    for odd, nodes in total.most_common():
        where = [index for index, of_graph in enumerate(found) if of_graph[odd]]
        what = odd.text(ontology_of(graphs[0]))
        remarks.append(Remark(what, nodes, len(where), where[0]))
    return remarks


def oddities(graph: SceneGraph) -> Counter[Odd]:
    """Counts what is unusual in one host graph."""
    found: Counter[Odd] = Counter()
    for odd, nodes in (*odd_wholes(graph), *_odd_parts(graph)):
        found[odd] += nodes
    found[Odd(Oddity.APART)] += _num_apart(graph)
    for odd, nodes in _repeated(graph):
        found[odd] += nodes
    if seems_not_in_metres(graph):
        found[Odd(Oddity.IMMENSE)] += len(graph.nodes.label)
    return +found


def odd_wholes(graph: SceneGraph) -> Iterator[tuple[Odd, int]]:
    """Counts parts that have none or several of what they should have one of."""
    ontology, label, number = ontology_of(graph), np.asarray(graph.nodes.label), num_wholes(graph)
    for low, high in ontology.single_wholes:
        if high <= label.max(initial=-1):
            wholes = number[label == low, high]
            names = ontology.names[low], ontology.names[high]
            yield Odd(Oddity.WITHOUT_WHOLE, *names), int((wholes == 0).sum())
            yield Odd(Oddity.SEVERAL_WHOLES, *names), int((wholes > 1).sum())


def num_wholes(graph: SceneGraph) -> np.ndarray:
    """Returns int[n, C], of how many nodes of each concept each node is part."""
    label, kinds = np.asarray(graph.nodes.label), ontology_of(graph).num_concepts
    part, whole = parts_first(graph).T
    number = np.bincount(part * kinds + label[whole], minlength=len(label) * kinds)
    return number.reshape(-1, kinds)


def _odd_parts(graph: SceneGraph) -> Iterator[tuple[Odd, int]]:
    """Counts nodes that are made of too little; what is observed needs no parts."""
    ontology, label = ontology_of(graph), np.asarray(graph.nodes.label)
    _, whole = parts_first(graph).T
    parts = np.bincount(whole, minlength=len(label))
    for kind in np.flatnonzero(ontology.may_be_part.any(axis=0) & ~ontology.is_observed):
        few = parts[label == kind] < ontology.concepts[kind].least_parts
        yield Odd(Oddity.TOO_FEW_PARTS, ontology.names[kind]), int(few.sum())


def _repeated(graph: SceneGraph) -> Iterator[tuple[Odd, int]]:
    """Counts observed nodes that are where another one of their concept is, with its features."""
    ontology, nodes = ontology_of(graph), graph.nodes
    for kind in np.flatnonzero(ontology.is_observed):
        concept, chosen = ontology.concepts[kind], np.asarray(nodes.label) == kind
        columns = [nodes.position, *(getattr(nodes, name) for name in concept.features)]
        rows = np.column_stack([np.asarray(column)[chosen] for column in columns])
        yield Odd(Oddity.REPEATED, concept.name), len(rows) - len(np.unique(rows, axis=0))


def _num_apart(graph: SceneGraph) -> int:
    """Returns how many nodes are outside the largest component of the part-of edges."""
    return len(graph.nodes.label) - int(np.bincount(components(graph)).max(initial=0))


def components(graph: SceneGraph) -> np.ndarray:
    """Returns int[n], which piece of those that part-of edges hold together each node is in."""
    num_nodes, pairs = len(graph.nodes.label), parts_first(graph)
    links = coo_array((np.ones(len(pairs), bool), tuple(pairs.T)), (num_nodes, num_nodes))
    return connected_components(links, directed=False)[1]


def _text_of_too_few(ontology: Ontology, name: str) -> str:
    """Returns such as "empty room", or "wall with fewer than two planes"."""
    kind = ontology.label_of(name)
    least = ontology.concepts[kind].least_parts
    if least == 1:
        return f"empty {name}"
    number = NUMERALS[least] if least < len(NUMERALS) else str(least)
    parts = np.flatnonzero(ontology.may_be_part[:, kind])
    plurals = " or ".join(ontology.concepts[part].layer.lower() for part in parts)
    return f"{name} with fewer than {number} {plurals}"
