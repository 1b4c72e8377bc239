"""Noise augmentation of the conditioning graph, against exposure bias.

Source: paper, Sec. "Noise augmentation". The values are not printed there; ours are the defaults.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from sg3d_jax.scene.graph import Edges, SceneGraph, ontology_of
from sg3d_jax.scene.ontology import PART_OF
from sg3d_jax.scene.padding import part_of_adjacency


@dataclasses.dataclass(frozen=True)
class CorruptionConfig:
    """How much the conditioning graph is perturbed in training."""

    p_node: float = 0.01  # chance that a grown node gets another label
    p_drop: float = 0.01  # chance that an edge with a grown end is removed
    p_add: float = 0.0005  # chance that a missing such edge is inserted; pairs outnumber edges 20:1
    sigma_position: float = 0.05  # metres
    added_per_node: float = 0.0  # mean number of inserted edges, a node, beside those of p_add


def corrupt(graph: SceneGraph, key: Key[Array, ""], config: CorruptionConfig) -> SceneGraph:
    """Perturbs labels, positions and edges of the grown nodes; observed ones are protected.

    Args:
      graph: padded, `E` edges of capacity.
      key: a new key gives a new perturbation.
      config: its strength.

    Returns:
      A graph with `2 added_slots(N, config)` more edges of capacity, so that insertions always have
      room. Observed nodes and edges between them are untouched.

    Source: paper, Sec. "Noise augmentation".
    """
    key_label, key_position, key_drop, key_add = jax.random.split(key, 4)
    nodes = graph.nodes
    free = nodes.mask & ~nodes.observed
    noise = config.sigma_position * jax.random.normal(key_position, nodes.position.shape)
    perturbed = nodes._replace(
        label=_other_labels(key_label, graph, free, config.p_node),
        position=nodes.position + jnp.where(free[:, None], noise, 0.0),
    )
    drop = _symmetric_uniform(key_drop, nodes.mask.shape[0]) < config.p_drop
    touches_free = free[graph.senders] | free[graph.receivers]
    kept = graph.edges.mask & ~(drop[graph.senders, graph.receivers] & touches_free)
    added = _missing_pairs(graph, key_add, free, config)
    return _with_edges(graph._replace(nodes=perturbed), kept, *added)


def added_slots(num_nodes: int, config: CorruptionConfig) -> int:
    """Returns how many inserted edges there is room for in a graph of N slots.

    Six standard deviations above the mean number of insertions were all pairs missing: not one
    graph in ten million would need more.
    """
    mean = config.p_add * num_nodes * (num_nodes - 1) / 2 + config.added_per_node * num_nodes
    return math.ceil(mean + 6 * math.sqrt(mean) + 4) if mean else 0


def _other_labels(
    key: Key[Array, ""], graph: SceneGraph, free: Bool[Array, " N"], p_node: float
) -> Int[Array, " N"]:
    """Replaces labels, each by one of the other grown concepts with equal chance."""
    key_which, key_shift = jax.random.split(key)
    label, observed = graph.nodes.label, ontology_of(graph).is_observed
    grown = jnp.asarray(np.flatnonzero(~observed))
    place = jnp.asarray(np.cumsum(~observed) - 1)[label]
    shift = jax.random.randint(key_shift, label.shape, 1, max(2, grown.shape[0]))
    other = grown[(place + shift) % grown.shape[0]].astype(label.dtype)
    return jnp.where(free & (jax.random.uniform(key_which, label.shape) < p_node), other, label)


def _symmetric_uniform(key: Key[Array, ""], num_nodes: int) -> Float[Array, "N N"]:
    """Draws one number a pair of nodes."""
    upper = jnp.triu(jax.random.uniform(key, (num_nodes, num_nodes)), 1)
    return upper + upper.T


def _missing_pairs(
    graph: SceneGraph, key: Key[Array, ""], free: Bool[Array, " N"], config: CorruptionConfig
) -> tuple[Int[Array, " A"], Int[Array, " A"], Bool[Array, " A"]]:
    """Chooses pairs without an edge, at least one end free: their two ends, and which are real."""
    mask = graph.nodes.mask
    candidates = jnp.triu(mask[:, None] & mask[None, :] & (free[:, None] | free[None, :]), 1)
    candidates &= ~part_of_adjacency(graph)
    score = jnp.where(candidates, jax.random.uniform(key, candidates.shape), 1.0)
    num_nodes = mask.shape[0]
    pairs_per_node = jnp.sum(candidates) / jnp.sum(mask)
    chance = config.p_add + config.added_per_node / jnp.maximum(pairs_per_node, 1e-3)
    least, pair = jax.lax.top_k(-score.ravel(), min(added_slots(num_nodes, config), score.size))
    return pair // num_nodes, pair % num_nodes, -least < chance


def _with_edges(
    graph: SceneGraph,
    kept: Bool[Array, " E"],
    senders: Int[Array, " A"],
    receivers: Int[Array, " A"],
    real: Bool[Array, " A"],
) -> SceneGraph:
    """Keeps some edges and appends both directions of some part-of pairs."""
    mask = jnp.concatenate([kept, real, real])
    num_edges = jnp.sum(mask, dtype=jnp.int32)
    relation = jnp.full(2 * senders.shape[0], PART_OF, jnp.int32)
    return graph._replace(
        edges=Edges(jnp.concatenate([graph.edges.relation, relation]), mask),
        senders=jnp.concatenate(
            [graph.senders, senders.astype(jnp.int32), receivers.astype(jnp.int32)]
        ),
        receivers=jnp.concatenate(
            [graph.receivers, receivers.astype(jnp.int32), senders.astype(jnp.int32)]
        ),
        n_edge=jnp.stack([num_edges, mask.shape[0] - num_edges]),
    )
