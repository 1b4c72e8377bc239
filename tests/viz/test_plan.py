import numpy as np
import numpy.testing as npt
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.image import imread
from matplotlib.patches import Polygon
from matplotlib.path import Path as Outline

from sg3d_jax.scene.graph import make_graph, parts_first
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, ROOM, WALL
from sg3d_jax.viz.outline import PALETTE, area_colours, outline, plan_of
from sg3d_jax.viz.plan import save_plan
from sg3d_jax.viz.style import faded, styles_of
from tests.colour_vision import EYES, least_apart
from tests.own_world import own_world
from tests.two_rooms import two_rooms
from tests.viz.small_city import small_city

HOOK = np.array([[0, 0], [6, 0], [6, 4], [5, 4], [5, 1], [0, 1]], float)  # an area like an L


def around(corners):
    """Returns the sides of an area as segments, mixed up."""
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return sides[np.random.default_rng(0).permutation(len(sides))]


def area_of(corners):
    x, y = corners.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def without_wholes(graph, part):
    """Returns a graph in which a node is part of no room."""
    pairs, label = parts_first(graph), graph.nodes.label
    kept = pairs[(pairs[:, 0] != part) | (label[pairs[:, 1]] != ROOM)]
    return make_graph(label, graph.nodes.position, graph.nodes.normal, graph.nodes.width, kept)


def patches(axes):
    return [patch for patch in axes.patches if isinstance(patch, Polygon)]


def test_segments_outline_an_area_that_is_not_convex():
    corners = outline(around(HOOK))
    assert len(corners) == len(HOOK)
    assert {*map(tuple, corners.tolist())} == {*map(tuple, HOOK.tolist())}
    assert area_of(corners) == area_of(HOOK)


def test_segments_are_cut_and_prolonged_to_their_corners():
    sides = np.stack([HOOK, np.roll(HOOK, -1, axis=0)], axis=1)
    middle = sides.mean(axis=1, keepdims=True)
    for scale in (0.8, 1.1):  # as a robot sees a part of a plane, or planes that go on
        npt.assert_allclose(area_of(outline(middle + (sides - middle) * scale)), area_of(HOOK))


def test_the_way_around_an_area_does_not_hang_on_the_order_of_its_segments():
    sides = np.array([[[0.6, 3], [0, 3]], [[2, 3], [1.4, 3]], [[0, 0], [2, 0]]])
    for shift in range(3):
        assert area_of(outline(np.roll(sides, shift, axis=0))) == pytest.approx(6)


def test_where_a_segment_lacks_the_outline_goes_straight_on():
    square = around(np.array([[0, 0], [2, 0], [2, 2], [0, 2]], float))
    facing = square[np.isclose(np.ptp(square[..., 1], axis=1), 0)]
    assert area_of(outline(facing)) == 4
    npt.assert_array_equal(outline(facing[:1]), facing[0, ::-1])  # and back


def test_rooms_are_areas_and_walls_lines_as_long_as_both_sides():
    graph = two_rooms()
    plan = plan_of(graph)
    assert [*plan.areas] == [9, 10]
    npt.assert_allclose(
        [area_of(area.corners) for area in plan.areas.values()], [4 * 3, 4.8 * 3.3], rtol=1e-12
    )
    assert plan.line_rows.tolist() == [8]
    assert graph.nodes.label[8] == WALL
    (line,) = plan.lines
    npt.assert_allclose(np.sort(line, axis=0), [[4.1, 0.1], [4.1, 3.0]])


def test_neighbours_differ_in_colour():
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 0.9
    places = [(x, y) for x in range(5) for y in range(5)]
    corridor = np.array([[5, 0], [6, 0], [6, 5], [5, 5]], float)
    colours = area_colours([*(unit + np.array(place) for place in places), corridor])
    by_place = dict(zip(places, colours, strict=False))
    for (x, y), colour in by_place.items():
        assert colour not in (by_place.get((x + 1, y)), by_place.get((x, y + 1)))
        assert x < 4 or colour != colours[-1]


