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

from sg3d_jax.io.files import MAX_GRAPHS

MIN_GRAPHS: Final = 5  # the fewest that leave one graph for each part
PARTS: Final = ("train", "validation", "test")


class Splits(NamedTuple):
    """Indices of graphs; every graph of the data set is in exactly one part."""

    train: np.ndarray  # int[60 %]
    validation: np.ndarray  # int[20 %]
    test: np.ndarray  # int[20 %]


def split(num_graphs: int, seed: int = 0, whole: int | None = None) -> Splits:
    """Deals graphs into 60 % training, 20 % validation and 20 % test.

    Args:
      num_graphs: size of the data set.
      seed: of the permutation (`numpy.random.default_rng`), whose head is for training and whose
        tail is for test. Training and evaluation must use the same.
      whole: how many graphs the set has of which these are the first, so that each is for the same
        part as there; None for these alone. Those beyond it are dealt by themselves, and so are
        all if some part would be empty.

    Returns:
      Indices in the order of the permutation; parts are rounded down, the rest is for test.

    Raises:
      ValueError: too few graphs to fill the three parts.
    """
    if num_graphs < MIN_GRAPHS:
        raise ValueError(f"a split needs at least {MIN_GRAPHS} graphs, got {num_graphs}")
    if whole is not None and whole != num_graphs:
        return _split_as(whole, num_graphs, seed)
    order = np.random.default_rng(seed).permutation(num_graphs)
    return Splits(*np.split(order, [num_graphs * 60 // 100, num_graphs * 80 // 100]))


def _split_as(whole: int, num_graphs: int, seed: int) -> Splits:
    """Deals the first graphs of a larger set, or a whole set and more, as that set is dealt."""
    dealt, more = split(whole, seed), num_graphs - whole
    if more <= 0:
        parts = Splits(*(part[part < num_graphs] for part in dealt))
        return parts if all(map(len, parts)) else split(num_graphs, seed)
    none = np.zeros(0, int)
    beyond = split(more, seed) if more >= MIN_GRAPHS else Splits(none, none, np.arange(more))
    return Splits(*map(np.append, dealt, (whole + part for part in beyond)))


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
      header: of the file (`npz.load`); `parts`, if there, names the part of every graph, and
        `whole` how many there are in the set of which these are the first.
      num_graphs: size of the data set.
      seed: of the permutation, which gives the order in a part that the header states, too, so
        that its first graphs are a fair sample of it.

    Raises:
      ValueError: parts are not one known name a graph, the whole is no number, or there are too few
        graphs to split.
    """
    parts = header.get("parts")
    if parts is None:
        whole = header.get("whole")
        if not (whole is None or (type(whole) is int and MIN_GRAPHS <= whole <= MAX_GRAPHS)):
            expected = f"a number from {MIN_GRAPHS} to {MAX_GRAPHS}"
            raise ValueError(f"header whole is {whole!r:.40}, expected {expected}")
        return split(num_graphs, seed, whole)
    named = isinstance(parts, list) and all(part in PARTS for part in parts)
    if not named or len(parts) != num_graphs:
        raise ValueError(f"header parts must name one of {', '.join(PARTS)} for each graph")
    order = np.random.default_rng(seed).permutation(num_graphs)
    return Splits(*(order[np.array(parts)[order] == part] for part in PARTS))
