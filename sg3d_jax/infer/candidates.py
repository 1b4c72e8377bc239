"""A choice among several candidates that needs no truth: the valid one that agrees most.

That one, and not the medoid under FGW: a graph is likely to be right if others have what it has,
while what others have beside it says less, because what most draws have and one lacks is mended
afterwards (`consensus`). It also costs no FGW.
"""

from collections import Counter
from collections.abc import Sequence

from sg3d_jax.metrics.calibration import identities
from sg3d_jax.metrics.oddities import oddities
from sg3d_jax.metrics.structure import num_forbidden_edges
from sg3d_jax.scene.graph import SceneGraph


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
    grown = [identities(graph)[num_given:] for graph in candidates]
    holders = Counter(identity for of_graph in grown for identity in of_graph)
    share = [sum(holders[one] for one in nodes) / max(1, len(nodes)) for nodes in grown]
    valid = [not num_flaws(graph) for graph in candidates]
    return max(range(len(candidates)), key=lambda index: (valid[index], share[index]))


def num_flaws(graph: SceneGraph) -> int:
    """Counts what is against the ontology, or odd, in a host graph."""
    return oddities(graph).total() + num_forbidden_edges(graph)
