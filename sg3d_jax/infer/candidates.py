"""A choice among several candidates that needs no truth: the valid one that agrees most.

It is what `consensus` begins from, which adds what most others have and this one lacks.
"""

from collections import Counter
from collections.abc import Sequence

from sg3d_jax.metrics.calibration import identities
from sg3d_jax.metrics.oddities import odd_wholes
from sg3d_jax.metrics.structure import num_forbidden_edges
from sg3d_jax.scene.graph import SceneGraph, ontology_of


def most_agreeing(candidates: Sequence[SceneGraph], num_given: int) -> int:
    """Chooses the candidate whose grown nodes are, in the mean, in most of the others.

    Two nodes are the same if they are of one concept and over the same observed nodes. Candidates
    that break a rule of the ontology are chosen only if all do.

    Args:
      candidates: at least one host graph, all over the same given nodes.
      num_given: how many of their first nodes were given.

    Returns:
      Its index; the first of several that are equally good.

    Raises:
      ValueError: there are no candidates.
    """
    if not candidates:
        raise ValueError("a scene has no candidates, expected at least one")
    if len(candidates) == 1:
        return 0
    grown = [identities(graph)[num_given:] for graph in candidates]
    holders = Counter(identity for of_graph in grown for identity in of_graph)
    share = [sum(holders[one] for one in nodes) / max(1, len(nodes)) for nodes in grown]
    valid = [not num_flaws(graph) for graph in candidates]
    return max(range(len(candidates)), key=lambda index: (valid[index], share[index]))


def are_settled(candidates: Sequence[SceneGraph], num_given: int) -> bool:
    """Returns whether more than half of several candidates are alike, so that no more are needed.

    Args:
      candidates: host graphs, all over the same given nodes.
      num_given: how many of their first nodes were given.
    """
    if len(candidates) < 2:
        return False
    held = [frozenset(identities(graph)[num_given:]) for graph in candidates]
    return 2 * Counter(held).most_common(1)[0][1] > len(held)


def num_flaws(graph: SceneGraph) -> int:
    """Counts what breaks the rules of the ontology in a host graph.

    Edges that it forbids, and grown nodes of none or several wholes where one is due. What is
    observed may belong to nothing (clutter), and what was cut to several (its pieces).
    """
    observed = {one.name for one in ontology_of(graph).concepts if one.observed}
    grown = sum(nodes for odd, nodes in odd_wholes(graph) if odd.concept not in observed)
    return num_forbidden_edges(graph) + grown
