"""How sure a completed graph is: what in it is unlike any complete graph, and what samples share.

No truth is needed. A graph that the model found complete may still be wrong all over; then much of
what is observed has no place in it, or the next sample is another one. Nodes and edges have a
confidence of their own: how likely they are right, told by how many of the graphs that were drawn
of the scene have them (`benchmarks/calibration.py` says how well).
"""

from collections import Counter
from collections.abc import Iterator, Sequence, Set
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.metrics.calibration import Identity, edge_identities, identities
from sg3d_jax.scene.graph import SceneGraph, ontology_of, parts_first
from sg3d_jax.scene.ontology import Ontology

LEAST_GROUPED: Final = 2  # observed nodes: one alone is no group

# What is beyond these is said. Of 49 exact graphs (fd4-s-f on S-F, midi-p-f on P-F) none lacks
# anything, and nine of ten agree with a second sample by 0.88 and more. Where a fifth of the planes
# was missing and the others shortened, no graph was exact; in the mean 0.03 (midi-p-f) and 0.14
# (fd4-s-f) were without a room, and two samples agreed by 0.61 and 0.64.
MOST_UNPLACED: Final = 0.05
MOST_LOOSE: Final = 0.0
MOST_THIN: Final = 0.05
LEAST_AGREEMENT: Final = 0.8

# What k of K draws have is right with odds of ((k + PRIOR) / (K - k + PRIOR)) ** SHARPNESS: more
# often than k in K if most have it, more seldom if few have. Fitted on validation splits alone, to
# draws of midi-general on S-F, P-F and S-F@robot (`benchmarks/calibration.py --fit`).
PRIOR: Final = 0.4
SHARPNESS: Final = 2.4
# A draw that has one room of a floor otherwise still has the floor: two nodes that share so much of
# what either groups, and at least so many, stand for the same.
NEARLY: Final = 0.9
LEAST_NEARLY: Final = 9


class Confidence(NamedTuple):
    """What a completed graph lacks, as shares, and how much of it another sample has, too."""

    unplaced: float  # observed nodes that lack the whole that is due, such as planes without a room
    loose: float  # others that are below nothing, but for one, such as rooms without a floor
    thin: float  # nodes that group fewer than two observed ones, such as rooms of one plane
    agreement: float | None  # grown nodes that other samples have, too; None if there are none


class Judgement(NamedTuple):
    """What there is to say of a completed graph."""

    confidence: Confidence  # of all of it
    remarks: tuple[str, ...]  # one sentence each
    # How likely each is right, 0 to 1; what was given has 1. None if one graph was drawn.
    nodes: np.ndarray | None  # float64[n]
    edges: np.ndarray | None  # float64[e], in the order of `parts_first`


class _Read(NamedTuple):
    """What the nodes and edges of a host graph stand for."""

    of_nodes: list[Identity]
    of_edges: list[tuple[Identity, Identity]]


class _Doubt(NamedTuple):
    """What is not as it should be of the nodes of one concept."""

    field: str  # of `Confidence`
    count: int
    total: int
    text: str  # such as "2 of 9 rooms without a floor"


def judged(
    graphs: Sequence[SceneGraph],
    drawn: Sequence[SceneGraph],
    num_given: int,
    set_aside: Sequence[int] | np.ndarray = (),
) -> list[Judgement]:
    """Returns how sure some graphs of one scene are, and what to say of it.

    A node is right if the truth has one of its concept over the same observed nodes; see
    `metrics.calibration`.

    Args:
      graphs: host graphs that were completed of the scene.
      drawn: all that were drawn of it; `graphs` are some of them, or made of them.
      num_given: how many of their first nodes were given: they, and edges between them, are sure.
      set_aside: rows of nodes that were given and not grown from: they lack nothing.
    """
    several = len(drawn) > 1  # one alone tells nothing of its nodes and edges
    every = {id(graph): graph for graph in (*drawn, *graphs)} if several else {}
    read = {name: _read(graph) for name, graph in every.items()}
    draws = [read[id(graph)] for graph in drawn if several]
    results = []
    for graph in graphs:
        agreement, of_nodes, of_edges = None, None, None
        if several:
            own = read[id(graph)]
            place = next((i for i, one in enumerate(drawn) if one is graph), len(drawn))
            agreement = _agreement(own, [*draws[:place], *draws[place + 1 :]], num_given)
            alike = [_as_called_in(own, draw, num_given) for draw in draws]
            nodes = Counter(one for draw in alike for one in draw.of_nodes)
            edges = Counter(one for draw in alike for one in draw.of_edges)
            of_nodes = likely([nodes[one] for one in own.of_nodes], len(drawn))
            of_edges = likely([edges[one] for one in own.of_edges], len(drawn))
            of_nodes[:num_given] = 1.0
            of_edges[(parts_first(graph) < num_given).all(axis=1)] = 1.0
        doubts = list(_doubts(graph, set_aside))
        shares = {field: _share(doubts, field) for field in Confidence._fields[:3]}
        confidence = Confidence(**shares, agreement=agreement)
        remarks = tuple(_remarks(confidence, doubts))
        results.append(Judgement(confidence, remarks, of_nodes, of_edges))
    return results


def _read(graph: SceneGraph) -> _Read:
    nodes = identities(graph)
    return _Read(nodes, edge_identities(graph, nodes))


