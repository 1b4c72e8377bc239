"""Stage one of FD4: discrete diffusion of the labels and edges of a block, on the rectangle.

Source: paper, Eq. (digress_transition); DiGress; FLAGG for the three marginals and the rectangle.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from sg3d_jax.diffusion import categorical
from sg3d_jax.diffusion.sampler import ancestral_sample
from sg3d_jax.fill.constraints import Rules, constrained, draw_valid, mirrored
from sg3d_jax.fill.protocol import Marginals, Params, Terms, real_pairs
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.graph_transformer import Conditioning, RectangleTransformer
from sg3d_jax.scene.padding import Block

EDGE_WEIGHT = 5.0


class Topology(NamedTuple):
    """Labels and edges of a block: the state that is denoised."""

    label: Array  # int32[M]
    edges: Array  # int32[M, M + N], 0 or 1, symmetric inside the block


def _join(square: Array, cross: Array, block_mask: Array, old_mask: Array) -> Array:
    """Joins both parts of the rectangle and clears what is not a real pair."""
    real = block_mask[:, None] & jnp.concatenate([block_mask, old_mask])[None, :]
    return mirrored(jnp.concatenate([square, cross], axis=1)) * real


Logits = tuple[Float[Array, "M C"], Float[Array, "M tokens 2"]]  # of labels and edges


class Levels(NamedTuple):
    """Signal levels of both parts of a topology at one diffusion time."""

    label: Array  # float[]
    edge: Array  # float[]


def topology_of(block: Block) -> Topology:
    """Returns the clean topology of a block."""
    return Topology(block.label, block.edges.astype(jnp.int32))


def add_noise(
    key: Key[Array, ""],
    topology: Topology,
    signal: Levels,
    block_mask: Bool[Array, " M"],
    old_mask: Bool[Array, " N"],
    marginals: Marginals,
) -> Topology:
    """Draws a noisier topology: from a clean one, that of the time at which signals are such."""
    keys = jax.random.split(key, 3)
    num_block = block_mask.shape[0]
    square, cross = topology.edges[:, :num_block], topology.edges[:, num_block:]
    square = categorical.add_noise(keys[0], square, signal.edge, marginals.block_edge)
    cross = categorical.add_noise(keys[1], cross, signal.edge, marginals.cross_edge)
    label = categorical.add_noise(keys[2], topology.label, signal.label, marginals.label)
    return Topology(label, _join(square, cross, block_mask, old_mask))


def cross_entropies(
    logits_label: Float[Array, "M C"],
    logits_edge: Float[Array, "M tokens 2"],
    block: Block,
    old_mask: Bool[Array, " N"],
) -> Terms:
    """Returns the cross-entropies of the clean labels and edges.

    Each is a mean over the nodes, or over the pairs, of this one graph, so that in a batch every
    graph weighs the same; zero for an empty block.

    Source: FLAGG's loss.
    Differs: FLAGG's per-graph weights hit the wrong elements when a batch has more than one graph.
    """
    square, cross = real_pairs(block.mask, old_mask)
    pairs = jnp.concatenate([square, cross], axis=1)
    label = _cross_entropy(logits_label, block.label)
    edge = _cross_entropy(logits_edge, block.edges.astype(jnp.int32))
    return {"label": _masked_mean(label, block.mask), "edge": _masked_mean(edge, pairs)}


def _cross_entropy(logits: Float[Array, "... C"], target: Int[Array, "..."]) -> Float[Array, "..."]:
    chosen = jnp.take_along_axis(jax.nn.log_softmax(logits), target[..., None], axis=-1)
    return -chosen[..., 0]


def _masked_mean(values: Float[Array, "..."], mask: Bool[Array, "..."]) -> Float[Array, ""]:
    return jnp.sum(values * mask) / jnp.maximum(jnp.sum(mask), 1)


def draw_start(
    key: Key[Array, ""],
    block_mask: Bool[Array, " M"],
    old_mask: Bool[Array, " N"],
    marginals: Marginals,
) -> Topology:
    """Draws pure noise from the marginals."""
    num_block, num_old = block_mask.shape[0], old_mask.shape[0]
    key_label, key_square, key_cross = jax.random.split(key, 3)
    square = categorical.draw_marginal(key_square, (num_block,) * 2, marginals.block_edge)
    cross = categorical.draw_marginal(key_cross, (num_block, num_old), marginals.cross_edge)
    label = categorical.draw_marginal(key_label, (num_block,), marginals.label)
    return Topology(label, _join(square, cross, block_mask, old_mask))


def reverse_step(
    key: Key[Array, ""],
    noisy: Topology,
    logits_label: Float[Array, "M C"],
    logits_edge: Float[Array, "M tokens 2"],
    signal_next: Levels,
    signal_now: Levels,
    block_mask: Bool[Array, " M"],
    old_mask: Bool[Array, " N"],
    marginals: Marginals,
    rules: Rules | None = None,
) -> Topology:
    """Draws the topology at an earlier diffusion time, given the prediction of the clean one.

    Of what the rules forbid, the prediction is zero.

    Source: paper, Eq. (digress_transition).
    """
    # A class of no marginal probability, such as an observed one, would never be left again.
    logits_label = jnp.where((marginals.label > 0)[None], logits_label, -jnp.inf)
    keys = jax.random.split(key, 3)
    probs_label, probs_edge = constrained(rules, logits_label, logits_edge)
    levels = signal_next.edge, signal_now.edge
    num_block = block_mask.shape[0]

    def draw(key: Array, part: slice, marginal: Array) -> Array:
        probs = categorical.posterior(probs_edge[:, part], noisy.edges[:, part], *levels, marginal)
        return categorical.draw(key, probs)

    square = draw(keys[0], slice(None, num_block), marginals.block_edge)
    cross = draw(keys[1], slice(num_block, None), marginals.cross_edge)
    levels_label = signal_next.label, signal_now.label
    probs = categorical.posterior(probs_label, noisy.label, *levels_label, marginals.label)
    label = categorical.draw(keys[2], probs)
    return Topology(label, _join(square, cross, block_mask, old_mask))


def no_logits(
    block_mask: Bool[Array, " M"], old_mask: Bool[Array, " N"], num_concepts: int
) -> Logits:
    """Returns logits that say nothing, of labels and edges: what is predicted before any step."""
    num_block, num_old = block_mask.shape[0], old_mask.shape[0]
    edge = jnp.zeros((num_block, num_block + num_old, 2))
    return jnp.zeros((num_block, num_concepts)), edge


def settled(
    key: Key[Array, ""],
    topology: Topology,
    logits: Logits,
    block_mask: Bool[Array, " M"],
    rules: Rules | None,
) -> tuple[Topology, Bool[Array, " M"]]:
    """Returns the topology at time 0 and which nodes there are.

    Args:
      key: one draw.
      topology: what the last step drew, each edge by itself.
      logits: what it predicted: of them a topology is drawn that obeys the rules.
      block_mask: the nodes that are asked for.
      rules: of the old graph; None to take what the last step drew.
    """
    if rules is None:
        return topology, block_mask
    label, edges, mask = draw_valid(key, rules, *logits, block_mask)
    return Topology(label, edges.astype(jnp.int32)), mask


def loss(
    network: RectangleTransformer,
    params: Params,
    key: Key[Array, ""],
    conditioning: Conditioning,
    block: Block,
    schedule: Float[Array, " times"],
    marginals: Marginals,
) -> Terms:
    """Returns `cross_entropies` at one random diffusion time."""
    key_time, key_noise = jax.random.split(key)
    time = jax.random.randint(key_time, (), 1, schedule.shape[0])
    signal = Levels(schedule[time], schedule[time])
    masks = block.mask, conditioning.mask
    noisy = add_noise(key_noise, topology_of(block), signal, *masks, marginals)
    inputs = conditioning, block.mask, noisy.label, noisy.edges, time.astype(jnp.float32)
    logits = apply(network, params, *inputs)
    return cross_entropies(*logits, block, conditioning.mask)


def sample(
    network: RectangleTransformer,
    params: Params,
    key: Key[Array, ""],
    conditioning: Conditioning,
    block_mask: Bool[Array, " M"],
    schedule: Float[Array, " times"],
    num_steps: int,
    marginals: Marginals,
    rules: Rules | None = None,
) -> tuple[Topology, Bool[Array, " M"]]:
    """Draws the topology of the places in `block_mask` by the reverse process.

    It takes `num_steps` sampling steps, a stride over the trained schedule.

    Returns:
      The topology, and which nodes there are: those that the rules leave room for.
    """
    key_start, key_steps, key_last = jax.random.split(key, 3)
    masks = block_mask, conditioning.mask

    def step(
        key: Array, state: tuple[Topology, Logits], now: Array, then: Array
    ) -> tuple[Topology, Logits]:
        noisy, _ = state
        time = now.astype(jnp.float32)
        logits = apply(network, params, conditioning, block_mask, *noisy, time)
        levels = (Levels(schedule[then], schedule[then]), Levels(schedule[now], schedule[now]))
        return reverse_step(key, noisy, *logits, *levels, *masks, marginals, rules), logits

    start = draw_start(key_start, *masks, marginals), no_logits(*masks, marginals.label.shape[0])
    times = schedule.shape[0] - 1, num_steps
    topology, logits = ancestral_sample(step, start, key_steps, *times)
    return settled(key_last, topology, logits, block_mask, rules)
