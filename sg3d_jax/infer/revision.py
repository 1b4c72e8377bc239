"""What a map takes over of a region that was drawn again.

A draw is one opinion, and the map is what stayed of those before. So what is drawn replaces what is
there only around what has changed, where nothing was there, or where a node is drawn elsewhere
twice in a row: nothing flickers. A whole that was drawn just so twice has settled: as long as none
of its parts has changed, what is observed joins or leaves it only if that is drawn twice in a row;
what is new waits for it, and is drawn again by the next update. Concepts are revised bottom-up,
each over the parts that the map then has; the drawn whole that shares most parts with one that is
there goes on as that one.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.infer.region import Region
from sg3d_jax.scene.graph import (
    SceneGraph,
    features_of,
    make_graph,
    ontology_of,
    part_of_matrix,
    subgraph,
)
from sg3d_jax.scene.ontology import Ontology

PATIENCE: Final = 2  # draws that settle a whole, and that in a row then change what has settled


class Tracks(NamedTuple):
    """What is known of the nodes of a map beside its graph."""

    id: np.ndarray  # int64[n], of grown nodes, never given twice; -1 for observed ones
    born: np.ndarray  # int64[n], the update in which each came
    drawn: np.ndarray  # int64[n], how often it was drawn since its parts are these,
    held: np.ndarray  # int64[n], and how often just so
    astray: np.ndarray  # int64[n, C], draws in a row in which it had another whole of a concept
    firm: np.ndarray  # bool[n], stays whatever comes
    due: np.ndarray  # bool[n], is to be drawn again: is new, not what it was, or lost or bent parts
    grew: np.ndarray  # float[n, 2], metres that the ends of what is observed moved since it was due


class Map(NamedTuple):
    """What is observed, and what has grown above it."""

    graph: SceneGraph  # host graph, observed nodes first, part-of edges alone
    tracks: Tracks


class _Overlay(NamedTuple):
    """A map and a draw of a region of it, in m common rows: those of the map, then what is new."""

    ontology: Ontology
    label: np.ndarray  # int[m]
    known: np.ndarray  # bool[m, m], part and whole, as the map has them
    drawn: np.ndarray  # bool[m, m], and as the draw has them
    rows: np.ndarray  # int[d], of the nodes of the draw
    new: np.ndarray  # int[v], of those that it has grown
    open: np.ndarray  # bool[m], may be others now
    hidden: np.ndarray  # bool[m], wholes that the draw was not given, and has its own version of
    firm: np.ndarray  # bool[m], stays whatever comes
    due: np.ndarray  # bool[m], is drawn because it has changed
    settled: np.ndarray  # bool[m], wholes that were drawn so before, and of which nothing changed


class _Verdict(NamedTuple):
    """What the map takes over."""

    part_of: np.ndarray  # bool[m, m], part and whole, as the map has them now
    told: np.ndarray  # bool[m, m], as the draw has them, where each node is what it goes on as
    stands: np.ndarray  # int[m], the row that each node goes on as
    astray: np.ndarray  # int[m, C], of `Tracks`


def revised(
    known: Map,
    region: Region,
    drawn: SceneGraph,
    update: int,
    next_id: int,
    is_banned: Callable[[int, frozenset[int]], bool] | None = None,
    piece_of: np.ndarray | None = None,
) -> Map:
    """Returns a map with what it takes over of a draw.

    A whole with pieces of the same as before has not changed, however those are cut.

    Args:
      known: what is there.
      region: what was drawn again of it.
      drawn: host graph; its first nodes are those of the region, as they are there.
      update: its number.
      next_id: of the first node that comes.
      is_banned: whether a whole of a concept over some rows of the map is not to come; None if all
        may.
      piece_of: int[k], of each of the first rows, which are observed, the first row that is a piece
        of the same; None if none are.
    """
    over = _overlaid(known, region, drawn)
    verdict = _judged(over, known.tracks.astray, is_banned)
    stays = _that_stay(verdict.part_of, over.label, over.firm, over.ontology)
    part_of = verdict.part_of & stays[:, None] & stays
    inside = np.isin(np.arange(len(stays)), verdict.stands[over.rows])
    changed = (_joined(over.known, piece_of) != _joined(part_of, piece_of)).any(axis=0)
    agrees = verdict.told.any(axis=0) & (verdict.told == part_of)[inside].all(axis=0)
    again = over.open & (verdict.told | (part_of & inside[:, None])).any(axis=0)
    tracks = Tracks(*(_padded(field, len(over.new)) for field in known.tracks))
    is_drawn = agrees & ~over.firm & ~part_of[~inside].any(axis=0)
    share = (is_drawn & changed).astype(float)  # of where a node is that the draw decides
    share[over.new] = 1.0
    if not tracks.due.any():  # the map is thought over: places become the mean of all draws
        thought = is_drawn & again & ~changed
        share[thought] = 1 / (1 + tracks.held[thought])
    there = _padded(known.graph.nodes.position, len(over.new))
    drawn_at = there.copy()
    drawn_at[verdict.stands[over.new]] = drawn.nodes.position[len(region.rows) :]
    position = there + share[:, None] * (drawn_at - there)
    before = np.where(changed, over.known, part_of)
    lasting = there, position, before, part_of, over.label, over.ontology, share == 0
    graph = _with_nodes(known.graph, over.label, followed(*lasting), part_of)
    is_waiting = ~part_of.any(axis=1) & verdict.astray.any(axis=1) & graph.nodes.observed
    tracks.id[over.new], tracks.born[over.new] = -1, update
    tracks = tracks._replace(
        drawn=np.where(changed, 1, tracks.drawn + again),
        held=np.where(changed, 1, tracks.held + (again & agrees)),
        astray=verdict.astray,
        due=tracks.due & ~over.open & (~inside | is_waiting),
    )
    return _numbered(_of_rows(Map(graph, tracks), np.flatnonzero(stays)), next_id)


def pruned(known: Map) -> Map:
    """Returns a map without the wholes that have lost all of their parts, unless they are firm."""
    graph = known.graph
    part_of = part_of_matrix(graph)
    stays = _that_stay(part_of, graph.nodes.label, known.tracks.firm, ontology_of(graph))
    return known if stays.all() else _of_rows(known, np.flatnonzero(stays))


def without(known: Map, rows: list[int]) -> Map:
    """Returns a map without some nodes."""
    return _of_rows(known, np.delete(np.arange(len(known.graph.nodes.label)), rows))


def followed(
    before: np.ndarray,
    now: np.ndarray,
    part_of_before: np.ndarray,
    part_of: np.ndarray,
    label: np.ndarray,
    ontology: Ontology,
    which: np.ndarray,
) -> np.ndarray:
    """Returns where nodes are once each has moved as the middle of its parts has, bottom-up.

    Args:
      before: float[n, 3], metres.
      now: float[n, 3], where what does not follow is.
      part_of_before: bool[n, n], part and whole.
      part_of: bool[n, n], now.
      label: int[n].
      ontology: says which concepts stand above their parts, and so upon the highest.
      which: bool[n], what follows.
    """
    now = now.copy()
    lasting = which & part_of_before.any(axis=0) & part_of.any(axis=0)
    has_others = (part_of_before != part_of).any(axis=0)
    for concept in np.flatnonzero(ontology.may_be_part.any(axis=0)):
        shifted = has_others | part_of[(now != before).any(axis=1)].any(axis=0)
        for row in np.flatnonzero(lasting & shifted & (label == concept)):
            parts = before[part_of_before[:, row]], now[part_of[:, row]]
            was, is_at = (each.mean(axis=0) for each in parts)
            if ontology.is_above[concept]:
                was[2], is_at[2] = (each[:, 2].max() for each in parts)
            now[row] += is_at - was
    return now


def _joined(part_of: np.ndarray, piece_of: np.ndarray | None) -> np.ndarray:
    """Returns bool[m, m], part and whole, where the pieces of one are the first of them."""
    if piece_of is None:
        return part_of
    further = np.flatnonzero(piece_of != np.arange(len(piece_of)))
    joined = part_of.copy()
    np.logical_or.at(joined, piece_of[further], part_of[further])
    joined[further] = False
    return joined


def _overlaid(known: Map, region: Region, drawn: SceneGraph) -> _Overlay:
    """Brings a map and a draw to common rows."""
    num_known, num_given = len(known.graph.nodes.label), len(region.rows)
    further = len(drawn.nodes.label) - num_given
    new = np.arange(num_known, num_known + further)
    rows, total = np.concatenate([region.rows, new]), num_known + further
    is_open, firm = _padded(region.open, further), _padded(known.tracks.firm, further)
    is_open[new] = True
    hidden = is_open | (firm & ~np.isin(np.arange(total), rows))
    part_of = _matrix(known.graph, np.arange(num_known), total)
    due = _padded(known.tracks.due, further)
    settled = (_padded(known.tracks.held, further) >= PATIENCE) & ~due & ~part_of[due].any(axis=0)
    settled &= due.any()  # else the map is thought over, to change
    return _Overlay(
        ontology_of(known.graph),
        np.concatenate([known.graph.nodes.label, drawn.nodes.label[num_given:]]),
        part_of,
        _matrix(drawn, rows, total),
        rows,
        new,
        is_open,
        hidden,
        firm,
        due,
        settled,
    )


def _judged(
    over: _Overlay, astray: np.ndarray, is_banned: Callable[[int, frozenset[int]], bool] | None
) -> _Verdict:
    """Decides, concept by concept, which parts have the wholes that were drawn."""
    ontology, label = over.ontology, over.label
    part_of, stands = over.known.copy(), np.arange(len(label))
    told, astray = np.zeros_like(part_of), _padded(astray, len(over.new))
    is_observed = ontology.is_observed[label]
    fresh = over.due & is_observed
    stirred = over.due | (over.known | over.drawn)[fresh].any(axis=0)
    for concept in np.flatnonzero(ontology.may_be_part.any(axis=0)).tolist():
        is_of = label == concept
        new = over.new[is_of[over.new]]
        says = np.zeros((len(label), len(new)), bool)
        np.logical_or.at(says, stands[over.rows], over.drawn[np.ix_(over.rows, new)])
        says[:, _refused(says, over, part_of, concept, is_banned)] = False
        stands[new] = _go_on_as(says, over, part_of, concept)
        for one, of_one in zip(stands[new], says.T, strict=True):
            told[:, one] |= of_one
        columns = np.flatnonzero(is_of & over.hidden)
        _keep_closed(
            told, part_of, is_of & ~over.open, columns, ontology.has_one_whole[label, concept]
        )
        is_drawn = np.isin(np.arange(len(label)), stands[over.rows])
        differs = is_drawn & ontology.may_be_part[label, concept]
        differs &= (told != part_of)[:, columns].any(axis=1)
        near = (part_of | told)[:, columns[stirred[columns]]].any(axis=1)
        settled = columns[over.settled[columns]]
        waits = is_observed & (part_of | told)[:, settled].any(axis=1)
        is_free = (fresh | near | ~part_of[:, is_of].any(axis=1)) & ~waits
        moves = differs & told[:, columns].any(axis=1) & is_free
        moves |= differs & (astray[:, concept] + 1 >= PATIENCE)
        part_of[np.ix_(moves, columns)] = told[np.ix_(moves, columns)]
        changed = columns[over.open[columns]]
        refused = _refused(part_of[:, changed], over, part_of, concept, is_banned)
        part_of[:, changed[refused]] = False
        in_a_row = np.where(differs & ~moves, astray[:, concept] + 1, 0)
        astray[:, concept] = np.where(is_drawn, in_a_row, astray[:, concept])
    return _Verdict(part_of, told, stands, astray)


def _refused(
    wholes: np.ndarray,
    over: _Overlay,
    part_of: np.ndarray,
    concept: int,
    is_banned: Callable[[int, frozenset[int]], bool] | None,
) -> np.ndarray:
    """Returns bool[k], which wholes of a concept are not to come.

    Args:
      wholes: bool[m, k], the parts of each.
      over: a map and a draw.
      part_of: bool[m, m], as the map has it now below the concept.
      concept: its label.
      is_banned: see `revised`.
    """
    if is_banned is None:
        return np.zeros(wholes.shape[1], bool)
    below = [_observed_below(part_of, over, one) for one in wholes.T]
    return np.array([is_banned(concept, rows) for rows in below], bool)


def _observed_below(part_of: np.ndarray, over: _Overlay, parts: np.ndarray) -> frozenset[int]:
    """Returns the rows of what is observed below some nodes, bool[m], or among them."""
    below = parts.copy()
    for concept in range(over.ontology.num_concepts - 1, -1, -1):
        below |= part_of[:, below & (over.label == concept)].any(axis=1)
    return frozenset(np.flatnonzero(below & over.ontology.is_observed[over.label]).tolist())


def _go_on_as(says: np.ndarray, over: _Overlay, part_of: np.ndarray, concept: int) -> np.ndarray:
    """Returns int[v], the row that each drawn whole of a concept goes on as, may be its own.

    Args:
      says: bool[m, v], the parts of each, in rows of the map.
      over: a map and a draw.
      part_of: bool[m, m], as the map has it now.
      concept: its label.
    """
    is_of = over.label == concept
    there = np.setdiff1d(np.flatnonzero(is_of), over.new)
    new, old = over.new[is_of[over.new]], there[over.hidden[there]]
    if over.ontology.is_top[concept] and len(there):
        return np.full(len(new), there[0])
    return _heirs(part_of[:, old].T.astype(int) @ says, old, new)


def _keep_closed(
    told: np.ndarray,
    part_of: np.ndarray,
    closed: np.ndarray,
    columns: np.ndarray,
    has_one_whole: np.ndarray,
) -> None:
    """Leaves wholes that may not change their parts, and parts that have one such theirs.

    Args:
      told: bool[m, m], as was drawn; changed.
      part_of: bool[m, m], as the map has it.
      closed: bool[m], wholes that keep their parts.
      columns: int[h], wholes of the concept that may get parts.
      has_one_whole: bool[m], which nodes are part of one whole of the concept at most.
    """
    told[:, closed] |= part_of[:, closed]
    held = np.flatnonzero(part_of[:, closed].any(axis=1) & has_one_whole)
    told[np.ix_(held, columns)] = part_of[np.ix_(held, columns)]


def _heirs(shared: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Returns the row that each drawn whole goes on as: one that shares most parts, or its own.

    Args:
      shared: int[o, v], how many parts each old one shares with each drawn one.
      old: int[o], their rows.
      new: int[v], their rows.
    """
    heirs, shared = new.copy(), shared.copy()
    while shared.size and shared.max() > 0:
        one, other = np.unravel_index(np.argmax(shared), shared.shape)
        heirs[other] = old[one]
        shared[one], shared[:, other] = 0, 0
    return heirs


