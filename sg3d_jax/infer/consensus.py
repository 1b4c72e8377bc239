"""One graph of several candidates, decided part by part: what most of them have.

Candidates seldom go wrong in the same place, and in a large scene nearly each goes wrong somewhere.
So the wholes of every concept are put to the vote bottom-up, over parts that are chosen already. A
candidate's whole holds a given part by its edge, and a chosen one if more than half of what is
observed below that is below the whole: a candidate that has another room there still says which
floor it is on. Where two candidates differ, the wholes that overlap must be taken together, or a
part would have two wholes, or none: those of one side replace those of the other if more candidates
have just these.

Source: Margush and McMorris, "Consensus n-trees", Bulletin of Mathematical Biology 43, 1981: what
most trees have fits together.
Differs: where no majority is, what most candidates have stays if it fits; wholes are compared over
the parts chosen below, so that one room does not cost the votes for its floor.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import NamedTuple

import numpy as np

from sg3d_jax.infer.candidates import most_agreeing, num_flaws
from sg3d_jax.metrics.calibration import observed_below
from sg3d_jax.scene.graph import SceneGraph, extended, ontology_of, parts_first, subgraph
from sg3d_jax.scene.ontology import Ontology


class Version(NamedTuple):
    """A whole, as some candidates have it."""

    row: int  # of a given one; of others, -1 less the number of equal ones before it
    parts: frozenset[int]  # rows in the graph that is put together


class _Candidate(NamedTuple):
    """A host graph as arrays."""

    label: np.ndarray  # int[n]
    position: np.ndarray  # float64[n, 3], metres
    below: np.ndarray  # bool[n, o], what is observed below each node
    edge: np.ndarray  # bool[given, n], whether a given node is part of a node


class _Draft(NamedTuple):
    """What is chosen so far: the given nodes, and others behind them."""

    label: list[int]  # of each node
    below: list[np.ndarray]  # bool[o], of each node
    position: list[np.ndarray]  # float64[3], of each node that was not given, metres
    pairs: list[tuple[int, int]]  # part and whole, not both given


def consensus(candidates: Sequence[SceneGraph], num_given: int) -> tuple[SceneGraph, int]:
    """Puts a graph together of what most candidates have.

    Args:
      candidates: at least one host graph, all over the same given nodes.
      num_given: how many of their first nodes were given.

    Returns:
      The graph, its given nodes as they were, and the index of the candidate that it started from,
      the valid one that agrees most. That one itself if the graph breaks more rules than it, or if
      concepts grow that have no parts: they cannot be told from one another.

    Raises:
      ValueError: there are no candidates.
    """
    start = most_agreeing(candidates, num_given)
    ontology = ontology_of(candidates[start])
    if not (ontology.is_observed | ontology.may_be_part.any(axis=0)).all():
        return candidates[start], start
    graph = _assembled(candidates, num_given, start)
    return (
        candidates[start] if num_flaws(graph) > num_flaws(candidates[start]) else graph
    ), start


def _assembled(graphs: Sequence[SceneGraph], num_given: int, start: int) -> SceneGraph:
    """Returns the graph of the wholes that are elected, concept by concept."""
    given, ontology = subgraph(graphs[start], np.arange(num_given)), ontology_of(graphs[start])
    candidates = [_read(graph, num_given) for graph in graphs]
    draft = _Draft(given.nodes.label.tolist(), [*observed_below(given)], [], [])
    for concept in np.flatnonzero(ontology.may_be_part.any(axis=0)).tolist():
        ballots = [_ballot(one, draft, concept, num_given, ontology) for one in candidates]
        chosen = elected([{*ballot} for ballot in ballots], start)
        for version in sorted(chosen, key=lambda version: (version.row, sorted(version.parts))):
            held = [
                one.position[ballot[version]]
                for one, ballot in zip(candidates, ballots, strict=True)
                if version in ballot
            ]
            _add(draft, version, concept, np.mean(held, axis=0), num_given)
    return extended(given, draft.label[num_given:], draft.position, draft.pairs)


def _read(graph: SceneGraph, num_given: int) -> _Candidate:
    label, pairs = np.asarray(graph.nodes.label), parts_first(graph)
    edge = np.zeros((num_given, len(label)), bool)
    part, whole = pairs[pairs[:, 0] < num_given].T
    edge[part, whole] = True
    return _Candidate(label, np.asarray(graph.nodes.position), observed_below(graph), edge)


def _ballot(
    candidate: _Candidate, draft: _Draft, concept: int, num_given: int, ontology: Ontology
) -> Mapping[Version, int]:
    """Returns the wholes of a concept as a candidate has them, and their rows in it."""
    parts = np.flatnonzero(ontology.may_be_part[draft.label, concept])
    wholes = np.flatnonzero(candidate.label == concept)
    if not len(parts):
        return {}
    below = np.stack([draft.below[part] for part in parts]).astype(int)
    holds = 2 * below @ candidate.below[wholes].T > below.sum(axis=1)[:, None]
    given = parts < num_given
    holds[given] = candidate.edge[parts[given]][:, wholes]
    ballot, before = {}, Counter()
    for whole, held in zip(wholes.tolist(), holds.T, strict=True):
        of_whole = frozenset(parts[held].tolist())
        if whole < num_given:
            ballot[Version(whole, of_whole)] = whole
        elif of_whole:
            before[of_whole] += 1
            ballot[Version(-before[of_whole], of_whole)] = whole
    return ballot


def _add(
    draft: _Draft, version: Version, concept: int, position: np.ndarray, num_given: int
) -> None:
    """Adds a whole to a draft, or to a given whole its parts."""
    row, below = version.row, np.any([draft.below[part] for part in version.parts], axis=0)
    if row < 0:
        row = len(draft.label)
        draft.label.append(concept)
        draft.below.append(below)
        draft.position.append(position)
    elif version.parts:
        draft.below[row] = draft.below[row] | below
    draft.pairs.extend((part, row) for part in version.parts if max(part, row) >= num_given)


def elected(ballots: Sequence[AbstractSet[Version]], start: int) -> AbstractSet[Version]:
    """Returns the wholes that no other candidate would outvote.

    Args:
      ballots: the wholes of each candidate. In each, those of a concept whose parts have one whole
        have no part in common.
      start: whose wholes stay where votes are equal.
    """
    chosen = {*ballots[start]}
    for _ in ballots:  # an exchange may allow another; a few rounds are enough
        before = {*chosen}
        for ballot in ballots:
            for out, into in _exchanges(chosen - ballot, ballot - chosen):
                if _votes(ballots, into, out) > _votes(ballots, out, into):
                    chosen = (chosen - out) | into
        if chosen == before:
            break
    return chosen


def _votes(
    ballots: Sequence[AbstractSet[Version]], wanted: AbstractSet[Version], not_: AbstractSet[Version]
) -> int:
    """Counts the candidates that have all of some wholes and none of some others."""
    return sum(wanted <= ballot and not_.isdisjoint(ballot) for ballot in ballots)


def _exchanges(
    left: AbstractSet[Version], right: AbstractSet[Version]
) -> Iterator[tuple[AbstractSet[Version], AbstractSet[Version]]]:
    """Yields the least groups, of wholes on either side, such that no two groups overlap."""
    waiting = [*left, *right]
    while waiting:
        group = [waiting.pop()]
        for one in group:  # which grows
            near = [other for other in waiting if _overlap(one, other)]
            waiting = [other for other in waiting if other not in near]
            group += near
        yield left & {*group}, right & {*group}


def _overlap(one: Version, other: Version) -> bool:
    same = one.row == other.row >= 0
    return same or not one.parts.isdisjoint(other.parts)
