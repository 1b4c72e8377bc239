import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.scene.graph import (
    FEATURES,
    Nodes,
    SceneGraph,
    extended,
    features_of,
    make_graph,
    observed_of,
    ontology_of,
    parts_first,
    subgraph,
    undirected_edges,
)
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PART_OF, PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.padding import Capacity, pad
from tests import own_world


def small_graph() -> SceneGraph:
    """Two planes of one room: planes in rows 1 and 2."""
    return make_graph(
        label=[ROOM, PLANE, PLANE],
        position=[[0.5, 0, 0], [0, 0, 0], [1, 0, 0]],
        normal=[[0, 0, 0], [1, 0, 0], [-1, 0, 0]],
        width=[0, 2, 3],
        part_of=[[1, 0], [0, 2]],
        proximity=[[2, 1]],
    )


def random_graph(seed: int, num_nodes: int) -> SceneGraph:
    """Any labels of the made-up ontology, any edges, each in a random direction."""
    rng = np.random.default_rng(seed)
    pairs = np.argwhere(np.triu(rng.random((num_nodes, num_nodes)) < 0.5, 1))
    pairs = rng.permuted(rng.permutation(pairs), axis=1)
    part_of, proximity = np.split(pairs, [len(pairs) // 2])
    position, normal = rng.normal(size=(2, num_nodes, 3))
    label, width = rng.integers(6, size=num_nodes), rng.random(num_nodes)
    return make_graph(label, position, normal, width, part_of, proximity, own_world.ONTOLOGY)


def edges_of(graph: SceneGraph, relation: int) -> set[frozenset[int]]:
    return {frozenset(pair) for pair in undirected_edges(graph, relation).tolist()}


def assert_same_rows(left: SceneGraph, right: SceneGraph, rows: list[int]) -> None:
    """Asserts that the first rows of one graph are certain rows of another, bit for bit."""
    for name in Nodes._fields:
        wanted = np.asarray(getattr(right.nodes, name))[rows]
        npt.assert_array_equal(getattr(left.nodes, name)[: len(rows)], wanted)


def test_every_edge_is_stored_in_both_directions():
    graph = small_graph()
    pairs = set(zip(graph.senders.tolist(), graph.receivers.tolist(), strict=True))
    assert pairs == {(1, 0), (0, 1), (0, 2), (2, 0), (1, 2), (2, 1)}
    assert graph.n_edge.tolist() == [6]
    assert graph.n_node.tolist() == [3]


def test_undirected_edges_are_sorted_and_chosen_by_relation():
    graph = small_graph()
    npt.assert_array_equal(undirected_edges(graph, PART_OF), [[0, 1], [0, 2]])
    npt.assert_array_equal(undirected_edges(graph, PROXIMITY), [[1, 2]])


def test_undirected_edges_leaves_masked_edges_out():
    graph = small_graph()
    none = graph._replace(edges=graph.edges._replace(mask=np.zeros(6, bool)))
    assert undirected_edges(none, PART_OF).shape == (0, 2)


def test_planes_of_keeps_planes_exactly_and_nothing_else():
    planes = observed_of(small_graph())
    npt.assert_array_equal(planes.nodes.position, [[0, 0, 0], [1, 0, 0]])
    npt.assert_array_equal(planes.nodes.width, [2, 3])
    npt.assert_array_equal(planes.nodes.label, [PLANE, PLANE])
    assert len(planes.senders) == 0


def test_a_graph_without_edges_can_be_made():
    graph = make_graph([PLANE], [[0, 0, 0]], [[1, 0, 0]], [1], part_of=[])
    assert len(graph.senders) == 0
    assert graph.nodes.position.dtype == np.float64


def test_features_that_are_not_given_are_zero_and_an_empty_graph_has_their_shapes():
    graph = make_graph([ROOM, ROOM], [[0, 0, 0], [1, 0, 0]])
    empty = make_graph([], [])
    assert empty.nodes.position.shape == (0, 3)
    for name, shape in FEATURES.items():
        npt.assert_array_equal(features_of(graph)[name], np.zeros((2, *shape)))
        assert features_of(empty)[name].shape == (0, *shape)


def test_observed_is_what_the_ontology_says_of_the_label():
    npt.assert_array_equal(small_graph().nodes.observed, [False, True, True])
    world = own_world.own_world()
    expected = np.isin(world.nodes.label, [own_world.PLANE, own_world.PILLAR])
    npt.assert_array_equal(world.nodes.observed, expected)
    assert expected.sum() == own_world.NUM_OBSERVED
    # A label that no concept has is refused when the graph is validated, not here.
    npt.assert_array_equal(make_graph([-1, 0, 6], np.zeros((3, 3))).nodes.observed, [0, 1, 0])


def test_a_graph_carries_its_ontology():
    assert ontology_of(small_graph()) is PAPER_ONTOLOGY
    world = own_world.own_world()
    padded = pad(world, Capacity(32, 160))
    for graph in (world, observed_of(world), extended(world, [], [], []), padded):
        assert ontology_of(graph) is own_world.ONTOLOGY


@given(seed=st.integers(0, 2**32 - 1), num_nodes=st.integers(1, 9), as_mask=st.booleans())
@settings(deadline=None, max_examples=40)
def test_a_subgraph_has_the_edges_between_its_nodes(seed, num_nodes, as_mask):
    graph, rng = random_graph(seed, num_nodes), np.random.default_rng(seed)
    rows = rng.permutation(num_nodes)[: rng.integers(num_nodes + 1)]
    rows = np.sort(rows) if as_mask else rows
    chosen = np.isin(np.arange(num_nodes), rows) if as_mask else rows
    padded = pad(graph, Capacity(num_nodes + 2, len(graph.senders) + 3))
    of_padded = np.append(chosen, [False] * 2) if as_mask else rows
    for found in (subgraph(graph, chosen), subgraph(padded, of_padded)):
        assert found.nodes.label.shape == rows.shape
        assert_same_rows(found, graph, rows.tolist())
        for relation in (PART_OF, PROXIMITY):
            expected = {
                frozenset((new, other))
                for new in range(len(rows))
                for other in range(new)
                if frozenset((int(rows[new]), int(rows[other]))) in edges_of(graph, relation)
            }
            assert edges_of(found, relation) == expected
    bare = subgraph(graph, chosen, edges=False)
    assert_same_rows(bare, graph, rows.tolist())
    assert len(bare.senders) == 0


def test_a_subgraph_may_be_empty():
    for rows in ([], np.zeros(3, bool)):
        assert len(subgraph(small_graph(), rows).nodes.label) == 0


@given(seed=st.integers(0, 2**32 - 1), num_nodes=st.integers(1, 7), num_new=st.integers(0, 4))
@settings(deadline=None, max_examples=30)
def test_extending_appends_nodes_and_keeps_all_that_was(seed, num_nodes, num_new):
    graph, rng = random_graph(seed, num_nodes), np.random.default_rng(seed)
    label, position = rng.integers(2, 6, num_new), rng.normal(size=(num_new, 3))
    size = num_nodes + num_new
    pairs = [(i, j) for j in range(num_nodes, size) for i in range(j) if rng.random() < 0.5]
    grown = extended(graph, label, position, pairs)
    assert_same_rows(grown, graph, list(range(num_nodes)))
    npt.assert_array_equal(grown.nodes.label[num_nodes:], label)
    npt.assert_array_equal(grown.nodes.position[num_nodes:], position)
    assert not grown.nodes.observed[num_nodes:].any()
    assert all(not feature[num_nodes:].any() for feature in features_of(grown).values())
    assert edges_of(grown, PROXIMITY) == edges_of(graph, PROXIMITY)
    assert edges_of(grown, PART_OF) == edges_of(graph, PART_OF) | {frozenset(p) for p in pairs}


@given(seed=st.integers(0, 2**32 - 1), num_nodes=st.integers(1, 9))
@settings(deadline=None, max_examples=30)
def test_parts_come_before_their_wholes(seed, num_nodes):
    graph = random_graph(seed, num_nodes)
    label = graph.nodes.label
    expected = [
        (j, i) if label[j] < label[i] else (i, j)
        for i, j in undirected_edges(graph, PART_OF).tolist()
    ]
    npt.assert_array_equal(parts_first(graph), np.reshape(expected, (-1, 2)))


@pytest.mark.parametrize("name", ["position", *FEATURES])
def test_a_wrong_shape_is_kept_as_it_is_for_validation_to_name(name):
    fields = {"position": np.zeros((3, 3))} | {name: np.zeros((3, 2))}
    graph = make_graph([PLANE] * 3, **fields)
    assert getattr(graph.nodes, name).shape == (3, 2)
