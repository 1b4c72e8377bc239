"""What a map takes over of a region that was drawn again.

A draw is one opinion, and the map is what stayed of those before. So what is drawn replaces what is
there only around what has changed, where nothing was there, or where a node is drawn elsewhere
twice in a row: nothing flickers. Concepts are revised bottom-up, each over the parts that the map
then has; the drawn whole that shares most parts with one that is there goes on as that one.
"""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.infer.region import Region
from sg3d_jax.scene.graph import SceneGraph, features_of, make_graph, ontology_of, parts_first
from sg3d_jax.scene.ontology import FEATURES, Ontology

PATIENCE: Final = 2  # draws in a row that a node must be elsewhere in where nothing has changed


class Tracks(NamedTuple):
    """What is known of the nodes of a map beside its graph."""

    id: np.ndarray  # int64[n], of grown nodes, never given twice; -1 for observed ones
    born: np.ndarray  # int64[n], the update in which each came
    drawn: np.ndarray  # int64[n], how often it was drawn since its parts are these,
    held: np.ndarray  # int64[n], and how often just so
    astray: np.ndarray  # int64[n, C], draws in a row in which it had another whole of a concept
    firm: np.ndarray  # bool[n], stays whatever comes


class Map(NamedTuple):
    """What is observed, and what has grown above it."""

    graph: SceneGraph  # host graph, observed nodes first, part-of edges alone
    tracks: Tracks


class Banned(NamedTuple):
    """What is not to come again."""

    label: int
    observed: AbstractSet[int]  # rows of the map that were below it


def revised(
    known: Map,
    region: Region,
    drawn: SceneGraph,
    fresh: np.ndarray,
    stirred: np.ndarray,
    update: int,
    next_id: int,
    banned: Sequence[Banned] = (),
) -> Map:
    """Returns a map with what it takes over of a draw.

    Args:
      known: what is there.
      region: what was drawn again of it.
      drawn: host graph; its first nodes are those of the region, as they are there.
      fresh: bool[n], observed nodes that are new, or others than they were.
      stirred: bool[n], wholes that have lost parts, or whose parts have moved apart.
      update: its number.
      next_id: of the first node that comes.
      banned: what is not taken over.
    """
    ontology, num_known = ontology_of(known.graph), len(known.graph.nodes.label)
    new_rows = np.arange(num_known, num_known + len(drawn.nodes.label) - len(region.rows))
    total, rows = num_known + len(new_rows), np.concatenate([region.rows, new_rows])
    label = np.concatenate([known.graph.nodes.label, drawn.nodes.label[len(region.rows) :]])
    before = _matrix(known.graph, np.arange(num_known), total)
    drawn_part_of = _matrix(drawn, rows, total)
    is_open = np.pad(region.open, (0, len(new_rows)), constant_values=True)
    fresh, stirred = (np.pad(one, (0, len(new_rows))) for one in (fresh, stirred))
    stirred = stirred | (before | drawn_part_of)[fresh].any(axis=0)
    astray = np.pad(known.tracks.astray, [(0, len(new_rows)), (0, 0)])
    part_of, told = before.copy(), np.zeros_like(before)  # the map, and the draw in its rows
    stands = np.arange(total)  # which row of the map each node stands for
    for concept in np.flatnonzero(ontology.may_be_part.any(axis=0)):
        is_of = label == concept
        new = new_rows[is_of[new_rows]]
        says = np.zeros((total, len(new)), bool)
        for row in rows:
            says[stands[row]] |= drawn_part_of[row, new]
        for one in says.T:
            below = observed_below(part_of, label, one)
            one &= not any(ban == Banned(concept, below) for ban in banned)
        old = np.flatnonzero(is_of[:num_known] & region.open)
        stands[new] = _heirs(part_of[:, old].T.astype(int) @ says, old, new)
        if ontology.is_top[concept] and is_of[:num_known].any():
            stands[new] = np.argmax(is_of)
        for one, of_one in zip(stands[new], says.T, strict=True):
            told[:, one] |= of_one
        columns = np.flatnonzero(is_of & is_open)
        parts = np.isin(np.arange(total), stands[rows]) & ontology.may_be_part[label, concept]
        differs = parts & (told != part_of)[:, columns].any(axis=1)
        near = (part_of | told)[:, columns[stirred[columns]]].any(axis=1)
        is_free = fresh | near | ~part_of[:, is_of].any(axis=1)
        moves = differs & told[:, columns].any(axis=1) & is_free
        moves |= differs & (astray[:, concept] + 1 >= PATIENCE)
        part_of[np.ix_(moves, columns)] = told[np.ix_(moves, columns)]
        astray[parts, concept] = np.where(differs & ~moves, astray[:, concept] + 1, 0)[parts]
    stays = _that_stay(part_of, label, np.pad(known.tracks.firm, (0, len(new_rows))), ontology)
    part_of &= stays[:, None] & stays
    inside = np.isin(np.arange(total), stands[rows])
    agrees = told.any(axis=0) & (told == part_of)[inside].all(axis=0)
    changed, is_new = (before != part_of).any(axis=0), np.arange(total) >= num_known
    is_as_drawn = is_new | (changed & agrees & ~part_of[~inside].any(axis=0))
    drawn_at = np.zeros((total, 3))
    drawn_at[stands[new_rows]] = drawn.nodes.position[len(region.rows) :]
    there = np.pad(known.graph.nodes.position, [(0, len(new_rows)), (0, 0)])
    position = np.where(is_as_drawn[:, None], drawn_at, there)
    position = followed(there, position, before, part_of, label, ontology, ~is_as_drawn)
    again = is_open & (told | (part_of & inside[:, None])).any(axis=0)
    tracks = Tracks(
        id=np.concatenate([known.tracks.id, np.full(len(new_rows), -1)]),
        born=np.concatenate([known.tracks.born, np.full(len(new_rows), update)]),
        drawn=np.where(changed, 1, np.pad(known.tracks.drawn, (0, len(new_rows))) + again),
        held=np.where(changed, 1, np.pad(known.tracks.held, (0, len(new_rows))) + (again & agrees)),
        astray=astray,
        firm=np.pad(known.tracks.firm, (0, len(new_rows))),
    )
    came = np.flatnonzero(stays & is_new)
    tracks.id[came] = next_id + np.arange(len(came))
    return _only(stays, label, position, known.graph, part_of, tracks)


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
    for concept in np.flatnonzero(ontology.may_be_part.any(axis=0)):
        for row in np.flatnonzero(lasting & (label == concept)):
            parts = before[part_of_before[:, row]], now[part_of[:, row]]
            was, is_at = (each.mean(axis=0) for each in parts)
            if ontology.is_above[concept]:
                was[2], is_at[2] = (each[:, 2].max() for each in parts)
            now[row] += is_at - was
    return now


