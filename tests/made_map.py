"""A map that was made, and not grown."""

import numpy as np

from sg3d_jax.infer.revision import Map, Tracks
from sg3d_jax.scene.graph import SceneGraph, ontology_of


def known_as(graph: SceneGraph, due=(), firm=(), astray=0) -> Map:
    """Returns the map of a graph; its grown nodes have the ids 0, 1 and so on."""
    count, is_grown = len(graph.nodes.label), ~graph.nodes.observed
    rows = np.arange(count)
    tracks = Tracks(
        id=np.where(is_grown, np.cumsum(is_grown) - 1, -1),
        born=np.where(is_grown, 1, 0),
        drawn=is_grown.astype(int),
        held=is_grown.astype(int),
        astray=np.full((count, ontology_of(graph).num_concepts), astray),
        firm=np.isin(rows, firm),
        due=np.isin(rows, due),
        grew=np.zeros((count, 2)),
    )
    return Map(graph, tracks)
