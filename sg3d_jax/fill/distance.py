"""Stage two of FD4: Gaussian diffusion of the distances on the generated edges.

Source: paper, Eq. (distance_transition); D4 for the process.
Differs: distances are standardised by the training edges; D4 divides by the largest distance, which
leaves a signal far below the noise.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from sg3d_jax.diffusion import gaussian
from sg3d_jax.diffusion.sampler import ancestral_sample
from sg3d_jax.fill.protocol import Params, Statistics, real_pairs
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.embed import safe_norm
from sg3d_jax.nn.graph_transformer import Conditioning, DistanceNetwork
from sg3d_jax.scene.padding import Block


def _symmetric_normal(key: Key[Array, ""], num_block: int, num_old: int) -> Array:
    """Draws one number a pair of the rectangle."""
    noise = jax.random.normal(key, (num_block, num_block + num_old))
    lower = jnp.tril(noise[:, :num_block], -1)
    return jnp.concatenate([lower + lower.T, noise[:, num_block:]], axis=1)


def loss(
    network: DistanceNetwork,
    params: Params,
    key: Key[Array, ""],
    conditioning: Conditioning,
    block: Block,
    schedule: Float[Array, " times"],
    statistics: Statistics,
) -> Float[Array, ""]:
    """Returns the mean squared error of the standardised clean distances at one random time.

    A mean over the new edges of this one graph, on the true edges; zero without edges.
    """
    key_time, key_noise = jax.random.split(key)
    num_block, num_old = block.mask.shape[0], conditioning.mask.shape[0]
    tokens = jnp.concatenate([block.position, conditioning.surface.position])
    clean = safe_norm(block.position[:, None] - tokens[None])
    clean = (clean - statistics.distance_mean) / statistics.distance_std
    time = jax.random.randint(key_time, (), 1, schedule.shape[0])
    signal = schedule[time]
    noise = _symmetric_normal(key_noise, num_block, num_old)
    noisy = gaussian.add_noise(noise, clean, signal)
    predicted = apply(
        network, params, conditioning, block.label, block.edges, noisy, time.astype(jnp.float32)
    )
    square, cross = real_pairs(block.mask, conditioning.mask)
    counted = jnp.concatenate([square, cross], axis=1) & block.edges
    return jnp.sum((predicted - clean) ** 2 * counted) / jnp.maximum(jnp.sum(counted), 1)


def sample(
    network: DistanceNetwork,
    params: Params,
    key: Key[Array, ""],
    conditioning: Conditioning,
    label: Int[Array, " M"],
    edges: Bool[Array, "M tokens"],
    schedule: Float[Array, " times"],
    num_steps: int,
    statistics: Statistics,
) -> Float[Array, "M tokens"]:
    """Draws the lengths of the given edges by the reverse process, metres, at least zero.

    Entries without an edge are meaningless.
    """
    num_block, num_old = label.shape[0], conditioning.mask.shape[0]
    key_start, key_steps = jax.random.split(key)
    start = _symmetric_normal(key_start, num_block, num_old)

    def step(key: Array, noisy: Array, now: Array, then: Array) -> Array:
        predicted = apply(
            network, params, conditioning, label, edges, noisy, now.astype(jnp.float32)
        )
        noise = _symmetric_normal(key, num_block, num_old)
        return gaussian.reverse_step(noise, predicted, noisy, schedule[then], schedule[now])

    standardised = ancestral_sample(step, start, key_steps, schedule.shape[0] - 1, num_steps)
    metres = standardised * statistics.distance_std + statistics.distance_mean
    return jnp.maximum(metres, 0.0)
