"""Where objects are put, and the rooms that are read off a storey."""

import numpy as np
import numpy.testing as npt
import pytest
import shapely

from sg3d_jax.data.floorplan import storey_of_rooms
from sg3d_jax.data.furnished_objects import DOOR_DEPTH, ITEMS, SIZES, Item, draw_objects
from sg3d_jax.data.furnished_plan import draw_doors, layout_of


def box(x0, y0, x1, y1):
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)


@pytest.fixture(scope="module")
def layout():
    """A room of 8 x 6 m around a closet of 1.2 x 1.2 m, and two more beside it."""
    rooms = [box(0, 0, 8, 6), box(3, 2, 4.2, 3.2), box(8.2, 0, 12, 3), box(8.2, 3.2, 12, 6)]
    return layout_of(storey_of_rooms(rooms))


@pytest.fixture(scope="module")
def doors(layout):
    kinds = ["corridor", "storage", "office", "office"]
    return draw_doors(layout, kinds, [0] * 4, None, True, 0.0, np.random.default_rng(0))


def test_the_rooms_of_a_storey_are_read_off_its_planes(layout):
    inset = [1.08**2, 3.8 * 2.8, 3.8 * 3, 7.88 * 5.88 - 1.32**2]  # the two that touch, by 6 cm
    npt.assert_allclose(sorted(layout.area), inset)
    hall = int(np.argmax(layout.area))
    assert len(layout.meeting[hall]) == 3
    assert len(shapely.get_rings(layout.shape[hall])) == 2


def test_doors_hang_all_rooms_together_and_one_leads_outside(layout, doors):
    inner = [door.rooms for door in doors if len(door.rooms) == 2]
    assert len(inner) == 3
    assert {room for rooms in inner for room in rooms} == set(range(4))
    (entrance,) = (door for door in doors if len(door.rooms) == 1)
    place = shapely.points(entrance.place)
    assert not shapely.intersects(layout.shape, place).any()
    assert shapely.distance(layout.shape[entrance.rooms[0]], place) < 0.2


def test_no_entrance_is_in_a_shaft_between_rooms():
    two = layout_of(storey_of_rooms([box(0, 0, 4, 6), box(5, 0, 9, 6)]))
    drawn = draw_doors(two, ["office"] * 2, [0, 1], None, True, 0.0, np.random.default_rng(0))
    assert [door.rooms for door in drawn] == [(0,), (1,)]
    assert not any(4 < door.place[0] < 5 for door in drawn)


@pytest.fixture(scope="module")
def furnished(layout, doors):
    rng = np.random.default_rng(1)
    items = [ITEMS[name] for name in ("living room", "storage", "office", "classroom")]
    return [draw_objects(layout, doors, items, 8, rng) for _ in range(40)]


def test_objects_are_in_their_rooms_and_overlap_neither_each_other_nor_doors(
    layout, doors, furnished
):
    for objects in furnished:
        boxes = shapely.polygons(objects.corners)
        assert shapely.covers(shapely.buffer(layout.shape[objects.room], 1e-6), boxes).all()
        one, other = shapely.STRtree(boxes).query(boxes, "intersects")
        assert (one == other).all()
        for door in doors:
            jamb = np.outer([-0.5, 0.5], door.along) * door.width
            before = shapely.buffer(
                shapely.linestrings(door.place + jamb), DOOR_DEPTH - 0.01, cap_style="flat"
            )
            assert not shapely.intersects(before, boxes).any()


def test_objects_are_as_large_and_as_high_up_as_their_kind(furnished):
    kinds = set()
    for objects in furnished:
        for kind, width, up in zip(objects.kind, objects.width, objects.up, strict=True):
            size = SIZES[kind]
            low, high = (max(size.along[end], size.out[end]) for end in (0, 1))
            assert low - 1e-9 <= width <= high + 1e-9
            assert size.lift + size.height[0] / 2 <= up <= size.lift + size.height[1] / 2
            kinds.add(kind)
    assert {"sofa", "table", "chair", "desk", "shelf", "board"} <= kinds


def test_chairs_are_at_tables_and_desks(furnished):
    chairs = 0
    for objects in furnished:
        is_seat = np.array([kind == "chair" for kind in objects.kind])
        tables = np.array([kind in ("table", "desk") for kind in objects.kind])
        for place in objects.place[is_seat]:
            away = shapely.distance(
                shapely.points(place), shapely.polygons(objects.corners[tables])
            )
            assert 0.1 < away.min() <= 0.35 + 1e-9  # nearer to another one than to its own
            chairs += 1
    assert chairs > 40


def test_what_does_not_fit_is_left_out_and_no_room_has_more_than_stated(layout, doors):
    many = [(Item("shelf", 20.0, most=20),)] * 4
    objects = draw_objects(layout, doors, many, 5, np.random.default_rng(2))
    count = np.bincount(objects.room, minlength=4)
    assert count.max() == 5
    assert count[np.argmin(layout.area)] < 5
    tables = [(Item("table", 2.0, most=2, is_free=True, chairs=4.0),)] * 4
    count = np.bincount(draw_objects(layout, doors, tables, 3, np.random.default_rng(2)).room)
    assert count.max() == 3
    nothing = draw_objects(layout, doors, [()] * 4, 5, np.random.default_rng(2))
    assert not len(nothing.kind)


def test_a_door_is_left_a_jamb_on_both_sides(layout):
    rng = np.random.default_rng(3)
    for _ in range(60):
        drawn = draw_doors(layout, ["hall"] * 4, [0] * 4, None, False, 1.0, rng)
        for door in drawn:
            assert len(door.rooms) == 2  # nobody comes in from the outside
            line = layout.line[layout.meeting[door.rooms[0]][door.rooms[1]]]
            half = np.outer([-0.5, 0.5], door.along) * door.width
            ends = (door.place + half - line[0]) @ door.along
            assert ends.min() >= 0.1 - 1e-9
            assert ends.max() <= np.linalg.norm(line[1] - line[0]) - 0.1 + 1e-9
