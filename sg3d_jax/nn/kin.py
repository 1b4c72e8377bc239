"""Edges between kin, which the encoder of the old graph adds: from nodes of one concept.

What the next layer groups then hears of each other directly, and not by way of a dozen planes and
walls: whether two rooms lie on one floor is a question to these two. The ontology says which
concepts hear of their kin.

Source: ours.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from sg3d_jax.scene.graph import Edges, SceneGraph, ontology_of
from sg3d_jax.scene.ontology import PROXIMITY
from sg3d_jax.scene.proximity import k_nearest


def kin_slots(num_nodes: int) -> int:
    """Returns how many nodes of a graph of N slots may hear of kin.

    A graph with more does not fit and needs the next bucket: growing says so, and training sorts
    graphs by it.
    """
    return num_nodes // 3


def hears_kin(graph: SceneGraph) -> Bool[Array, " N"]:
    """Returns which real nodes hear of their kin."""
    return graph.nodes.mask & jnp.asarray(ontology_of(graph).hears_kin)[graph.nodes.label]


def kin_fit(graph: SceneGraph) -> Bool[Array, ""]:
    """Returns whether all nodes of a padded graph that hear of their kin have a slot."""
    return jnp.sum(hears_kin(graph)) <= kin_slots(graph.nodes.mask.shape[0])


def connect_kin(graph: SceneGraph, k: int) -> SceneGraph:
    """Appends edges from the nearest nodes of a node's own concept.

    Args:
      graph: padded, `N` nodes and `E` edges of capacity.
      k: nearest nodes that each one hears of.

    Returns:
      The graph with `kin_slots(N) k` more edge slots, of directed proximity edges. It is no longer
      packed. Nodes beyond `kin_slots(N)` hear of none: see `kin_fit`.
    """
    nodes = graph.nodes
    chosen, num_kin = hears_kin(graph), kin_slots(nodes.mask.shape[0])
    (slot,) = jnp.nonzero(chosen, size=num_kin, fill_value=0)
    real = jnp.arange(num_kin) < jnp.sum(chosen)
    label = nodes.label[slot]
    pairs = real[:, None] & real[None, :] & (label[:, None] == label[None, :])
    nearest, found = k_nearest(nodes.position[slot], pairs, k)
    receivers = jnp.repeat(slot, nearest.shape[1])
    return with_heard(graph, slot[nearest].ravel(), receivers, found.ravel())


def with_heard(
    graph: SceneGraph,
    senders: Int[Array, " K"],
    receivers: Int[Array, " K"],
    mask: Bool[Array, " K"],
) -> SceneGraph:
    """Appends directed proximity edges, those in the mask real, to a padded graph."""
    senders, receivers = (jnp.where(mask, e, 0).astype(jnp.int32) for e in (senders, receivers))
    count: Int[Array, ""] = jnp.sum(mask, dtype=jnp.int32)
    return SceneGraph(
        nodes=graph.nodes,
        edges=Edges(
            jnp.concatenate([graph.edges.relation, jnp.full_like(senders, PROXIMITY)]),
            jnp.concatenate([graph.edges.mask, mask]),
        ),
        senders=jnp.concatenate([graph.senders, senders]),
        receivers=jnp.concatenate([graph.receivers, receivers]),
        n_node=graph.n_node,
        n_edge=graph.n_edge + jnp.stack([count, mask.shape[0] - count]),
        globals=graph.globals,
    )
