"""Parts of the hierarchy: graphs of fewer concepts."""

from collections.abc import Collection

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, ontology_of, subgraph
from sg3d_jax.scene.ontology import Ontology


def restricted(
    graph: SceneGraph, until: str | None = None, without: str | Collection[str] = ()
) -> SceneGraph:
    """Returns the host graph of some concepts alone, with the edges between them.

    What is observed stays, and so do all numbers of what is left: a centroid is where it was with
    all of its parts. Parts of what is left out are part of nothing then.

    Args:
      graph: padded or not; its arrays are read on the host.
      until: the uppermost concept that stays of those that are grown, such as "room"; None for all.
      without: concepts that are left out, such as "wall", or ["wall", "floor"].

    Raises:
      ValueError: there is no such concept, or one that is left out is observed.
    """
    kept = kept_concepts(ontology_of(graph), until, without)
    return subgraph(graph, kept[np.asarray(graph.nodes.label)] & np.asarray(graph.nodes.mask))


def kept_concepts(
    ontology: Ontology, until: str | None = None, without: str | Collection[str] = ()
) -> np.ndarray:
    """Returns bool[C], the concepts that `restricted` leaves in a graph; arguments are the same."""
    last = ontology.num_concepts if until is None else ontology.label_of(until)
    left_out = [ontology.label_of(name) for name in _names(without)]
    for label in left_out:
        if ontology.is_observed[label]:
            grown = ", ".join(c.name for c in ontology.concepts if not c.observed)
            raise ValueError(
                f"{ontology.names[label]} is observed and cannot be left out, expected of {grown}"
            )
    labels = np.arange(ontology.num_concepts)
    return ontology.is_observed | ((labels <= last) & ~np.isin(labels, left_out))


def _names(without: str | Collection[str]) -> Collection[str]:
    return [without] if isinstance(without, str) else without
