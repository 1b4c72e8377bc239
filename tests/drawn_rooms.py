"""Other rooms and walls over the planes of two rooms: what a model may draw of them."""

from collections.abc import Sequence

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, features_of, make_graph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import BUILDING, FLOOR, PART_OF, PLANE, ROOM, WALL
from tests.two_rooms import NUM_PLANES, two_rooms


def drawn(
    *rooms: tuple[int, ...],
    walls: Sequence[tuple[int, ...]] = (),
    floors: Sequence[tuple[int, ...]] | None = None,
    at: float = 0.0,
) -> SceneGraph:
    """Returns the planes of two rooms with other rooms over them.

    Args:
      rooms: the planes of each.
      walls: the planes of each; they come after the rooms.
      floors: the rooms of each, by their number; they stand in one building. None for one floor,
        in none.
      at: x of all that is drawn, metres.
    """
    lists = [rooms, walls, [range(len(rooms))] if floors is None else floors]
    lists.append([] if floors is None else [range(len(floors))])
    starts = NUM_PLANES + np.cumsum([0, *map(len, lists)])
    first_part = [0, 0, NUM_PLANES, starts[2]]
    label = [PLANE] * NUM_PLANES
    pairs = []
    for kind, wholes, start, first in zip(
        (ROOM, WALL, FLOOR, BUILDING), lists, starts, first_part, strict=False
    ):
        label += [kind] * len(wholes)
        pairs += [(first + p, start + i) for i, parts in enumerate(wholes) for p in parts]
    nodes = two_rooms().nodes
    position, normal = np.zeros((2, len(label), 3))
    position[:NUM_PLANES], normal[:NUM_PLANES] = (
        nodes.position[:NUM_PLANES],
        nodes.normal[:NUM_PLANES],
    )
    position[NUM_PLANES:, 0] = at
    width = np.pad(nodes.width[:NUM_PLANES], (0, len(label) - NUM_PLANES))
    return make_graph(label, position, normal, width, pairs)


def with_pairs(
    graph: SceneGraph, lost: Sequence[tuple[int, int]] = (), new: Sequence[tuple[int, int]] = ()
) -> SceneGraph:
    """Returns a graph with other part-of edges."""
    pairs = [pair for pair in undirected_edges(graph, PART_OF).tolist() if tuple(pair) not in lost]
    return make_graph(
        graph.nodes.label,
        graph.nodes.position,
        **features_of(graph),
        part_of=[*pairs, *new],
        ontology=ontology_of(graph),
    )
