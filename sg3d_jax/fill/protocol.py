"""What every Fill model is, and what it must know of the data."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from sg3d_jax.flagg.removal import Cut
from sg3d_jax.scene.ontology import NUM_CONCEPTS
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.padding import Block

Params = Any


class Statistics(NamedTuple):
    """Noise distributions and scales, counted on the cuts of a training set."""

    label: Array  # float[C], marginal of new labels
    block_edge: Array  # float[2], marginal of {no edge, edge} inside a block
    cross_edge: Array  # float[2], between a block and the old graph
    distance_mean: Array  # float[], metres, on new edges
    distance_std: Array  # float[], metres
    position_std: Array  # float[], metres a coordinate, of new nodes around the old graph's mean


class Fill(NamedTuple):
    """A Fill model: three pure functions on one padded graph; `vmap` them for a batch.

    Attributes:
      init: (key, graph, block) -> params.
      loss: (params, key, graph, block) -> (loss, metrics), both scalars or dicts of scalars; zero
        for an empty block.
      sample: (params, key, graph, block mask) -> block.
    """

    init: Callable[[Key[Array, ""], SceneGraph, Block], Params]
    loss: Callable[
        [Params, Key[Array, ""], SceneGraph, Block],
        tuple[Float[Array, ""], dict[str, Float[Array, ""]]],
    ]
    sample: Callable[[Params, Key[Array, ""], SceneGraph, Bool[Array, " M"]], Block]


def real_pairs(
    block_mask: Bool[Array, " M"], old_mask: Bool[Array, " N"]
) -> tuple[Bool[Array, "M M"], Bool[Array, "M N"]]:
    """Returns which pairs may carry an edge: inside the block (each pair once) and across."""
    once = jnp.tril(block_mask[:, None] & block_mask[None, :], -1)
    return once, block_mask[:, None] & old_mask[None, :]


def frame_centre(position: Float[Array, "N 3"], mask: Bool[Array, " N"]) -> Float[Array, "3"]:
    """Returns the mean position of the real nodes: c_{t-1}, the origin of MiDi's frame.

    Source: paper, Sec. "Adapting MiDi".
    """
    return jnp.sum(position * mask[:, None], axis=0) / jnp.maximum(jnp.sum(mask), 1)


def count_statistics(cuts: Cut) -> Statistics:
    """Counts the marginals and the distance scale on stacked cuts.

    Args:
      cuts: of leading axis `B`, as drawn in training.

    Returns:
      Marginals of labels and of both kinds of edges, mean and spread of the new edges' lengths, and
      spread of the new nodes. The plane label has probability zero.

    Source: DiGress (marginal transitions), FLAGG (three separate marginals).
    Differs: counted before training; FLAGG counts while it already trains.
    """
    block, old = cuts.block, cuts.survivors.nodes
    is_concept = block.label[..., None] == jnp.arange(NUM_CONCEPTS)[None, None]
    label = jnp.sum(is_concept & block.mask[..., None], axis=(0, 1))
    num_block = block.mask.shape[-1]
    once = jnp.tril(jnp.ones((num_block, num_block), bool), -1)[None]
    square = once & block.mask[:, :, None] & block.mask[:, None, :]
    cross = block.mask[:, :, None] & old.mask[:, None, :]
    inside, across = block.edges[..., :num_block], block.edges[..., num_block:]
    tokens = jnp.concatenate([block.position, old.position], axis=1)
    length = jnp.linalg.norm(block.position[:, :, None] - tokens[:, None], axis=-1)
    new = jnp.concatenate([inside & square, across & cross], axis=-1)
    total = jnp.maximum(jnp.sum(new), 1)
    mean = jnp.sum(length * new) / total
    variance = jnp.sum((length - mean) ** 2 * new) / total
    centre = jax.vmap(frame_centre)(old.position, old.mask)
    offset = (block.position - centre[:, None]) * block.mask[..., None]
    spread = jnp.sum(offset**2) / jnp.maximum(3 * jnp.sum(block.mask), 1)

    def binary(edges: Array, pairs: Array) -> Array:
        share = jnp.sum(edges & pairs) / jnp.maximum(jnp.sum(pairs), 1)
        return jnp.stack([1 - share, share])

    return Statistics(
        label=label / jnp.sum(label),
        block_edge=binary(inside, square),
        cross_edge=binary(across, cross),
        distance_mean=mean,
        distance_std=jnp.sqrt(variance) + 1e-3,
        position_std=jnp.sqrt(spread) + 1e-3,
    )
