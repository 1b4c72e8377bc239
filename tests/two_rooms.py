"""A scene small enough to compile quickly, and what may be done to it without changing it."""

from collections.abc import Callable
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from sg3d_jax.fill.protocol import Statistics
from sg3d_jax.nn.graph_transformer import Gates
from sg3d_jax.scene.graph import (
    SceneGraph,
    features_of,
    make_graph,
    observed_of,
    ontology_of,
    undirected_edges,
)
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PLANE, PROXIMITY, ROOM, WALL
from sg3d_jax.scene.padding import Block, Capacity, pad, part_of_adjacency
from sg3d_jax.scene.proximity import connect_observed

CAPACITY: Final = Capacity(16, 128)
TWICE: Final = Capacity(32, 256)
NUM_PLANES: Final = 8
LABELS: Final = [PLANE] * NUM_PLANES + [WALL, ROOM, ROOM, FLOOR]
PART_OF_PAIRS: Final = [
    *[(1, 8), (4, 8)],  # the wall between both rooms
    *[(plane, 9) for plane in range(4)],
    *[(plane, 10) for plane in range(4, 8)],
    *[(9, 11), (10, 11)],
]
STATISTICS: Final = Statistics(
    label=(0.0, 0.4, 0.4, 0.2, 0.0, 0.0),
    block_edge=(0.7, 0.3),
    cross_edge=(0.6, 0.4),
    distance_mean=2.0,
    distance_std=0.5,
    position_std=2.5,
)
NO_GATES: Final = Gates(jnp.zeros((0, 0)), jnp.zeros(0, int), jnp.zeros(0, int), None)
WEST, EAST = (0.0, 4.0, 0.0, 3.0), (4.2, 9.0, 0.1, 3.4)  # x and y of both rooms, metres


_connect = jax.jit(connect_observed)


def planes_of_room(
    left: float, right: float, low: float, high: float
) -> tuple[list[tuple[float, float]], list[tuple[float, float]], list[float]]:
    """Returns centroids, normals and widths of the planes: left, right, low, high."""
    x, y = (left + right) / 2, (low + high) / 2
    centroid = [(left, y), (right, y), (x, low), (x, high)]
    normal = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
    return centroid, normal, [high - low, high - low, right - left, right - left]


def two_rooms() -> SceneGraph:
    """Returns the host graph: eight planes, a wall, two rooms, a floor; some planes are near."""
    rooms = [planes_of_room(*room) for room in (WEST, EAST)]
    centroid, normal, width = ([row for room in rooms for row in room[i]] for i in range(3))
    position, normals, widths = np.zeros((12, 3)), np.zeros((12, 3)), np.zeros(12)
    position[:NUM_PLANES, :2], normals[:NUM_PLANES, :2] = centroid, normal
    position[:NUM_PLANES, 2] = np.linspace(1.2, 1.5, NUM_PLANES)
    widths[:NUM_PLANES] = width
    position[8] = position[[1, 4]].mean(axis=0)
    position[9], position[10] = position[:4].mean(axis=0), position[4:8].mean(axis=0)
    position[11] = position[[9, 10]].mean(axis=0)
    near = [(i, j) for i in range(NUM_PLANES) for j in range(i) if (i * j) % 3 != 1]
    return make_graph(LABELS, position, normals, widths, PART_OF_PAIRS, near)


def on_device(graph: SceneGraph, capacity: Capacity = CAPACITY) -> SceneGraph:
    return jax.tree.map(jnp.asarray, pad(graph, capacity))


def observed(graph: SceneGraph) -> SceneGraph:
    """Returns the planes of a host graph on the device, connected."""
    return _connect(on_device(observed_of(graph)))


def all_at_once() -> Block:
    """Returns the wall, the rooms and the floor as one block on the planes."""
    graph = on_device(two_rooms())
    adjacency = part_of_adjacency(graph)[NUM_PLANES:12]
    old = adjacency.at[:, NUM_PLANES:].set(False)
    edges = jnp.concatenate([adjacency[:, NUM_PLANES:12], old], axis=1)
    new = jax.tree.map(lambda field: field[NUM_PLANES:12], graph.nodes)
    return Block(new.label, new.position, edges, new.mask)


def moved(
    graph: SceneGraph, angle: float = 0.0, offset: tuple[float, ...] = (0, 0, 0), flip: bool = False
) -> SceneGraph:
    """Turns a host graph about the vertical, mirrors it in a vertical plane, and shifts it."""
    matrix = rotation(angle) @ np.diag([1, -1 if flip else 1, 1])
    nodes = graph.nodes
    position = nodes.position @ matrix.T + np.asarray(offset)
    return graph._replace(nodes=nodes._replace(position=position, normal=nodes.normal @ matrix.T))


def rotation(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])


def reordered(graph: SceneGraph, order: np.ndarray) -> SceneGraph:
    """Renumbers a host graph: node i of the result is node order[i]; its edges come backwards."""
    place = np.argsort(order)
    part_of, proximity = (place[undirected_edges(graph, kind)] for kind in (PART_OF, PROXIMITY))
    return make_graph(
        np.asarray(graph.nodes.label)[order],
        np.asarray(graph.nodes.position)[order],
        **{name: np.asarray(array)[order] for name, array in features_of(graph).items()},
        part_of=part_of[::-1],
        proximity=proximity[::-1],
        ontology=ontology_of(graph),
    )


def with_garbage(graph: SceneGraph, seed: int) -> SceneGraph:
    """Writes finite nonsense into every padding slot of a padded graph."""
    rng = np.random.default_rng(seed)
    num_nodes, num_edges = len(graph.nodes.mask), len(graph.edges.mask)
    node_mask, edge_mask = np.asarray(graph.nodes.mask), np.asarray(graph.edges.mask)

    def spoilt(real: jax.Array, mask: np.ndarray, nonsense: np.ndarray) -> jax.Array:
        mask = mask.reshape(-1, *[1] * (real.ndim - 1))
        return jnp.asarray(np.where(mask, real, nonsense).astype(real.dtype))

    nodes, edges = graph.nodes, graph.edges
    labels = rng.integers(ontology_of(graph).num_concepts, size=num_nodes)
    relations = rng.integers(2, size=num_edges)
    ends = rng.integers(num_nodes, size=(2, num_edges))
    vectors = rng.normal(0, 50, (2, num_nodes, 3))
    return graph._replace(
        nodes=nodes._replace(
            label=spoilt(nodes.label, node_mask, labels),
            position=spoilt(nodes.position, node_mask, vectors[0]),
            normal=spoilt(nodes.normal, node_mask, vectors[1]),
            width=spoilt(nodes.width, node_mask, rng.normal(0, 50, num_nodes)),
        ),
        edges=edges._replace(relation=spoilt(edges.relation, edge_mask, relations)),
        senders=spoilt(graph.senders, edge_mask, ends[0]),
        receivers=spoilt(graph.receivers, edge_mask, ends[1]),
    )


def random_params(init: Callable[..., Any], *inputs: Any, seed: int = 0) -> Any:
    """Returns parameters of the shapes of `init(key, *inputs)`, without compiling initialisers."""
    shapes = jax.eval_shape(init, jax.random.key(0), *inputs)
    rng = np.random.default_rng(seed)
    # Cast by numpy: JAX compiles a program for each shape.
    return jax.tree.map(
        lambda leaf: jnp.asarray(np.asarray(rng.normal(0, 0.4, leaf.shape), "f")), shapes
    )
