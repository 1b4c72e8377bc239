"""What a model must know of its training set before it is built.

Everything is an expectation over training: each bucket counts by its share of the calls
(`shares_of`), within it every graph and every cut alike.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Key

from sg3d_jax.fill.protocol import Statistics, frame_centre
from sg3d_jax.flagg.compiled import quick_options
from sg3d_jax.flagg.removal import Cut
from sg3d_jax.scene.graph import SceneGraph, ontology_of

CUTS_A_GRAPH = 16
LEAST_SPREAD = 1e-3  # metres


class Moments(NamedTuple):
    """Sums over what is to be drawn after one cut, or means of them over cuts."""

    inside: Array  # float[2], pairs inside the block without and with an edge
    across: Array  # float[2], pairs of block and old graph
    lengths: Array  # float[3], of new edges: their number, sum and sum of squares, metres
    offsets: Array  # float[2], of new nodes from the old graph's mean: coordinates, their squares


def shares_of(stacks: Sequence[SceneGraph]) -> np.ndarray:
    """Returns the share of training that each bucket gets: that of its nodes.

    A graph has as many growth steps as nodes to insert. FLAGG trains on all of them, so a large
    graph counts more; otherwise the large floors among many small ones would hardly be seen.
    """
    sizes = np.array([np.sum(stack.n_node[:, 0]) for stack in stacks])
    return sizes / sizes.sum()


def statistics_of(
    cut_graph: Callable[[Key[Array, ""], SceneGraph], Cut],
    stacks: Sequence[SceneGraph],
    cuts_a_graph: int = CUTS_A_GRAPH,
) -> Statistics:
    """Counts the statistics of a training set, on fixed random cuts of every graph.

    Labels are counted on the graphs themselves: every node of a graph is the next one equally
    often, and a rare concept must not be missed by the cuts.

    Args:
      cut_graph: cuts one complete padded graph as in training.
      stacks: of padded graphs with proximity edges, one a bucket.
      cuts_a_graph: one is enough where every cut of a graph is the same.

    Raises:
      ValueError: there is nothing to grow in any graph.

    Source: DiGress (marginal transitions), FLAGG (three separate marginals).
    Differs: counted before training; FLAGG counts while it already trains.
    """

    def mean_moments(graphs: SceneGraph, key: Key[Array, ""]) -> Moments:
        def of_graph(key: Key[Array, ""], graph: SceneGraph) -> Moments:
            keys = jax.random.split(key, cuts_a_graph)
            return jax.vmap(lambda key: moments_of(cut_graph(key, graph)))(keys)

        keys = jax.random.split(key, graphs.n_node.shape[0])
        moments = jax.lax.map(lambda one: of_graph(*one), (keys, graphs))
        return jax.tree.map(lambda leaf: jnp.mean(leaf, axis=(0, 1)), moments)

    keys, shares = jax.random.split(jax.random.key(0), len(stacks)), shares_of(stacks)
    count = jax.jit(mean_moments, compiler_options=quick_options(growing=True))
    with ThreadPoolExecutor() as pool:  # they compile side by side
        counted = list(pool.map(count, stacks, keys))
    labels = sum(
        share * _label_shares(graphs) for share, graphs in zip(shares, stacks, strict=True)
    )
    if not np.any(labels):
        given = ontology_of(stacks[0]).observed_plural
        raise ValueError(f"no training graph has a node beside its {given}, expected at least one")
    moments = jax.tree.map(
        lambda *leaves: np.tensordot(shares, np.asarray(leaves, np.float64), axes=1), *counted
    )
    number, total, squares = moments.lengths
    mean = total / max(number, 1e-12)
    variance = max(squares / max(number, 1e-12) - mean**2, 0.0)
    spread = moments.offsets[1] / max(moments.offsets[0], 1e-12)
    degree = moments.across[1] / max(moments.offsets[0] / 3, 1e-12)
    return Statistics(
        label=tuple((labels / labels.sum()).tolist()),
        block_edge=tuple(_marginal(moments.inside).tolist()),
        cross_edge=tuple(_marginal(moments.across).tolist()),
        distance_mean=float(mean),
        distance_std=float(np.sqrt(variance) + LEAST_SPREAD),
        position_std=float(np.sqrt(spread) + LEAST_SPREAD),
        cross_degree=float(degree),
    )


def moments_of(cut: Cut) -> Moments:
    """Sums up the block of one cut."""
    block, old = cut.block, cut.survivors.nodes
    num_block = block.mask.shape[0]
    once = jnp.tril(jnp.ones((num_block, num_block), bool), -1)
    square = once & block.mask[:, None] & block.mask[None, :]
    cross = block.mask[:, None] & old.mask[None, :]
    inside, across = block.edges[:, :num_block], block.edges[:, num_block:]
    tokens = jnp.concatenate([block.position, old.position])
    length = jnp.linalg.norm(block.position[:, None] - tokens[None], axis=-1)
    new = jnp.concatenate([inside & square, across & cross], axis=-1)
    centre = frame_centre(old.position, old.mask)
    offset = (block.position - centre[None]) * block.mask[:, None]

    def counts(edges: Bool[Array, "..."], pairs: Bool[Array, "..."]) -> Array:
        return jnp.stack([jnp.sum(pairs & ~edges), jnp.sum(pairs & edges)]).astype(jnp.float32)

    return Moments(
        inside=counts(inside, square),
        across=counts(across, cross),
        lengths=jnp.stack([jnp.sum(new), jnp.sum(length * new), jnp.sum(length**2 * new)]),
        offsets=jnp.stack([3.0 * jnp.sum(block.mask), jnp.sum(offset**2)]),
    )


def _label_shares(graphs: SceneGraph) -> np.ndarray:
    """Returns the mean over a stack of the share of each concept among the grown nodes."""
    nodes = graphs.nodes
    concepts = np.arange(ontology_of(graphs).num_concepts)
    grown = np.asarray(nodes.mask & ~nodes.observed)
    is_concept = np.asarray(nodes.label)[..., None] == concepts[None, None]
    counts = np.sum(is_concept & grown[..., None], axis=1)
    return np.mean(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1), axis=0)


def _marginal(counts: np.ndarray) -> np.ndarray:
    """Returns the shares of {no edge, edge}; no edge where there are no pairs."""
    return counts / counts.sum() if counts.sum() else np.array([1.0, 0.0])
