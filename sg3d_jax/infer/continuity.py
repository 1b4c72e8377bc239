"""What goes on of a map when what is observed changes: the same pieces, and what is above them.

A piece is the one of before that it covers most of, on the same observed node or on what was merged
into it. It is the same while its ends and its direction are, whichever way the whole of it went; so
a map that is bent by the closing of a loop takes its rooms along, and nothing has to be drawn again
unless parts have moved apart. What is observed as it was, to the bit, has not moved, though what
came beside it may cut it elsewhere.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.infer.revision import Map, Tracks, followed, pruned
from sg3d_jax.scene.cut import Pieces
from sg3d_jax.scene.graph import SceneGraph, extended, ontology_of, part_of_matrix, parts_first

GREW: Final = 0.3  # metres by which a piece may have grown or shrunk at an end and be the same
KEPT: Final = 0.05  # metres by which a width may change and the node have only moved
TURNED: Final = 45.0  # degrees by which a piece may turn and be the same
APART: Final = 0.15  # metres by which parts of a whole may move apart and leave it as it was


class Seen(NamedTuple):
    """What is observed, and what it is cut into."""

    graph: SceneGraph  # host graph, as it was told
    ids: tuple[int | str, ...]  # the caller's, of its nodes
    pieces: Pieces  # in rows of it


class _Match(NamedTuple):
    """What k pieces were before."""

    old: np.ndarray  # int[k], row among the pieces of before, -1 for those that are new
    ends: np.ndarray  # float[k, 2], metres that the ends have moved along the piece since
    turned: np.ndarray  # bool[k], points elsewhere
    still: np.ndarray  # bool[k], is of what is as it was, to the bit


def carried(
    known: Map, before: Seen, now: Seen, in_pieces: SceneGraph, heir: Mapping[int | str, int | str]
) -> Map:
    """Returns the map over the pieces of now; what moved as one takes its wholes along.

    Args:
      known: the map over the pieces of before.
      before: what was observed.
      now: what is.
      in_pieces: host graph of its pieces.
      heir: what gone ids were merged into.

    Returns:
      Wholes that have lost all of their parts are gone, unless they are firm. What is to be drawn
      again is marked so.
    """
    graph, tracks = known
    num_before, num_now = len(before.pieces.owner), len(now.pieces.owner)
    old, ends, turned, still = _matched(graph, before, now, in_pieces, heir)
    goes_on = np.flatnonzero(old >= 0)
    place = np.full(len(graph.nodes.label), -1)
    place[old[goes_on]] = goes_on
    place[num_before:] = num_now + np.arange(len(place) - num_before)
    pairs = parts_first(graph)
    is_there = place[pairs[:, 0]] >= 0
    made = extended(
        in_pieces,
        graph.nodes.label[num_before:],
        graph.nodes.position[num_before:],
        place[pairs[is_there]],
    )
    source = np.concatenate([old, np.arange(num_before, len(place))])
    carried_on = Tracks(*(_of_rows(field, source) for field in tracks))
    grew = carried_on.grew + np.pad(ends, [(0, len(source) - num_now), (0, 0)])
    changed = (source < 0) | (np.abs(grew) > GREW).any(axis=1)
    changed[:num_now] |= turned
    still = np.pad(still, (0, len(source) - num_now))
    position, apart = _taken_along(graph, made, source, changed, still)
    due = carried_on.due | changed | apart
    due[place[pairs[~is_there, 1]]] = True
    carried_on.id[source < 0] = -1
    tracks = carried_on._replace(
        due=due & ~carried_on.firm, grew=np.where(changed[:, None], 0.0, grew)
    )
    nodes = made.nodes._replace(position=position)
    return pruned(Map(made._replace(nodes=nodes), tracks))


def _taken_along(
    graph: SceneGraph,
    made: SceneGraph,
    source: np.ndarray,
    changed: np.ndarray,
    still: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Moves wholes as their parts have moved.

    Args:
      graph: of the map, over the pieces of before.
      made: over the pieces of now; wholes are where they were.
      source: int[n], which node of `graph` each is, -1 for what is new.
      changed: bool[n], what is not what it was, and tells nothing.
      still: bool[n], what has not moved, though its middle may have.

    Returns:
      float[n, 3], metres; bool[n], wholes whose parts have moved apart, and observed nodes without
      a whole that have moved as far.
    """
    nodes, part_of = made.nodes, part_of_matrix(made)
    position, apart = nodes.position.copy(), np.zeros(len(source), bool)
    is_there = (still | (source < 0))[:, None]
    earlier = np.where(is_there, position, _of_rows(graph.nodes.position, source))
    normal = _of_rows(graph.nodes.normal, source)
    has_moved = (earlier != position).any(axis=1)
    part_of_one = part_of & (nodes.observed & ~changed)[:, None]
    for whole in np.flatnonzero(part_of_one[has_moved].any(axis=0)):
        parts = np.flatnonzero(part_of_one[:, whole])
        turn = _turn(normal[parts, :2], nodes.normal[parts, :2])
        middle, middle_now = earlier[parts].mean(axis=0), position[parts].mean(axis=0)
        fitted = (earlier[parts] - middle) @ turn.T + middle_now
        apart[whole] = np.abs(fitted - position[parts]).max() > APART
        position[whole] = (earlier[whole] - middle) @ turn.T + middle_now
    is_alone = nodes.observed & ~part_of.any(axis=1)
    apart |= is_alone & (np.abs(earlier - position) > APART).any(axis=1)
    is_upper = ~nodes.observed & ~part_of[nodes.observed].any(axis=0)
    upper = earlier, position, part_of, part_of, nodes.label, ontology_of(made), is_upper
    return followed(*upper), apart


