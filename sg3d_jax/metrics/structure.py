"""Whether the hierarchy over the observed planes is right, and if not, what is wrong with it.

Both graphs stand on the same planes in the same order, so a plane is known by its rank.
All of this runs on the host.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from sg3d_jax.scene.ontology import (
    BUILDING,
    CITY,
    CONCEPTS,
    FLOOR,
    NUM_CONCEPTS,
    PART_OF,
    PART_OF_RULES,
    PLANE,
    ROOM,
    SINGLE_PARENT,
    WALL,
)
from sg3d_jax.scene.graph import SceneGraph, undirected_edges

Neighbours = list[list[int]]
PlaneSet = frozenset[int]


class Hierarchy(NamedTuple):
    """The part-of edges of a host graph as lists."""

    label: list[int]
    neighbours: Neighbours
    rank: dict[int, int]  # of each plane among the planes


def exact_structure(generated: SceneGraph, truth: SceneGraph) -> bool:
    """Returns whether the labelled graphs are isomorphic with every plane mapped to itself.

    Decided by colour refinement from unique colours for planes, which is exact where the true graph
    without its planes is a forest: where no room, floor or building has two parents.

    Source: Arvind et al., "On the power of color refinement", FCT 2015: it identifies forests.
    """
    if len(generated.nodes.label) != len(truth.nodes.label):
        return False
    left, right = _stable_colours([_hierarchy(generated), _hierarchy(truth)])
    return Counter(left) == Counter(right)


def node_count_error(generated: SceneGraph, truth: SceneGraph) -> dict[str, int]:
    """Returns how many nodes of each concept were generated too many (or, negative, too few)."""
    made, true = (
        np.bincount(graph.nodes.label, minlength=NUM_CONCEPTS) for graph in (generated, truth)
    )
    return dict(zip(CONCEPTS, (made - true).tolist(), strict=True))


def failures(generated: SceneGraph, truth: SceneGraph) -> Counter[str]:
    """Counts what is wrong with a generated hierarchy, by kind.

    A wall or a room that is not the true one over its planes is one of

    - `missing`, `extra`: no counterpart shares a plane with it;
    - `duplicate`: its planes are right, and drawn before;
    - `split`: several generated ones lie within one true one; `merged`: the reverse;
    - `with wrong planes`: overlaps its counterpart;
    - `without planes`.

    Floors, buildings and cities (and planes) are `missing` or `extra` by their number. A node may
    lie `without` its parent or `with more than one`. What obeys all this and is still not right is
    a `wrong grouping`.

    Returns:
      Kinds and how often each occurs; empty if and only if `exact_structure`.
    """
    made, true = _hierarchy(generated), _hierarchy(truth)
    found: Counter[str] = Counter()
    for concept in (WALL, ROOM):
        found.update(_plane_set_failures(CONCEPTS[concept], *_plane_sets(concept, made, true)))
    surplus = node_count_error(generated, truth)
    for concept in (PLANE, FLOOR, BUILDING, CITY):
        name = CONCEPTS[concept]
        found[f"extra {name}"] += max(0, surplus[name])
        found[f"missing {name}"] += max(0, -surplus[name])
    found.update(_parent_failures(made, true))
    found["edge against the rules"] += num_forbidden_edges(generated)
    if not found.total() and not exact_structure(generated, truth):
        found["wrong grouping"] = 1
    return +found


def _hierarchy(graph: SceneGraph) -> Hierarchy:
    """Reads labels, neighbours and plane ranks off a host graph."""
    label = np.asarray(graph.nodes.label)
    neighbours: Neighbours = [[] for _ in label]
    for first, second in undirected_edges(graph, PART_OF).tolist():
        neighbours[first].append(second)
        neighbours[second].append(first)
    rank = {node: rank for rank, node in enumerate(np.flatnonzero(label == PLANE).tolist())}
    return Hierarchy(label.tolist(), neighbours, rank)


def _stable_colours(graphs: Sequence[Hierarchy]) -> list[list[int]]:
    """Refines the colours of several graphs together until they tell no more nodes apart."""
    signatures: list[list[tuple]] = [
        [(label, graph.rank.get(node, -1)) for node, label in enumerate(graph.label)]
        for graph in graphs
    ]
    num_colours = 0
    while True:
        names: dict[tuple, int] = {}
        colours = [[names.setdefault(one, len(names)) for one in each] for each in signatures]
        if len(names) == num_colours:
            return colours
        num_colours = len(names)
        signatures = [
            [
                (colour[node], *sorted(colour[other] for other in others))
                for node, others in enumerate(graph.neighbours)
            ]
            for graph, colour in zip(graphs, colours, strict=True)
        ]


def _plane_sets(concept: int, *graphs: Hierarchy) -> list[list[PlaneSet]]:
    """Returns the planes of every node of one concept, for each graph."""
    return [
        [
            frozenset(graph.rank[other] for other in graph.neighbours[node] if other in graph.rank)
            for node, label in enumerate(graph.label)
            if label == concept
        ]
        for graph in graphs
    ]


def _plane_set_failures(name: str, made: list[PlaneSet], true: list[PlaneSet]) -> Counter[str]:
    """Sorts the walls or rooms that are not right into kinds; each node falls into one."""
    left, wanted = _differences(made, true)
    found = Counter({f"{name} without planes": sum(not one for one in left)})
    left = [one for one in left if one]
    found[f"duplicate {name}"] = sum(one in true for one in left)
    left = [one for one in left if one not in true]
    wanted, left, found[f"split {name}"] = _take_parts(wanted, left)
    left, wanted, found[f"merged {name}"] = _take_parts(left, wanted)
    num_overlaps = _num_overlaps(left, wanted)
    found[f"{name} with wrong planes"] = num_overlaps
    found[f"extra {name}"] = len(left) - num_overlaps
    found[f"missing {name}"] = len(wanted) - num_overlaps
    return found


def _differences(
    first: Iterable[PlaneSet], second: Iterable[PlaneSet]
) -> tuple[list[PlaneSet], list[PlaneSet]]:
    """Returns what is left of two lists once equal entries are struck out one against one."""
    first, second = Counter(first), Counter(second)
    return list((first - second).elements()), list((second - first).elements())


def _take_parts(
    wholes: list[PlaneSet], parts: list[PlaneSet]
) -> tuple[list[PlaneSet], list[PlaneSet], int]:
    """Takes out the wholes that contain two or more of the parts, with these parts."""
    whole_left, num_taken = [], 0
    for whole in wholes:
        inside = [part for part in parts if part < whole]
        if len(inside) < 2:
            whole_left.append(whole)
            continue
        num_taken += 1
        parts = [part for part in parts if not part < whole]
    return whole_left, parts, num_taken


def _num_overlaps(first: list[PlaneSet], second: list[PlaneSet]) -> int:
    """Pairs the entries of two lists that share planes, most shared first, and counts the pairs."""
    shared = np.array([[len(one & other) for other in second] for one in first])
    pairs = 0
    while shared.size and shared.max() > 0:
        row, column = np.unravel_index(np.argmax(shared), shared.shape)
        shared[row] = shared[:, column] = 0
        pairs += 1
    return pairs


def _parent_failures(made: Hierarchy, true: Hierarchy) -> Counter[str]:
    """Counts the parts with no parent where one is due, and those with more than one."""
    found: Counter[str] = Counter()
    for child, parent in SINGLE_PARENT:
        usual, numbers = _num_parents(true, child, parent), _num_parents(made, child, parent)
        several = f"{CONCEPTS[child]} with more than one {CONCEPTS[parent]}"
        found[several] = sum(number > max([1, *usual]) for number in numbers)
        # A plane without its room shows in the room, which is missing or has wrong planes.
        if child != PLANE and min(usual, default=0) > 0:
            found[f"{CONCEPTS[child]} without {CONCEPTS[parent]}"] = numbers.count(0)
    return found


def _num_parents(graph: Hierarchy, child: int, parent: int) -> list[int]:
    """Returns how many parents of one concept each node of another has."""
    return [
        sum(graph.label[other] == parent for other in graph.neighbours[node])
        for node, label in enumerate(graph.label)
        if label == child
    ]


def num_forbidden_edges(graph: SceneGraph) -> int:
    """Counts the part-of edges between concepts that are not part of each other."""
    ends = np.sort(np.asarray(graph.nodes.label)[undirected_edges(graph, PART_OF)], axis=1)
    return sum((child, parent) not in PART_OF_RULES for child, parent in ends.tolist())


def num_duplicates(graph: SceneGraph) -> int:
    """Counts the nodes that repeat another one: the same concept over the same parts."""
    label = np.asarray(graph.nodes.label).tolist()
    parts: dict[int, set[int]] = {}
    for pair in undirected_edges(graph, PART_OF).tolist():
        child, parent = sorted(pair, key=label.__getitem__)
        parts.setdefault(parent, set()).add(child)
    return len(parts) - len({(label[node], frozenset(of)) for node, of in parts.items()})
