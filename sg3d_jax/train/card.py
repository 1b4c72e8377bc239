"""The card of weights: what they were trained on, and how well they complete what.

A scene unlike any that a model was trained on is completed all the same, and wrongly: the card says
what the training scenes measured, so that `complete` can say where a scene lies outside.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.infer.plausible import THICK, layout
from sg3d_jax.scene.graph import SceneGraph, observed_of, ontology_of

# What is measured of a scene, and what it is called; beyond the range by the slack, it is outside.
MEASURES: Final = {
    "number": "{plural}",
    "extent": "m across",
    "width": "m wide",
    "thickness": "m back to back",
}
TAIL: Final = 0.5  # percent of the training scenes that a range leaves out at each end
SLACK: Final = 1.25
MEASURED: Final = 2000  # graphs, of many evenly spaced ones


class Score(NamedTuple):
    """How well the weights complete the scenes of a test split; means."""

    data: str  # the data set
    graphs: int  # how many scenes of it
    fgw: float
    exact: float  # share of graphs whose edges are all right


@dataclass(frozen=True)
class Card:
    """What weights are.

    Attributes:
      graphs: how many they were trained on.
      ranges: of the measures of the scenes of these, least and greatest; see `measures_of`.
      scores: on test splits.
      history: how they came about, one sentence; empty where the configuration says it all.
    """

    graphs: int
    ranges: dict[str, tuple[float, float]]
    scores: tuple[Score, ...] = ()
    history: str = field(default="")

    def with_score(self, score: Score) -> "Card":
        """Returns the card with a score on a data set in place of any that it has there."""
        others = [one for one in self.scores if one.data != score.data]
        return replace(self, scores=tuple(sorted([*others, score])))


def measures_of(graph: SceneGraph) -> dict[str, float]:
    """Returns what is measured of the observed nodes of a host graph.

    Returns:
      number: how many there are. extent: the longer side of the box of their centroids, metres.
      width: the median of their widths, metres. thickness: the median gap between those that stand
      back to back; missing where none do.
    """
    nodes = observed_of(graph).nodes
    planes = layout(graph)
    measures = {
        "number": float(len(nodes.label)),
        "extent": float(np.ptp(nodes.position[:, :2], axis=0).max()),
    }
    if len(planes.width):
        measures["width"] = float(np.median(planes.width))
    if (thin := planes.back[planes.back < THICK]).size:
        measures["thickness"] = float(np.median(thin))
    return measures


def card_of(graphs: Sequence[SceneGraph], history: str = "") -> Card:
    """Returns the card of weights that were trained on these graphs; without scores."""
    measured = [measures_of(graph) for graph in graphs[:: -(-len(graphs) // MEASURED)]]
    ranges = {}
    for name in MEASURES:
        values = [measures[name] for measures in measured if name in measures]
        if values:
            low, high = np.percentile(values, [TAIL, 100 - TAIL])
            ranges[name] = (float(low), float(high))
    return Card(len(graphs), ranges, (), history)


def outside(card: Card, graph: SceneGraph) -> str | None:
    """Returns in what a scene is unlike those that weights were trained on; None if it is not.

    Args:
      card: of the weights.
      graph: a host graph, of which the observed nodes are looked at.
    """
    plural, found = ontology_of(graph).observed_plural, []
    for name, value in measures_of(graph).items():
        low, high = card.ranges.get(name, (-np.inf, np.inf))
        if not low / SLACK <= value <= high * SLACK:
            unit = MEASURES[name].format(plural=plural)
            found.append(f"{value:.3g} {unit} ({low:.2g} to {high:.3g} in training)")
    return "; ".join(found) or None


def described(card: Card, plural: str) -> str:
    """Returns the ranges of a card, a line each.

    Args:
      card: of weights.
      plural: what observed nodes are called.
    """
    return "\n".join(
        f"{low:.2g} to {high:.3g} {MEASURES[name].format(plural=plural)}"
        for name, (low, high) in card.ranges.items()
    )


def card_to_json(card: Card) -> str:
    """Returns a card as JSON text."""
    return json.dumps({**asdict(card), "scores": [score._asdict() for score in card.scores]})


def card_from_json(text: str) -> Card:
    """Rebuilds a card from `card_to_json`."""
    values: dict[str, Any] = json.loads(text)
    ranges = {name: (low, high) for name, (low, high) in values["ranges"].items()}
    scores = tuple(Score(**score) for score in values["scores"])
    return Card(values["graphs"], ranges, scores, values["history"])
