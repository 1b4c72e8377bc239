"""Noise augmentation of the conditioning graph, against exposure bias.

Source: paper, Sec. "Noise augmentation". The values are not printed there; ours are the defaults.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from sg3d_jax.scene.ontology import NUM_CONCEPTS, PART_OF, PLANE
from sg3d_jax.scene.graph import Edges, SceneGraph
from sg3d_jax.scene.padding import part_of_adjacency


@dataclasses.dataclass(frozen=True)
class CorruptionConfig:
    """How much the conditioning graph is perturbed in training."""

    p_node: float = 0.01  # chance that a high-level node gets another label
    p_drop: float = 0.01  # chance that an edge with a high-level end is removed
    p_add: float = 0.0005  # chance that a missing such edge is inserted; pairs outnumber edges 20:1
    sigma_position: float = 0.05  # metres
    max_added: int = 8  # at most this many inserted edges a graph


def corrupt(graph: SceneGraph, key: Key[Array, ""], config: CorruptionConfig) -> SceneGraph:
    """Perturbs labels, positions and edges of the high-level nodes; planes are protected.

    Args:
      graph: padded, `E` edges of capacity.
      key: a new key gives a new perturbation.
      config: its strength.

    Returns:
      A graph with `E + 2 max_added` edges of capacity, so that insertions always have room. Planes
      and edges between planes are untouched.

    Source: paper, Sec. "Noise augmentation".
    Differs: at most `max_added` edges are inserted in one graph.
    """
    key_label, key_position, key_drop, key_add = jax.random.split(key, 4)
    nodes = graph.nodes
    free = nodes.mask & (nodes.label != PLANE)
    noise = config.sigma_position * jax.random.normal(key_position, nodes.position.shape)
    perturbed = nodes._replace(
        label=_other_labels(key_label, nodes.label, free, config.p_node),
        position=nodes.position + jnp.where(free[:, None], noise, 0.0),
    )
    drop = _symmetric_uniform(key_drop, nodes.mask.shape[0]) < config.p_drop
    touches_free = free[graph.senders] | free[graph.receivers]
    kept = graph.edges.mask & ~(drop[graph.senders, graph.receivers] & touches_free)
    added = _missing_pairs(graph, key_add, free, config)
    return _with_edges(graph._replace(nodes=perturbed), kept, *added)


def _other_labels(
    key: Key[Array, ""], label: Int[Array, " N"], free: Bool[Array, " N"], p_node: float
) -> Int[Array, " N"]:
    """Replaces labels, each by one of the other high-level concepts with equal chance."""
    key_which, key_shift = jax.random.split(key)
    num_high = NUM_CONCEPTS - 1  # all but the plane, which is concept 0
    shift = jax.random.randint(key_shift, label.shape, 1, num_high)
    other = 1 + (label - 1 + shift) % num_high
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
    chosen = candidates & (jax.random.uniform(key, candidates.shape) < config.p_add)
    senders, receivers = jnp.nonzero(chosen, size=config.max_added, fill_value=0)
    return senders, receivers, jnp.arange(config.max_added) < jnp.sum(chosen)


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
