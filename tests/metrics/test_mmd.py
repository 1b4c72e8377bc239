from collections.abc import Sequence
from typing import Final

import jax
import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.metrics.gin import gin_embedding, init_gin
from sg3d_jax.metrics.mmd import embedding_mmd, histogram_mmd, mmd_scores
from sg3d_jax.scene.graph import SceneGraph, make_graph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PLANE, ROOM
from sg3d_jax.scene.padding import Capacity, pad
from tests.unchecked import unchecked

NAMES: Final = {"degree", "clustering", "spectrum", "gin"}

embed = jax.jit(gin_embedding)


def scene(graph: nx.Graph, proximity: Sequence[tuple[int, int]] = ()) -> SceneGraph:
    """A scene graph that has the edges of another; labels and positions do not count."""
    count = graph.number_of_nodes()
    label = [PLANE] * (count - 1) + [ROOM] * min(count, 1)
    zeros = np.zeros((count, 3))
    return make_graph(label, zeros, zeros, np.zeros(count), list(graph.edges), proximity)


def random_scenes(number: int, p: float, seed: int) -> list[SceneGraph]:
    sizes = np.random.default_rng(seed).integers(5, 15, number)
    return [scene(nx.gnp_random_graph(int(n), p, seed=seed + i)) for i, n in enumerate(sizes)]


def reordered(graph: SceneGraph, seed: int) -> SceneGraph:
    place = np.random.default_rng(seed).permutation(len(graph.nodes.label))
    label, position = (
        field[np.argsort(place)] for field in (graph.nodes.label, graph.nodes.position)
    )
    return make_graph(label, position, part_of=place[undirected_edges(graph, PART_OF)][::-1])


def as_networkx(graph: SceneGraph) -> nx.Graph:
    result = nx.empty_graph(len(graph.nodes.label))
    result.add_edges_from(undirected_edges(graph, PART_OF).tolist())
    return result


def histograms(graph: nx.Graph) -> tuple[np.ndarray, ...]:
    eigenvalues = np.linalg.eigvalsh(nx.normalized_laplacian_matrix(graph).toarray())
    counts = (
        np.bincount([degree for _, degree in graph.degree], minlength=20),
        np.histogram(list(nx.clustering(graph).values()), 100, (0.0, 1.0))[0],
        np.histogram(np.minimum(eigenvalues, 2.0), 200, (-1e-5, 2.0))[0],
    )
    return tuple(each / each.sum() for each in counts)


def embeddings(graphs: Sequence[SceneGraph], network: int) -> np.ndarray:
    gin = jax.jit(init_gin)(jax.random.split(jax.random.key(0), 10)[network])
    rows = []
    for graph in map(as_networkx, graphs):
        adjacency = np.zeros((16, 16), bool)
        adjacency[: len(graph), : len(graph)] = nx.to_numpy_array(graph) > 0
        rows.append(embed(gin, adjacency, np.arange(16) < len(graph)))
    return np.array(rows, float)


def mmd_by_loops(left: Sequence, right: Sequence, bandwidths: Sequence[float]) -> float:
    """The definition, pair by pair."""

    def mean_kernel(first: Sequence, second: Sequence, sigma: float) -> float:
        squared = [np.linalg.norm(x - y) ** 2 for x in first for y in second]
        return float(np.mean(np.exp(-np.array(squared) / (2 * sigma**2))))

    return max(
        mean_kernel(left, left, s) + mean_kernel(right, right, s) - 2 * mean_kernel(left, right, s)
        for s in bandwidths
    )


def test_histogram_scores__are_those_of_networkx_and_numpy():
    generated, reference = random_scenes(9, 0.3, seed=0), random_scenes(7, 0.15, seed=50)
    found = mmd_scores(generated, reference)
    assert set(found) == NAMES
    left, right = (
        list(zip(*(histograms(as_networkx(graph)) for graph in graphs), strict=True))
        for graphs in (generated, reference)
    )
    bandwidths = [np.exp(-5 + 10 * step / 49) for step in range(30)]
    for name, *sets in zip(("degree", "clustering", "spectrum"), left, right, strict=True):
        assert found[name] == pytest.approx(mmd_by_loops(*sets, bandwidths), abs=1e-9)
        assert found[name] > 0.05