@pytest.mark.parametrize("eye", EYES)
def test_the_colour_blind_can_tell_the_colours_apart(eye):
    assert least_apart(PALETTE, eye) > 10


def test_floors_stand_apart_bottom_up_in_one_scale(tmp_path, figures):
    save_plan(small_city(), tmp_path / "a.png")
    (figure,) = figures
    shown = [axes for axes in figure.axes if axes.get_title()]
    assert [axes.get_title() for axes in shown] == [
        "building 24, floor 5",
        "building 24, floor 11",
        "building 25, floor 17",
        "building 25, floor 23",
    ]
    assert len({float(np.round(np.ptp(axes.get_xlim()), 6)) for axes in shown}) == 1
    for axes, row in zip(shown, (4, 10, 16, 22), strict=True):
        assert len(patches(axes)) == 1
        assert str(row) in [text.get_text() for text in axes.texts]
        for lines in axes.collections:
            ends = np.concatenate(lines.get_segments())
            assert axes.viewLim.contains(*ends.min(axis=0))
            assert axes.viewLim.contains(*ends.max(axis=0))
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["plane", "room, with its name"]


def test_names_are_written_as_they_are_inside_their_areas(tmp_path, figures):
    ends = around(HOOK)
    along = ends[:, 1] - ends[:, 0]
    width = np.linalg.norm(along, axis=1)
    normal = np.stack([-along[:, 1], along[:, 0], 0 * width], axis=1) / width[:, None]
    position = np.zeros((7, 3))
    position[:6, :2], position[6, :2] = ends.mean(axis=1), (3, 3)  # not inside
    padded = [np.concatenate([rows, 0 * rows[:1]]) for rows in (normal, width)]
    pairs = [(row, 6) for row in range(6)]
    graph = make_graph([0] * 6 + [ROOM], position, *padded, part_of=pairs)
    save_plan(graph, tmp_path / "a.png", [""] * 6 + ["hall $1$"])
    name, *_ = figures[0].axes[0].texts
    assert name.get_text() == "hall $1$"
    assert not name.get_parse_math()
    assert Outline(HOOK).contains_point(name.get_position())


def test_what_differs_from_the_truth_is_marked(tmp_path, figures):
    truth = two_rooms()
    save_plan(truth, tmp_path / "a.png", truth=truth)
    save_plan(without_wholes(truth, 7), tmp_path / "b.png", truth=truth)
    same, other = (patches(figure.axes[0]) for figure in figures)
    assert [patch.get_hatch() for patch in same] == [None, None]
    assert [patch.get_hatch() for patch in other] == [None, "///", None]
    assert [patch.get_fill() for patch in other] == [True, True, False]
    assert area_of(other[2].get_xy()[:-1]) == pytest.approx(4.8 * 3.3)


def test_what_is_unsure_is_faint(tmp_path, figures):
    sure = np.linspace(0, 1, 12)
    save_plan(two_rooms(), tmp_path / "a.png", node_confidence=sure)
    (axes,) = figures[0].axes
    shades = {patch.get_facecolor() for patch in patches(axes)}
    expected = {to_rgba(faded(colour, sure[[row]])[0]) for row in (9, 10) for colour in PALETTE}
    assert shades <= expected
    planes, walls = (item for item in axes.collections if isinstance(item, LineCollection))
    styles = styles_of(PAPER_ONTOLOGY)
    npt.assert_array_equal(planes.get_color(), [*map(to_rgba, faded(styles[0].colour, sure[:8]))])
    npt.assert_array_equal(walls.get_color(), [*map(to_rgba, faded(styles[1].colour, sure[8:9]))])


def test_a_plan_of_other_concepts_is_saved_whole(tmp_path):
    save_plan(own_world(), tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert imread(tmp_path / "a.png").std() > 0


def test_what_cannot_be_drawn_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"a\.png: there are no planes to draw"):
        save_plan(make_graph([ROOM], [[0, 0, 0]]), tmp_path / "a.png")
    with pytest.raises(ValueError, match="node_confidence has shape"):
        save_plan(two_rooms(), tmp_path / "a.png", node_confidence=np.ones(3))
    assert not list(tmp_path.iterdir())