def _that_stay(
    part_of: np.ndarray, label: np.ndarray, firm: np.ndarray, ontology: Ontology
) -> np.ndarray:
    """Returns bool[n], what is observed, firm, or has parts that stay."""
    stays = firm | ontology.is_observed[label]
    for concept in np.flatnonzero(~ontology.is_observed):
        stays |= (label == concept) & part_of[stays].any(axis=0)
    return stays


def _padded(field: np.ndarray, further: int) -> np.ndarray:
    """Returns a field with zeros for further nodes."""
    return np.pad(field, [(0, further), *[(0, 0)] * (field.ndim - 1)])


def _matrix(graph: SceneGraph, rows: np.ndarray, size: int) -> np.ndarray:
    """Returns the part-of edges of a graph as bool[n, n], part and whole, in other rows."""
    matrix = np.zeros((size, size), bool)
    matrix[np.ix_(rows, rows)] = part_of_matrix(graph)
    return matrix


def _with_nodes(
    graph: SceneGraph, label: np.ndarray, position: np.ndarray, part_of: np.ndarray
) -> SceneGraph:
    """Returns a host graph with further nodes, which have no features, and other edges."""
    further = len(label) - len(graph.nodes.label)
    features = {name: _padded(array, further) for name, array in features_of(graph).items()}
    pairs = np.argwhere(part_of)
    return make_graph(label, position, **features, part_of=pairs, ontology=ontology_of(graph))


def _of_rows(known: Map, rows: np.ndarray) -> Map:
    """Returns the map of some nodes."""
    return Map(subgraph(known.graph, rows), Tracks(*(field[rows] for field in known.tracks)))


def _numbered(known: Map, next_id: int) -> Map:
    """Returns a map in which what is new has ids, from the next one on."""
    number = known.tracks.id.copy()
    new = np.flatnonzero((number < 0) & ~known.graph.nodes.observed)
    number[new] = next_id + np.arange(len(new))
    return Map(known.graph, known.tracks._replace(id=number))
