"""Which part of a map a change touches: the region that is drawn again, and what stays around it.

A region is a graph of its own. It has what is observed around the change, and the wholes there that
stay as they are; those that may be others now are left out, and so is everything further up, or
growing would take it for complete. A model grows it to its end as it would a small scene, so that
the time does not depend on the size of the map.
"""

from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, part_of_matrix

CONTEXT: Final = 36  # observed nodes of a region, unless the change alone has more
STOREY: Final = 4.0  # a height difference counts as a way so many times as long
REACH: Final = 8.0  # metres between a node and the nearest part of a whole that it may be part of
NUM_REACHED: Final = 2  # wholes of each kind that a new node may be part of, at most
BEHIND: Final = 0.1  # metres that a node may lie behind another and still face it


class Region(NamedTuple):
    """What is drawn again."""

    rows: np.ndarray  # int[r], of the map: what is observed, then the wholes that stay
    open: np.ndarray  # bool[n], nodes of the map that may be others now


def region_of(graph: SceneGraph, due: np.ndarray, firm: np.ndarray) -> Region:
    """Returns the region around a change.

    Args:
      graph: host graph of a map, observed nodes first.
      due: bool[n], observed nodes that are new, or others than they were, and wholes of observed
        nodes that may be others now; at least one.
      firm: bool[n], nodes that stay whatever comes.
    """
    members, observed = members_of(graph), np.asarray(graph.nodes.observed)
    fresh = due & observed
    direct = members.any(axis=0) & ~firm
    new = fresh & ~members.any(axis=1)
    is_open = direct & (due | members[fresh].any(axis=0) | _reached(graph, members, new))
    core = fresh | members[:, is_open].any(axis=1)
    chosen = _with_context(graph, members, core)
    upper = ~observed & ~members.any(axis=0)
    staying = members[chosen].any(axis=0) & ~is_open
    rows = np.concatenate([np.flatnonzero(chosen), np.flatnonzero(staying)])
    return Region(rows, is_open | (upper & ~firm))


def whole_region(graph: SceneGraph, firm: np.ndarray) -> Region:
    """Returns the region of a whole map: all but what is firm may be other than it is.

    Args:
      graph: host graph of a map, observed nodes first.
      firm: bool[n], nodes that stay whatever comes.
    """
    observed = np.asarray(graph.nodes.observed)
    staying = firm & members_of(graph).any(axis=0)
    rows = np.concatenate([np.flatnonzero(observed), np.flatnonzero(staying)])
    return Region(rows, ~observed & ~firm)


def members_of(graph: SceneGraph) -> np.ndarray:
    """Returns bool[n, n], which observed node (row) is part of which grown one (column)."""
    return part_of_matrix(graph) & np.asarray(graph.nodes.observed)[:, None]


def _reached(graph: SceneGraph, members: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Returns bool[n], the wholes that new nodes may be part of.

    A new node lies to the parts of such a whole as they lie to each other: the sides of a room face
    each other, those of a wall do not. What has no normal may be part of anything near.
    """
    reached, rows = np.zeros(len(new), bool), np.flatnonzero(new)
    placed = np.flatnonzero(members.any(axis=1))
    is_near = (_way(graph, rows, placed) < REACH).any(axis=0)
    wholes = np.flatnonzero(members[placed[is_near]].any(axis=0))
    if not len(wholes):
        return reached
    seen = np.flatnonzero(members[:, wholes].any(axis=1))
    of_whole = members[np.ix_(seen, wholes)].astype(float)
    inside = _facing(graph, seen, seen).astype(float) - np.eye(len(seen))
    number = of_whole.sum(axis=0)
    pairs = np.maximum(number * (number - 1), 1)
    share_inside = np.sum(of_whole * (inside @ of_whole), axis=0) / pairs
    share = _facing(graph, rows, seen) @ of_whole / number
    way = _way(graph, rows, seen)
    near = np.stack([way[:, held].min(axis=1) for held in of_whole.T.astype(bool)], axis=1)
    label = np.asarray(graph.nodes.label)[wholes]
    for kind in np.unique(label):
        fits = ((share > 0.5) == (share_inside > 0.5)) | (number == 1)
        far = np.where(fits & (near < REACH) & (label == kind), near, np.inf)
        best = np.argsort(far, axis=1)[:, :NUM_REACHED]
        found = np.isfinite(np.take_along_axis(far, best, axis=1))
        reached[wholes[best[found]]] = True
    return reached


def _facing(graph: SceneGraph, rows: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Returns bool[r, o], which nodes lie in front of each other."""
    position, normal = (np.asarray(x) for x in (graph.nodes.position, graph.nodes.normal))
    ahead = _ahead(position[rows], normal[rows], position[others])
    return (ahead > -BEHIND) & (
        _ahead(position[others], normal[others], position[rows]).T > -BEHIND
    )


def _ahead(position: np.ndarray, normal: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Returns float[r, o], how far others lie along the normal of each, metres."""
    return normal @ others.T - np.sum(normal * position, axis=1)[:, None]


def _way(graph: SceneGraph, rows: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Returns float[r, o], metres between nodes; half their widths are no way."""
    position, width = (np.asarray(x) for x in (graph.nodes.position, graph.nodes.width))
    apart = position[rows][:, None] - position[others][None]
    way = np.linalg.norm(apart * [1.0, 1.0, STOREY], axis=-1)
    return np.maximum(way - (width[rows][:, None] + width[others][None]) / 2, 0.0)


def _with_context(graph: SceneGraph, members: np.ndarray, core: np.ndarray) -> np.ndarray:
    """Returns bool[n], a core of observed nodes and what is nearest to it, in groups of wholes.

    A node that has several wholes comes with the one that has most parts, so that what is near is
    there with all of its sides.
    """
    observed = np.flatnonzero(graph.nodes.observed)
    size = members.sum(axis=0)
    largest = np.argmax(members[observed] * size, axis=1)
    group = np.where(members[observed].any(axis=1), largest, observed)
    is_core = core[observed]
    way = _way(graph, observed, observed[is_core]).min(axis=1, initial=np.inf)
    way[is_core] = -1.0
    nearest = np.full(len(core), np.inf)
    np.minimum.at(nearest, group, way)
    chosen, room = core.copy(), max(CONTEXT, 3 * int(is_core.sum()) // 2)
    for one in np.argsort(nearest, kind="stable"):
        if not np.isfinite(nearest[one]):
            break
        with_it = observed[group == one]
        if chosen.sum() + np.sum(~chosen[with_it]) > room:
            break
        chosen[with_it] = True
    return chosen
