"""Rooms on a grid become outlines, outlines rooms within walls: checked against shapely."""

import numpy as np
import pytest
import shapely

from sg3d_jax.data.wide_plan import (
    MAX_SIDES,
    Frame,
    Outline,
    Thickness,
    cut_off,
    draw_frame,
    moved_in,
    put_in_place,
    storey_of_labels,
    trace,
)

STRAIGHT = np.zeros(0, int)


def rng(seed=0):
    return np.random.default_rng(seed)


def grid(size, step=1.0):
    """A frame of straight lines."""
    x, y = (step * np.arange(number + 1.0) for number in size)
    base = np.column_stack([x, 0 * x])
    return Frame(base, np.tile([0.0, 1.0], (len(x), 1)), y, STRAIGHT)


def even(size, thickness, lined=0.0):
    return Thickness(
        np.full(size[0] + 1, thickness), np.full(size[1] + 1, thickness), thickness, lined
    )


def polygons(outline):
    """Each room of an outline, ring by ring."""
    shapes = []
    for room in np.unique(outline.room):
        rings = [
            outline.corner[outline.ring == ring]
            for ring in np.unique(outline.ring[outline.room == room])
        ]
        shapes.append(shapely.Polygon(rings[0], rings[1:]))
    return np.array(shapes)


def of_label(labels, label):
    """The cells of a label, as one shape."""
    return shapely.union_all(
        [shapely.box(x, y, x + 1, y + 1) for x, y in np.argwhere(labels == label)]
    )


@pytest.mark.parametrize("seed", range(20))
def test_outlines_are_those_of_the_union_of_cells(seed):
    labels = rng(seed).integers(-1, 3, (6, 5)).repeat(2, 0).repeat(3, 1)
    outline = trace(labels, STRAIGHT)
    found = polygons(outline)
    assert shapely.is_ccw(shapely.get_exterior_ring(found)).all()
    inside = shapely.get_coordinates(shapely.point_on_surface(found)).astype(int)
    label = labels[tuple(inside.T)]
    for wanted in range(3):
        shape = shapely.union_all(shapely.make_valid(found[label == wanted]))
        assert shape.symmetric_difference(of_label(labels, wanted)).area == 0
    assert shapely.area(found).sum() == (labels >= 0).sum()  # none is drawn twice
    # No corner is flat: sides along x and along y take turns.
    along_x = outline.side > len(labels)
    for ring in np.unique(outline.ring):
        mine = along_x[outline.ring == ring]
        assert (mine != np.roll(mine, 1)).all()


def test_a_room_around_others_has_a_hole_and_one_label_in_two_places_is_two_rooms():
    labels = np.zeros((9, 7), int)
    labels[2:4, 2:5] = 1
    labels[6, 3] = -1
    labels = np.concatenate([labels, np.full((1, 7), -1), np.zeros((2, 7), int)])
    outline = trace(labels, STRAIGHT)
    around, core, far = polygons(outline)
    assert [len(shape.interiors) for shape in (around, core, far)] == [2, 0, 0]
    assert [shape.area for shape in (around, core, far)] == [63 - 6 - 1, 6, 14]
    assert np.bincount(outline.room).tolist() == [12, 4, 4]


def test_a_side_along_x_has_a_corner_at_each_bend():
    labels = np.zeros((8, 3), int)
    outline = trace(labels, np.array([2, 5]))
    assert len(outline.corner) == 4 + 2 * 2
    assert polygons(outline)[0].area == 24


def test_sides_move_in_by_half_of_the_thickness_of_their_line():
    labels = np.zeros((10, 8), int)
    labels[6:, 5:] = -1
    labels[2:4, 2:4] = -1
    outline = put_in_place(
        trace(labels, STRAIGHT), grid((10, 8)), even((10, 8), 0.4), np.random.default_rng(0)
    )
    inset, vanished = moved_in(outline)
    (drawn,), (found,) = polygons(outline), polygons(inset)
    assert not vanished.any()
    assert found.symmetric_difference(drawn.buffer(-0.2, join_style="mitre")).area < 1e-9


def test_a_line_has_one_thickness_and_another_line_another():
    labels = np.arange(4).reshape(2, 2).repeat(4, 0).repeat(4, 1)
    thickness = even((8, 8), 0.1)
    thickness.x[4] = 0.45
    outline, _ = moved_in(
        put_in_place(trace(labels, STRAIGHT), grid((8, 8)), thickness, np.random.default_rng(0))
    )
    rooms = polygons(outline)
    gaps = shapely.distance(rooms[:, None], rooms)
    np.testing.assert_allclose([gaps[0, 2], gaps[1, 3]], 0.45)
    np.testing.assert_allclose([gaps[0, 1], gaps[2, 3]], 0.1)


