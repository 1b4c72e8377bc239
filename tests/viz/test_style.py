import dataclasses

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.scene.graph import features_of, make_graph
from sg3d_jax.scene.ontology import BUILDING, PAPER_ONTOLOGY, PLANE
from sg3d_jax.scene.validate import validate_graph
from sg3d_jax.viz.style import (
    AZIMUTH,
    called,
    check_confidence,
    crowding,
    faded,
    floor_of,
    lifted,
    plane_segments,
    project,
    styles_of,
    view_of,
)
from tests.colour_vision import EYES, least_apart
from tests.viz.small_city import BUILDINGS, FLOORS, SIDE, TOP, one_room, small_city


def drawn_storeys(graph):
    """Returns the lowest and highest point of each floor's planes and room in the picture."""
    seen = project(lifted(graph), view_of(graph))[:, 1]
    return [(seen[row - 5 : row + 1].min(), seen[row - 5 : row + 1].max()) for row in FLOORS]


def without_edges(graph, parent):
    pairs = np.stack([graph.senders, graph.receivers], axis=-1)[: len(graph.senders) // 2]
    kept = pairs[(pairs != parent).all(axis=-1)]
    nodes = graph.nodes.label, graph.nodes.position
    return make_graph(*nodes, **features_of(graph), part_of=kept)


def test_the_city_of_these_tests_is_sound():
    validate_graph(small_city(), "city")


def test_planes_are_segments_across_their_normal():
    segments = plane_segments(one_room())
    npt.assert_allclose(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1), [6, 4, 5])
    npt.assert_allclose(segments.mean(axis=1), one_room().nodes.position[:3])
    npt.assert_allclose(sorted(segments[0, :, 0]), [-3, 3])
    npt.assert_allclose(sorted(segments[1, :, 1]), [-2, 2])


def test_levels_are_lifted_apart():
    npt.assert_array_equal(lifted(one_room())[:, 2], [1, 1, 1, 3, 4])
    assert [style.lift for style in styles_of(PAPER_ONTOLOGY)] == [0, 1, 2, 3, 4, 5]


def test_lifts_grow_with_large_floors():
    nodes = one_room().nodes
    large = one_room()._replace(nodes=nodes._replace(position=nodes.position * 50))
    lift = lifted(large)[:, 2] - large.nodes.position[:, 2]
    npt.assert_allclose(lift, [0, 0, 0, 2 * 200 / 25, 3 * 200 / 25])


def test_drawing_moves_nodes_only_in_z_and_leaves_the_graph_alone():
    graph = small_city()
    before = graph.nodes.position.copy()
    npt.assert_array_equal(lifted(graph)[:, :2], before[:, :2])
    npt.assert_array_equal(graph.nodes.position, before)


def test_storeys_of_a_building_do_not_overlap_in_the_picture():
    ground, upper, other_ground, other_upper = drawn_storeys(small_city())
    assert ground[1] < upper[0]
    assert other_ground[1] < other_upper[0]


def test_ground_floors_keep_their_height_and_what_is_above_storeys_stays_above():
    graph = small_city()
    points = lifted(graph)
    npt.assert_allclose(points[[0, 12], 2], graph.nodes.position[[0, 12], 2])
    assert points[BUILDINGS[0], 2] > points[FLOORS[1], 2]
    assert points[BUILDINGS[1], 2] > points[FLOORS[3], 2]
    assert points[TOP, 2] > points[BUILDINGS, 2].max()


def test_every_plane_and_room_is_drawn_with_its_floor():
    expected = [*np.repeat(FLOORS, 6), -1, -1, -1]
    assert floor_of(small_city()).tolist() == expected


def test_what_hangs_on_no_floor_is_drawn_on_the_nearest():
    assert floor_of(without_edges(small_city(), parent=10))[6:12].tolist() == [11] * 6


def test_without_floors_nothing_is_pulled_apart():
    planes = make_graph([PLANE] * 2, [[0, 0, 0], [0, 0, 3]], [[1, 0, 0]] * 2, [9, 9], [])
    assert floor_of(planes).tolist() == [-1, -1]
    npt.assert_array_equal(lifted(planes), planes.nodes.position)


