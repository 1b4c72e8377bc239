"""The data model: a scene graph is a jraph `GraphsTuple` with typed nodes and edges.

Shape letters, here and everywhere: `N` node capacity, `E` edge capacity, `M` block capacity,
`C` concepts, `B` graphs, `S` diffusion steps, `T` growth steps. Units: metres, radians, hops.

The same type holds a graph on the host (numpy, exact size, float64, every mask True) and on the
device (jax, padded, float32). Boolean masks travel with the data because jraph's own padding masks
are silently wrong when a graph fills its capacity (jraph issue 55).
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jraph
import numpy as np

from sg3d_jax.scene.concepts import PART_OF, PLANE, PROXIMITY

Array = Any  # jax.Array on the device, np.ndarray on the host: no checker can know which


class Nodes(NamedTuple):
    """Node fields; padding rows are zero."""

    label: Array  # int32[N], index into CONCEPTS
    position: Array  # float[N, 3], centroid, metres
    normal: Array  # float[N, 3], unit, into the room; zero for all but planes
    width: Array  # float[N], metres; zero for all but planes
    mask: Array  # bool[N], True for real nodes


class Edges(NamedTuple):
    """Edge fields; an undirected edge is stored as its two directions."""

    relation: Array  # int32[E], PROXIMITY or PART_OF
    mask: Array  # bool[E], True for real edges


if TYPE_CHECKING:

    class SceneGraph(NamedTuple):
        """What type checkers see of the jraph `GraphsTuple` below: its fields are ours."""

        nodes: Nodes
        edges: Edges
        senders: Array  # int32[E]
        receivers: Array  # int32[E]
        n_node: Array  # int32[1], or int32[2] if padded: real nodes, padding
        n_edge: Array  # int32[1], or int32[2]
        globals: None

else:
    SceneGraph = jraph.GraphsTuple


def make_graph(
    label: Sequence[int] | Array,
    position: Array,
    normal: Array,
    width: Array,
    part_of: Array,
    proximity: Array | None = None,
) -> SceneGraph:
    """Builds an unpadded host graph from undirected edges.

    Args:
      label: int[n].
      position: float[n, 3], metres.
      normal: float[n, 3], unit for planes, zero otherwise.
      width: float[n], metres, zero for all but planes.
      part_of: int[e, 2], pairs of node indices in either direction, each pair once.
      proximity: int[p, 2], likewise; None for none.

    Returns:
      A numpy `SceneGraph` whose edges are all forward directions, then all backward ones.
    """
    part_of = np.asarray(part_of, np.int32).reshape(-1, 2)
    proximity = np.asarray([] if proximity is None else proximity, np.int32).reshape(-1, 2)
    pairs = np.concatenate([proximity, part_of])
    relation = np.repeat([PROXIMITY, PART_OF], [len(proximity), len(part_of)]).astype(np.int32)
    label = np.asarray(label, np.int32)
    return SceneGraph(
        nodes=Nodes(
            label=label,
            position=np.asarray(position, np.float64).reshape(-1, 3),
            normal=np.asarray(normal, np.float64).reshape(-1, 3),
            width=np.asarray(width, np.float64),
            mask=np.ones(len(label), bool),
        ),
        edges=Edges(np.concatenate([relation, relation]), np.ones(2 * len(pairs), bool)),
        senders=np.concatenate([pairs[:, 0], pairs[:, 1]]),
        receivers=np.concatenate([pairs[:, 1], pairs[:, 0]]),
        n_node=np.array([len(label)], np.int32),
        n_edge=np.array([2 * len(pairs)], np.int32),
        globals=None,
    )


def undirected_edges(graph: SceneGraph, relation: int) -> np.ndarray:
    """Returns the real edges of one relation, each pair once, as int32[e, 2] with i < j, sorted."""
    senders, receivers = np.asarray(graph.senders), np.asarray(graph.receivers)
    chosen = np.asarray(graph.edges.mask) & (np.asarray(graph.edges.relation) == relation)
    pairs = np.stack([senders, receivers], axis=-1)[chosen & (senders < receivers)]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def planes_of(graph: SceneGraph) -> SceneGraph:
    """Returns the observed part of a host graph: its planes, without edges, in their order."""
    nodes = graph.nodes
    keep = np.asarray(nodes.mask) & (np.asarray(nodes.label) == PLANE)
    no_edges = np.zeros((0, 2), np.int32)
    return make_graph(
        np.asarray(nodes.label)[keep],
        np.asarray(nodes.position)[keep],
        np.asarray(nodes.normal)[keep],
        np.asarray(nodes.width)[keep],
        no_edges,
    )
