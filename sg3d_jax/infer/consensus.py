"""One graph of several candidates, decided part by part: what most of them have.

Candidates seldom go wrong in the same place, and in a large scene nearly each goes wrong somewhere.
So the wholes of every concept are put to the vote bottom-up, over parts that are chosen already. A
candidate's whole holds a given part by its edge, and a chosen one if more than half of what is
observed below that is below the whole: a candidate that has another room there still says which
floor it is on. Where two candidates differ, wholes that overlap are taken or left together, or a
part would have two wholes, or none.

Over what is observed candidates agree on most wholes to the last part, and a whole has the votes of
those that have it. Higher up they seldom do: three may each put another room on the wrong floor. So
there every two parts vote, for or against being in one whole.

Of wholes with parts of several concepts, those of the lowest say which whole it is, as planes do of
a room. The others are put to the vote one by one, once wholes are elected: a chair that stands next
door in some candidates does not cost the room its votes.

Nothing is matched by FGW plans: what is observed is the same in all candidates and says which nodes
stand for the same. Votes over nodes that plans match were tried, and are no better and far slower.

Source: Margush and McMorris, "Consensus n-trees", Bulletin of Mathematical Biology 43, 1981: what
most trees have fits together. Votes of pairs: the median partition of Barthelemy and Monjardet,
"The median procedure in cluster analysis and social choice theory", Mathematical Social Sciences 1,
1981.
Differs: where there is no majority, a part gets a whole nonetheless; wholes are compared over the
parts chosen below, so that one room does not cost the votes for its floor.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from itertools import chain
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.infer.candidates import most_agreeing, num_flaws
from sg3d_jax.infer.confidence import likely
from sg3d_jax.metrics.calibration import bits_below
from sg3d_jax.scene.graph import SceneGraph, extended, ontology_of, parts_first, subgraph

# Share of the parts that belong to nothing, about as in training. Where a scene has so many, a part
# that half of the candidates place has a place; where it has none, a fifth or a third is enough.
LONE: Final = 0.1


class Version(NamedTuple):
    """A whole, as some candidates have it."""

    row: int  # of a given one; of others, -1 less the number of equal ones before it
    parts: frozenset[int]  # rows in the graph that is put together, all of one concept


class _Held(NamedTuple):
    """What a candidate has of a version."""

    row: int  # in the candidate
    others: frozenset[int]  # parts of further concepts, rows in the graph that is put together


class _Candidate(NamedTuple):
    """A host graph as arrays."""

    label: np.ndarray  # int[n]
    position: np.ndarray  # float64[n, 3], metres
    below: list[int]  # what is observed below each node, as bits
    edge: np.ndarray  # bool[given, n], whether a given node is part of a node


class _Draft(NamedTuple):
    """What is chosen so far: the given nodes, and others behind them."""

    num_given: int
    label: list[int]  # of each node
    below: list[int]  # what is observed below each node, as bits
    position: list[np.ndarray]  # float64[3], of each node that was not given, metres
    pairs: list[tuple[int, int]]  # part and whole, not both given


def consensus(candidates: Sequence[SceneGraph], num_given: int) -> tuple[SceneGraph, int]:
    """Puts a graph together of what most candidates have.

    Args:
      candidates: at least one host graph, all over the same given nodes.
      num_given: how many of their first nodes were given.

    Returns:
      The graph, its given nodes as they were, and the index of the candidate that it started from,
      the valid one that agrees most. That one itself if it is the only one, if the graph breaks
      more rules than it, or if concepts grow that have no parts: what has none is known by nothing.

    Raises:
      ValueError: there are no candidates.
    """
    start = most_agreeing(candidates, num_given)
    best = candidates[start]
    has_parts = ontology_of(best).may_be_part.any(axis=0)
    if len(candidates) == 1 or not (ontology_of(best).is_observed | has_parts).all():
        return best, start
    graph = _assembled(candidates, num_given, start)
    return best if num_flaws(graph) > num_flaws(best) else graph, start


def _assembled(graphs: Sequence[SceneGraph], num_given: int, start: int) -> SceneGraph:
    """Returns the graph of the wholes that are elected, concept by concept."""
    given, ontology = subgraph(graphs[start], np.arange(num_given)), ontology_of(graphs[start])
    candidates = [_read(graph, num_given) for graph in graphs]
    draft = _Draft(num_given, given.nodes.label.tolist(), bits_below(given), [], [])
    for concept in np.flatnonzero(ontology.may_be_part.any(axis=0)).tolist():
        parts = np.flatnonzero(ontology.may_be_part[draft.label, concept])
        if not len(parts):
            continue
        has_one = ontology.has_one_whole[draft.label, concept][parts]
        ballots = [_ballot(one, draft, parts, has_one, concept) for one in candidates]
        wholes = [{*ballot} for ballot in ballots]
        single = {*parts[has_one].tolist()}
        over_grown = not ontology.is_observed[ontology.may_be_part[:, concept]].any()
        votes = votes_of_pairs if over_grown and has_one.all() else votes_of
        chosen = elected(wholes, start, votes(wholes))
        lowest = min((draft.label[part] for part in single), default=concept)
        joined = adopted(chosen, wholes, {one for one in single if draft.label[one] == lowest})
        settled = {one for version in chosen for one in version.parts | joined[version]} & single
        beside = _beside(chosen, ballots, settled)
        for version in sorted(chosen, key=lambda version: (sorted(version.parts), -version.row)):
            held = [
                one.position[ballot[version].row]
                for one, ballot in zip(candidates, ballots, strict=True)
                if version in ballot
            ]
            whole = Version(version.row, version.parts | joined[version] | beside[version])
            draft = _with_whole(draft, whole, concept, np.mean(held, axis=0))
    return extended(given, draft.label[num_given:], draft.position, draft.pairs)


def _read(graph: SceneGraph, num_given: int) -> _Candidate:
    label, pairs = np.asarray(graph.nodes.label), parts_first(graph)
    edge = np.zeros((num_given, len(label)), bool)
    part, whole = pairs[pairs[:, 0] < num_given].T
    edge[part, whole] = True
    return _Candidate(label, np.asarray(graph.nodes.position), bits_below(graph), edge)


def _ballot(
    candidate: _Candidate, draft: _Draft, parts: np.ndarray, has_one: np.ndarray, concept: int
) -> Mapping[Version, _Held]:
    """Returns the wholes of a concept as a candidate has them.

    Args:
      candidate: one of them.
      draft: what is chosen so far.
      parts: int[p], rows in the draft of what may be part of them; at least one.
      has_one: bool[p], which of these have one such whole at most.
      concept: their label.
    """
    wholes = np.flatnonzero(candidate.label == concept)
    given = parts < draft.num_given
    holds = np.zeros((len(parts), len(wholes)), bool)
    holds[given] = candidate.edge[parts[given]][:, wholes]
    if len(wholes) and not given.all():
        below = [draft.below[part] for part in parts[~given].tolist()]
        of_wholes = [candidate.below[whole] for whole in wholes.tolist()]
        shared = np.array([[(one & whole).bit_count() for whole in of_wholes] for one in below])
        most = np.array([[one.bit_count() / 2] for one in below])
        foremost = np.arange(len(wholes)) == shared.argmax(axis=1)[:, None]
        # A door is below two: what has but doors in common is part of one of them.
        holds[~given] = (shared > most) & (foremost | ~has_one[~given, None])
    ballot, before = {}, Counter()
    for whole, held in zip(wholes.tolist(), holds.T, strict=True):
        rows = parts[held].tolist()
        lowest = min((draft.label[row] for row in rows), default=concept)
        of_whole = frozenset(row for row in rows if draft.label[row] == lowest)
        others = frozenset(rows) - of_whole
        if whole < draft.num_given:
            ballot[Version(whole, of_whole)] = _Held(whole, others)
        elif of_whole:
            before[of_whole] += 1
            ballot[Version(-before[of_whole], of_whole)] = _Held(whole, others)
    return ballot


def _with_whole(draft: _Draft, version: Version, concept: int, position: np.ndarray) -> _Draft:
    """Returns a draft with one more whole, or with the parts of a given one."""
    below = 0
    for part in version.parts:
        below |= draft.below[part]
    if version.row < 0:
        row = len(draft.label)
        draft = draft._replace(
            label=[*draft.label, concept],
            below=[*draft.below, below],
            position=[*draft.position, position],
        )
    else:
        row, of_all = version.row, [*draft.below]
        of_all[row] = of_all[row] | below
        draft = draft._replace(below=of_all)
    new = [(part, row) for part in sorted(version.parts) if max(part, row) >= draft.num_given]
    return draft._replace(pairs=[*draft.pairs, *new])


def elected(
    ballots: Sequence[AbstractSet[Version]], start: int, votes: Mapping[Version, int]
) -> AbstractSet[Version]:
    """Returns the wholes of one candidate, exchanged until no other's have more votes.

    Args:
      ballots: the wholes of each candidate.
      start: whose wholes stay where votes are equal.
      votes: for each of the wholes, less those against.
    """
    chosen, before = {*ballots[start]}, None
    while chosen != before:  # ends: every exchange adds votes
        before = {*chosen}
        for ballot in ballots:
            for out, into in _exchanges(chosen - ballot, ballot - chosen):
                if sum(votes[one] for one in into) > sum(votes[one] for one in out):
                    chosen = (chosen - out) | into
    return chosen


def votes_of(ballots: Sequence[AbstractSet[Version]]) -> Mapping[Version, int]:
    """Returns the votes of the parts of each whole.

    A part votes in each candidate, for its whole there and against any other. So wholes that a
    majority has are elected, and where there is no majority those that most of their parts want.

    Args:
      ballots: the wholes of each candidate.
    """
    holders = Counter(chain.from_iterable(ballots))
    return {one: (2 * held - len(ballots)) * len(one.parts) for one, held in holders.items()}


def votes_of_pairs(ballots: Sequence[AbstractSet[Version]]) -> Mapping[Version, int]:
    """Returns the votes of the parts of each whole, and of every two of them.

    In each candidate two parts vote for a whole that has both if they are in one whole there, and
    against it if they are not; so does each with the given whole that it has, and each by itself
    for having a whole.

    Args:
      ballots: the wholes of each candidate, no part in two.
    """
    holders = Counter(chain.from_iterable(ballots))
    versions, held = [*holders], np.array([*holders.values()])
    given = {one.row for one in versions if one.row >= 0}
    place = {row: k for k, row in enumerate(given | _parts_of(versions))}
    has = np.zeros((len(versions), len(place)))
    for one, row in zip(versions, has, strict=True):
        row[[place[other] for other in {one.row} & given | one.parts]] = 1
    together = 2 * (has.T * held) @ has - len(ballots)
    of_given = [place[row] for row in given]
    together[of_given, of_given] = 0  # which is there in any case
    twice = np.sum((has @ together) * has, axis=1) + has @ together.diagonal()
    return dict(zip(versions, (twice // 2).astype(int).tolist(), strict=True))


def adopted(
    chosen: AbstractSet[Version], ballots: Sequence[AbstractSet[Version]], single: AbstractSet[int]
) -> Mapping[Version, AbstractSet[int]]:
    """Finds a whole for parts that the election left alone though candidates have them in one.

    That is where candidates agree that a part belongs to something, but not on what, or where few
    place it, but nearly all else has its place, so that hardly anything in the scene belongs to
    nothing. It joins the whole that shares most with those that it has in the candidates.

    Args:
      chosen: the wholes that are elected.
      ballots: the wholes of each candidate.
      single: parts that have exactly one such whole, of the concept that says which it is.

    Returns:
      What joins each of the chosen ones.

    Source: the odds of what k of K draws have (`infer.confidence`), and Bayes' rule: the share of
    parts that belong to nothing in this scene in place of that in training.
    """
    joins: dict[Version, set[int]] = {version: set() for version in chosen}
    placed = Counter(part for ballot in ballots for part in _parts_of(ballot) & single)
    lone = (len(single) - len(placed) + 0.5) / (len(single) + 1)
    needed = lone / (1 - lone) * (1 - LONE) / LONE
    for part in sorted({*placed} - _parts_of(chosen)):
        sure = likely([placed[part]], len(ballots))[0]
        if chosen and sure > needed * (1 - sure):
            held = [one.parts for ballot in ballots for one in ballot if part in one.parts]
            shared = {one: sum(len(one.parts & other) for other in held) for one in chosen}
            best = _foremost(shared)
            if shared[best]:
                joins[best].add(part)
    return joins


def _parts_of(wholes: Iterable[Version]) -> AbstractSet[int]:
    return frozenset().union(*(one.parts for one in wholes))


def _beside(
    chosen: AbstractSet[Version],
    ballots: Sequence[Mapping[Version, _Held]],
    settled: AbstractSet[int],
) -> Mapping[Version, AbstractSet[int]]:
    """Finds the parts of further concepts of the wholes that are elected.

    A part joins those that most candidates have it in; if most have it in some, but none has so
    many, that which has it most often.

    Args:
      chosen: the wholes that are elected.
      ballots: the wholes of each candidate.
      settled: parts that must not have another whole.

    Returns:
      What joins each of the chosen ones.
    """
    votes, voters = Counter(), Counter()
    for ballot in ballots:
        pairs = {
            (part, alike)
            for version, held in ballot.items()
            if held.others and (alike := _alike(version, chosen))
            for part in held.others - settled
        }
        votes.update(pairs)
        voters.update({part for part, _ in pairs})
    joins: dict[Version, set[int]] = {version: set() for version in chosen}
    for part, number in voters.items():
        if 2 * number > len(ballots):
            had = {one: votes[part, one] for one in chosen}
            best = _foremost(had)
            for one in chosen:
                if one == best or 2 * had[one] > len(ballots):
                    joins[one].add(part)
    return joins


def _alike(version: Version, chosen: AbstractSet[Version]) -> Version | None:
    """Returns the whole that one of a candidate stands for: the same, or that which shares most."""
    if version in chosen:
        return version

    def nearness(one: Version) -> tuple[bool, int]:
        return one.row == version.row >= 0, len(one.parts & version.parts)

    near = {one: nearness(one) for one in chosen if any(nearness(one))}
    return _foremost(near) if near else None


def _foremost(weight: Mapping[Version, Any]) -> Version:
    """Returns the version of the greatest weight; of equal ones it is the same in any order."""
    return max(weight, key=lambda one: (weight[one], sorted(one.parts), one.row))


def _exchanges(
    left: AbstractSet[Version], right: AbstractSet[Version]
) -> Iterator[tuple[AbstractSet[Version], AbstractSet[Version]]]:
    """Yields the least groups, of wholes on either side, such that no two groups overlap."""
    waiting = [*left, *right]
    while waiting:
        group = [waiting.pop()]
        for one in group:  # which grows
            near = [other for other in waiting if not one.parts.isdisjoint(other.parts)]
            waiting = [other for other in waiting if other not in near]
            group += near
        yield left & {*group}, right & {*group}
