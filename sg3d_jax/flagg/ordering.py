"""Insertion orders of the nodes of a scene graph: H and HP.

A rank array gives every node that is grown its place in the order, from 0; observed nodes have rank
-1 (they are there before the first step) and padding has rank N. The survivors of a removal are
then the nodes with `rank < number of survivors`.

Source: paper, Sec. "Orderings for 3DSGs".
"""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.scene.graph import SceneGraph, ontology_of
from sg3d_jax.scene.ontology import Ontology

Ordering = Literal["H", "HP"]


def insertion_rank(
    graph: SceneGraph,
    key: Key[Array, ""],
    ordering: Ordering = "H",
    layers: tuple[str, ...] = (),
) -> Int[Array, " N"]:
    """Draws an insertion order of the nodes that are grown.

    Args:
      graph: padded.
      key: a new key gives a new order.
      ordering: "H", uniformly random inside a layer, or "HP", by distance from a random node of
        the layer, outwards.
      layers: the concepts in the order of their insertion (sigma_C); empty for bottom-up.

    Returns:
      The rank of every node: -1 for observed ones, N for padding.

    Raises:
      ValueError: layers do not name every concept that is grown once.

    Source: paper, Eq. for sigma_H and sigma_P.
    Differs: the printed sigma_P compares d(start, w) with d(v, w); we rank by d(start, v), as the
    text says.
    """
    key_tie, key_start = jax.random.split(key)
    nodes = graph.nodes
    num_nodes = nodes.mask.shape[0]
    ontology = ontology_of(graph)
    order_of_layers = grown_layers(ontology, layers)
    layer_of = jnp.asarray(
        [order_of_layers.index(name) if name in order_of_layers else -1 for name in ontology.names]
    )
    layer = jnp.where(nodes.mask, layer_of[nodes.label], len(layer_of))
    tie = jax.random.uniform(key_tie, (num_nodes,))
    distance = jnp.zeros(num_nodes)
    if ordering == "HP":
        distance = _distance_from_start(graph, key_start)
    order = jnp.lexsort((tie, distance, layer))
    place = jnp.zeros(num_nodes, jnp.int32).at[order].set(jnp.arange(num_nodes, dtype=jnp.int32))
    rank = jnp.where(nodes.observed, -1, place - jnp.sum(nodes.observed, dtype=jnp.int32))
    return jnp.where(nodes.mask, rank, num_nodes)


def grown_layers(ontology: Ontology, layers: tuple[str, ...] = ()) -> list[str]:
    """Returns the concepts that are grown, in the order of their insertion.

    Args:
      ontology: the concepts.
      layers: their names in some order, with those that are observed or without; empty for
        bottom-up.

    Raises:
      ValueError: layers do not name each of them once.
    """
    given = {concept.name for concept in ontology.concepts if concept.observed}
    grown = [name for name in ontology.names if name not in given]
    order = [name for name in layers if name not in given] if layers else grown
    if sorted(order) != sorted(grown):
        raise ValueError(
            f"flagg.layers must name each of {', '.join(grown)} once, got {', '.join(layers)}"
        )
    return order


def is_upper(ontology: Ontology, first: str, layers: tuple[str, ...] = ()) -> np.ndarray:
    """Returns bool[C], which concepts are one or come after it; none if it is empty."""
    order = grown_layers(ontology, layers)
    upper = order[order.index(first) :] if first else []
    return np.isin(ontology.names, upper)


def _distance_from_start(graph: SceneGraph, key: Key[Array, ""]) -> Float[Array, " N"]:
    """Returns the distance of every node from one random node of its own concept, metres."""
    nodes = graph.nodes
    concepts = jnp.arange(ontology_of(graph).num_concepts)
    member = nodes.mask[None] & (nodes.label[None] == concepts[:, None])
    score = jnp.where(member, jax.random.uniform(key, member.shape), -1.0)
    start = jnp.take(nodes.position, jnp.argmax(score, axis=-1), axis=0)
    return jnp.linalg.norm(nodes.position - start[nodes.label], axis=-1)
