"""One report on a list of generated graphs: distances to the truth, structure, failures."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.metrics.fgw_problem import ALPHA
from sg3d_jax.metrics.mmd import mmd_scores
from sg3d_jax.metrics.structure import (
    exact_structure,
    failures,
    hangs_together,
    has_one_whole_each,
    node_count_error,
    num_duplicates,
    num_forbidden_edges,
)
from sg3d_jax.scene.graph import SceneGraph, ontology_of
from sg3d_jax.scene.padding import unpad_all


def score(
    generated: Iterable[SceneGraph],
    truth: Iterable[SceneGraph],
    alpha: float = ALPHA,
    pieces: Sequence[np.ndarray] | None = None,
) -> dict[str, Any]:
    """Scores generated graphs against the true ones over the same observed nodes.

    Args:
      generated: host graphs, or padded ones.
      truth: likewise, in the same order.
      alpha: weight of the structure in FGW, from 0 to 1.
      pieces: for each graph int[observed], into how many pieces each observed node was cut, each of
        which may have a whole of its own; None for one each.

    Returns:
      A dictionary that JSON can hold: the paper's seven scores (means of `fgw`, `gw` and `w`, and
      MMD^2 of `degree`, `spectrum`, `clustering` and `gin`, which are None where no graph of a set
      has nodes); the share of graphs whose structure is exact; shares of graphs that obey the
      hierarchy (`one_parent`, `layer_rule`, `connected`, `no_duplicates`; what is observed and
      belongs to nothing in truth need not belong to anything); `precision` and `recall` of each
      concept: of its generated nodes those that the FGW plan puts on true nodes of the same
      concept, and of the true ones those that are met so; mean absolute and signed errors of node
      counts, a concept and in total; for each kind of failure its `count` and the `share` of graphs
      that have it; and the FGW of every pair.

    Raises:
      ValueError: the lists differ in length, are empty or none, graphs have different ontologies,
        one is too large, or `alpha` is outside 0 to 1.

    Source: paper, Sec. "Metrics".
    Differs: all but the seven scores is ours.
    """
    generated, truth = unpad_all(generated), unpad_all(truth)
    scores = fgw_pairs(generated, truth, alpha)
    pairs = list(zip(generated, truth, strict=True))
    return {
        "graphs": len(pairs),
        "fgw": float(np.mean(scores.value)),
        "gw": float(np.mean(scores.gw)),
        "w": float(np.mean(scores.w)),
        **_mmd(generated, truth),
        "exact_structure": float(np.mean([exact_structure(*pair) for pair in pairs])),
        **_rules(pairs, pieces),
        **_levels(generated, truth, np.asarray(scores.matched)),
        "node_count_error": _node_count_errors(pairs),
        "failures": _failure_histogram(pairs),
        "fgw_per_graph": np.asarray(scores.value).tolist(),
    }


def summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Sums up the reports of several seeds.

    Args:
      runs: what `score` returned, one a seed; further numbers in a report are summed up, too.

    Returns:
      `mean` and `sd` over the seeds of every number in the reports, those of node counts under
      names such as "node count error, wall"; the sd of a single seed is None.
    """
    columns = [dict(_numbers(run)) for run in runs]
    shared = [name for name in columns[0] if all(name in column for column in columns)]
    values = {name: np.array([column[name] for column in columns]) for name in shared}
    return {
        name: {
            "mean": float(column.mean()),
            "sd": float(column.std(ddof=1)) if len(column) > 1 else None,
        }
        for name, column in values.items()
    }


def _numbers(run: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yields the numbers of a report with their names."""
    for name, value in run.items():
        if isinstance(value, (int, float)) and name != "graphs":
            yield name.replace("_", " "), float(value)
    columns = {"node count error": run["node_count_error"]["absolute"]}
    columns |= {name: run[name] for name in ("precision", "recall")}
    for name, column in columns.items():
        for concept, value in column.items():
            yield f"{name}, {concept}", value


def _mmd(
    generated: Sequence[SceneGraph], truth: Sequence[SceneGraph]
) -> dict[str, float] | dict[str, None]:
    """Returns the scores of the two sets, in the paper's order; None if one is without nodes."""
    names = ("degree", "spectrum", "clustering", "gin")
    if not all(any(len(graph.nodes.label) for graph in each) for each in (generated, truth)):
        return dict.fromkeys(names)
    scores = mmd_scores(generated, truth)
    return {name: scores[name] for name in names}


def _rules(
    pairs: Sequence[tuple[SceneGraph, SceneGraph]], pieces: Sequence[np.ndarray] | None
) -> dict[str, float]:
    """Returns the share of graphs that obey each rule of the hierarchy."""
    counts = [None] * len(pairs) if pieces is None else pieces
    broken = {
        "one_parent": [
            not has_one_whole_each(*pair, count) for pair, count in zip(pairs, counts, strict=True)
        ],
        "layer_rule": [num_forbidden_edges(made) > 0 for made, _ in pairs],
        "connected": [not hangs_together(*pair) for pair in pairs],
        "no_duplicates": [num_duplicates(made) > 0 for made, _ in pairs],
    }
    return {rule: 1 - float(np.mean(graphs)) for rule, graphs in broken.items()}


def _levels(
    generated: Sequence[SceneGraph], truth: Sequence[SceneGraph], matched: np.ndarray
) -> dict[str, dict[str, float]]:
    """Returns precision and recall of the concepts that occur; the observed ones are given.

    Args:
      generated: host graphs.
      truth: host graphs.
      matched: float[B, C, C], see `FGW`.
    """
    ontology = ontology_of(truth[0])
    made, true = (_label_counts(graphs) for graphs in (generated, truth))
    met = np.einsum("bcc->c", matched)
    return {
        name: {
            ontology.names[concept]: float(met[concept] / count[concept])
            for concept in np.flatnonzero(~ontology.is_observed)
            if count[concept]
        }
        for name, count in (("precision", made), ("recall", true))
    }


def _label_counts(graphs: Sequence[SceneGraph]) -> np.ndarray:
    labels = np.concatenate([graph.nodes.label for graph in graphs])
    return np.bincount(labels, minlength=ontology_of(graphs[0]).num_concepts)


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
