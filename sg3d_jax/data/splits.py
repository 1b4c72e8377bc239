"""Which graphs of a data set are for training, validation and test.

Source: paper, Sec. "Experiments": 60 % training, 20 % validation, 20 % test; its recordings of real
buildings are for testing only.
Differs: the authors' assignment is not published; ours is a seeded permutation. Where floors of
one building, or copies of one floor, occur in several graphs, whole buildings are dealt, and the
file of the set says which graph went where.
"""

from collections.abc import Hashable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

MIN_GRAPHS: Final = 5  # the fewest that leave one graph for each part
PARTS: Final = ("train", "validation", "test")


class Splits(NamedTuple):
    """Indices of graphs; every graph of the data set is in exactly one part."""

    train: np.ndarray  # int[60 %]
    validation: np.ndarray  # int[20 %]
    test: np.ndarray  # int[20 %]


def split(num_graphs: int, seed: int = 0) -> Splits:
    """Deals graphs into 60 % training, 20 % validation and 20 % test.

    Args:
      num_graphs: size of the data set.
      seed: of the permutation (`numpy.random.default_rng`), whose head is for training and whose
        tail is for test. Training and evaluation must use the same.

    Returns:
      Indices in the order of the permutation; parts are rounded down, the rest is for test.

    Raises:
      ValueError: too few graphs to fill the three parts.
    """
    if num_graphs < MIN_GRAPHS:
        raise ValueError(f"a split needs at least {MIN_GRAPHS} graphs, got {num_graphs}")
    order = np.random.default_rng(seed).permutation(num_graphs)
    return Splits(*np.split(order, [num_graphs * 60 // 100, num_graphs * 80 // 100]))


def split_groups(groups: Sequence[Hashable], seed: int = 0) -> list[str]:
    """Deals whole groups, such as the floors of one building, into the three parts.

    Args:
      groups: the group of each item.
      seed: of the permutation of the groups.

    Returns:
      The part of each item. Groups are 60/20/20, so items are nearly so where groups are small; if
      there are too few to fill the parts, all are for test.
    """
    names = list(dict.fromkeys(groups))
    if len(names) < MIN_GRAPHS:
        return [PARTS[-1]] * len(groups)
    dealt = split(len(names), seed)
    part_of = {names[i]: part for part in PARTS for i in getattr(dealt, part)}
    return [part_of[group] for group in groups]


def split_of(header: Mapping[str, Any], num_graphs: int, seed: int = 0) -> Splits:
    """Returns the split of a data set: the one that its file states, else a seeded one.

    Args:
      header: of the file (`npz.load`); `parts`, if there, names the part of every graph.
      num_graphs: size of the data set.
      seed: of the permutation, which gives the order in a part that the header states, too, so
        that its first graphs are a fair sample of it.

    Raises:
      ValueError: parts are not one known name a graph, or there are too few graphs to split.
    """
    parts = header.get("parts")
    if parts is None:
        return split(num_graphs, seed)
    named = isinstance(parts, list) and all(part in PARTS for part in parts)
    if not named or len(parts) != num_graphs:
        raise ValueError(f"header parts must name one of {', '.join(PARTS)} for each graph")
    order = np.random.default_rng(seed).permutation(num_graphs)
    return Splits(*(order[np.array(parts)[order] == part] for part in PARTS))
