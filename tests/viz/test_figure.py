import matplotlib.pyplot as plt
import numpy as np
import numpy.testing as npt
import pytest
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgba
from matplotlib.image import imread

from sg3d_jax.scene.graph import make_graph
from sg3d_jax.scene.ontology import CITY, FLOOR, PAPER_ONTOLOGY, PLANE, ROOM, WALL
from sg3d_jax.scene.padding import bucket, pad
from sg3d_jax.viz.figure import contact_sheet, dataset_sheet, draw_graph, save_picture
from sg3d_jax.viz.style import (
    EDGE_COLOUR,
    faded,
    lifted,
    plane_segments,
    project,
    styles_of,
    view_of,
)
from tests.viz.small_city import one_room, small_city

STYLES = styles_of(PAPER_ONTOLOGY)


def test_the_graph_is_not_changed_by_drawing():
    graph = one_room()
    before = graph.nodes.position.copy()
    draw_graph(graph)
    npt.assert_array_equal(graph.nodes.position, before)


def test_part_of_edges_planes_and_nodes_are_drawn_in_their_colours():
    axes = draw_graph(one_room())
    edges, planes = (item for item in axes.collections if isinstance(item, LineCollection))
    assert len(edges.get_segments()) == 4
    assert len(planes.get_segments()) == 3
    assert to_rgba(STYLES[PLANE].colour) == tuple(planes.get_color()[0])
    dots = [item for item in axes.collections if isinstance(item, PathCollection)]
    drawn = {tuple(item.get_facecolor()[0]): len(item.get_offsets()) for item in dots}
    assert drawn == {
        to_rgba(STYLES[PLANE].colour): 3,
        to_rgba(STYLES[ROOM].colour): 1,
        to_rgba(STYLES[FLOOR].colour): 1,
    }


@pytest.mark.parametrize("graph", [one_room(), small_city()], ids=["room", "city"])
def test_everything_lies_inside_the_frame(graph):
    axes = draw_graph(graph)
    points = np.concatenate([lifted(graph), plane_segments(graph).reshape(-1, 3)])
    seen = project(points, view_of(graph))
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    assert np.all(seen >= low[None])
    assert np.all(seen <= high[None])
    assert axes.get_aspect() == 1


def test_padding_is_not_drawn():
    graph = one_room()
    drawn, padded = (draw_graph(one) for one in (graph, pad(graph, bucket(40))))
    for one, other in zip(drawn.collections, padded.collections, strict=True):
        npt.assert_array_equal(one.get_offsets(), other.get_offsets())


def test_axes_of_the_caller_are_used():
    figure, axes = plt.subplots()
    assert draw_graph(one_room(), axes) is axes
    plt.close(figure)


@pytest.mark.parametrize("label", [PLANE, WALL, CITY])
def test_a_single_node_can_be_drawn(tmp_path, label):
    normal, width = ([1, 0, 0], 2) if label == PLANE else ([0, 0, 0], 0)
    save_picture(make_graph([label], [[1, 2, 3]], [normal], [width], []), tmp_path / "a.png")
    assert imread(tmp_path / "a.png").std() > 0


def test_a_picture_is_saved_whole_with_colours_in_it(tmp_path):
    save_picture(one_room(), tmp_path / "a.png", title="a room")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    pixels = imread(tmp_path / "a.png")[..., :3]
    for concept in (PLANE, ROOM, FLOOR):
        distance = np.abs(pixels - to_rgba(STYLES[concept].colour)[:3]).max(axis=-1)
        assert (distance < 0.02).sum() > 20


def test_no_window_is_opened(tmp_path):
    save_picture(one_room(), tmp_path / "a.svg")
    assert plt.get_fignums() == []


NODES, EDGES = np.array([1, 0.5, 0.25, 0.75, 0]), np.array([1, 0.5, 0.25, 0])


def test_what_is_unsure_is_faint():
    drawn = draw_graph(one_room(), node_confidence=NODES, edge_confidence=EDGES).collections
    edges, planes = (item for item in drawn if isinstance(item, LineCollection))
    npt.assert_array_equal(edges.get_color(), [to_rgba(c) for c in faded(EDGE_COLOUR, EDGES)])
    colours = [to_rgba(c) for c in faded(STYLES[PLANE].colour, NODES[:3])]
    npt.assert_array_equal(planes.get_color(), colours)
    dots = [item for item in drawn if isinstance(item, PathCollection)]
    npt.assert_array_equal(dots[0].get_facecolor(), colours)
    for item, concept, row in zip(dots[1:], (ROOM, FLOOR), (3, 4), strict=True):
        (colour,) = faded(STYLES[concept].colour, NODES[row : row + 1])
        npt.assert_array_equal(item.get_facecolor(), [to_rgba(colour)])


def test_nodes_may_be_faint_while_edges_are_not_and_the_other_way_round():
    for said in ({"node_confidence": np.zeros(5)}, {"edge_confidence": np.zeros(4)}):
        edges = draw_graph(one_room(), **said).collections[0]
        faint = to_rgba(faded(EDGE_COLOUR, np.zeros(1))[0])
        assert (tuple(edges.get_color()[0]) == faint) == ("edge_confidence" in said)


@pytest.mark.parametrize("said", [{}, {"node_confidence": NODES}, {"edge_confidence": EDGES}])
def test_the_legend_says_what_faint_means_if_something_may_be(tmp_path, figures, said):
    save_picture(one_room(), tmp_path / "a.png", **said)
    (legend,) = figures[0].legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["plane", "room", "floor", *["faint: unsure"] * bool(said)]


def test_the_legend_names_what_occurs(tmp_path, figures):
    contact_sheet([("true", [one_room()] * 2), ("generated", [one_room()])], tmp_path / "a.png")
    (legend,) = figures[0].legends
    assert [text.get_text() for text in legend.get_texts()] == ["plane", "room", "floor"]
    assert [axes.get_ylabel() for axes in figures[0].axes] == ["true", "", "generated"]
    assert [axes.get_title() for axes in figures[0].axes] == ["", "", ""]


def test_a_sheet_of_a_data_set_captions_each_graph_in_reading_order(tmp_path, figures):
    graphs = [one_room(), small_city(), one_room()]
    dataset_sheet(graphs, tmp_path / "a.png", first=7, columns=2)
    (figure,) = figures
    captions = [axes.get_title() for axes in figure.axes]
    assert captions == ["7: |V| = 5", "8: |V| = 27", "9: |V| = 5"]
    places = [axes.get_subplotspec() for axes in figure.axes]
    assert [(place.rowspan[0], place.colspan[0]) for place in places] == [(0, 0), (0, 1), (1, 0)]
    (legend,) = figure.legends
    assert len(legend.get_texts()) == 5


def test_captions_of_a_row_align_and_every_graph_stays_inside_its_cell(tmp_path, figures):
    dataset_sheet([one_room(), small_city()], tmp_path / "a.png")
    (figure,) = figures
    figure.draw_without_rendering()
    first, second = (axes.title.get_window_extent() for axes in figure.axes)
    assert first.y0 == pytest.approx(second.y0)
    for axes in figure.axes:
        low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
        assert np.all(axes.dataLim.min >= low)
        assert np.all(axes.dataLim.max <= high)


def test_what_cannot_be_drawn_or_written_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"'txt' is no picture format, expected .*png"):
        save_picture(one_room(), tmp_path / "a.txt")
    with pytest.raises(ValueError, match="there are no graphs"):
        contact_sheet([("true", [])], tmp_path / "a.png")
    with pytest.raises(ValueError, match="there are no graphs"):
        dataset_sheet([], tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