def test_a_room_too_narrow_for_its_walls_is_none():
    labels = np.array([[0, 1]]).repeat(4, 0).repeat([4, 1], 1)
    storey = storey_of_labels(labels, grid((4, 5), 0.5), even((4, 5), 0.45), 0.0, rng())
    assert len(storey.room_centre) == 1
    assert (
        storey_of_labels(labels[:, 4:], grid((4, 1), 0.5), even((4, 1), 0.45), 0.0, rng()) is None
    )


def test_a_room_of_too_many_sides_is_drawn_anew():
    labels = np.zeros((30, 4), int)
    labels[1::4, 3] = -1
    assert len(trace(labels, STRAIGHT).corner) > MAX_SIDES
    assert storey_of_labels(labels, grid((30, 4)), even((30, 4), 0.1), 0.0, rng()) is None


@pytest.mark.parametrize("seed", range(30))
def test_frames_keep_the_order_of_their_cells(seed):
    frame = draw_frame((30, 15), 0.3, 1.0, rng(seed))
    corners = frame.base[:, None] + frame.depth[None, :, None] * frame.lean[:, None]
    cells = shapely.polygons(
        np.stack([corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]], axis=2)
    )
    assert shapely.is_ccw(shapely.get_exterior_ring(cells)).all()
    assert shapely.is_valid(cells).all()
    whole = shapely.union_all(cells, grid_size=1e-6)
    assert whole.geom_type == "Polygon"
    np.testing.assert_allclose(whole.area, shapely.area(cells).sum(), rtol=1e-4)  # none overlap


def test_frames_are_straight_askew_and_bent():
    frames = [draw_frame((40, 15), 0.3, 0.6, rng(seed)) for seed in range(60)]
    bent = np.mean([len(frame.bends) > 0 for frame in frames])
    right = np.mean([np.allclose(frame.lean, [0, 1]) for frame in frames])
    assert 0.1 < bent < 0.4
    assert 0.25 < right < 0.6


@pytest.mark.parametrize("seed", range(10))
def test_walls_in_any_frame_are_as_thick_as_drawn(seed):
    labels = np.arange(8).reshape(4, 2).repeat(8, 0).repeat(8, 1)
    frame = draw_frame((32, 16), 0.4, 1.0, rng(seed))
    outline, vanished = moved_in(
        put_in_place(trace(labels, frame.bends), frame, even((32, 16), 0.23), rng())
    )
    assert not vanished.any()
    rooms = polygons(outline)
    assert shapely.is_valid(rooms).all()
    gaps = shapely.distance(rooms[:-2], rooms[2:])  # of neighbours in x
    np.testing.assert_allclose(gaps, 0.23, atol=0.01)


@pytest.mark.parametrize("seed", range(12))
def test_rooms_cut_at_an_angle_stay_within_themselves(seed):
    labels = np.arange(4).reshape(2, 2).repeat(8, 0).repeat(8, 1)
    outline = put_in_place(
        trace(labels, STRAIGHT), grid((16, 16), 0.5), even((16, 16), 0.2), rng(seed)
    )
    cut = cut_off(outline, 1.0, 0.3, rng(seed))
    before, after = polygons(outline), polygons(cut)
    assert len(np.unique(cut.room)) == cut.room.max() + 1
    assert shapely.is_valid(after).all()
    assert shapely.area(shapely.difference(after, shapely.union_all(before))).max() < 1e-9
    overlap = shapely.area(shapely.intersection(after[:, None], after))
    assert np.triu(overlap, 1).max() < 1e-9
    inset, _ = moved_in(cut)
    rooms = polygons(inset)
    gaps = shapely.distance(rooms[:, None], rooms)[np.triu_indices(len(rooms), 1)]
    assert gaps.min() > 0.2 - 1e-9


def test_an_untouched_outline_is_returned_as_it_is():
    outline = Outline(
        np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]]),
        np.full(4, 0.1),
        np.zeros(4, int),
        np.zeros(4, int),
    )
    assert cut_off(outline, 1.0, 0.1, rng()) is outline  # narrower than what is cut
