"""Pairs of small graphs, and FGW computed otherwise: by definition, with scipy, with POT."""

import warnings
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import shortest_path

from sg3d_jax.scene.graph import SceneGraph, make_graph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import (
    FLOOR,
    PAPER_ONTOLOGY,
    PART_OF,
    PLANE,
    ROOM,
    WALL,
    Ontology,
)
from sg3d_jax.scene.padding import Capacity, pad

CAPACITY = Capacity(24, 288)


def random_hierarchy(rng: np.random.Generator, rooms: int, noise: float = 0.0) -> SceneGraph:
    """Rooms of four planes on a row, a wall between neighbours, one floor; positions in metres."""
    sides = np.array([[0.0, 2.0, 1.0], [4.0, 2.0, 1.0], [2.0, 0.0, 1.0], [2.0, 4.0, 1.0]])
    planes = np.concatenate([sides + np.array([4.0 * room, 0, 0]) for room in range(rooms)])
    walls = np.array([[4.0 * room, 2.0, 1.0] for room in range(1, rooms)]).reshape(-1, 3)
    centres = np.array([[4.0 * room + 2.0, 2.0, 1.0] for room in range(rooms)])
    label = [PLANE] * len(planes) + [WALL] * len(walls) + [ROOM] * rooms + [FLOOR]
    wall, room, floor = len(planes), len(planes) + len(walls), len(label) - 1
    edges = [(4 * index + side, room + index) for index in range(rooms) for side in range(4)]
    edges += [(4 * index + 1, wall + index) for index in range(rooms - 1)]
    edges += [(4 * index + 4, wall + index) for index in range(rooms - 1)]
    edges += [(room + index, floor) for index in range(rooms)]
    position = np.concatenate([planes, walls, centres, centres.mean(axis=0, keepdims=True)])
    position += rng.normal(size=position.shape) * 0.05
    position[wall:] += rng.normal(size=position[wall:].shape) * noise
    return graph_of(label, position, edges)


def graph_of(
    label: list[int] | np.ndarray,
    position: np.ndarray,
    part_of: list | np.ndarray,
    ontology: Ontology = PAPER_ONTOLOGY,
) -> SceneGraph:
    """A host graph without normals, widths or proximity."""
    return make_graph(label, position, part_of=part_of, ontology=ontology)


def perturb(rng: np.random.Generator, graph: SceneGraph, drop: int, share: float) -> SceneGraph:
    """Moves the new nodes by metres, drops the last `drop` of them and a share of the edges."""
    label, position = graph.nodes.label, graph.nodes.position.copy()
    new = ~graph.nodes.observed
    position[new] += rng.normal(size=(new.sum(), 3))
    keep = len(label) - drop
    pairs = undirected_edges(graph, PART_OF)
    pairs = pairs[(pairs < keep).all(axis=1)]
    pairs = pairs[rng.random(len(pairs)) >= share]
    return graph_of(label[:keep], position[:keep], pairs, ontology_of(graph))


def placed(graph: SceneGraph, position: np.ndarray | jax.Array) -> SceneGraph:
    return graph._replace(nodes=graph.nodes._replace(position=position))


def permute(graph: SceneGraph, order: np.ndarray) -> SceneGraph:
    """The same graph with its nodes listed in another order."""
    slot = np.argsort(order)
    pairs = slot[undirected_edges(graph, PART_OF)]
    return graph_of(graph.nodes.label[order], graph.nodes.position[order], pairs)