def _matched(
    graph: SceneGraph,
    before: Seen,
    now: Seen,
    in_pieces: SceneGraph,
    heir: Mapping[int | str, int | str],
) -> _Match:
    """Finds what each piece was before.

    Pieces of one owner are compared along it: with respect to its middle if it has kept its width,
    and so has only moved; else where they stand.
    """
    row_of = {one: row for row, one in enumerate(now.ids)}
    goes_on_as = np.array([row_of.get(heir.get(one, one), -1) for one in before.ids], int)
    is_merged = np.array([one in heir for one in before.ids], bool)
    owners = goes_on_as[before.pieces.owner]
    new, old = np.nonzero(now.pieces.owner[:, None] == owners)
    owner, previous = now.pieces.owner[new], before.pieces.owner[old]
    grown = now.graph.nodes.width[owner] - before.graph.nodes.width[previous]
    has_moved = (np.abs(grown) <= KEPT)[:, None]
    nodes, nodes_before = in_pieces.nodes, graph.nodes
    normal, normal_before = nodes.normal[new, :2], nodes_before.normal[old, :2]
    middle = np.where(has_moved, now.graph.nodes.position[owner, :2], 0.0)
    middle_before = np.where(has_moved, before.graph.nodes.position[previous, :2], 0.0)
    axis_before = np.where(has_moved, normal_before, normal)
    width, width_before = nodes.width[new], nodes_before.width[old]
    ends = _ends(normal, nodes.position[new, :2] - middle, width)
    ends_before = _ends(axis_before, nodes_before.position[old, :2] - middle_before, width_before)
    shared = np.minimum(ends, ends_before)[:, 1] - np.maximum(ends, ends_before)[:, 0]
    shared = np.where((width == 0) & (width_before == 0), 1.0, shared)
    cosine = np.sum(normal * normal_before, axis=1)
    turned = normal_before.any(axis=1) & (cosine < np.cos(np.radians(TURNED)))
    chosen = _best_pairs(new, old, shared, is_merged[previous])
    count = len(now.pieces.owner)
    match = _Match(np.full(count, -1), np.zeros((count, 2)), *np.zeros((2, count), bool))
    match.old[new[chosen]] = old[chosen]
    match.ends[new[chosen]] = (ends - ends_before)[chosen]
    match.turned[new[chosen]] = turned[chosen]
    match.still[new[chosen]] = _alike(now.graph, owner, before.graph, previous)[chosen]
    return match


def _alike(
    graph: SceneGraph, rows: np.ndarray, before: SceneGraph, rows_before: np.ndarray
) -> np.ndarray:
    """Returns bool[m], which nodes are to the bit where, and as, others are."""
    one, other = graph.nodes, before.nodes
    return (
        (one.position[rows] == other.position[rows_before]).all(axis=1)
        & (one.normal[rows] == other.normal[rows_before]).all(axis=1)
        & (one.width[rows] == other.width[rows_before])
    )


def _best_pairs(
    new: np.ndarray, old: np.ndarray, shared: np.ndarray, is_merged: np.ndarray
) -> list[int]:
    """Returns which pairs of pieces of now and of before share most, each piece in one pair.

    Args:
      new: int[m], the piece of now of each pair.
      old: int[m], that of before.
      shared: float[m], metres that they have in common.
      is_merged: bool[m], whether that of before is of a node that is gone; it comes last.
    """
    chosen, taken_new, taken_old = [], set(), set()
    order = np.lexsort((-shared, is_merged))
    order = order[shared[order] > 0]
    for pair in order.tolist():
        one, other = int(new[pair]), int(old[pair])
        if one not in taken_new and other not in taken_old:
            chosen.append(pair)
            taken_new.add(one)
            taken_old.add(other)
    return chosen


def _ends(normal: np.ndarray, offset: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Returns where vertical pieces start and stop along themselves, float[m, 2], metres."""
    along = normal[:, 0] * offset[:, 1] - normal[:, 1] * offset[:, 0]
    return np.stack([along - width / 2, along + width / 2], axis=1)


def _turn(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Returns the rotation about the vertical, float[3, 3], that turns directions best."""
    cross = np.sum(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    angle = np.arctan2(cross, np.sum(before * after))
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _of_rows(field: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Returns the rows of a field; zeros where there is none."""
    is_new = (source < 0).reshape(-1, *[1] * (field.ndim - 1))
    if not len(field):
        return np.zeros((len(source), *field.shape[1:]), field.dtype)
    return np.where(is_new, np.zeros_like(field[:1]), field[source])
