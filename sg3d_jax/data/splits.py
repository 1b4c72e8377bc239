"""Which graphs of a data set are for training, validation and test.

Source: paper, Sec. "Experiments": 60 % training, 20 % validation, 20 % test.
Differs: the authors' assignment is not published; ours is a seeded permutation.
"""

from typing import Final, NamedTuple

import numpy as np

MIN_GRAPHS: Final = 5  # the fewest that leave one graph for each part


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
