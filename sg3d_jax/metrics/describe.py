"""Statistics of a data set: the columns of the paper's table of data sets, and more.

Source: paper, Table "Overview of dataset subsets". Its |E| and degree count the proximity edges
of the planes, so both are given with and without them. Proximity edges are those that a graph has
(published graphs and S-C carry theirs, which are not exactly the 10 nearest), else those that a
model would give it.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from sg3d_jax.scene.graph import (
    FEATURES,
    SceneGraph,
    ontology_of,
    parts_first,
    undirected_edges,
)
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY
from sg3d_jax.scene.padding import Capacity, bucket, stack, unpad_all
from sg3d_jax.scene.proximity import observed_neighbours

Summary = dict[str, float]


def describe(graphs: Iterable[SceneGraph]) -> dict[str, Any]:
    """Returns statistics of host graphs, or of padded ones, as JSON values.

    Args:
      graphs: with part-of edges, of one ontology.

    Returns:
      `num_graphs`; mean, sd, min and max over graphs of `nodes`, `edges`, `degree` (2 |E| / |V|;
      both with proximity edges), `hierarchy_edges`, `hierarchy_degree`, `proximity_edges`, and of
      the number of nodes of each concept (`concepts`); for each kind of part-of edge, such as
      "plane-room", the share of parents with so many children (`children`); least and greatest
      `x`, `y`, `z` of nodes and `width` of those that have one, metres (`ranges`).

    Raises:
      ValueError: there are no graphs.
    """
    graphs = unpad_all(graphs)
    if not graphs:
        raise ValueError("no graphs to describe, expected at least one")
    nodes = np.array([len(graph.nodes.label) for graph in graphs])
    hierarchy = np.array([len(undirected_edges(graph, PART_OF)) for graph in graphs])
    proximity = count_proximity_edges(graphs)
    return {
        "num_graphs": len(graphs),
        "nodes": _summary(nodes),
        "edges": _summary(hierarchy + proximity),
        "degree": _summary(2 * (hierarchy + proximity) / nodes),
        "hierarchy_edges": _summary(hierarchy),
        "hierarchy_degree": _summary(2 * hierarchy / nodes),
        "proximity_edges": _summary(proximity),
        "concepts": _concepts(graphs),
        "children": _children(graphs),
        "ranges": _ranges(graphs),
    }


def count_proximity_edges(graphs: Sequence[SceneGraph]) -> np.ndarray:
    """Returns the number of undirected proximity edges of each host graph, int[B].

    A graph without any is counted with those that it is grown with.
    """
    counts = np.array([len(undirected_edges(graph, PROXIMITY)) for graph in graphs])
    members: dict[Capacity, list[int]] = defaultdict(list)
    for index in np.flatnonzero(counts == 0).tolist():
        members[bucket(len(graphs[index].nodes.label), len(graphs[index].senders))].append(index)
    for capacity, indices in members.items():
        counts[indices] = _count_pairs(stack([graphs[index] for index in indices], capacity))
    return counts


@jax.jit
@jax.vmap
def _count_pairs(graph: SceneGraph) -> Int[Array, ""]:
    """Returns the number of pairs of near observed nodes of one graph."""
    return jnp.sum(observed_neighbours(graph.nodes, ontology_of(graph))) // 2


def _summary(values: np.ndarray) -> Summary:
    """Returns mean, sd, min and max."""
    summary = {
        "mean": values.mean(),
        "sd": values.std(),
        "min": values.min(),
        "max": values.max(),
    }
    return {name: float(value) for name, value in summary.items()}


def _concepts(graphs: Sequence[SceneGraph]) -> dict[str, Summary]:
    """Summarises the number of nodes of each concept that occurs."""
    names = ontology_of(graphs[0]).names
    counts = np.stack([np.bincount(g.nodes.label, minlength=len(names)) for g in graphs])
    found = np.flatnonzero(counts.any(axis=0))
    return {names[concept]: _summary(counts[:, concept]) for concept in found}


def _children(graphs: Sequence[SceneGraph]) -> dict[str, dict[str, float]]:
    """Returns, for each kind of part-of edge, the share of parents that have so many children."""
    sizes: dict[str, Counter[int]] = defaultdict(Counter)
    for graph in graphs:
        names, upwards = ontology_of(graph).names, parts_first(graph)
        kinds = graph.nodes.label[upwards]
        for child, parent in np.unique(kinds, axis=0):
            of_kind = (kinds == (child, parent)).all(axis=1)
            _, counts = np.unique(upwards[of_kind, 1], return_counts=True)
            sizes[f"{names[child]}-{names[parent]}"].update(counts.tolist())
    return {kind: _shares(counter) for kind, counter in sizes.items()}


def _shares(counter: Counter[int]) -> dict[str, float]:
    """Returns how often each number occurs, of all; the numbers are text, as JSON wants them."""
    return {str(size): counter[size] / counter.total() for size in sorted(counter)}


def _ranges(graphs: Sequence[SceneGraph]) -> dict[str, list[float]]:
    """Returns the least and greatest coordinates and features, if those are single numbers."""
    position = np.concatenate([graph.nodes.position for graph in graphs])
    columns = dict(zip("xyz", position.T, strict=True))
    for name in (name for name, shape in FEATURES.items() if not shape):
        having = ontology_of(graphs[0]).has(name)
        rows = [getattr(graph.nodes, name)[having[graph.nodes.label]] for graph in graphs]
        columns[name] = np.concatenate(rows)
    return {name: [float(c.min()), float(c.max())] for name, c in columns.items() if c.size}
