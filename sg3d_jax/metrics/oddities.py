"""What is unusual about the graphs of a data set, though each is a sound scene graph.

`validate_graph` refuses what no model could read. Here is what a model can read and is seldom
meant: real recordings have some of it, a faulty conversion has much of it.
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sg3d_jax.scene.ontology import CONCEPTS, PART_OF, PLANE, ROOM, SINGLE_PARENT, WALL
from sg3d_jax.scene.graph import SceneGraph, undirected_edges


class Remark(NamedTuple):
    """One thing that is unusual about some graphs."""

    what: str  # such as "empty room"
    nodes: int  # how often in all
    graphs: int  # in how many graphs
    first: int  # the first of them


def check(graphs: Sequence[SceneGraph]) -> list[Remark]:
    """Returns what is unusual, the most frequent first; empty for a clean data set.

    - a plane, room, floor or building "without" the parent that the graph's highest concept asks
      for, or "with more than one";
    - a wall with fewer than two planes, an "empty" room, floor, building or city;
    - a node outside the largest piece that part-of edges hold together ("apart from the rest");
    - two planes with equal centroid, normal and width ("repeated plane").
    """
    found = [oddities(graph) for graph in graphs]
    total = sum(found, Counter())
    remarks = []
    for what, nodes in total.most_common():
        where = [index for index, of_graph in enumerate(found) if of_graph[what]]
        remarks.append(Remark(what, nodes, len(where), where[0]))
    return remarks


def oddities(graph: SceneGraph) -> Counter[str]:
    """Counts what is unusual in one host graph, by kind."""
    label = np.asarray(graph.nodes.label)
    edges = undirected_edges(graph, PART_OF)
    upwards = np.take_along_axis(edges, np.argsort(label[edges], axis=1), axis=1)
    child, parent = upwards.T
    found: Counter[str] = Counter()
    for low, high in SINGLE_PARENT:
        if high <= label.max():
            of_kind = (label[child] == low) & (label[parent] == high)
            parents = np.bincount(child[of_kind], minlength=len(label))[label == low]
            found[f"{CONCEPTS[low]} without a {CONCEPTS[high]}"] += int((parents == 0).sum())
            found[f"{CONCEPTS[low]} with more than one {CONCEPTS[high]}"] += int(
                (parents > 1).sum()
            )
    children = np.bincount(parent, minlength=len(label))
    found["wall with fewer than two planes"] += int((children[label == WALL] < 2).sum())
    for high in sorted(set(label[label >= ROOM].tolist())):
        found[f"empty {CONCEPTS[high]}"] += int((children[label == high] == 0).sum())
    found["node apart from the rest"] += _num_apart(len(label), edges)
    planes = label == PLANE
    rows = np.column_stack([field[planes] for field in graph.nodes[1:4]])
    found["repeated plane"] += len(rows) - len(np.unique(rows, axis=0))
    return +found


def _num_apart(num_nodes: int, edges: np.ndarray) -> int:
    """Returns how many nodes are outside the largest component of the part-of edges."""
    component = np.arange(num_nodes)
    while True:  # each node takes the least component that it touches, until nothing changes
        lowest = component.copy()
        np.minimum.at(lowest, edges[:, 0], component[edges[:, 1]])
        np.minimum.at(lowest, edges[:, 1], component[edges[:, 0]])
        lowest = lowest[lowest]
        if (lowest == component).all():
            return num_nodes - int(np.bincount(component).max())
        component = lowest
