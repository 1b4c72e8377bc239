"""Whether graphs are as sure of their nodes and edges as they are right.

What is grown is known by what it stands for: its concept, and what is observed below it. A node is
right if the truth has one that stands for the same, an edge if the truth has one between such. So
nothing needs to be matched, and a graph is right all over if and only if its structure is exact.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, parts_first
from sg3d_jax.scene.padding import unpad_all

BINS: Final = 10

# Concept; what is observed below, as the bits of a number; how many such came before it.
Identity = tuple[int, int, int]


class Reliability(NamedTuple):
    """How often what is said to be right with some confidence is right, by confidence."""

    error: float  # expected calibration error: mean over all of |confidence - correct| of their bin
    count: np.ndarray  # int[b], of each bin of equal width between 0 and 1
    confidence: np.ndarray  # float[b], mean; 0 where a bin is empty
    correct: np.ndarray  # float[b], share; 0 where a bin is empty


def reliability(confidence: np.ndarray, correct: np.ndarray, bins: int = BINS) -> Reliability:
    """Compares confidence with what is right.

    Args:
      confidence: float[k], 0 to 1.
      correct: bool[k].
      bins: of equal width.

    Raises:
      ValueError: the lengths differ, or a confidence is no probability.

    Source: Guo et al., "On calibration of modern neural networks", ICML 2017, Eq. 3.
    """
    confidence, correct = np.asarray(confidence, np.float64), np.asarray(correct, bool)
    if confidence.shape != correct.shape:
        shapes = f"{confidence.shape} and correct {correct.shape}"
        raise ValueError(f"confidence has the shape {shapes}, expected the same")
    if not ((confidence >= 0) & (confidence <= 1)).all():
        raise ValueError("confidence holds a number that is not between 0 and 1")
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins)
    means = [
        np.bincount(place, values, minlength=bins) / np.maximum(count, 1)
        for values in (confidence, correct)
    ]
    error = float(np.sum(count * np.abs(means[0] - means[1])) / max(1, len(confidence)))
    return Reliability(error, count, *means)


def calibration(
    generated: Iterable[SceneGraph],
    truth: Iterable[SceneGraph],
    node_confidence: Sequence[np.ndarray],
    edge_confidence: Sequence[np.ndarray],
) -> dict[str, Reliability]:
    """Returns the reliability of all grown nodes, and of all part-of edges, of several graphs.

    Args:
      generated: host graphs, or padded ones.
      truth: likewise, over the same observed nodes, in the same order.
      node_confidence: float[n] of each; of observed nodes, which are given, it is not read.
      edge_confidence: float[e] of each, in the order of `parts_first`.

    Returns:
      The two, under "nodes" and "edges".
    """
    generated = unpad_all(generated)
    pairs = list(zip(generated, unpad_all(truth), strict=True))
    grown = [~np.asarray(graph.nodes.observed) for graph in generated]
    right = [correct_nodes(*pair)[new] for pair, new in zip(pairs, grown, strict=True)]
    sure = [of_graph[new] for of_graph, new in zip(node_confidence, grown, strict=True)]
    right_edges = [correct_edges(*pair) for pair in pairs]
    return {
        "nodes": reliability(np.concatenate(sure), np.concatenate(right)),
        "edges": reliability(np.concatenate(edge_confidence), np.concatenate(right_edges)),
    }


def correct_nodes(generated: SceneGraph, truth: SceneGraph) -> np.ndarray:
    """Returns bool[n], the nodes of a host graph that the truth has over the same observed nodes.

    One that repeats another is right as often as the truth repeats it.
    """
    true = {*identities(truth)}
    return np.array([identity in true for identity in identities(generated)], bool)


def correct_edges(generated: SceneGraph, truth: SceneGraph) -> np.ndarray:
    """Returns bool[e], the part-of edges whose ends are both right and have an edge in the truth.

    They are in the order of `parts_first`.
    """
    true = {*edge_identities(truth)}
    return np.array([identity in true for identity in edge_identities(generated)], bool)


def identities(graph: SceneGraph) -> list[Identity]:
    """Returns what each node of a host graph stands for; no two stand for the same.

    Of what is observed below a node the lowest concept says what it stands for, as planes do of a
    room: a chair that is thought to be next door makes no other room of it.
    """
    label, below = np.asarray(graph.nodes.label), bits_below(graph)
    observed = label[np.asarray(graph.nodes.observed)]
    lowest = [0] * len(label)
    for concept in sorted({*observed.tolist()}, reverse=True):
        of_concept = sum(1 << bit for bit in np.flatnonzero(observed == concept).tolist())
        lowest = [held & of_concept or other for held, other in zip(below, lowest, strict=True)]
    before, known = defaultdict(int), []
    for stands_for in zip(label.tolist(), lowest, strict=True):
        known.append((*stands_for, before[stands_for]))
        before[stands_for] += 1
    return known


def edge_identities(
    graph: SceneGraph, known: Sequence[Identity] | None = None
) -> list[tuple[Identity, Identity]]:
    """Returns what both ends of each part-of edge stand for, in the order of `parts_first`.

    Args:
      graph: host graph.
      known: its `identities`, where they are there already.
    """
    known = identities(graph) if known is None else known
    return [(known[part], known[whole]) for part, whole in parts_first(graph).tolist()]


def observed_below(graph: SceneGraph) -> np.ndarray:
    """Returns bool[n, o], which observed nodes are parts of each node, or parts of its parts.

    What is observed is below itself alone.
    """
    below, num_observed = bits_below(graph), int(np.sum(graph.nodes.observed))
    size = -(-num_observed // 8)
    packed = np.frombuffer(b"".join(bits.to_bytes(size, "little") for bits in below), np.uint8)
    rows = packed.reshape(len(below), size)
    return np.unpackbits(rows, axis=1, count=num_observed, bitorder="little").astype(bool)


def bits_below(graph: SceneGraph) -> list[int]:
    """Returns `observed_below` as numbers, of which bit k stands for the k-th observed node."""
    label, observed = np.asarray(graph.nodes.label), np.asarray(graph.nodes.observed)
    below = [0] * len(label)
    for bit, row in enumerate(np.flatnonzero(observed).tolist()):
        below[row] = 1 << bit
    pairs = parts_first(graph)
    pairs = pairs[~observed[pairs[:, 1]]]
    bottom_up = np.argsort(label[pairs[:, 1]], kind="stable")
    for part, whole in pairs[bottom_up].tolist():
        below[whole] |= below[part]
    return below