def _as_called_in(own: _Read, draw: _Read, num_given: int) -> _Read:
    """Returns a draw in which what nearly stands for a node of another graph does so."""
    known, grown = {*own.of_nodes}, own.of_nodes[num_given:]
    names = {
        one: _nearest(one, grown)
        for one in draw.of_nodes[num_given:]
        if one not in known and one[1].bit_count() >= LEAST_NEARLY
    }
    return _Read(
        [names.get(one, one) for one in draw.of_nodes],
        [(names.get(part, part), names.get(whole, whole)) for part, whole in draw.of_edges],
    )


def _nearest(one: Identity, others: Sequence[Identity]) -> Identity:
    """Returns which of some others is nearly the same, or the one itself."""
    concept, below, number = one
    shares = {
        other: (below & other[1]).bit_count() / (below | other[1]).bit_count()
        for other in others
        if (other[0], other[2]) == (concept, number)
    }
    best = max(shares, key=lambda other: shares[other], default=one)
    return best if shares.get(best, 0.0) >= NEARLY else one


def likely(holders: Sequence[int], num_drawn: int) -> np.ndarray:
    """Returns how likely is right what so many of the draws have."""
    count = np.asarray(holders, np.float64)
    return 1 / (1 + ((num_drawn - count + PRIOR) / (count + PRIOR)) ** SHARPNESS)


def _share(doubts: Sequence[_Doubt], field: str) -> float:
    of_field = [doubt for doubt in doubts if doubt.field == field]
    return sum(doubt.count for doubt in of_field) / max(1, sum(doubt.total for doubt in of_field))


def _remarks(confidence: Confidence, doubts: Sequence[_Doubt]) -> Iterator[str]:
    """Yields what is beyond what good graphs have."""
    most = {"unplaced": MOST_UNPLACED, "loose": MOST_LOOSE, "thin": MOST_THIN}
    for doubt in doubts:
        if doubt.count and getattr(confidence, doubt.field) > most[doubt.field]:
            yield f"unsure: {doubt.text}"
    if confidence.agreement is not None and confidence.agreement < LEAST_AGREEMENT:
        yield f"unsure: other samples have {confidence.agreement:.0%} of what was grown"


def _doubts(graph: SceneGraph, set_aside: Sequence[int] | np.ndarray) -> Iterator[_Doubt]:
    """Yields, for each concept, how many of its nodes lack what they should have."""
    ontology, label = ontology_of(graph), np.asarray(graph.nodes.label)
    part, whole = parts_first(graph).T
    due = _wholes_that_are_due(ontology)
    placed = np.bincount(part[due[label[part], label[whole]]], minlength=len(label)) > 0
    placed[np.asarray(set_aside, int)] = True
    grouped = np.bincount(whole[ontology.is_observed[label[part]]], minlength=len(label))
    for kind in _labels(ontology.is_observed & due.any(axis=1)):
        yield _without_whole("unplaced", ontology, kind, due, ~placed[label == kind])
    loose = {
        kind: ~placed[label == kind]
        for kind in _labels(~ontology.is_observed & (due.any(axis=0) | due.any(axis=1)))
    }
    root = max((kind for kind, of_kind in loose.items() if of_kind.any()), default=None)
    for kind, of_kind in loose.items():
        yield _without_whole("loose", ontology, kind, due, of_kind, one_less=kind == root)
    parts = ontology.may_be_part & ontology.is_observed[:, None]
    for kind in _labels(parts.any(axis=0) & ~ontology.is_observed):
        thin, least = label == kind, max(LEAST_GROUPED, ontology.concepts[kind].least_parts)
        few, total = int(np.sum(thin & (grouped < least))), int(thin.sum())
        plurals = " or ".join(_plural(ontology, part) for part in _labels(parts[:, kind]))
        text = f"{few} of {total} {_plural(ontology, kind)} with fewer than {least} {plurals}"
        yield _Doubt("thin", few, total, text)


def _without_whole(
    field: str,
    ontology: Ontology,
    kind: int,
    due: np.ndarray,
    lacking: np.ndarray,
    one_less: bool = False,
) -> _Doubt:
    """Returns how many nodes of a concept are part of nothing; one may be the top of the graph."""
    count, total = int(lacking.sum()) - one_less, len(lacking)
    wholes = " or ".join(ontology.names[whole] for whole in _labels(due[kind]))
    held = f"without a {wholes}" if wholes else "too many"
    return _Doubt(field, count, total, f"{count} of {total} {_plural(ontology, kind)} {held}")


def _wholes_that_are_due(ontology: Ontology) -> np.ndarray:
    """Returns bool[C, C], which wholes (columns) a part should have one of.

    Those that it has exactly one of; of a concept that has none such, any that may be.
    """
    due = ontology.has_one_whole
    any_number = ~due.any(axis=1) & ontology.is_observed
    return due | (any_number[:, None] & ontology.may_be_part)


def _labels(chosen: np.ndarray) -> list[int]:
    return np.flatnonzero(chosen).tolist()


def _plural(ontology: Ontology, kind: int) -> str:
    return ontology.concepts[kind].layer.lower()


def _agreement(graph: _Read, others: Sequence[_Read], num_given: int) -> float:
    """Returns the share of grown nodes that other draws have over the same observed nodes.

    Of two graphs it is twice what they share over what both have.
    """
    one = {*graph.of_nodes[num_given:]}
    return float(np.mean([_shared(one, {*other.of_nodes[num_given:]}) for other in others]))


def _shared(one: Set, other: Set) -> float:
    total = len(one) + len(other)
    return 2 * len(one & other) / total if total else 1.0
