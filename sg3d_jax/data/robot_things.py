"""What a robot does not see as it is of things: of all that is observed and has no surface.

Doors, stairs, furniture, pillars: a robot sees things in the rooms of which it sees a plane, misses
some, takes some for two, is wrong about where and how wide they are, and of which kind.

Source: ours. No map of objects with its truth was at hand: the ranges are guesses.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, ontology_of, parts_first

LEVEL_NOISE: Final = 0.3  # noise of heights, as a share of that of x and of y
_SHARES: Final = ("missing", "doubled", "mistaken")
_LENGTHS: Final = ("position_noise", "width_noise")


@dataclass(frozen=True)
class ThingsConfig:
    """What a robot does not see as it is of things. Without arguments it sees them as they are.

    Attributes:
      missing: share of the things that are not seen; 1 for none at all.
      doubled: share of those seen that are mapped a second time.
      doubled_offset: range of how far from the first, metres in x and y.
      position_noise: of x and of y, metres, standard deviation.
      width_noise: of the logarithm of the width, standard deviation.
      mistaken: share of the things of a kind that are taken for another kind.

    Raises:
      ValueError: a share is not in 0..1, a range is empty, or a noise is negative.
    """

    missing: float = 0.0
    doubled: float = 0.0
    doubled_offset: tuple[float, float] = (0.1, 0.6)
    position_noise: float = 0.0
    width_noise: float = 0.0
    mistaken: float = 0.0

    def __post_init__(self) -> None:
        """Refuses settings that nothing can be seen with."""
        check_strengths(self, _SHARES, _LENGTHS)
        low, high = self.doubled_offset
        if not 0 <= low <= high < np.inf:
            held = f"doubled_offset is ({low:g}, {high:g})"
            raise ValueError(f"{held}, expected 0 <= least <= greatest")


def check_strengths(config: Any, shares: Sequence[str], lengths: Sequence[str]) -> None:
    """Refuses settings of what is seen that are no shares and no lengths.

    Args:
      config: has fields of these names.
      shares: fields that are 0 to 1.
      lengths: fields that are zero or more.

    Raises:
      ValueError: one sentence that names the first that is wrong.
    """
    for name in shares:
        if not 0 <= getattr(config, name) <= 1:
            raise ValueError(f"{name} is {getattr(config, name):g}, expected 0 to 1")
    for name in lengths:
        if not 0 <= getattr(config, name) < np.inf:
            raise ValueError(f"{name} is {getattr(config, name):g}, expected zero or more")


class SeenThings(NamedTuple):
    """Things as they are seen: `t` of them, sorted by what they are."""

    node: np.ndarray  # int[t], node of the complete graph
    position: np.ndarray  # float[t, 3], metres
    width: np.ndarray  # float[t], metres
    kind: np.ndarray  # float[t]


NO_THINGS: Final = SeenThings(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0), np.zeros(0))


def is_surface(graph: SceneGraph) -> np.ndarray:
    """Returns bool[n], which nodes are observed surfaces: planes, which have a normal."""
    ontology = ontology_of(graph)
    return (ontology.is_observed & ontology.has("normal"))[graph.nodes.label]


def seen_things(
    graph: SceneGraph, seen: np.ndarray, config: ThingsConfig, rng: np.random.Generator
) -> SeenThings:
    """Draws the things that a robot sees.

    Args:
      graph: complete.
      seen: int[k], its surfaces that are seen.
      config: what is seen otherwise than it is.
      rng: source of randomness.
    """
    nodes = graph.nodes
    things = np.flatnonzero(nodes.observed & ~is_surface(graph))
    part, whole = parts_first(graph).T
    near = part[np.isin(whole, whole[np.isin(part, seen)])]
    lost = np.setdiff1d(part, near)  # what is in rooms that are not seen; what is in none may be
    things = things[~np.isin(things, lost)]
    node = things[rng.random(len(things)) >= config.missing]
    twice = rng.random(len(node)) < config.doubled
    node = np.repeat(node, 1 + twice)
    again = np.append(False, node[1:] == node[:-1])[: len(node)]
    size = len(node)
    angle, far = rng.uniform(0, 2 * np.pi, size), rng.uniform(*config.doubled_offset, size)
    noise = config.position_noise * np.array([1, 1, LEVEL_NOISE])
    position = nodes.position[node] + noise * rng.normal(0, 1, (size, 3))
    aside = (again * far)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    position[:, :2] += aside
    width = nodes.width[node] * np.exp(config.width_noise * rng.normal(0, 1, size))
    return SeenThings(node, position, width, _kinds_seen(graph, node, config, rng))


def _kinds_seen(
    graph: SceneGraph, node: np.ndarray, config: ThingsConfig, rng: np.random.Generator
) -> np.ndarray:
    """Returns what kinds things are taken for, float[t]: some for another of their concept."""
    kind = graph.nodes.kind[node]
    number = ontology_of(graph).num_kinds[graph.nodes.label[node]]
    wrong = (rng.random(len(node)) < config.mistaken) & (kind > 0) & (number > 1)
    shift = 1 + np.floor(rng.random(len(node)) * (number - 1))
    return np.where(wrong, (kind - 1 + shift) % np.maximum(number, 1) + 1, kind)
