"""The data model: a scene graph is a jraph `GraphsTuple` with typed nodes and edges.

Shape letters, here and everywhere: `N` node capacity, `E` edge capacity, `M` block capacity,
`C` concepts, `B` graphs, `S` diffusion steps, `T` growth steps. Units: metres, radians, hops.

The same type holds a graph on the host (numpy, exact size, float64, every mask True) and on the
device (jax, padded, float32). Boolean masks travel with the data because jraph's own padding masks
are silently wrong when a graph fills its capacity (jraph issue 55). A padded graph whose real nodes
and edges fill the first slots is a `PackedGraph`; only such a one can be appended to.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jraph
import numpy as np

from sg3d_jax.scene.ontology import (
    FEATURES,
    PAPER_ONTOLOGY,
    PART_OF,
    PROXIMITY,
    RELATIONS,
    Ontology,
)

Array = Any  # jax.Array on the device, np.ndarray on the host: no checker can know which


class Nodes(NamedTuple):
    """Node fields; padding rows are zero."""

    label: Array  # int32[N], place among the concepts of the ontology
    position: Array  # float[N, 3], centroid, metres
    normal: Array  # float[N, 3], unit, into the room; zero for concepts that have none
    width: Array  # float[N], horizontal extent, metres; zero for concepts that have none
    kind: Array  # float[N], place among the kinds of its concept, from 1; 0 unknown, or none
    observed: Array  # bool[N], True for real nodes that are given and never generated
    mask: Array  # bool[N], True for real nodes


class Edges(NamedTuple):
    """Edge fields; an undirected edge is stored as its two directions."""

    relation: Array  # int32[E], PROXIMITY or PART_OF
    mask: Array  # bool[E], True for real edges


if TYPE_CHECKING:

    class SceneGraph(NamedTuple):
        """What type checkers see of the jraph `GraphsTuple` below: its fields are ours."""

        nodes: Nodes  # their fields
        edges: Edges  # their fields
        senders: Array  # int32[E], node each edge comes from
        receivers: Array  # int32[E], node it goes to
        n_node: Array  # int32[1], or int32[2] if padded: real nodes, padding
        n_edge: Array  # int32[1], or int32[2], likewise
        globals: Ontology  # its concepts; no array, but part of the tree structure

else:
    SceneGraph = jraph.GraphsTuple


class PackedGraph(SceneGraph):
    """A padded graph whose real nodes and real edges fill the first slots."""

    __slots__ = ()


def make_graph(
    label: Sequence[int] | Array,
    position: Array,
    normal: Array | None = None,
    width: Array | None = None,
    part_of: Array = (),
    proximity: Array = (),
    ontology: Ontology = PAPER_ONTOLOGY,
    kind: Array | None = None,
) -> SceneGraph:
    """Builds an unpadded host graph from undirected edges.

    Args:
      label: int[n].
      position: float[n, 3], metres.
      normal: float[n, 3], unit for planes, zero for what has none; None for all zero.
      width: float[n], metres, zero for what has none; None for all zero.
      part_of: int[e, 2], pairs of node indices in either direction, each pair once.
      proximity: int[p, 2], likewise.
      ontology: the concepts.
      kind: int[n], from 1 among the kinds of each concept, zero for what has none or is unknown;
        None for all zero.

    Returns:
      A numpy `SceneGraph` whose edges are all forward directions, then all backward ones.
    """
    part_of = np.asarray(part_of, np.int32).reshape(-1, 2)
    proximity = np.asarray(proximity, np.int32).reshape(-1, 2)
    pairs = np.concatenate([proximity, part_of])
    relation = np.repeat([PROXIMITY, PART_OF], [len(proximity), len(part_of)]).astype(np.int32)
    label = np.asarray(label, np.int32)
    features = {
        name: np.zeros((len(label), *shape)) if array is None else _rows(array, shape)
        for array, (name, shape) in zip((normal, width, kind), FEATURES.items(), strict=True)
    }
    known = (label >= 0) & (label < ontology.num_concepts)  # what is not is refused when validated
    return SceneGraph(
        nodes=Nodes(
            label=label,
            position=_rows(position, (3,)),
            **features,
            observed=known & ontology.is_observed[np.where(known, label, 0)],
            mask=np.ones(len(label), bool),
        ),
        edges=Edges(np.concatenate([relation, relation]), np.ones(2 * len(pairs), bool)),
        senders=np.concatenate([pairs[:, 0], pairs[:, 1]]),
        receivers=np.concatenate([pairs[:, 1], pairs[:, 0]]),
        n_node=np.array([len(label)], np.int32),
        n_edge=np.array([2 * len(pairs)], np.int32),
        globals=ontology,
    )


def _rows(array: Array, shape: tuple[int, ...]) -> np.ndarray:
    """Returns rows as float64: none in their right shape, any others as they are, to be checked."""
    rows = np.asarray(array, np.float64)
    return rows if rows.size else rows.reshape(0, *shape)


def ontology_of(graph: SceneGraph) -> Ontology:
    """Returns the concepts of a graph."""
    return graph.globals


def features_of(graph: SceneGraph) -> dict[str, Array]:
    """Returns the features of the nodes by name, as `make_graph` takes them."""
    return {name: getattr(graph.nodes, name) for name in FEATURES}


def undirected_edges(graph: SceneGraph, relation: int) -> np.ndarray:
    """Returns the real edges of one relation, each pair once, as int32[e, 2] with i < j, sorted."""
    senders, receivers = np.asarray(graph.senders), np.asarray(graph.receivers)
    once = np.asarray(graph.edges.relation) == relation
    once &= np.asarray(graph.edges.mask) & (senders < receivers)
    low, high = senders[once], receivers[once]
    order = np.lexsort((high, low))
    return np.array([low[order], high[order]]).T


def parts_first(graph: SceneGraph) -> np.ndarray:
    """Returns the part-of edges of a host graph as int32[e, 2], the part before its whole."""
    pairs = undirected_edges(graph, PART_OF)
    label = np.asarray(graph.nodes.label)[pairs]
    return np.where(label[:, :1] > label[:, 1:], pairs[:, ::-1], pairs)


def part_of_matrix(graph: SceneGraph) -> np.ndarray:
    """Returns the part-of edges of a host graph as bool[n, n], part (row) and whole (column)."""
    matrix = np.zeros((len(graph.nodes.label),) * 2, bool)
    part, whole = parts_first(graph).T
    matrix[part, whole] = True
    return matrix


def subgraph(graph: SceneGraph, rows: Array, edges: bool = True) -> SceneGraph:
    """Returns the host graph of some nodes, with the edges between them.

    Args:
      graph: padded or not; its arrays are read on the host.
      rows: int[k], which nodes, in the order that they are to have; or bool[n].
      edges: False to leave all edges out.
    """
    rows = np.asarray(rows)
    rows = np.flatnonzero(rows) if rows.dtype == bool else rows.astype(int)
    place = np.full(len(graph.nodes.label), -1)
    place[rows] = np.arange(len(rows))
    pairs = {
        name: place[undirected_edges(graph, relation) if edges else np.zeros((0, 2), int)]
        for relation, name in enumerate(RELATIONS)
    }
    return make_graph(
        np.asarray(graph.nodes.label)[rows],
        np.asarray(graph.nodes.position)[rows],
        **{name: np.asarray(array)[rows] for name, array in features_of(graph).items()},
        **{name: inside[(inside >= 0).all(axis=-1)] for name, inside in pairs.items()},
        ontology=ontology_of(graph),
    )


def observed_of(graph: SceneGraph) -> SceneGraph:
    """Returns the observed part of a graph on the host: its planes, without edges, in order."""
    return subgraph(graph, np.asarray(graph.nodes.observed), edges=False)


def extended(graph: SceneGraph, label: Array, position: Array, part_of: Array) -> SceneGraph:
    """Appends nodes without features to a host graph.

    Args:
      graph: unpadded, n nodes.
      label: int[k], of the new ones.
      position: float[k, 3], metres.
      part_of: int[e, 2], further pairs of node indices; new nodes are n to n + k - 1.
    """
    new = len(label)
    return make_graph(
        np.concatenate([graph.nodes.label, np.asarray(label, np.int32)]),
        np.concatenate([graph.nodes.position, np.asarray(position, float).reshape(-1, 3)]),
        **{
            name: np.concatenate([array, np.zeros((new, *FEATURES[name]))])
            for name, array in features_of(graph).items()
        },
        part_of=np.concatenate(
            [undirected_edges(graph, PART_OF), np.asarray(part_of, np.int32).reshape(-1, 2)]
        ),
        proximity=undirected_edges(graph, PROXIMITY),
        ontology=ontology_of(graph),
    )
