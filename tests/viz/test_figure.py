import matplotlib.pyplot as plt
import numpy as np
import numpy.testing as npt
import pytest
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.image import imread

from sg3d_jax.scene.concepts import CITY, CONCEPTS, FLOOR, PLANE, ROOM, WALL
from sg3d_jax.scene.graph import make_graph
from sg3d_jax.viz.figure import (
    STYLES,
    contact_sheet,
    draw_graph,
    lifted,
    plane_segments,
    project,
    save_picture,
)


def one_room():
    return make_graph(
        [PLANE, PLANE, PLANE, ROOM, FLOOR],
        [[0, 2, 1], [3, 0, 1], [0, -2, 1], [1, 0, 1], [1, 0, 1]],
        [[0, -1, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0]],
        [6, 4, 5, 0, 0],
        part_of=[[0, 3], [1, 3], [2, 3], [3, 4]],
        proximity=[[0, 1], [1, 2], [0, 2]],
    )


def test_planes_are_segments_across_their_normal():
    segments = plane_segments(one_room())
    npt.assert_allclose(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1), [6, 4, 5])
    npt.assert_allclose(segments.mean(axis=1), one_room().nodes.position[:3])
    npt.assert_allclose(sorted(segments[0, :, 0]), [-3, 3])
    npt.assert_allclose(sorted(segments[1, :, 1]), [-2, 2])


def test_levels_are_lifted_apart():
    npt.assert_array_equal(lifted(one_room())[:, 2], [1, 1, 1, 3, 4])
    assert [STYLES[concept].lift for concept in range(len(CONCEPTS))] == [0, 1, 2, 3, 4, 5]


def test_the_graph_is_not_changed_by_drawing():
    graph = one_room()
    before = graph.nodes.position.copy()
    draw_graph(graph)
    npt.assert_array_equal(graph.nodes.position, before)


def test_up_is_up_and_lengths_seen_across_are_true():
    npt.assert_allclose(project(np.array([0.0, 0.0, 1.0]))[0], 0, atol=1e-12)
    assert project(np.array([0.0, 0.0, 1.0]))[1] > 0.5
    axes = project(np.eye(3))
    npt.assert_allclose(axes.T @ axes, np.eye(2), atol=1e-12)


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


def test_everything_lies_inside_the_frame():
    axes = draw_graph(one_room())
    points = project(
        np.concatenate([lifted(one_room()), plane_segments(one_room()).reshape(-1, 3)])
    )
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    assert np.all(points >= low)
    assert np.all(points <= high)
    assert axes.get_aspect() == 1


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


def test_the_legend_names_what_occurs(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(
        Figure, "savefig", lambda self, path, **_: (figures.append(self), path.touch())
    )
    contact_sheet([("true", [one_room()] * 2), ("generated", [one_room()])], tmp_path / "a.png")
    (legend,) = figures[0].legends
    assert [text.get_text() for text in legend.get_texts()] == ["plane", "room", "floor"]
    assert [axes.get_ylabel() for axes in figures[0].axes] == ["true", "", "generated"]


def test_what_cannot_be_drawn_or_written_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"'txt' is no picture format, expected .*png"):
        save_picture(one_room(), tmp_path / "a.txt")
    with pytest.raises(ValueError, match="there are no graphs"):
        contact_sheet([("true", [])], tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
