import numpy as np
import numpy.testing as npt
import plotly.graph_objects as go

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.io.records import in_terms_of
from sg3d_jax.scene.graph import make_graph, subgraph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF
from sg3d_jax.viz.compare import is_missing, is_odd, mark_traces, matched
from sg3d_jax.viz.style import lifted
from tests.two_rooms import reordered, two_rooms
from tests.viz.small_city import FLOORS, TOP, small_city

WALL, ROOMS, FLOOR = 8, (9, 10), 11  # of `two_rooms`


def with_one_room(graph):
    """Returns the graph with the planes of its second room in the first, and without a wall."""
    pairs = undirected_edges(graph, PART_OF)
    pairs = np.unique(np.where(pairs == ROOMS[1], ROOMS[0], pairs), axis=0)
    whole = make_graph(
        graph.nodes.label,
        graph.nodes.position,
        graph.nodes.normal,
        graph.nodes.width,
        pairs[pairs[:, 1] != WALL],
    )
    return subgraph(whole, [row for row in range(12) if row not in (WALL, ROOMS[1])])


def test_nodes_of_the_same_concept_over_the_same_segments_match_in_any_order():
    order = np.random.default_rng(0).permutation(12)
    npt.assert_array_equal(matched(two_rooms(), reordered(two_rooms(), order)), order)
    furnished = in_terms_of(two_rooms(), FURNISHED_ONTOLOGY)
    npt.assert_array_equal(matched(furnished, two_rooms()), np.arange(12))
    of_four = matched(small_city(), small_city())
    npt.assert_array_equal(of_four, np.arange(27))


def test_what_groups_others_is_odd_and_what_has_no_match_is_missing():
    made, truth = with_one_room(two_rooms()), two_rooms()
    match = matched(made, truth)
    assert np.flatnonzero(is_odd(made, match)).tolist() == [8]  # the room of all
    assert np.flatnonzero(is_missing(truth, match)).tolist() == [WALL, *ROOMS]
    assert match[FLOOR] == 9


def test_segments_that_a_graph_has_not_count_for_nothing():
    seen = subgraph(two_rooms(), [row for row in range(12) if row != 2])
    match = matched(seen, two_rooms())
    assert np.flatnonzero(match < 0).tolist() == [2]
    assert not is_missing(two_rooms(), match).any()
    assert not is_odd(seen, match).any()


def test_marks_stand_where_a_graph_draws_what_is_below_them():
    truth = small_city()
    made = subgraph(truth, [row for row in range(27) if row not in (FLOORS[1] - 1, FLOORS[1], TOP)])
    match = matched(made, truth)
    frames, circles, dashes = mark_traces(made, truth, match, 1.0)
    odd = np.flatnonzero(is_odd(made, match)).tolist()
    assert frames["customdata"] == odd == [len(made.nodes.label) - 2]  # the building above
    npt.assert_allclose(points_of(frames), lifted(made)[odd], atol=1e-3)
    missing = np.flatnonzero(is_missing(truth, match)).tolist()
    assert missing == [FLOORS[1] - 1, FLOORS[1], TOP - 2, TOP]
    assert circles["customdata"] == [len(made.nodes.label) + place for place in range(4)]
    npt.assert_allclose(points_of(circles)[:2, :2], truth.nodes.position[missing[:2], :2])
    planes = lifted(made)[6:10, 2]  # those of the storey
    room, floor = points_of(circles)[:2, 2] - planes.max()
    assert 0 < room < floor < 10
    lines = points_of(dashes).reshape(-1, 3, 3)
    assert len(lines) == 4 + 1 + 2 + 2  # of planes, the room, both floors, both buildings
    assert np.isnan(lines[:, 2]).all()
    assert np.isfinite(lines[:, :2]).all()
    data = [frames, circles, dashes]
    assert len(go.Figure(data).data) == len(data)


def points_of(trace):
    return np.array([trace[axis] for axis in "xyz"], float).T
