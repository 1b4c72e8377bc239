"""Stage three of FD4: centroids from distances, by stress minimisation with the old nodes fixed.

Source: paper, Eq. for R_t* in Sec. "Adapting D4".
Differs: Levenberg-Marquardt from the mean of the neighbours, where the authors' D4 snapshot runs
500 steps of Adam from random starts. The plane centroids of a floor lie at one height and a wall
has two planes, so where distances are too long the minimum leaves their plane or line in an
arbitrary direction; from our start the steps stay in it. Buildings and cities have few neighbours,
all below them: distances leave mirror images or a circle, and from a start above the neighbours the
uppermost place is found.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Bool, Float

from sg3d_jax.nn.embed import Surface, safe_norm

NUM_STEPS = 20
LEAST_DAMPING = 1e-3  # float32 leaves 1e-7 of curvature where there is none


class _Iterate(NamedTuple):
    position: Array  # float[M, 3]
    stress: Array  # float[]
    damping: Array  # float[]


def stress(
    position: Float[Array, "M 3"],
    old_position: Float[Array, "N 3"],
    distance: Float[Array, "M tokens"],
    edges: Bool[Array, "M tokens"],
) -> Float[Array, ""]:
    """Returns the sum over new edges, each once, of (length - distance)^2, square metres."""
    num_block = position.shape[0]
    tokens = jnp.concatenate([position, old_position])
    residual = safe_norm(position[:, None] - tokens[None]) - distance
    twice = jnp.where(jnp.arange(tokens.shape[0]) < num_block, 0.5, 1.0)
    return jnp.sum(jnp.where(edges, residual**2, 0.0) * twice[None])


def recover_positions(
    distance: Float[Array, "M tokens"],
    edges: Bool[Array, "M tokens"],
    old: Surface,
    old_mask: Bool[Array, " N"],
    above: Bool[Array, " M"],
) -> Float[Array, "M 3"]:
    """Returns the centroids of a block that fit the distances on its edges.

    Args:
      distance: metres; only entries with an edge count.
      edges: symmetric inside the block; False at padding.
      old: the N old nodes.
      old_mask: real old nodes.
      above: new nodes that stand above their neighbours, as buildings and cities do.

    Returns:
      float[M, 3], metres. A node without edges stands at the mean of the old graph; one with a
      single neighbour stands at its distance above it or in front of it.
    """
    num_block = edges.shape[0]
    mean_distance = jnp.sum(distance * edges, axis=1) / jnp.maximum(jnp.sum(edges, axis=1), 1)
    lift = (above * mean_distance)[:, None] * jnp.asarray([[0.0, 0.0, 1.0]])
    start = _start(distance, edges, old, old_mask, above) + lift
    position = _fit(start, distance, edges, old.position)
    if num_block == 1:
        return position
    # What hangs on new nodes alone, such as their floor, starts again from where those stand now.
    inside = edges[:, :num_block]
    mean = inside @ position / jnp.maximum(jnp.sum(inside, axis=1), 1)[:, None]
    hanging = (jnp.sum(inside, axis=1) > 1) & ~jnp.any(edges[:, num_block:], axis=1)
    return _fit(jnp.where(hanging[:, None], mean + lift, position), distance, edges, old.position)


def _fit(
    start: Float[Array, "M 3"],
    distance: Float[Array, "M tokens"],
    edges: Bool[Array, "M tokens"],
    old_position: Float[Array, "N 3"],
) -> Float[Array, "M 3"]:
    """Lowers the stress from a start, by a fixed number of Levenberg-Marquardt steps."""
    value = stress(start, old_position, distance, edges)
    begin = _Iterate(start, value, jnp.asarray(LEAST_DAMPING))

    def step(iterate: _Iterate, _: None) -> tuple[_Iterate, None]:
        return _levenberg_step(iterate, distance, edges, old_position), None

    final, _ = jax.lax.scan(step, begin, None, length=NUM_STEPS)
    return final.position


def _levenberg_step(
    iterate: _Iterate,
    distance: Float[Array, "M tokens"],
    edges: Bool[Array, "M tokens"],
    old_position: Float[Array, "N 3"],
) -> _Iterate:
    """Solves the damped normal equations; keeps the step and lowers the damping if it helped."""
    num_block = iterate.position.shape[0]
    tokens = jnp.concatenate([iterate.position, old_position])
    offset = iterate.position[:, None] - tokens[None]
    length = safe_norm(offset)
    unit = offset / length[..., None] * edges[..., None]
    gradient = jnp.sum(unit * (length - distance)[..., None], axis=1)
    own = jnp.einsum("bti,btj->bij", unit, unit)
    between = -jnp.einsum("bci,bcj->bicj", unit[:, :num_block], unit[:, :num_block])
    same = jnp.eye(num_block)[:, None, :, None]
    hessian = (between + own[:, :, None, :] * same).reshape(3 * num_block, 3 * num_block)
    damped = hessian + iterate.damping * jnp.eye(3 * num_block)
    # Filtering by the Hessian itself keeps out of directions that no distance fixes: there a plain
    # damped step amplifies rounding until a wall leaves the line between its planes.
    solve = functools.partial(cho_solve, cho_factor(damped))
    move = solve(hessian @ solve(gradient.reshape(-1)))
    move = move.reshape(num_block, 3)
    position = iterate.position - move
    value = stress(position, old_position, distance, edges)
    better = value < iterate.stress
    return _Iterate(
        position=jnp.where(better, position, iterate.position),
        stress=jnp.where(better, value, iterate.stress),
        damping=jnp.maximum(iterate.damping * jnp.where(better, 0.2, 8.0), LEAST_DAMPING),
    )


def _start(
    distance: Float[Array, "M tokens"],
    edges: Bool[Array, "M tokens"],
    old: Surface,
    old_mask: Bool[Array, " N"],
    above: Bool[Array, " M"],
) -> Float[Array, "M 3"]:
    """Places every new node at the mean of its neighbours, those with old neighbours first.

    One with a single neighbour is moved in front of it, unless it stands above.
    """
    num_block = edges.shape[0]
    total = jnp.maximum(jnp.sum(old_mask), 1)
    everyone = jnp.sum(old.position * old_mask[:, None], axis=0) / total
    position = jnp.broadcast_to(everyone[None], (num_block, 3))
    placed = jnp.concatenate([jnp.zeros(num_block, bool), old_mask])
    for _ in range(num_block):
        usable = edges & placed[None]
        count = jnp.sum(usable, axis=1)
        mean = usable @ jnp.concatenate([position, old.position]) / jnp.maximum(count, 1)[:, None]
        fresh = (count > 0) & ~placed[:num_block]
        position = jnp.where(fresh[:, None], mean, position)
        placed = placed.at[:num_block].set(placed[:num_block] | fresh)
    alone = (jnp.sum(edges, axis=1) == 1) & ~above
    tokens = jnp.concatenate([position, old.position])
    normal = jnp.concatenate([jnp.zeros_like(position), old.normal])
    step = _in_front(distance, edges, tokens, normal, everyone)
    return position + jnp.where(alone[:, None], step, 0.0)


def _in_front(
    distance: Float[Array, "M tokens"],
    edges: Bool[Array, "M tokens"],
    position: Float[Array, "tokens 3"],
    normal: Float[Array, "tokens 3"],
    everyone: Float[Array, "3"],
) -> Float[Array, "M 3"]:
    """Returns the step from a single neighbour: along a plane's normal, else towards the others."""
    inwards = everyone[None] - position
    inwards = inwards / safe_norm(inwards)[:, None]
    facing = jnp.any(normal != 0, axis=-1, keepdims=True)
    return (edges * distance) @ jnp.where(facing, normal, inwards)
