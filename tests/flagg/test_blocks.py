from fractions import Fraction
from itertools import combinations_with_replacement

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.flagg.blocks import draw_schedule, fewest_coins, insert_posterior

COIN_SETS = [(1,), (1, 4), (1, 3), (1, 2, 8), (1, 4, 16), (1, 3, 4, 5)]
MAX_AMOUNT = 26


def fewest_by_search(coins, amount):
    """The multiset of the fewest coins, of those the one with the largest coins."""
    for number in range(amount + 1):
        change = [
            sorted(chosen, reverse=True)
            for chosen in combinations_with_replacement(coins, number)
            if sum(chosen) == amount
        ]
        if change:
            return max(change)
    raise AssertionError("every amount has change, as there is a coin of 1")


def arrangements(blocks):
    """All different orders of a multiset; in a random order each is as likely as the others."""
    if not blocks:
        yield ()
    for size in set(blocks):
        rest = blocks.copy()
        rest.remove(size)
        yield from ((size, *others) for others in arrangements(rest))


def posterior_by_enumeration(coins, total):
    """For every number of missing nodes, the chances of the next block, over all arrangements."""
    chances = {}
    for arrangement in arrangements(fewest_by_search(coins, total)):
        for step, size in enumerate(arrangement):
            missing = sum(arrangement[step:])
            chances.setdefault(missing, dict.fromkeys(coins, 0))[size] += 1
    return {
        missing: [Fraction(count[coin], sum(count.values())) for coin in coins]
        for missing, count in chances.items()
    }


@pytest.mark.parametrize("coins", COIN_SETS)
def test_change__is_the_fewest_coins_and_of_those_the_largest(coins):
    table = fewest_coins(coins, MAX_AMOUNT)
    for amount in range(MAX_AMOUNT + 1):
        best = fewest_by_search(coins, amount)
        assert table[amount].tolist() == [best.count(coin) for coin in coins]


@pytest.mark.parametrize("coins", COIN_SETS)
@pytest.mark.parametrize("total", [1, 5, 6, 7, 22])
def test_posterior__is_that_of_all_arrangements_of_the_blocks(coins, total):
    found = np.asarray(insert_posterior(jnp.arange(MAX_AMOUNT + 1), coins, MAX_AMOUNT))
    for missing, chances in posterior_by_enumeration(coins, total).items():
        np.testing.assert_allclose(found[missing], np.array(chances, float), rtol=1e-6)


def test_posterior__is_zero_where_nothing_is_missing():
    found = insert_posterior(jnp.asarray([0, 5]), (1, 4), MAX_AMOUNT)
    np.testing.assert_array_equal(found, [[0, 0], [0.5, 0.5]])


@pytest.mark.parametrize("coins", [(), (2, 4), (1, 4, 4), (1, 4, 3)])
def test_coins__increase_and_begin_with_one(coins):
    with pytest.raises(ValueError, match="must increase and begin with 1"):
        fewest_coins(coins, 5)


@pytest.mark.parametrize("coins", [(1, 4), (1, 2, 8)])
def test_schedule__holds_the_change_and_sums_to_the_missing_nodes(coins):
    amounts = jnp.arange(MAX_AMOUNT + 1)
    keys = jax.random.split(jax.random.key(0), len(amounts))
    draw = jax.jit(jax.vmap(lambda key, amount: draw_schedule(key, amount, coins, MAX_AMOUNT)))
    schedules = jax.tree.map(np.asarray, draw(keys, amounts))
    for amount, size, start, num_steps in zip(range(MAX_AMOUNT + 1), *schedules, strict=True):
        assert sorted(size[:num_steps], reverse=True) == fewest_by_search(coins, amount)
        assert not size[num_steps:].any()
        np.testing.assert_array_equal(start[:num_steps], (np.cumsum(size) - size)[:num_steps])


def test_schedule__puts_every_arrangement_of_the_blocks_equally_often():
    keys = jax.random.split(jax.random.key(1), 6000)
    draw = jax.jit(jax.vmap(lambda key: draw_schedule(key, jnp.asarray(10), (1, 4), 12).size))
    orders, counts = np.unique(np.asarray(draw(keys))[:, :4], axis=0, return_counts=True)
    assert {tuple(row) for row in orders.tolist()} == set(arrangements([1, 1, 4, 4]))
    np.testing.assert_allclose(counts / 6000, np.full(6, 1 / 6), atol=0.02)
