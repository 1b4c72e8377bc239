"""Stage one of FD4: discrete diffusion of the labels and edges of a block, on the rectangle.

Source: paper, Eq. (digress_transition); DiGress; FLAGG for the three marginals and the rectangle.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from sg3d_jax.diffusion import categorical
from sg3d_jax.diffusion.schedules import strided_times
from sg3d_jax.fill.protocol import Params, Statistics, real_pairs
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.graph_transformer import Conditioning, RectangleTransformer
from sg3d_jax.scene.padding import Block

EDGE_WEIGHT = 5.0


class Topology(NamedTuple):
    """Labels and edges of a block: the state that is denoised."""

    label: Array  # int32[M]
    edges: Array  # int32[M, M + N], 0 or 1, symmetric inside the block


def _mirror(square: Array) -> Array:
    """Mirrors the strict lower triangle: one draw a pair."""
    lower = jnp.tril(square, -1)
    return lower + lower.T


def _join(square: Array, cross: Array, block_mask: Array, old_mask: Array) -> Array:
    """Joins both parts of the rectangle and clears what is not a real pair."""
    real = block_mask[:, None] & jnp.concatenate([block_mask, old_mask])[None, :]
    return jnp.concatenate([_mirror(square), cross], axis=1) * real


def add_noise(
    key: Key[Array, ""],
    block: Block,
    old_mask: Bool[Array, " N"],
    signal: Float[Array, ""],
    statistics: Statistics,
) -> Topology:
    """Draws the noisy topology at one signal level."""
    keys = jax.random.split(key, 3)
    num_block = block.mask.shape[0]
    edges = block.edges.astype(jnp.int32)
    square = categorical.add_noise(keys[0], edges[:, :num_block], signal, statistics.block_edge)
    cross = categorical.add_noise(keys[1], edges[:, num_block:], signal, statistics.cross_edge)
    label = categorical.add_noise(keys[2], block.label, signal, statistics.label)
    return Topology(label, _join(square, cross, block.mask, old_mask))


def loss(
    network: RectangleTransformer,
    params: Params,
    key: Key[Array, ""],
    conditioning: Conditioning,
    block: Block,
    schedule: Float[Array, " times"],
    statistics: Statistics,
) -> dict[str, Float[Array, ""]]:
    """Returns the cross-entropies of labels and edges at one random diffusion time.

    Each is a mean over the nodes, or over the pairs, of this one graph, so that in a batch every
    graph weighs the same; zero for an empty block.

    Source: FLAGG's loss, label + 5 x edge.
    Differs: FLAGG's per-graph weights hit the wrong elements when a batch has more than one graph.
    """
    key_time, key_noise = jax.random.split(key)
    time = jax.random.randint(key_time, (), 1, schedule.shape[0])
    noisy = add_noise(key_noise, block, conditioning.mask, schedule[time], statistics)
    logits_label, logits_edge = apply(
        network,
        params,
        conditioning,
        block.mask,
        noisy.label,
        noisy.edges,
        time.astype(jnp.float32),
    )
    square, cross = real_pairs(block.mask, conditioning.mask)
    pairs = jnp.concatenate([square, cross], axis=1)
    cross_entropy_label = _cross_entropy(logits_label, block.label)
    cross_entropy_edge = _cross_entropy(logits_edge, block.edges.astype(jnp.int32))
    return {
        "label": _masked_mean(cross_entropy_label, block.mask),
        "edge": _masked_mean(cross_entropy_edge, pairs),
    }


def _cross_entropy(logits: Float[Array, "... C"], target: Int[Array, "..."]) -> Float[Array, "..."]:
    chosen = jnp.take_along_axis(jax.nn.log_softmax(logits), target[..., None], axis=-1)
    return -chosen[..., 0]


def _masked_mean(values: Float[Array, "..."], mask: Bool[Array, "..."]) -> Float[Array, ""]:
    return jnp.sum(values * mask) / jnp.maximum(jnp.sum(mask), 1)


def sample(
    network: RectangleTransformer,
    params: Params,
    key: Key[Array, ""],
    conditioning: Conditioning,
    block_mask: Bool[Array, " M"],
    schedule: Float[Array, " times"],
    num_steps: int,
    statistics: Statistics,
) -> Topology:
    """Draws the topology of the places in `block_mask` by the reverse process.

    It takes `num_steps` sampling steps, a stride over the trained schedule.
    """
    num_block, old_mask = block_mask.shape[0], conditioning.mask
    key_start, key_steps = jax.random.split(key)
    key_label, key_square, key_cross = jax.random.split(key_start, 3)
    square = categorical.draw_marginal(key_square, (num_block,) * 2, statistics.block_edge)
    cross = categorical.draw_marginal(
        key_cross, (num_block, old_mask.shape[0]), statistics.cross_edge
    )
    start = Topology(
        label=categorical.draw_marginal(key_label, (num_block,), statistics.label),
        edges=_join(square, cross, block_mask, old_mask),
    )

    # A class of no marginal probability, such as the plane, would never be left again.
    possible = statistics.label > 0

    def step(noisy: Topology, inputs: tuple[Array, Array, Array]) -> tuple[Topology, None]:
        key, now, then = inputs
        logits_label, logits_edge = apply(
            network,
            params,
            conditioning,
            block_mask,
            noisy.label,
            noisy.edges,
            now.astype(jnp.float32),
        )
        logits_label = jnp.where(possible[None], logits_label, -jnp.inf)
        levels = schedule[then], schedule[now]
        keys = jax.random.split(key, 3)
        probs_label, probs_edge = jax.nn.softmax(logits_label), jax.nn.softmax(logits_edge)

        def draw(key: Array, probs: Array, state: Array, marginal: Array) -> Array:
            return categorical.draw(key, categorical.posterior(probs, state, *levels, marginal))

        split = (slice(None), slice(None, num_block)), (slice(None), slice(num_block, None))
        square, cross = (
            draw(key, probs_edge[part], noisy.edges[part], marginal)
            for key, part, marginal in zip(
                keys[:2], split, (statistics.block_edge, statistics.cross_edge), strict=True
            )
        )
        label = draw(keys[2], probs_label, noisy.label, statistics.label)
        return Topology(label, _join(square, cross, block_mask, old_mask)), None

    times = strided_times(schedule.shape[0] - 1, num_steps)
    keys = jax.random.split(key_steps, num_steps)
    topology, _ = jax.lax.scan(step, start, (keys, times[:-1], times[1:]))
    return topology