def test_gin_score__is_the_mean_over_networks_of_standardised_embeddings():
    generated, reference = random_scenes(9, 0.3, seed=0), random_scenes(7, 0.15, seed=50)
    expected = []
    for network in range(10):
        left, right = (embeddings(graphs, network) for graphs in (generated, reference))
        varies = np.ptp(right, axis=0) > 0
        scale = np.where(varies, right.std(axis=0), 1.0)
        left, right = (left - right.mean(axis=0)) / scale, (right - right.mean(axis=0)) / scale
        squared = [np.linalg.norm(x - y) ** 2 for x in left for y in right]
        multiples = np.array([0.01, 0.1, 0.25, 0.5, 0.75, 1, 2.5, 5, 7.5, 10])
        expected.append(mmd_by_loops(left, right, multiples * np.mean(squared) ** 0.5))
    assert np.ptp(expected) > 1e-3
    found = mmd_scores(generated, reference)
    assert found["gin"] == pytest.approx(np.mean(expected), abs=1e-4)
    assert mmd_scores(generated, reference, gin_seed=1)["gin"] != pytest.approx(found["gin"])


@given(st.integers(0, 1000), st.sampled_from([1, 3]))
@settings(deadline=None, max_examples=10)
def test_equal_sets__score_zero_in_whatever_order_their_graphs_and_nodes_come(seed, number):
    graphs = random_scenes(number, 0.3, seed)
    shuffled = [reordered(graph, seed) for graph in graphs[::-1]]
    assert mmd_scores(shuffled, graphs) == pytest.approx(dict.fromkeys(NAMES, 0.0), abs=1e-9)


def test_scores__ignore_padding_and_proximity_edges():
    generated, reference = random_scenes(3, 0.3, seed=0), random_scenes(3, 0.15, seed=50)
    near = [scene(as_networkx(graph), proximity=[(0, 1), (2, 4)]) for graph in generated]
    padded = [pad(graph, Capacity(24, 512)) for graph in near]
    expected = mmd_scores(generated, reference)
    assert mmd_scores(padded, reference) == pytest.approx(expected, abs=1e-9)


def test_score__is_two_where_the_sets_have_nothing_in_common():
    stars, points = [scene(nx.star_graph(6))] * 3, [scene(nx.empty_graph(7))] * 3
    expected = dict.fromkeys(NAMES, 2.0) | {"clustering": 0.0}  # neither has a triangle
    assert mmd_scores(stars, points) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    "odd",
    [nx.empty_graph(1), nx.empty_graph(9), nx.disjoint_union(nx.path_graph(3), nx.cycle_graph(4))],
    ids=["single node", "no edges", "disconnected"],
)
def test_odd_graphs__are_scored(odd):
    scores = mmd_scores([scene(odd)] * 3, random_scenes(3, 0.3, seed=0))
    assert all(0 <= score <= 2 for score in scores.values())
    assert scores["degree"] > 0.1


def test_graphs_without_nodes__are_left_out_but_must_not_be_all():
    nothing, graphs = scene(nx.empty_graph(0)), random_scenes(3, 0.3, seed=0)
    scores = mmd_scores([nothing, *graphs], graphs)
    assert scores == pytest.approx(dict.fromkeys(NAMES, 0.0), abs=1e-9)
    with pytest.raises(ValueError, match="got 0 generated and 3 true"):
        mmd_scores([nothing], graphs)


def test_single_graphs__agree_or_are_as_far_apart_as_can_be():
    path, cycle = (scene(graph) for graph in (nx.path_graph(9), nx.cycle_graph(9)))
    assert mmd_scores([reordered(path, 0)], [path]) == dict.fromkeys(NAMES, 0.0)
    assert mmd_scores([cycle], [path])["gin"] == pytest.approx(2)


def test_a_worse_generator__scores_worse():
    reference = random_scenes(20, 0.15, seed=50)
    close = mmd_scores(random_scenes(20, 0.15, seed=0), reference)
    far = mmd_scores(random_scenes(20, 0.5, seed=0), reference)
    assert all(far[name] > 2 * close[name] for name in NAMES)


def test_scores_of_arrays__work_in_float32_and_have_finite_gradients():
    rng = np.random.default_rng(0)
    left, right = rng.random((5, 8), np.float32), rng.random((6, 8), np.float32)
    right[:, 3] = 0.5  # what does not vary over the reference is not standardised
    for mmd in (histogram_mmd, embedding_mmd):
        value, gradient = jax.jit(jax.value_and_grad(mmd))(left, right)
        assert value.dtype == np.float32
        assert 0 < value <= 2
        assert np.isfinite(gradient).all()


def test_scores__do_not_depend_on_the_promotion_of_types():
    graphs = (graph for graph in random_scenes(3, 0.3, seed=0))
    with jax.numpy_dtype_promotion("strict"):
        scores = mmd_scores(graphs, random_scenes(3, 0.3, seed=0))
    assert scores == pytest.approx(dict.fromkeys(NAMES, 0.0), abs=1e-9)


def test_one_graph_in_place_of_a_list_is_refused():
    graph = scene(nx.path_graph(3))
    with unchecked(), pytest.raises(ValueError, match="got one scene graph, expected a list"):
        mmd_scores(graph, [graph])
