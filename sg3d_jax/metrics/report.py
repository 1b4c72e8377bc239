"""One report on a list of generated graphs: distances to the truth, structure, failures."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from sg3d_jax.metrics.fgw import ALPHA, fgw_pairs
from sg3d_jax.metrics.structure import exact_structure, failures, node_count_error
from sg3d_jax.scene.graph import SceneGraph


def score(
    generated: Sequence[SceneGraph], truth: Sequence[SceneGraph], alpha: float = ALPHA
) -> dict[str, Any]:
    """Scores generated graphs against the true ones over the same planes.

    Args:
      generated: host graphs.
      truth: host graphs, in the same order.
      alpha: weight of the structure in FGW.

    Returns:
      A dictionary that JSON can hold: means of `fgw`, `gw` and `w`; the share of graphs whose
      structure is exact; mean absolute and signed errors of node counts, a concept and in total;
      for each kind of failure its `count` and the `share` of graphs that have it; and the FGW of
      every pair.

    Raises:
      ValueError: the lists differ in length or are empty, or a graph is too large.
    """
    scores = fgw_pairs(generated, truth, alpha)
    pairs = list(zip(generated, truth, strict=True))
    return {
        "graphs": len(pairs),
        "fgw": float(np.mean(scores.value)),
        "gw": float(np.mean(scores.gw)),
        "w": float(np.mean(scores.w)),
        "exact_structure": float(np.mean([exact_structure(*pair) for pair in pairs])),
        "node_count_error": _node_count_errors(pairs),
        "failures": _failure_histogram(pairs),
        "fgw_per_graph": np.asarray(scores.value).tolist(),
    }


def _node_count_errors(
    pairs: Sequence[tuple[SceneGraph, SceneGraph]],
) -> dict[str, dict[str, float]]:
    """Returns mean signed and mean absolute errors, a concept and in total."""
    errors = [node_count_error(*pair) for pair in pairs]
    rows = [{"total": sum(error.values()), **error} for error in errors]
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return {
        "absolute": {name: float(np.abs(column).mean()) for name, column in columns.items()},
        "signed": {name: float(column.mean()) for name, column in columns.items()},
    }


def _failure_histogram(
    pairs: Sequence[tuple[SceneGraph, SceneGraph]],
) -> dict[str, dict[str, int | float]]:
    """Returns how often each kind of failure occurs, and in what share of the graphs, by count."""
    found = [failures(*pair) for pair in pairs]
    counts: Counter[str] = sum(found, Counter())
    graphs = Counter(kind for each in found for kind in each)
    return {
        kind: {"count": count, "share": graphs[kind] / len(pairs)}
        for kind, count in counts.most_common()
    }
