"""A choice among several candidates that needs no truth: the medoid under FGW."""

import itertools
from collections.abc import Sequence

import numpy as np

from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.scene.graph import SceneGraph


def medoids(candidates: Sequence[Sequence[SceneGraph]]) -> list[int]:
    """Chooses of each scene the candidate with the least mean FGW to the others.

    A model that has learnt the posterior of a scene draws most candidates near its mode, and each
    mistake but rarely: the medoid is the draw of least expected FGW to another draw.

    Args:
      candidates: of each scene, at least one host graph, all over the same planes.

    Returns:
      The index of the chosen one of each scene; the first of several that are equally good.

    Raises:
      ValueError: a scene has no candidates.
    """
    for scene, graphs in enumerate(candidates):
        if not graphs:
            raise ValueError(f"scene {scene} has no candidates, expected at least one")
    pairs = [
        (scene, *pair)
        for scene, graphs in enumerate(candidates)
        for pair in itertools.combinations(range(len(graphs)), 2)
    ]
    if not pairs:
        return [0] * len(candidates)
    left, right = ([candidates[pair[0]][pair[side]] for pair in pairs] for side in (1, 2))
    values = np.asarray(fgw_pairs(left, right).value, np.float64)
    total = [np.zeros(len(graphs)) for graphs in candidates]
    for (scene, first, second), value in zip(pairs, values, strict=True):
        total[scene][[first, second]] += value
    return [int(np.argmin(sums)) for sums in total]
