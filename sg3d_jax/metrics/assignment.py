"""The linear assignment problem on padded matrices: the linear step of Frank-Wolfe."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

FREE = -1


class Matching(NamedTuple):
    """A partial assignment and the prices that prove it optimal."""

    column_of: Int[Array, " N"]  # of each row; FREE if none
    row_of: Int[Array, " N"]  # of each column; FREE if none
    price: Float[Array, " N"]  # of each column


def assign(cost: Float[Array, "N N"], size: Int[Array, ""]) -> Int[Array, " N"]:
    """Returns the column of each row in the cheapest assignment of the leading block.

    Args:
      cost: finite in the leading block; the rest is not read.
      size: rows and columns of that block.

    Returns:
      A permutation of `0 .. N-1` that leaves the places from `size` on where they are.

    Source: Jonker and Volgenant, "A shortest augmenting path algorithm for dense and sparse linear
    assignment problems", Computing 38, 1987: column reduction, then shortest augmenting paths.
    Differs: rows left over by column reduction go straight to the augmenting paths.
    """
    inside = jnp.arange(cost.shape[0]) < size
    # An infinite column is never entered, so that padding costs no step.
    cost = jnp.where(inside[None, :], cost, jnp.inf)
    matching = _reduce_columns(cost, inside)

    def is_free(matching: Matching) -> Bool[Array, " N"]:
        return inside & (matching.column_of == FREE)

    matching = jax.lax.while_loop(
        lambda matching: jnp.any(is_free(matching)),
        lambda matching: _augment(cost, matching, jnp.argmax(is_free(matching))),
        matching,
    )
    return jnp.where(inside, matching.column_of, jnp.arange(cost.shape[0]))


def _reduce_columns(cost: Float[Array, "N N"], inside: Bool[Array, " N"]) -> Matching:
    """Prices every column at its cheapest row and matches the rows that want different columns."""
    num_rows = cost.shape[0]
    price = jnp.min(cost, axis=0, where=inside[:, None], initial=jnp.inf)
    price = jnp.where(inside, price, 0.0)
    rows = jnp.arange(num_rows)
    wanted = jnp.argmin(cost - price[None, :], axis=1)
    row_of = jnp.full(num_rows, FREE).at[jnp.where(inside, wanted, num_rows)].max(rows, mode="drop")
    column_of = jnp.where(inside & (row_of[wanted] == rows), wanted, FREE)
    return Matching(column_of, row_of, price)


def _augment(cost: Float[Array, "N N"], matching: Matching, row: Int[Array, ""]) -> Matching:
    """Matches one more row along the shortest augmenting path that starts at it."""
    column_of, row_of, price = matching
    columns = jnp.arange(cost.shape[0])
    # Under vmap this also runs, to no effect, where every row is matched and no path would end.
    needed = column_of[row] == FREE

    def visit(state: tuple) -> tuple:
        distance, through, visited, column, nearest = state
        visited = visited | (columns == column)
        owner = row_of[column]
        offset = cost[owner, column] - price[column] - nearest
        detour = jnp.where(visited, jnp.inf, cost[owner] - price - offset)
        through = jnp.where(detour < distance, owner, through)
        distance = jnp.minimum(distance, detour)
        return distance, through, visited, *_nearest(distance, visited)

    distance = cost[row] - price
    unvisited = jnp.zeros_like(distance, bool)
    start = distance, jnp.full(columns.shape, row), unvisited, *_nearest(distance, unvisited)

    # A column at no finite distance ends the search too: costs that are not numbers must not hang.
    def continues(state: tuple) -> Bool[Array, ""]:
        *_, column, nearest = state
        return needed & (row_of[column] != FREE) & (nearest < jnp.inf)

    distance, through, visited, sink, nearest = jax.lax.while_loop(continues, visit, start)
    price = jnp.where(visited, price + distance - nearest, price)

    def swap(state: tuple) -> tuple:
        column, _, column_of, row_of = state
        owner = through[column]
        freed = column_of[owner]
        return freed, owner == row, column_of.at[owner].set(column), row_of.at[column].set(owner)

    *_, column_of, row_of = jax.lax.while_loop(
        lambda state: ~state[1], swap, (sink, ~needed, column_of, row_of)
    )
    return Matching(column_of, row_of, price)


def _nearest(
    distance: Float[Array, " N"], visited: Bool[Array, " N"]
) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """Returns the unvisited column that is nearest, and its distance."""
    column = jnp.argmin(jnp.where(visited, jnp.inf, distance))
    return column, distance[column]
