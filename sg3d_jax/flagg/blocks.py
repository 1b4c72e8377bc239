"""The node schedule: block sizes from a set of coins, in the fewest coins, in random order.

Source: paper, Sec. "FLAGG for graph extension" (the node schedule m_t); FLAGG's categorical
removal: an amount is changed into the fewest coins (ties go to the larger coin), and the coins come
in uniformly random order.
"""

import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key


class Schedule(NamedTuple):
    """Block sizes of one insertion sequence; slots behind the last block are zero."""

    size: Array  # int32[T], nodes inserted at step t
    start: Array  # int32[T], nodes inserted before step t
    num_steps: Array  # int32[]


@functools.cache
def fewest_coins(coins: tuple[int, ...], max_amount: int) -> np.ndarray:
    """Returns the fewest-coins decomposition of every amount, int32[max_amount + 1, K].

    Args:
      coins: distinct block sizes in increasing order, the first of them 1.
      max_amount: the largest amount.

    Raises:
      ValueError: the coins are not increasing or do not begin with 1.
    """
    if coins[:1] != (1,) or any(a >= b for a, b in itertools.pairwise(coins)):
        raise ValueError(f"block sizes must increase and begin with 1, got {coins}")
    table = np.zeros((max_amount + 1, len(coins)), np.int32)
    for amount in range(1, max_amount + 1):
        affordable = [index for index, coin in enumerate(coins) if coin <= amount]
        best = min(affordable, key=lambda i: (table[amount - coins[i]].sum(), -coins[i]))
        table[amount] = table[amount - coins[best]]
        table[amount, best] += 1
    table.setflags(write=False)
    return table


def insert_posterior(
    num_missing: Int[Array, "..."], coins: tuple[int, ...], max_amount: int
) -> Float[Array, "... K"]:
    """Returns the distribution of the next block size when `num_missing` nodes are missing.

    It is the normalised histogram of the coins of what is missing: the exact posterior of the last
    removed block, because every arrangement of the coins is equally likely. Zero where nothing is
    missing.
    """
    counts = jnp.asarray(fewest_coins(coins, max_amount), jnp.float32)[num_missing]
    return counts / jnp.maximum(jnp.sum(counts, axis=-1, keepdims=True), 1.0)


def draw_schedule(
    key: Key[Array, ""], num_missing: Int[Array, ""], coins: tuple[int, ...], max_amount: int
) -> Schedule:
    """Draws the block sizes of a whole insertion sequence.

    Args:
      key: a new key gives a new order of the blocks.
      num_missing: n_0, high-level nodes of the complete graph, at most `max_amount`.
      coins: block sizes.
      max_amount: T, the length of the result.
    """
    counts = jnp.asarray(fewest_coins(coins, max_amount))[num_missing]
    num_steps = jnp.sum(counts)
    slot = jnp.arange(max_amount)
    coin = jnp.sum(slot[:, None] >= jnp.cumsum(counts)[None, :-1], axis=-1)
    size = jnp.where(slot < num_steps, jnp.asarray(coins, jnp.int32)[coin], 0)
    shuffled = jnp.argsort(jnp.where(slot < num_steps, jax.random.uniform(key, slot.shape), 2.0))
    size = size[shuffled]
    return Schedule(size=size, start=jnp.cumsum(size) - size, num_steps=num_steps)
