"""From classified pairs of planes to rooms and walls, on the host.

Both rules give every plane at most one room, and depend on nothing but the pairs: ties go to the
lower indices.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, extended
from sg3d_jax.scene.ontology import ROOM, WALL

Pairs = np.ndarray  # int[e, 2], undirected, each pair once
Rooms = list[tuple[int, ...]]  # planes of each room, in increasing order


def rooms_by_cycles(pairs: Pairs) -> Rooms:
    """Returns rooms of four planes, then of three, that cycles of pairs connect.

    Four planes that are all paired with each other go first, then any four around which a cycle
    runs, then triangles of what is left. Each takes its planes away from the next.

    Args:
      pairs: planes in the same room.

    Source: EC-square.
    Differs: the original enumerates all cycles and sorts sets of planes by the number of cycles
    through them, 6 if all are paired and 2 if not: the same order, in exponential time. Ties are in
    the order of its hash table.
    """
    near = _neighbours(pairs)
    fours = sorted(_cycles_of_four(near), key=lambda planes: (not _complete(planes, near), planes))
    rooms = _disjoint(fours, set())
    taken = {plane for room in rooms for plane in room}
    return rooms + _disjoint(sorted(_triangles(near)), taken)


def rooms_by_communities(pairs: Pairs, weight: np.ndarray) -> Rooms:
    """Returns the communities of greatest modularity that greedy merging finds, of two planes up.

    Args:
      pairs: planes in the same room.
      weight: float[e], certainty of each pair, at least 0. Pairs of weight 0 do not count.

    Source: EC-L; Clauset, Newman and Moore 2004.
    """
    import networkx

    graph = networkx.Graph()
    counts = weight > 0
    chosen = sorted(zip(*pairs[counts].T.tolist(), weight[counts].tolist(), strict=True))
    graph.add_nodes_from(sorted(set(pairs[counts].ravel().tolist())))
    graph.add_weighted_edges_from(chosen)
    if not chosen:
        return []
    found = networkx.community.greedy_modularity_communities(graph, weight="weight")
    return sorted(tuple(sorted(members)) for members in found if len(members) > 1)


def with_rooms_and_walls(
    planes: SceneGraph, rooms: Rooms, walls: Pairs, offset: np.ndarray
) -> SceneGraph:
    """Builds the scene graph of planes, one wall a pair, and rooms.

    Args:
      planes: host graph of planes only.
      rooms: planes of each room.
      walls: pairs of planes; each becomes a wall in their middle.
      offset: float[r, 2], from the mean of the planes of each room to its centroid, metres.

    Returns:
      A host graph: planes as given, then walls, then rooms, with part-of edges.
    """
    nodes, num_planes = planes.nodes, len(planes.nodes.label)
    groups = [tuple(pair) for pair in walls.tolist()] + rooms
    centroid = [nodes.position[list(group)].mean(axis=0) for group in groups]
    centroid = np.array(centroid).reshape(-1, 3)
    centroid[len(walls) :, :2] += offset
    part_of = [(plane, num_planes + i) for i, group in enumerate(groups) for plane in group]
    label = [WALL] * len(walls) + [ROOM] * len(rooms)
    return extended(planes, label, centroid, np.array(part_of, np.int32))


def _neighbours(pairs: Pairs) -> dict[int, set[int]]:
    near: dict[int, set[int]] = {plane: set() for plane in pairs.ravel().tolist()}
    for one, other in pairs.tolist():
        near[one].add(other)
        near[other].add(one)
    return near


def _cycles_of_four(near: dict[int, set[int]]) -> set[tuple[int, ...]]:
    """Returns all sets of four planes around which a cycle runs: two with two common neighbours."""
    return {
        tuple(sorted((*opposite, *between)))
        for opposite in combinations(sorted(near), 2)
        for between in combinations(near[opposite[0]] & near[opposite[1]], 2)
    }


def _triangles(near: dict[int, set[int]]) -> Iterator[tuple[int, ...]]:
    for one in near:
        for other, third in combinations(sorted(near[one]), 2):
            if one < other and third in near[other]:
                yield one, other, third


def _complete(planes: tuple[int, ...], near: dict[int, set[int]]) -> bool:
    return all(other in near[one] for one, other in combinations(planes, 2))


def _disjoint(candidates: Sequence[tuple[int, ...]], taken: set[int]) -> Rooms:
    """Returns the candidates, in their order, that share no plane with those before."""
    rooms, taken = [], set(taken)
    for planes in candidates:
        if taken.isdisjoint(planes):
            rooms.append(planes)
            taken.update(planes)
    return rooms
