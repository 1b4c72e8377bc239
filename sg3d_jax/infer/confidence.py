"""How sure a completed graph is: what in it is unlike any complete graph, and what samples share.

No truth is needed. A graph that the model found complete may still be wrong all over; then much of
what is observed has no place in it, or the next sample is another one.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

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


class Confidence(NamedTuple):
    """What a completed graph lacks, as shares, and how much of it another sample has, too."""

    unplaced: float  # observed nodes that lack the whole that is due, such as planes without a room
    loose: float  # others that are below nothing, but for one, such as rooms without a floor
    thin: float  # nodes that group fewer than two observed ones, such as rooms of one plane
    agreement: float | None  # grown nodes that other samples have, too; None if there are none


class _Doubt(NamedTuple):
    """What is not as it should be of the nodes of one concept."""

    field: str  # of `Confidence`
    count: int
    total: int
    text: str  # such as "2 of 9 rooms without a floor"


def judged(
    graphs: Sequence[SceneGraph], num_given: int
) -> list[tuple[Confidence, tuple[str, ...]]]:
    """Returns how sure the samples of one scene are, and what to say of it, one sentence each.

    Args:
      graphs: host graphs that were completed of one scene.
      num_given: how many of their first nodes were given.
    """
    agreement = _agreement(graphs, num_given)
    results = []
    for graph, shared in zip(graphs, agreement, strict=True):
        doubts = list(_doubts(graph))
        confidence = Confidence(
            **{field: _share(doubts, field) for field in Confidence._fields[:3]}, agreement=shared
        )
        results.append((confidence, tuple(_remarks(confidence, doubts))))
    return results


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


def _doubts(graph: SceneGraph) -> Iterator[_Doubt]:
    """Yields, for each concept, how many of its nodes lack what they should have."""
    ontology, label = ontology_of(graph), np.asarray(graph.nodes.label)
    part, whole = parts_first(graph).T
    due = _wholes_that_are_due(ontology)
    placed = np.bincount(part[due[label[part], label[whole]]], minlength=len(label)) > 0
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
    due = np.zeros_like(ontology.may_be_part)
    for part, whole in ontology.single_wholes:
        due[part, whole] = True
    any_number = ~due.any(axis=1) & ontology.is_observed
    return due | (any_number[:, None] & ontology.may_be_part)


def _labels(chosen: np.ndarray) -> list[int]:
    return np.flatnonzero(chosen).tolist()


def _plural(ontology: Ontology, kind: int) -> str:
    return ontology.concepts[kind].layer.lower()


def _agreement(graphs: Sequence[SceneGraph], num_given: int) -> list[float | None]:
    """Returns the share of grown nodes that other samples have over the same observed nodes.

    Of two samples it is twice what they share over what both have.
    """
    if len(graphs) < 2:
        return [None] * len(graphs)
    grown = [_grown(graph, num_given) for graph in graphs]
    shares = np.array([[_shared(one, other) for other in grown] for one in grown])
    return [float(mean) for mean in (shares.sum(axis=1) - 1) / (len(graphs) - 1)]


def _shared(one: Counter, other: Counter) -> float:
    total = one.total() + other.total()
    return 2 * (one & other).total() / total if total else 1.0


def _grown(graph: SceneGraph, num_given: int) -> Counter[tuple[int, bytes]]:
    """Counts grown nodes by concept and by what is observed below them."""
    label, observed = np.asarray(graph.nodes.label), np.flatnonzero(graph.nodes.observed)
    below = np.zeros((len(label), len(observed)), bool)
    below[observed, np.arange(len(observed))] = True
    pairs = parts_first(graph)
    for kind in np.unique(label[pairs[:, 1]]):
        part, whole = pairs[label[pairs[:, 1]] == kind].T
        np.logical_or.at(below, whole, below[part])
    rows = range(num_given, len(label))
    return Counter((int(label[row]), below[row].tobytes()) for row in rows)
