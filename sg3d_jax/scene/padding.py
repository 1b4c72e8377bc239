"""Fixed capacities: buckets, padding, stacking, and appending a block to a packed graph.

Padding nodes are zero; padding edges are loops on slot 0 with a False mask, so that a gather stays
in range and a masked sum ignores them.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sg3d_jax.scene.graph import Edges, Nodes, PackedGraph, SceneGraph, subgraph
from sg3d_jax.scene.ontology import PART_OF

NODE_CAPACITIES = (16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048)
EDGES_PER_NODE = 12  # proximity edges are about 12 a plane (both directions), part-of 2.5 a node


class Capacity(NamedTuple):
    """Static sizes of a padded graph; one compilation a capacity."""

    nodes: int  # N
    edges: int  # E


class Block(NamedTuple):
    """New nodes of one growth step and their edges; padding rows are False in `mask`."""

    label: Array  # int32[M]
    position: Array  # float[M, 3], metres
    edges: Array  # bool[M, M + N], to the block itself (symmetric) and to the old graph
    mask: Array  # bool[M]


def bucket(num_nodes: int, num_edges: int = 0) -> Capacity:
    """Returns the smallest capacity that holds a graph.

    Raises:
      ValueError: the graph exceeds the largest capacity.
    """
    for nodes in NODE_CAPACITIES:
        if num_nodes <= nodes and num_edges <= EDGES_PER_NODE * nodes:
            return Capacity(nodes, EDGES_PER_NODE * nodes)
    raise ValueError(
        f"a graph of {num_nodes} nodes and {num_edges} directed edges exceeds the largest "
        f"capacity, {NODE_CAPACITIES[-1]} nodes and {EDGES_PER_NODE * NODE_CAPACITIES[-1]} edges"
    )


def pad(graph: SceneGraph, capacity: Capacity) -> PackedGraph:
    """Pads a host graph to a capacity; still numpy, in the types that it has.

    JAX rounds positions to float32 when it takes them over, which far from the origin loses
    centimetres (at 100 km, 8 mm): move graphs there first, or leave it to `complete` and `fgw`.

    Raises:
      ValueError: the graph does not fit.
    """
    capacity = Capacity(*capacity)
    num_nodes, num_edges = len(graph.nodes.label), len(graph.senders)
    if num_nodes > capacity.nodes or num_edges > capacity.edges:
        raise ValueError(
            f"a graph of {num_nodes} nodes and {num_edges} directed edges does not fit in "
            f"{capacity}"
        )

    def grow(array: np.ndarray, size: int) -> np.ndarray:
        array = np.asarray(array)
        padded = np.zeros((size, *array.shape[1:]), array.dtype)
        padded[: len(array)] = array
        return padded

    return PackedGraph(
        nodes=Nodes(*(grow(field, capacity.nodes) for field in graph.nodes)),
        edges=Edges(*(grow(field, capacity.edges) for field in graph.edges)),
        senders=grow(graph.senders, capacity.edges),
        receivers=grow(graph.receivers, capacity.edges),
        n_node=np.array([num_nodes, capacity.nodes - num_nodes], np.int32),
        n_edge=np.array([num_edges, capacity.edges - num_edges], np.int32),
        globals=graph.globals,
    )


def unpad(graph: SceneGraph) -> SceneGraph:
    """Returns the real nodes and edges of one graph as a host graph; without padding, as it is.

    Raises:
      ValueError: it is a stack of graphs, or something else.
    """
    if not isinstance(graph, SceneGraph):
        inside = ", such as its `graph`" if hasattr(graph, "graph") else ""
        raise ValueError(f"got {type(graph).__name__}, expected a scene graph{inside}")
    shape = np.shape(graph.nodes.mask)
    if len(shape) != 1:
        raise ValueError(
            f"a stack of graphs of the shape {shape[:-1]}, expected one of them, such as "
            "jax.tree.map(lambda leaf: leaf[0], stack)"
        )
    masks = graph.nodes.mask, graph.edges.mask
    on_host = not isinstance(graph, PackedGraph) and isinstance(masks[0], np.ndarray)
    if on_host and all(mask.all() for mask in masks):
        return graph
    return subgraph(graph, np.asarray(graph.nodes.mask))


def unpad_all(graphs: Iterable[SceneGraph]) -> list[SceneGraph]:
    """Returns what `unpad` makes of each.

    Raises:
      ValueError: it is one graph and no list, or one of them is no graph.
    """
    if isinstance(graphs, SceneGraph):
        raise ValueError("got one scene graph, expected a list of them, such as [graph]")
    return [unpad(graph) for graph in graphs]


def pack(graph: SceneGraph) -> PackedGraph:
    """Moves the real nodes and edges of one padded graph to the first slots, in their order.

    Padding is zero afterwards. On the device; runs under `jit` and `vmap`.
    """
    graph = jax.tree.map(jnp.asarray, graph)
    nodes, edges = graph.nodes, graph.edges
    order, edge_order = (jnp.argsort(~mask, stable=True) for mask in (nodes.mask, edges.mask))
    place = jnp.argsort(order)

    def moved(array: Array, mask: Array, order: Array) -> Array:
        real = mask.reshape(-1, *[1] * (array.ndim - 1))
        return jnp.where(real, array, jnp.zeros_like(array))[order]

    ends = (place[end].astype(end.dtype) for end in (graph.senders, graph.receivers))
    senders, receivers = (moved(end, edges.mask, edge_order) for end in ends)
    return PackedGraph(
        nodes=Nodes(*(moved(field, nodes.mask, order) for field in nodes)),
        edges=Edges(*(moved(field, edges.mask, edge_order) for field in edges)),
        senders=senders,
        receivers=receivers,
        n_node=_counts(nodes.mask),
        n_edge=_counts(edges.mask),
        globals=graph.globals,
    )


def stack(graphs: Sequence[SceneGraph], capacity: Capacity) -> PackedGraph:
    """Pads host graphs to one capacity and stacks them along a new first axis, on the device.

    Raises:
      ValueError: there are no graphs, or one does not fit.
    """
    if not graphs:
        raise ValueError("there are no graphs to stack, expected at least one")
    distinct = {id(graph): graph for graph in graphs}  # a batch may have one many times
    padded = {name: pad(graph, capacity) for name, graph in distinct.items()}
    in_order = [padded[id(graph)] for graph in graphs]
    return jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *in_order))


def part_of_adjacency(graph: SceneGraph) -> Bool[Array, "N N"]:
    """Returns the dense symmetric adjacency of the part-of edges of a padded graph."""
    num_nodes = graph.nodes.mask.shape[0]
    chosen = graph.edges.mask & (graph.edges.relation == PART_OF)
    empty = jnp.zeros((num_nodes, num_nodes), bool)
    return empty.at[graph.receivers, graph.senders].max(chosen)


def masked(graph: SceneGraph, nodes: Bool[Array, " N"], edges: Bool[Array, " E"]) -> SceneGraph:
    """Returns a padded graph with other masks: no longer packed, its slots may have holes."""
    return SceneGraph(
        nodes=graph.nodes._replace(mask=nodes, observed=graph.nodes.observed & nodes),
        edges=graph.edges._replace(mask=edges),
        senders=graph.senders,
        receivers=graph.receivers,
        n_node=_counts(nodes),
        n_edge=_counts(edges),
        globals=graph.globals,
    )


def _counts(mask: Bool[Array, " K"]) -> Int[Array, "2"]:
    """Returns how many slots are real, and how many padding."""
    count = jnp.sum(mask, dtype=jnp.int32)
    return jnp.stack([count, mask.shape[0] - count])


def without_proximity(graph: SceneGraph) -> SceneGraph:
    """Masks the proximity edges out: the final step of growing (paper, Sec. "Generating 3DSGs")."""
    part_of = graph.edges.mask & (graph.edges.relation == PART_OF)
    return masked(graph, graph.nodes.mask, part_of)


def append_block(graph: PackedGraph, block: Block) -> tuple[PackedGraph, Bool[Array, ""]]:
    """Appends a block behind the real nodes of a packed graph.

    Args:
      graph: packed: in one with holes, the next slots are not free. `pack` closes them.
      block: `M` new nodes. Only edges between real ones are appended.

    Returns:
      The grown graph and whether everything fitted. What does not fit is dropped, so a graph that
      did not fit must be discarded or reported.

    Source: paper, Sec. "FLAGG for graph extension" (merging a block with G_{t-1}).
    """
    if not isinstance(graph, PackedGraph):
        raise TypeError("only a PackedGraph can be appended to: `pack` makes one of a padded graph")
    nodes, edges = graph.nodes, graph.edges
    capacity, edge_capacity = nodes.mask.shape[0], edges.mask.shape[0]
    num_old, num_old_edges = graph.n_node[0], graph.n_edge[0]
    num_new = jnp.sum(block.mask, dtype=jnp.int32)
    place = num_old + jnp.cumsum(block.mask, dtype=jnp.int32) - 1
    slots = jnp.where(block.mask, place, capacity)  # dropped if beyond

    def put_nodes(array: Array, new: Array) -> Array:
        return array.at[slots].set(new.astype(array.dtype), mode="drop")

    nodes = nodes._replace(  # what is drawn has no features and is not observed: zero, as padding
        label=put_nodes(nodes.label, block.label),
        position=put_nodes(nodes.position, block.position),
        mask=nodes.mask.at[slots].set(True, mode="drop"),
    )

    wanted, tokens = _new_pairs(block, graph.nodes.mask, slots)
    rank = jnp.cumsum(wanted.ravel(), dtype=jnp.int32).reshape(wanted.shape) - 1
    count = jnp.sum(wanted, dtype=jnp.int32)
    forward = jnp.where(wanted, num_old_edges + 2 * rank, edge_capacity).ravel()
    backward = jnp.where(wanted, num_old_edges + 2 * rank + 1, edge_capacity).ravel()
    new = jnp.broadcast_to(slots[:, None], wanted.shape).ravel()
    old = jnp.broadcast_to(tokens[None, :], wanted.shape).ravel()

    def put(array: Array, at_forward: Array | int, at_backward: Array | int) -> Array:
        array = array.at[forward].set(at_forward, mode="drop")
        return array.at[backward].set(at_backward, mode="drop")

    total, total_edges = num_old + num_new, num_old_edges + 2 * count
    grown = graph._replace(
        nodes=nodes,
        edges=Edges(put(edges.relation, PART_OF, PART_OF), put(edges.mask, True, True)),
        senders=put(graph.senders, new, old),
        receivers=put(graph.receivers, old, new),
        n_node=jnp.stack([total, capacity - total]),
        n_edge=jnp.stack([total_edges, edge_capacity - total_edges]),
    )
    return grown, (total <= capacity) & (total_edges <= edge_capacity)


def _new_pairs(
    block: Block, old_mask: Bool[Array, " N"], slots: Int[Array, " M"]
) -> tuple[Bool[Array, "M M+N"], Int[Array, " M+N"]]:
    """Returns which pairs (block node, token) become edges, each once, and each token's slot."""
    num_block, capacity = block.mask.shape[0], old_mask.shape[0]
    once = jnp.tril(jnp.ones((num_block, num_block), bool), -1)
    once = jnp.concatenate([once, jnp.ones((num_block, capacity), bool)], axis=1)
    real = jnp.concatenate([block.mask, old_mask])
    tokens = jnp.concatenate([slots, jnp.arange(capacity, dtype=jnp.int32)])
    return block.edges & once & real[None, :] & block.mask[:, None], tokens


def centre_of_observed(graph: SceneGraph) -> Float[np.ndarray, "3"]:
    """Returns the mean observed centroid of a host graph, metres; zero if nothing is observed.

    It is the origin that float32 likes best.
    """
    observed = np.asarray(graph.nodes.observed)
    position = np.asarray(graph.nodes.position, np.float64)[observed]
    return position.mean(axis=0) if len(position) else np.zeros(3)


def moved_by(graph: SceneGraph, offset: Float[np.ndarray, "3"]) -> SceneGraph:
    """Shifts the real nodes of a host graph, metres; padding stays zero."""
    nodes = graph.nodes
    shift = np.where(np.asarray(nodes.mask)[:, None], offset[None], 0.0)
    position = np.asarray(nodes.position, np.float64) + shift
    return graph._replace(nodes=nodes._replace(position=position))
