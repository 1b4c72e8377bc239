"""Whether the hierarchy over the observed nodes is right, and if not, what is wrong with it.

Both graphs stand on the same observed nodes in the same order, so each is known by its rank. In the
paper's ontology these are the planes, and walls and rooms what they bound. All of this runs on the
host.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from sg3d_jax.metrics.oddities import components, num_wholes
from sg3d_jax.scene.graph import SceneGraph, ontology_of, parts_first, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, Ontology
from sg3d_jax.scene.padding import unpad

Neighbours = list[list[int]]
ObservedSet = frozenset[int]


class Hierarchy(NamedTuple):
    """The part-of edges of a host graph as lists."""

    label: list[int]  # of each node
    neighbours: Neighbours  # rows that each node has an edge to
    rank: dict[int, int]  # of each observed node among the observed


def exact_structure(generated: SceneGraph, truth: SceneGraph) -> bool:
    """Returns whether the labelled graphs are isomorphic with what is observed mapped to itself.

    Decided by colour refinement from unique colours for observed nodes, which is exact where the
    true graph without them is a forest: where nothing has two parents that is not observed. Padding
    does not count.

    Source: Arvind et al., "On the power of color refinement", FCT 2015: it identifies forests.
    """
    generated, truth = unpad(generated), unpad(truth)
    if len(generated.nodes.label) != len(truth.nodes.label):
        return False
    left, right = _stable_colours([_hierarchy(generated), _hierarchy(truth)])
    return Counter(left) == Counter(right)


def node_count_error(generated: SceneGraph, truth: SceneGraph) -> dict[str, int]:
    """Returns how many nodes of each concept were generated too many (or, negative, too few)."""
    names = ontology_of(truth).names
    made, true = (
        np.bincount(graph.nodes.label, minlength=len(names)) for graph in (generated, truth)
    )
    return dict(zip(names, (made - true).tolist(), strict=True))


def failures(generated: SceneGraph, truth: SceneGraph) -> Counter[str]:
    """Counts what is wrong with a generated hierarchy, padded or not, by kind.

    Nodes of which something observed may be part (walls and rooms, of planes) are known by their
    observed parts. One that is not the true one over its planes is one of

    - `missing`, `extra`: no counterpart shares a plane with it;
    - `duplicate`: its planes are right, and drawn before;
    - `split`: several generated ones lie within one true one; `merged`: the reverse;
    - `with wrong planes`: overlaps its counterpart;
    - `without planes`.

    All others (floors, buildings, cities, and planes) are `missing` or `extra` by their number. A
    node may lie `without` its parent or `with more than one`. What obeys all this and is still not
    right is a `wrong grouping`.

    Returns:
      Kinds and how often each occurs; empty if and only if `exact_structure`.
    """
    generated, truth = unpad(generated), unpad(truth)
    ontology, made, true = ontology_of(truth), _hierarchy(generated), _hierarchy(truth)
    found: Counter[str] = Counter()
    parts = _observed_parts(ontology)
    for concept, nouns in parts.items():
        sets = _observed_sets(concept, made, true)
        found.update(_observed_set_failures(ontology.names[concept], nouns, *sets))
    surplus = node_count_error(generated, truth)
    for name in (name for label, name in enumerate(ontology.names) if label not in parts):
        found[f"extra {name}"] += max(0, surplus[name])
        found[f"missing {name}"] += max(0, -surplus[name])
    found.update(_parent_failures(generated, truth))
    found["edge against the rules"] += num_forbidden_edges(generated)
    if not found.total() and not exact_structure(generated, truth):
        found["wrong grouping"] = 1
    return +found


def _hierarchy(graph: SceneGraph) -> Hierarchy:
    """Reads labels, neighbours and ranks off a host graph."""
    label = np.asarray(graph.nodes.label)
    neighbours: Neighbours = [[] for _ in label]
    for first, second in undirected_edges(graph, PART_OF).tolist():
        neighbours[first].append(second)
        neighbours[second].append(first)
    observed = np.flatnonzero(graph.nodes.observed).tolist()
    rank = {node: rank for rank, node in enumerate(observed)}
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


def _observed_parts(ontology: Ontology) -> dict[int, str]:
    """Returns the concepts that are known by their observed parts, and what to call those."""
    parts = ontology.may_be_part & ontology.is_observed[:, None] & ~ontology.is_observed[None, :]
    plurals = np.array([concept.layer.lower() for concept in ontology.concepts])
    return {
        int(whole): " or ".join(plurals[parts[:, whole]])
        for whole in np.flatnonzero(parts.any(axis=0))
    }


def _observed_sets(concept: int, *graphs: Hierarchy) -> list[list[ObservedSet]]:
    """Returns the observed nodes of every node of one concept, for each graph."""
    return [
        [
            frozenset(graph.rank[other] for other in graph.neighbours[node] if other in graph.rank)
            for node, label in enumerate(graph.label)
            if label == concept
        ]
        for graph in graphs
    ]


def _observed_set_failures(
    name: str, parts: str, made: list[ObservedSet], true: list[ObservedSet]
) -> Counter[str]:
    """Sorts the nodes of a concept that are not right into kinds; each falls into one."""
    left, wanted = _differences(made, true)
    found = Counter({f"{name} without {parts}": sum(not one for one in left)})
    left = [one for one in left if one]
    found[f"duplicate {name}"] = sum(one in true for one in left)
    left = [one for one in left if one not in true]
    wanted, left, found[f"split {name}"] = _take_parts(wanted, left)
    left, wanted, found[f"merged {name}"] = _take_parts(left, wanted)
    num_overlaps = _num_overlaps(left, wanted)
    found[f"{name} with wrong {parts}"] = num_overlaps
    found[f"extra {name}"] = len(left) - num_overlaps
    found[f"missing {name}"] = len(wanted) - num_overlaps
    return found


def _differences(
    first: Iterable[ObservedSet], second: Iterable[ObservedSet]
) -> tuple[list[ObservedSet], list[ObservedSet]]:
    """Returns what is left of two lists once equal entries are struck out one against one."""
    first, second = Counter(first), Counter(second)
    return list((first - second).elements()), list((second - first).elements())


def _take_parts(
    wholes: list[ObservedSet], parts: list[ObservedSet]
) -> tuple[list[ObservedSet], list[ObservedSet], int]:
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


def _num_overlaps(first: list[ObservedSet], second: list[ObservedSet]) -> int:
    """Pairs the entries of two lists that share nodes, most shared first, and counts the pairs."""
    shared = np.array([[len(one & other) for other in second] for one in first])
    pairs = 0
    while shared.size and shared.max() > 0:
        row, column = np.unravel_index(np.argmax(shared), shared.shape)
        shared[row] = shared[:, column] = 0
        pairs += 1
    return pairs


def _parent_failures(made: SceneGraph, true: SceneGraph) -> Counter[str]:
    """Counts the parts with no parent where one is due, and those with more than one."""
    found, ontology = Counter[str](), ontology_of(true)
    held = [(num_wholes(graph), np.asarray(graph.nodes.label)) for graph in (true, made)]
    for child, parent in ontology.single_wholes:
        low, high = ontology.names[child], ontology.names[parent]
        usual, numbers = (number[label == child, parent].tolist() for number, label in held)
        found[f"{low} with more than one {high}"] = sum(n > max([1, *usual]) for n in numbers)
        # A plane without its room shows in the room, which is missing or has wrong planes.
        if not ontology.is_observed[child] and min(usual, default=0) > 0:
            found[f"{low} without {high}"] = numbers.count(0)
    return found


def has_one_whole_each(
    generated: SceneGraph, truth: SceneGraph, pieces: np.ndarray | None = None
) -> bool:
    """Returns whether each part has the one whole that the graph's highest concept asks for.

    Args:
      generated: host graph.
      truth: over the same observed nodes: one that belongs to nothing there, or to several wholes,
        need not have one, and may have several.
      pieces: int[observed], into how many pieces each observed node was cut, each of which may have
        a whole of its own; None for one each.
    """
    ontology, label = ontology_of(generated), np.asarray(generated.nodes.label)
    observed = np.flatnonzero(generated.nodes.observed)
    number, of_truth = num_wholes(generated), num_wholes(truth)[np.asarray(truth.nodes.observed)]
    for part, whole in ontology.single_wholes:
        if whole > label.max(initial=-1):
            continue
        least, most = np.ones(len(label), int), np.ones(len(label), int)
        usual = of_truth[:, whole]
        if len(usual) != len(observed):
            usual = np.ones(len(observed), int)  # what was given was mended: others
        least[observed] = np.minimum(usual, 1)
        most[observed] = np.maximum(usual, 1 if pieces is None else pieces)
        wrong = (number[:, whole] < least) | (number[:, whole] > most)
        if np.any(wrong & (label == part)):
            return False
    return True


def hangs_together(generated: SceneGraph, truth: SceneGraph) -> bool:
    """Returns whether part-of edges join all nodes, but for observed ones that truth joins to none.

    Args:
      generated: host graph.
      truth: over the same observed nodes.
    """
    alone = np.ones(len(truth.nodes.label), bool)
    alone[parts_first(truth).ravel()] = False
    needed = np.ones(len(generated.nodes.label), bool)
    observed, usual = np.flatnonzero(generated.nodes.observed), ~alone[truth.nodes.observed]
    needed[observed] = usual if len(usual) == len(observed) else True
    return len(np.unique(components(generated)[needed])) <= 1


def num_forbidden_edges(graph: SceneGraph) -> int:
    """Counts the part-of edges between concepts that are not part of each other."""
    child, parent = np.asarray(graph.nodes.label)[parts_first(graph)].T
    return int(np.count_nonzero(~ontology_of(graph).may_be_part[child, parent]))


def num_duplicates(graph: SceneGraph) -> int:
    """Counts the nodes that repeat another one: the same concept over the same parts."""
    label = np.asarray(graph.nodes.label).tolist()
    parts: dict[int, set[int]] = {}
    for child, parent in parts_first(graph).tolist():
        parts.setdefault(parent, set()).add(child)
    return len(parts) - len({(label[node], frozenset(of)) for node, of in parts.items()})