def observed_below(part_of: np.ndarray, label: np.ndarray, parts: np.ndarray) -> frozenset[int]:
    """Returns the rows without parts that are below some nodes, or among them.

    Args:
      part_of: bool[n, n], part and whole.
      label: int[n]; parts have lesser ones than their wholes.
      parts: bool[n], the nodes.
    """
    below = parts.copy()
    for concept in range(label.max(), -1, -1):
        below |= part_of[:, below & (label == concept)].any(axis=1)
    return frozenset(np.flatnonzero(below & ~part_of.any(axis=0)).tolist())


def _matrix(graph: SceneGraph, rows: np.ndarray, size: int) -> np.ndarray:
    """Returns the part-of edges of a graph as bool[n, n], part and whole, in other rows."""
    matrix = np.zeros((size, size), bool)
    part, whole = rows[parts_first(graph)].T
    matrix[part, whole] = True
    return matrix


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


def _only(
    stays: np.ndarray,
    label: np.ndarray,
    position: np.ndarray,
    graph: SceneGraph,
    part_of: np.ndarray,
    tracks: Tracks,
) -> Map:
    """Returns the map of the nodes that stay; those beyond the graph have no features."""
    further = len(label) - len(graph.nodes.label)
    features = {
        name: np.concatenate([array, np.zeros((further, *FEATURES[name]))])[stays]
        for name, array in features_of(graph).items()
    }
    pairs = np.argwhere(part_of[np.ix_(stays, stays)])
    made = make_graph(
        label[stays], position[stays], **features, part_of=pairs, ontology=ontology_of(graph)
    )
    return Map(made, Tracks(*(field[stays] for field in tracks)))
