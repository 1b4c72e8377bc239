"""How finely wholes are divided: put to the vote once a scene, before what they are, one by one.

Between one room and three others floor plans have one wall, the paper's synthetic sets have three.
Planes do not tell which is meant, and candidates waver from place to place; all of them together,
over all of a scene, tell it better.

Source: ours.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any, Final

import numpy as np

from sg3d_jax.infer.consensus import Version
from sg3d_jax.scene.graph import SceneGraph, extended, ontology_of, parts_first, subgraph

COARSE: Final = 1.5  # times as many as say finely must say coarsely; where it is so, they do


def divided_alike(candidates: Sequence[SceneGraph], num_given: int) -> list[SceneGraph]:
    """Divides wholes whose parts may have several of them as most of the scene has it.

    Those are wholes of what is observed alone, which belong to nothing themselves, such as walls.

    Args:
      candidates: host graphs, all over the same given nodes.
      num_given: how many of their first nodes were given; what is given is never exchanged.

    Returns:
      The candidates; in some, wholes are exchanged for what others have in their place. One alone
      has nothing to exchange, and is as it was drawn.
    """
    made = list(candidates)
    if len(made) == 1:
        return made
    ontology = ontology_of(candidates[0])
    alone = ontology.may_be_part & ~ontology.has_one_whole & ontology.is_observed[:, None]
    for concept in np.flatnonzero(ontology.may_be_part.any(axis=0)).tolist():
        divisible = (alone | ~ontology.may_be_part)[:, concept].all()
        if divisible and not ontology.may_be_part[concept].any():
            least = ontology.concepts[concept].least_parts
            rows = [_wholes(graph, concept, num_given) for graph in made]
            sides = [_sides(graph) for graph in made]
            chosen = exchanged([{*held} for held in rows], sides, least)
            position = _mean_positions(made, rows)
            made = [
                _with_wholes(graph, held, wanted, concept, position)
                for graph, held, wanted in zip(made, rows, chosen, strict=True)
            ]
    return made


def _wholes(graph: SceneGraph, concept: int, num_given: int) -> dict[Version, int]:
    """Returns the rows of the wholes of a concept that have parts."""
    label, parts = np.asarray(graph.nodes.label), {}
    for part, whole in parts_first(graph).tolist():
        if label[whole] == concept:
            parts.setdefault(whole, set()).add(part)
    before, rows = Counter(), {}
    for row in sorted(parts):
        held = frozenset(parts[row])
        before[held] += row >= num_given
        rows[Version(row if row < num_given else -before[held], held)] = row
    return rows


def _sides(graph: SceneGraph) -> Mapping[int, int]:
    """Returns on which side of a whole a part is: of what it is part alone, such as a room."""
    label, pairs = np.asarray(graph.nodes.label), parts_first(graph)
    alone = ontology_of(graph).has_one_whole[label[pairs[:, 0]], label[pairs[:, 1]]]
    return dict(pairs[alone].tolist())


def _mean_positions(
    graphs: Sequence[SceneGraph], rows: Sequence[Mapping[Version, int]]
) -> dict[Version, np.ndarray]:
    """Returns where those that have a whole have it, in the mean, metres."""
    held: dict[Version, list[np.ndarray]] = {}
    for graph, of_graph in zip(graphs, rows, strict=True):
        for version, row in of_graph.items():
            held.setdefault(version, []).append(np.asarray(graph.nodes.position[row], float))
    return {version: np.mean(places, axis=0) for version, places in held.items()}


def _with_wholes(
    graph: SceneGraph,
    held: Mapping[Version, int],
    wanted: AbstractSet[Version],
    concept: int,
    position: Mapping[Version, np.ndarray],
) -> SceneGraph:
    """Returns a graph with other wholes of a concept; new ones come last."""
    gone = [row for version, row in held.items() if version not in wanted]
    new = sorted(wanted - held.keys(), key=lambda one: (sorted(one.parts), -one.row))
    if not gone and not new:
        return graph
    kept = subgraph(graph, np.setdiff1d(np.arange(len(graph.nodes.label)), gone))
    start = len(kept.nodes.label)  # parts are observed, and come before all that is grown
    pairs = [(part, start + i) for i, one in enumerate(new) for part in sorted(one.parts)]
    return extended(kept, [concept] * len(new), [position[one] for one in new], pairs)


def exchanged(
    ballots: Sequence[AbstractSet[Version]], sides: Sequence[Mapping[int, int]], least: int
) -> Sequence[AbstractSet[Version]]:
    """Exchanges wholes that are divided otherwise than most, where others have them so.

    A part of wholes with different sides says that they are divided finely, a whole with more sides
    than it needs that they are not; all candidates and all places are counted together. Finely is
    what candidates are less plain about, so in doubt it is finely. Two wholes with the same sides,
    as over a plane that was seen twice, say nothing.

    Args:
      ballots: the wholes of each candidate.
      sides: in each candidate the side that parts are on, if any.
      least: sides that a whole needs.
    """

    def sides_of(version: Version, sides: Mapping[int, int]) -> frozenset[int]:
        return frozenset(sides[part] for part in version.parts if part in sides)

    def spare(version: Version, sides: Mapping[int, int]) -> int:
        return max(0, len(sides_of(version, sides)) - least)

    pairs = [*zip(ballots, sides, strict=True)]
    coarse = sum(spare(version, of) for ballot, of in pairs for version in ballot)
    met = [
        {(part, sides_of(version, of)) for version in ballot for part in version.parts}
        for ballot, of in pairs
    ]
    fine = sum(len(of_ballot) - len({part for part, _ in of_ballot}) for of_ballot in met)
    if coarse > COARSE * fine:
        return [_coarsely(ballot, ballots) for ballot in ballots]
    return [_finely(ballot, lambda one, of=of: spare(one, of) > 0, ballots) for ballot, of in pairs]


def _finely(
    ballot: AbstractSet[Version],
    is_coarse: Callable[[Version], bool],
    ballots: Sequence[AbstractSet[Version]],
) -> AbstractSet[Version]:
    """Exchanges coarse wholes for what others divide them into, and that again if it is coarse."""
    waiting = [one for one in ballot if one.row < 0]
    for version in waiting:  # which grows, by smaller ones
        if is_coarse(version) and len(division := _division(version, ballots)) > 1:
            ballot = (ballot - {version}) | division
            waiting += division
    return ballot


def _division(version: Version, ballots: Sequence[AbstractSet[Version]]) -> frozenset[Version]:
    """Returns what another divides a whole into: what leaves least, of that the fewest wholes."""
    number = Counter(
        frozenset(one for one in ballot if one.row < 0 and one.parts < version.parts)
        for ballot in ballots
    )

    def rank(division: frozenset[Version]) -> tuple[int, int, int, Any]:
        held = {part for one in division for part in one.parts}
        wholes = sorted(sorted(one.parts) for one in division)
        return len(held), -len(wholes), number[division], wholes

    return max(number, key=rank)


def _coarsely(
    ballot: AbstractSet[Version], ballots: Sequence[AbstractSet[Version]]
) -> AbstractSet[Version]:
    """Exchanges wholes that share parts for the whole of them all that most others have."""
    for part in sorted({part for one in ballot for part in one.parts}):
        mine = [one for one in ballot if part in one.parts]
        if len(mine) < 2 or any(one.row >= 0 for one in mine):
            continue
        parts = frozenset().union(*(one.parts for one in mine))
        around = Counter(
            one for other in ballots for one in other if one.row < 0 and one.parts >= parts
        )
        if around:
            best = max(around, key=lambda one: (around[one], -len(one.parts), sorted(one.parts)))
            gone = {one for one in ballot if one.row < 0 and one.parts <= best.parts}
            ballot = (ballot - gone) | {best}
    return ballot