def reference_costs(
    generated: SceneGraph, truth: SceneGraph
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Feature distances and both hop matrices, in float64, dummies included."""
    observed = truth.nodes.position[truth.nodes.observed]
    scale = np.sqrt(observed[:, :2].var(axis=0).mean()) or 1.0
    size = max(len(generated.nodes.label), len(truth.nodes.label))
    features, hops, longest = [], [], []
    for graph in (generated, truth):
        count = len(graph.nodes.label)
        row = np.zeros((size, 3 + ontology_of(graph).num_concepts))
        row[:count, :3] = (graph.nodes.position - observed.mean(axis=0)) / scale
        row[np.arange(count), 3 + graph.nodes.label] = 1.0
        adjacency = np.zeros((count, count))
        adjacency[tuple(undirected_edges(graph, PART_OF).T)] = 1.0
        path = shortest_path(adjacency, directed=False, unweighted=True)
        path[np.isinf(path)] = 1 + path[np.isfinite(path)].max()
        padded = np.full((size, size), 1 + path.max())
        padded[:count, :count] = path
        np.fill_diagonal(padded, 0.0)
        features.append(row)
        hops.append(padded)
        longest.append(path.max())
    scale = max(*longest, 1.0)
    distance = np.linalg.norm(features[0][:, None] - features[1][None], axis=-1)
    return distance, hops[0] / scale, hops[1] / scale


def random_pairs() -> tuple[list[SceneGraph], list[SceneGraph]]:
    """Generated and true graphs of one to four rooms, of unequal sizes, some disconnected."""
    rng = np.random.default_rng(7)
    truth = [random_hierarchy(rng, rooms) for rooms in (1, 2, 3, 4, 1, 2, 3, 4)]
    drops, shares = (0, 1, 2, 3, 3, 2, 1, 0), (0.0, 0.1, 0.2, 0.3, 0.3, 0.0, 0.5, 0.2)
    made = [perturb(rng, *each) for each in zip(truth, drops, shares, strict=True)]
    return made + truth[:3], truth + made[:3]


def structure_of(plan: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The tensor product sum_kl P_kl |a_ik - b_jl|, by definition."""
    difference = np.abs(left[:, None, :, None] - right[None, :, None, :])
    return np.einsum("ijkl,kl->ij", difference, plan)


def reference_fgw(
    distance: np.ndarray, left: np.ndarray, right: np.ndarray, alpha: float
) -> tuple[float, float, float]:
    """FGW, GW and W by Frank-Wolfe with scipy's assignment and the four-axis tensor."""
    size = len(distance)
    plan = np.full((size, size), 1.0 / size**2)
    for _ in range(100):
        structure = structure_of(plan, left, right)
        gradient = (1 - alpha) * distance + 2 * alpha * structure
        vertex = np.zeros_like(plan)
        vertex[linear_sum_assignment(gradient)] = 1.0 / size
        slope = np.sum(gradient * (vertex - plan))
        if slope > -1e-12:
            break
        curvature = alpha * np.sum(structure_of(vertex - plan, left, right) * (vertex - plan))
        step = min(1.0, -slope / (2 * curvature)) if curvature > 0 else 1.0
        plan = plan + step * (vertex - plan)
    w = np.sum(distance * plan)
    gw = np.sum(structure_of(plan, left, right) * plan)
    return (1 - alpha) * w + alpha * gw, gw, w


def pot_fgw(
    distance: np.ndarray, left: np.ndarray, right: np.ndarray, alpha: float
) -> tuple[float, float, float]:
    """FGW, GW and W by POT's generic conditional gradient with the absolute loss."""
    ot = pot()
    mass = np.full(len(distance), 1.0 / len(distance))

    def energy(plan):
        return np.sum(plan * structure_of(plan, left, right))

    def line_search(cost, plan, direction, *_, **__):
        slope = np.sum(cost_of(plan) * direction)
        curvature = alpha * np.sum(structure_of(direction, left, right) * direction)
        step = min(1.0, -slope / (2 * curvature)) if curvature > 0 else 1.0
        after = plan + step * direction
        return step, 1, (1 - alpha) * np.sum(distance * after) + alpha * energy(after)

    def cost_of(plan):
        return (1 - alpha) * distance + 2 * alpha * structure_of(plan, left, right)

    plan = ot.optim.cg(
        mass,
        mass,
        (1 - alpha) * distance,
        alpha,
        energy,
        lambda plan: 2 * structure_of(plan, left, right),
        np.outer(mass, mass),
        line_search=line_search,
    )
    w, gw = np.sum(distance * plan), energy(plan)
    return (1 - alpha) * w + alpha * gw, gw, w


def pot_squared(
    distance: np.ndarray, left: np.ndarray, right: np.ndarray, alpha: float
) -> tuple[float, float, float]:
    """FGW, GW and W by POT's own solver, whose loss is squared."""
    ot = pot()
    mass = np.full(len(distance), 1.0 / len(distance))
    plan = ot.gromov.fused_gromov_wasserstein(distance, left, right, mass, mass, alpha=alpha)
    w = np.sum(distance * plan)
    difference = np.square(left[:, None, :, None] - right[None, :, None, :])
    gw = np.einsum("ijkl,kl,ij->", difference, plan, plan, optimize=True)
    return (1 - alpha) * w + alpha * gw, gw, w


def pot() -> ModuleType:
    """POT; its import warns of the array libraries that are not there."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("ot")


def on_device(graph: SceneGraph, capacity: Capacity = CAPACITY) -> SceneGraph:
    return jax.tree.map(jnp.asarray, pad(graph, capacity))
