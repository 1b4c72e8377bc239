"""Insertion orders of the nodes of a scene graph: H and HP.

A rank array gives every high-level node its place in the order, from 0; observed planes have rank
-1 (they are there before the first step) and padding has rank N. The survivors of a removal are
then the nodes with `rank < number of survivors`.

Source: paper, Sec. "Orderings for 3DSGs".
"""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.scene.ontology import CONCEPTS, NUM_CONCEPTS, PLANE
from sg3d_jax.scene.graph import SceneGraph

Ordering = Literal["H", "HP"]


def insertion_rank(
    graph: SceneGraph,
    key: Key[Array, ""],
    ordering: Ordering = "H",
    layers: tuple[str, ...] = CONCEPTS,
) -> Int[Array, " N"]:
    """Draws an insertion order of the high-level nodes.

    Args:
      graph: padded.
      key: a new key gives a new order.
      ordering: "H", uniformly random inside a layer, or "HP", by distance from a random node of
        the layer, outwards.
      layers: the concepts in the order of their insertion (sigma_C); planes come first.

    Returns:
      The rank of every node: -1 for planes, N for padding.

    Source: paper, Eq. for sigma_H and sigma_P.
    Differs: the printed sigma_P compares d(start, w) with d(v, w); we rank by d(start, v), as the
    text says.
    """
    key_tie, key_start = jax.random.split(key)
    nodes = graph.nodes
    num_nodes = nodes.mask.shape[0]
    layer_of = jnp.asarray([layers.index(concept) for concept in CONCEPTS])
    layer = jnp.where(nodes.mask, layer_of[nodes.label], NUM_CONCEPTS)
    tie = jax.random.uniform(key_tie, (num_nodes,))
    distance = jnp.zeros(num_nodes)
    if ordering == "HP":
        distance = _distance_from_start(graph, key_start)
    order = jnp.lexsort((tie, distance, layer))
    place = jnp.zeros(num_nodes, jnp.int32).at[order].set(jnp.arange(num_nodes, dtype=jnp.int32))
    planes = nodes.mask & (nodes.label == PLANE)
    rank = jnp.where(planes, -1, place - jnp.sum(planes, dtype=jnp.int32))
    return jnp.where(nodes.mask, rank, num_nodes)


def _distance_from_start(graph: SceneGraph, key: Key[Array, ""]) -> Float[Array, " N"]:
    """Returns the distance of every node from one random node of its own concept, metres."""
    nodes = graph.nodes
    member = nodes.mask[None] & (nodes.label[None] == jnp.arange(NUM_CONCEPTS)[:, None])
    score = jnp.where(member, jax.random.uniform(key, member.shape), -1.0)
    start = jnp.take(nodes.position, jnp.argmax(score, axis=-1), axis=0)
    return jnp.linalg.norm(nodes.position - start[nodes.label], axis=-1)
