import numpy as np
import numpy.testing as npt

from sg3d_jax.scene.ontology import PART_OF, PART_OF_RULES, PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.graph import make_graph, observed_of, undirected_edges


def small_graph():
    """Two planes of one room: planes in rows 1 and 2."""
    return make_graph(
        label=[ROOM, PLANE, PLANE],
        position=[[0.5, 0, 0], [0, 0, 0], [1, 0, 0]],
        normal=[[0, 0, 0], [1, 0, 0], [-1, 0, 0]],
        width=[0, 2, 3],
        part_of=[[1, 0], [0, 2]],
        proximity=[[2, 1]],
    )


def test_rules_lead_from_lower_to_higher_concepts():
    assert all(child < parent for child, parent in PART_OF_RULES)


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