def test_floors_side_by_side_stay_side_by_side():
    graph = small_city()
    position = graph.nodes.position.copy()
    position[6:12] += [SIDE + 1, 0, -3]  # the upper storey of the first building
    beside = graph._replace(nodes=graph.nodes._replace(position=position))
    npt.assert_allclose(lifted(beside)[[5, 11], 2], 3)


def test_up_is_up_and_lengths_seen_across_are_true():
    npt.assert_allclose(project(np.array([0.0, 0.0, 1.0]))[0], 0, atol=1e-12)
    assert project(np.array([0.0, 0.0, 1.0]))[1] > 0.5
    axes = project(np.eye(3))
    npt.assert_allclose(axes.T @ axes, np.eye(2), atol=1e-12)


def test_two_buildings_are_seen_side_by_side():
    graph = small_city()
    first, second = graph.nodes.position[BUILDINGS, :2]
    across = project(graph.nodes.position[BUILDINGS], view_of(graph))[:, 0]
    npt.assert_allclose(abs(across[0] - across[1]), np.linalg.norm(first - second), rtol=1e-3)
    assert abs(view_of(graph) - AZIMUTH) <= np.pi / 2
    assert view_of(one_room()) == AZIMUTH


def test_of_several_buildings_none_hides_another():
    corners = [[0, 0, 5], [20, 0, 5], [0, 20, 5], [20, 20, 5]]
    graph = make_graph([BUILDING] * 4, corners, np.zeros((4, 3)), np.zeros(4), [])
    across = np.sort(project(np.array(corners), view_of(graph))[:, 0])
    assert np.diff(across).min() > 8


def test_only_the_dots_of_large_graphs_shrink():
    assert crowding(one_room()) == 1
    label = np.full(1000, PLANE)
    vectors = np.tile([1.0, 0.0, 0.0], (1000, 1))
    assert 0.2 < crowding(make_graph(label, vectors, vectors, np.ones(1000), [])) < 0.5


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("ontology", [PAPER_ONTOLOGY, FURNISHED_ONTOLOGY])
def test_the_colour_blind_can_tell_concepts_apart_from_one_another_and_the_ground(ontology, eye):
    colours = [style.colour for style in styles_of(ontology)]
    assert least_apart([*colours, "#ffffff"], eye) > 25


def test_concepts_are_drawn_in_colours_of_their_own_though_others_are_equal():
    low, *others = PAPER_ONTOLOGY.concepts
    concepts = dataclasses.replace(low, colour="#123456"), *others
    repainted = dataclasses.replace(PAPER_ONTOLOGY, concepts=concepts)
    assert repainted == PAPER_ONTOLOGY
    assert styles_of(PAPER_ONTOLOGY)[0].colour == low.colour
    assert styles_of(repainted)[0].colour == "#123456"


def test_colours_fade_to_white_as_confidence_falls():
    colours = faded("#dc2626", np.array([1.0, 0.7, 0.0, np.nan]))
    assert colours == ["#dc2626", "#ec8a8a", "#fce9e9", "#dc2626"]
    assert faded("#dc2626", np.zeros(0)) == []


def test_confidence_of_another_number_of_nodes_or_edges_is_refused():
    check_confidence(one_room(), np.ones(5), np.ones(4))
    check_confidence(one_room(), None, None)
    with pytest.raises(ValueError, match=r"node_confidence has shape \[4\], expected \[5\]"):
        check_confidence(one_room(), np.ones(4), None)
    with pytest.raises(ValueError, match=r"edge_confidence has shape \[7\], expected \[4\]"):
        check_confidence(one_room(), np.ones(5), np.ones(7))  # proximity has none


@pytest.mark.parametrize(
    ("name", "expected"), [(7, "room 7"), ("room-7", "room-7"), ("roomy", "room roomy")]
)
def test_a_node_is_called_by_its_concept_once(name, expected):
    assert called("room", name) == expected
