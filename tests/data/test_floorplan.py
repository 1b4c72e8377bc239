"""Room polygons become planes, walls and rooms: checked against other ways to count them."""

import faulthandler
import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.data import plans
from sg3d_jax.data.buildings import Building, city_graph
from sg3d_jax.data.floorplan import (
    FloorplanConfig,
    facing_pairs,
    floors_of,
    read_floors,
    repaired_rooms,
    sides_of,
    storey_of_rooms,
    tidy_rooms,
)
from sg3d_jax.data.plans import UNITS, read_plans, unit_of
from sg3d_jax.scene.ontology import FLOOR
from sg3d_jax.scene.validate import validate_graph

REAL = Path(__file__).parents[3] / "shared" / "data" / "floorplans.jsonl.gz"
CONFIG = FloorplanConfig()
STEP = 0.02  # metres between sampled points


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)


def split(rng, corners, depth):
    """Cuts a rectangle into touching ones."""
    x0, y0, x1, y1 = corners
    if depth == 0 or min(x1 - x0, y1 - y0) < 2.5:
        return [corners]
    share = rng.uniform(0.35, 0.65)
    if x1 - x0 > y1 - y0:
        middle = x0 + share * (x1 - x0)
        parts = [(x0, y0, middle, y1), (middle, y0, x1, y1)]
    else:
        middle = y0 + share * (y1 - y0)
        parts = [(x0, y0, x1, middle), (x0, middle, x1, y1)]
    return [room for part in parts for room in split(rng, part, depth - 1)]


def turned(rooms, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    return [room @ np.array([[cos, sin], [-sin, cos]]) for room in rooms]


def drawn_plan(seed):
    """A plan of touching rectangles at a random angle."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(5, 14, 2)
    rooms = [box(*corners) for corners in split(rng, (0, 0, *size), 4)]
    return turned(rooms, rng.uniform(0, 2 * np.pi))


def walls_of(storey):
    """The planes of each wall."""
    return [storey.wall[storey.wall[:, 1] == w, 0].tolist() for w in range(len(storey.wall_centre))]


# --- planes ---

L_ROOM = np.array([[0, 0], [4, 0], [4, 2], [2, 2], [2, 3], [0, 3]], float)
ROOMS = {
    "rectangle": box(0, 0, 4, 3),
    "L": L_ROOM,
    "clockwise L": L_ROOM[::-1],
    "triangle": np.array([[0, 0], [4, 0], [0, 3]], float),
    "hexagon": 2 * np.array([[np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3]),
}


@pytest.mark.parametrize("name", ROOMS)
def test_a_room_has_a_plane_an_edge_looking_inwards(name):
    corners = ROOMS[name]
    far = corners + 50
    storey = storey_of_rooms([corners, far])
    mine = storey.room == 0
    polygon = shapely.Polygon(corners)
    assert mine.sum() == len(corners)
    np.testing.assert_allclose(np.linalg.norm(storey.normal, axis=1), 1)
    inside = shapely.points(storey.plane[mine] + 1e-3 * storey.normal[mine])
    outside = shapely.points(storey.plane[mine] - 1e-3 * storey.normal[mine])
    assert shapely.contains(polygon, inside).all()
    assert not shapely.contains(polygon, outside).any()
    np.testing.assert_allclose(storey.width[mine].sum(), polygon.length)
    # Divergence theorem: planes alone tell the area.
    area = -np.sum(storey.width * np.sum(storey.plane * storey.normal, axis=1) * mine) / 2
    np.testing.assert_allclose(area, polygon.area)
    centroid = [polygon.centroid.x, polygon.centroid.y]
    np.testing.assert_allclose(storey.room_centre[0], centroid, atol=1e-9)
    np.testing.assert_allclose(storey.centre, storey.room_centre.mean(axis=0))


@pytest.mark.parametrize("name", ROOMS)
def test_the_planes_of_a_room_turn_once(name):
    sides = sides_of(np.array([shapely.Polygon(ROOMS[name])]))
    np.testing.assert_array_equal(sides.ends[:, 1], np.roll(sides.ends[:, 0], -1, axis=0))
    following = np.roll(sides.normal, -1, axis=0)
    sine = sides.normal[:, 0] * following[:, 1] - sides.normal[:, 1] * following[:, 0]
    angle = np.arctan2(sine, np.sum(sides.normal * following, axis=1))
    np.testing.assert_allclose(angle.sum(), 2 * np.pi)


@pytest.mark.parametrize("start", range(8))
def test_corners_flatter_than_a_centimetre_are_none(start):
    flat = [[0, 0], [2, -0.008], [4, 0], [4, 1.5], [4, 3], [2, 3], [0, 3], [0.009, 1]]
    storey = storey_of_rooms([np.roll(flat, start, axis=0), box(9, 9, 12, 12)])
    assert (storey.room == 0).sum() == 4
    np.testing.assert_allclose(sorted(storey.width[storey.room == 0]), [3, 3, 4, 4], atol=0.02)


def test_a_corner_of_two_centimetres_stays():
    bent = np.array([[0, 0], [2, -0.02], [4, 0], [4, 3], [0, 3]])
    assert (storey_of_rooms([bent, box(9, 9, 12, 12)]).room == 0).sum() == 5


# --- walls between rooms ---


def test_rooms_that_touch_are_inset_so_that_a_wall_is_between_them():
    storey = storey_of_rooms([box(0, 0, 4, 3), box(4, 0, 8, 3)])
    np.testing.assert_allclose(storey.width, np.tile([3.88, 2.88], 4))
    ((one, other),) = walls_of(storey)
    np.testing.assert_allclose(np.abs(storey.plane[one] - storey.plane[other]), [0.12, 0])
    np.testing.assert_allclose(storey.wall_centre, [[4, 1.5]])


def test_rooms_with_walls_between_them_stay_as_they_are_drawn():
    storey = storey_of_rooms([box(0, 0, 4, 3), box(4.2, 1, 8, 3)])
    assert sorted(storey.width) == pytest.approx([2, 2, 3, 3, 3.8, 3.8, 4, 4])
    np.testing.assert_allclose(storey.wall_centre, [[4.1, 2]])


def test_a_narrow_room_with_walls_around_it_stays():
    storey = storey_of_rooms([box(0, 0, 4, 3), box(4.2, 0, 4.3, 3)])
    assert sorted(storey.width) == pytest.approx([0.1, 0.1, 3, 3, 3, 3, 4, 4])


def test_a_corridor_and_three_offices_have_one_wall_of_four_planes():
    offices = [box(x, 2.2, x + 3, 5) for x in (0, 3.2, 6.4)]
    storey = storey_of_rooms([box(0, 0, 9.4, 2), *offices])
    walls = walls_of(storey)
    assert sorted(map(len, walls)) == [2, 2, 4]
    long = next(planes for planes in walls if len(planes) == 4)
    assert sorted(storey.room[long]) == [0, 1, 2, 3]
    centre = storey.wall_centre[walls.index(long)]
    np.testing.assert_allclose(centre, [4.7, 2.1])


def test_strips_of_another_thickness_along_one_plane_are_one_wall():
    rooms = [box(0, 0, 8, 3), box(0, 3.1, 3.9, 6), box(4.1, 3.5, 8, 6)]
    storey = storey_of_rooms(rooms)
    assert sorted(map(len, walls_of(storey))) == [2, 3]
    great = next(i for i, planes in enumerate(walls_of(storey)) if len(planes) == 3)
    np.testing.assert_allclose(storey.wall_centre[great], [4, (3.05 + 3.25) / 2])


def test_a_chain_of_facing_planes_is_one_wall_and_a_wall_that_crosses_ends_it():
    below = [box(x, 0, x + 3, 3) for x in (0, 3.2, 6.4)]
    above = [box(-1.6, 3.2, 1.4, 6), box(1.6, 3.2, 4.6, 6), box(6.4, 3.2, 9.4, 6)]
    walls = walls_of(storey_of_rooms(below + above))
    lengths = [len(planes) for planes in walls]
    # Along y = 3.1 four planes are chained; the two on the right face each other alone.
    assert sorted(lengths) == [2, 2, 2, 2, 4]


def test_a_gap_of_half_a_metre_is_a_wall():
    storey = storey_of_rooms([box(0, 0, 4, 3), box(4.55, 0, 8, 3)])
    np.testing.assert_allclose(storey.wall_centre, [[4.275, 1.5]])


NO_WALL = {
    "too far": [box(0, 0, 4, 3), box(4.65, 0, 8, 3)],
    "too short an overlap": [box(0, 0, 4, 3), box(4.2, 2.95, 8, 6)],
    "corner to corner": [box(0, 0, 4, 3), box(4.2, 3.2, 8, 6)],
    "askew": [box(0, 0, 4, 3), np.array([[4.1, 0], [8, 0], [8, 3], [4.9, 3]])],
}


@pytest.mark.parametrize("name", NO_WALL)
def test_no_wall(name):
    storey = storey_of_rooms(NO_WALL[name])
    assert storey.wall.shape == (0, 2)
    assert storey.wall_centre.shape == (0, 2)
    validate_graph(city_graph([Building((storey,), (0.0,))], FLOOR), name)


def test_arms_of_one_room_have_no_wall_between_them():
    corners = [[0, 0], [5, 0], [5, 4], [2.7, 4], [2.7, 1], [2.4, 1], [2.4, 4], [0, 4]]
    storey = storey_of_rooms([np.array(corners, float), box(20, 0, 24, 3)])
    assert len(storey.wall_centre) == 0


def test_a_niche_narrower_than_a_wall_is_no_wall_between_the_rooms_beside_it():
    niche = np.array([[0, 0], [3, 0], [3, 2], [5.9, 2], [5.9, 2.15], [3, 2.15], [0, 2.15]], float)
    storey = storey_of_rooms([niche, box(3.1, 0, 5.9, 1.9), box(3.1, 2.25, 5.9, 5)])
    assert [sorted(storey.room[planes]) for planes in walls_of(storey)] == [[0, 1], [0, 1], [0, 2]]


def test_walls_a_little_askew_are_measured_where_both_planes_are():
    # Over 20 m the strip opens from 0.1 to 0.7 m; the small room stands at its narrow end.
    long = np.array([[0, -3], [20, -3], [20, -0.6], [0, 0]])
    storey = storey_of_rooms([long, box(0, 0.1, 3, 3)])
    assert len(walls_of(storey)) == 1


# --- walls, found by walking through them ---


def sampled_pairs(shapes, sides):
    """Metres over which a ray backwards from plane i meets plane j first, float[p, p]."""
    lines = shapely.linestrings(sides.ends)
    tree = shapely.STRtree(lines)
    met = np.zeros((len(lines), len(lines)))
    for i, (start, end) in enumerate(sides.ends):
        width = np.linalg.norm(end - start)
        steps = np.arange(STEP / 2, width, STEP)[:, None] / width
        points = start + steps * (end - start) - 1e-4 * sides.normal[i]
        rays = shapely.linestrings(
            np.stack([points, points - CONFIG.max_thickness * sides.normal[i]], axis=1)
        )
        ray, plane = tree.query(rays, predicate="intersects")
        hit = shapely.distance(
            shapely.points(points[ray]), shapely.intersection(rays[ray], lines[plane])
        )
        order = np.lexsort((hit, ray))
        _, first = np.unique(ray[order], return_index=True)
        np.add.at(met[i], plane[order][first], STEP)
    return met


def assert_walls_are_where_rays_meet(rooms):
    shapes = tidy_rooms(rooms, CONFIG)
    sides = sides_of(shapes, CONFIG.flatness)
    met = sampled_pairs(shapes, sides)
    back_to_back = sides.normal @ sides.normal.T < -np.cos(np.radians(CONFIG.max_angle))
    met = np.where(back_to_back & (sides.room[:, None] != sides.room), met, 0)
    storey = storey_of_rooms(rooms)
    together = np.zeros(met.shape, bool)
    for planes in walls_of(storey):
        together[np.ix_(planes, planes)] = True
    must = np.minimum(met, met.T) > CONFIG.min_overlap + 3 * STEP
    assert together[must].all()
    facing = facing_pairs(sides, CONFIG).planes
    seen = np.maximum(met, met.T) > CONFIG.min_overlap - 3 * STEP
    assert np.mean(seen[tuple(facing.T)]) > 0.99  # all but those with a niche between them
    assert (np.bincount(storey.wall[:, 1]) >= 2).all()
    assert len(np.unique(storey.wall[:, 0])) == len(storey.wall)  # a plane is of one wall
    return int(must.sum())


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_walls_are_where_rays_through_them_meet(seed):
    assert assert_walls_are_where_rays_meet(drawn_plan(seed)) > 0


@given(st.integers(0, 10_000), st.floats(0, 6.28), st.floats(-50, 50))
@settings(max_examples=25, deadline=None)
def test_a_plan_that_is_moved_gives_the_same_floor_moved(seed, angle, shift):
    rooms = drawn_plan(seed)
    moved = [room + shift for room in turned(rooms, angle)]
    one, other = storey_of_rooms(rooms), storey_of_rooms(moved)

    def place(points):
        return turned([points], angle)[0] + shift

    np.testing.assert_allclose(other.room_centre, place(one.room_centre), atol=1e-6)
    np.testing.assert_allclose(other.centre, place(one.centre), atol=1e-6)
    for mine, theirs in (
        (place(one.wall_centre), other.wall_centre),
        (place(one.plane), other.plane),
    ):
        assert len(mine) == len(theirs)
        distance = np.linalg.norm(mine[:, None] - theirs[None], axis=-1)
        assert distance.min(axis=1).max() < 1e-6  # rings may start elsewhere
    sizes = [sorted(np.bincount(storey.wall[:, 1])) for storey in (one, other)]
    assert sizes[0] == sizes[1]


# --- drawings with faults ---


def test_the_greater_of_two_rooms_that_overlap_gives_way():
    shapes = tidy_rooms([box(0, 0, 6, 4), box(5, 1, 8, 3)], CONFIG)
    assert shapely.distance(*shapes) == pytest.approx(0.12)
    np.testing.assert_allclose(shapely.area(shapes[1]), 2.88 * 1.88)
    assert repaired_rooms([box(0, 0, 6, 4), box(5, 1, 8, 3)]).tolist() == [True, False]


def test_a_room_around_another_one_has_planes_on_its_hole():
    storey = storey_of_rooms([box(0, 0, 9, 9), box(3, 3, 6, 6)])
    assert np.bincount(storey.room).tolist() == [8, 4]
    assert len(storey.wall_centre) == 4
    np.testing.assert_allclose(storey.room_centre, [[4.5, 4.5], [4.5, 4.5]])
    inside = storey.plane + 0.01 * storey.normal
    great = shapely.box(0, 0, 9, 9).difference(shapely.box(3, 3, 6, 6))
    assert shapely.contains(great, shapely.points(inside[storey.room == 0])).all()


def test_a_room_that_crosses_itself_a_little_keeps_nearly_all():
    knot = np.array([[0, 0], [4, 0], [4, 3], [0.1, 3], [-0.1, 2.9], [0, 2.9], [-0.2, 3], [0, 2.5]])
    assert not shapely.Polygon(knot).is_valid
    storey = storey_of_rooms([knot, box(9, 0, 12, 3)])
    np.testing.assert_allclose(storey.room_centre[0], [2, 1.5], atol=0.1)
    assert repaired_rooms([knot, box(9, 0, 12, 3)]).tolist() == [True, False]


REFUSED = {
    "there are 1 rooms": [box(0, 0, 4, 3)],
    r"rooms\[1\] crosses itself": [
        box(9, 9, 12, 12),
        np.array([[0, 0], [4, 3], [4, 0], [0, 3]], float),
    ],
    r"rooms\[0\] is in places narrower": [box(0, 0, 0.1, 3), box(0.1, 0, 4, 3)],
    r"rooms\[0\] is cut up": [box(0, 0, 9, 4), box(4, -1, 6, 7)],
    r"rooms\[1\] crosses itself, expected": [
        box(9, 9, 12, 12),
        np.array([[0, 0], [2, 0], [4, 0]], float),
    ],
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_rooms_that_nobody_could_tell_are_refused(sentence):
    with pytest.raises(ValueError, match=sentence):
        storey_of_rooms(REFUSED[sentence])


def test_a_corner_next_to_nothing_beside_an_axis_is_on_it():
    triangle = np.array([[0, 0], [1e-323, 3], [4, 0]])
    faulthandler.dump_traceback_later(60, exit=True)  # GEOS went on for ever
    try:
        shapes = tidy_rooms([triangle, box(4.2, 0, 7, 3)], CONFIG)
    finally:
        faulthandler.cancel_dump_traceback_later()
    assert shapely.get_coordinates(shapes[0]).tolist() == [[0, 0], [0, 3], [4, 0], [0, 0]]


def test_a_plan_without_faults_stays_as_it_is_drawn():
    assert not repaired_rooms(drawn_plan(0)).any()


@pytest.mark.parametrize("field", ["max_thickness", "inset", "flatness"])
@pytest.mark.parametrize("value", [-0.1, float("nan")])
def test_rules_that_nothing_can_be_measured_with_are_refused(field, value):
    with pytest.raises(ValueError, match=f"{field} is .*, expected zero or more"):
        FloorplanConfig(**{field: value})


# --- files ---


def floor(rooms, building="office/a", storey=0):
    drawn = [{"label": "OFFICE", "poly": room.tolist()} for room in rooms]
    return {"source": "x", "building": building, "storey": storey, "rooms": drawn}


GOOD = floor([box(0, 0, 4, 3), box(4, 0, 8, 3)])
TEXT = "\n".join(
    json.dumps(floor(drawn_plan(seed), f"b/{seed}", seed % 3)) for seed in range(4)
).encode()


def write(path, *documents):
    path.write_text("".join(json.dumps(document) + "\n" for document in documents))
    return path


def test_a_file_is_read_in_its_order_packed_or_not(tmp_path):
    plain, packed = tmp_path / "floors.jsonl", tmp_path / "floors.jsonl.gz"
    plain.write_bytes(TEXT)
    packed.write_bytes(gzip.compress(TEXT))
    one, other = read_floors(plain), read_floors(packed)
    assert [floor.origin for floor in one.floors] == [f"b/{i} storey {i % 3}" for i in range(4)]
    assert [floor.building for floor in one.floors] == [f"b/{i}" for i in range(4)]
    assert one.left_out == other.left_out == []
    for mine, theirs in zip(one.floors, other.floors, strict=True):
        for a, b in zip(mine.storey, theirs.storey, strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_floor_that_nobody_could_tell_is_left_out_with_a_reason(tmp_path):
    bad = floor([box(0, 0, 4, 3)], "office/b", 2)
    floors, left_out = read_floors(write(tmp_path / "floors.jsonl", GOOD, bad))
    assert [floor.building for floor in floors] == ["office/a"]
    assert left_out == ["office/b storey 2: there are 1 rooms, expected at least 2"]


def changed(**fields):
    return {**GOOD, **fields}


def with_poly(poly):
    return changed(rooms=[GOOD["rooms"][0], {"poly": poly}])


# --- plans of one's own ---


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_rooms_tell_in_which_unit_they_are_drawn(tmp_path, unit):
    drawn = floor([room / UNITS[unit] for room in (box(0, 0, 4, 3), box(4, 0, 8, 3))])
    path = write(tmp_path / "a.jsonl", drawn)
    found, scale = unit_of(read_plans(path, own=True))
    assert (found, scale) == (unit, UNITS[unit])
    ((own,), left_out), ((same,), _) = (
        floors_of(read_plans(path, own=True), scale),
        read_floors(write(tmp_path / "b.jsonl", GOOD)),
    )
    assert left_out == []
    np.testing.assert_allclose(own.storey.plane, same.storey.plane, atol=1e-9)
    np.testing.assert_allclose(own.storey.width, same.storey.width, atol=1e-9)
    assert own.rooms == ("OFFICE", "OFFICE")


@pytest.mark.parametrize(
    ("units", "scale"), [("ft", 0.3048), ("0.02", 0.02), ("mm", 0.001), ("in", 0.0254)]
)
def test_the_unit_may_be_said(units, scale):
    assert unit_of([], units)[1] == scale


@pytest.mark.parametrize("units", ["px", "-1", "nan", "1e9", ""])
def test_what_is_no_unit_is_refused(units):
    with pytest.raises(ValueError, match=r"units are '.*', expected m, cm, mm, ft, in, or metres"):
        unit_of([], units)


def test_pixels_are_refused_for_nobody_could_tell_them(tmp_path):
    drawn = floor([25 * box(0, 0, 4, 3), 25 * box(4, 0, 8, 3)])
    found = read_plans(write(tmp_path / "a.jsonl", drawn), own=True)
    with pytest.raises(ValueError, match="the median room has 7500 square units, which may be in"):
        unit_of(found)


def test_a_bad_room_of_one_s_own_plan_costs_that_room_and_the_reason_is_said(tmp_path):
    drawn = floor([box(0, 0, 4, 3), box(4, 0, 4.05, 3), box(4.05, 0, 8, 3)])
    drawn["rooms"].insert(1, {"poly": [[0, 0], [1, 1]]})
    drawn["rooms"][3]["name"] = "kitchen"
    ((own,), left_out) = floors_of(read_plans(write(tmp_path / "a.jsonl", drawn), own=True), 1.0)
    assert len(own.storey.room_centre) == 2
    assert own.rooms == ("OFFICE", "kitchen")
    assert left_out == [
        "office/a storey 0: rooms[1].poly has 2 different corners, expected at least 3",
        "office/a storey 0: rooms[2] is in places narrower than 0.12 m, expected one piece",
    ]


BROKEN = {
    "no 'building'": {key: GOOD[key] for key in ("storey", "rooms")},
    "no 'storey'": {key: GOOD[key] for key in ("building", "rooms")},
    "no 'rooms'": {key: GOOD[key] for key in ("building", "storey")},
    "building is 3, expected str": changed(building=3),
    "storey is 'first', expected int": changed(storey="first"),
    "storey is True, expected int": changed(storey=True),
    "rooms is {}, expected list": changed(rooms={}),
    r"rooms\[1\] is 7, expected an object": changed(rooms=[GOOD["rooms"][0], 7]),
    r"rooms\[1\] is {'poly': None}": with_poly(None),
    r"rooms\[1\].poly has 2 different corners": with_poly([[0, 0], [1, 1]]),
    r"poly has 2 different corners, expected at least 3": with_poly([[0, 0], [1, 1], [0, 0]]),
    r"rooms\[1\].poly\[1\] is \[1\]": with_poly([[0, 0], [1], [2, 2]]),
    r"rooms\[1\].poly\[2\] is 'a'": with_poly([[0, 0], [1, 1], ["a", 2]]),
    r"poly\[2\] is \[nan, 2\], expected metres": with_poly([[0, 0], [1, 1], [float("nan"), 2]]),
    r"poly\[0\] is \[inf, 2\], expected metres": with_poly([[float("inf"), 2], [1, 1], [0, 2]]),
    r"poly\[0\] is \[12000, 2\], expected metres": with_poly([[12000, 2], [1, 1], [0, 2]]),
    "is no object, expected one floor": [1, 2],
    r"building is 'a\\nb', expected a name of one line": changed(building="a\nb"),
}


@pytest.mark.parametrize("sentence", BROKEN)
def test_a_broken_line_is_refused_by_its_number(tmp_path, sentence):
    path = write(tmp_path / "floors.jsonl", GOOD, BROKEN[sentence])
    with pytest.raises(ValueError, match=sentence) as caught:
        read_floors(path)
    assert str(caught.value).startswith(f"{path}: line 2")
    assert "\n" not in str(caught.value)


FILES = {
    "not JSON": ("a.jsonl", b'{"building": "a", '),
    "deep brackets": ("a.jsonl", b"[" * 200_000),
    "not UTF-8": ("a.jsonl", b'{"building": "\xff"}'),
    "not UTF-8, packed": ("a.jsonl.gz", gzip.compress(b'{"building": "\xff"}')),
    "empty": ("a.jsonl", b"\n\n"),
    "not gzip": ("a.jsonl.gz", TEXT),
    "truncated gzip": ("a.jsonl.gz", gzip.compress(TEXT)[:-20]),
    "damaged gzip": ("a.jsonl.gz", gzip.compress(TEXT)[:40] + b"\0" * 9 + gzip.compress(TEXT)[49:]),
    "another suffix": ("a.json", TEXT),
    "gzip of what": ("a.gz", gzip.compress(TEXT)),
}


@pytest.mark.parametrize("name", FILES)
def test_a_wrong_file_is_refused_with_one_sentence(tmp_path, name):
    suffix, content = FILES[name]
    path = tmp_path / suffix
    path.write_bytes(content)
    with pytest.raises(ValueError, match=suffix) as caught:
        read_floors(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.jsonl", "a.jsonl.gz"])
def test_a_file_is_refused_before_it_fills_the_memory(tmp_path, monkeypatch, name):
    monkeypatch.setattr(plans, "MAX_BYTES", 2000)
    content = b" " * 100_000 + TEXT
    (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    with pytest.raises(ValueError, match=rf"{name}: the file is too large, expected 2000 bytes"):
        read_floors(tmp_path / name)


BOX = np.array([[0.0, 0], [4, 0], [4, 3], [0, 3]])
LARGE = {
    "the median room has 1.2e.07 square metres, expected 0.2 to 10000": [
        1000 * BOX,
        1000 * (BOX + np.array([4.2, 0])),
    ],
    "the median room has .* square metres, expected 0.2": [BOX / 9, BOX / 9 + 0.6],
    "rooms.1. has 600 corners, expected 500 at most": [BOX, np.tile(BOX, (150, 1))],
    "there are 4400 corners, expected at most 4000": [BOX + 5 * i for i in range(1100)],
    "110 rooms meet in 5995 pairs, expected side by side": [BOX + 0.01 * i for i in range(110)],
}


@pytest.mark.parametrize("reason", LARGE)
def test_a_floor_in_another_unit_or_too_large_to_compare_its_sides_is_refused(reason):
    with pytest.raises(ValueError, match=reason):
        storey_of_rooms(LARGE[reason])


@pytest.mark.parametrize("name", ["a.jsonl", "a.jsonl.gz"])
def test_a_missing_file_is_refused(tmp_path, name):
    with pytest.raises(ValueError, match="No such file"):
        read_floors(tmp_path / name)


# --- real floor plans ---


@pytest.mark.skipif(not REAL.exists(), reason="needs the real floor plans, which are not shipped")
def test_real_floor_plans():
    drawn = read_plans(REAL)
    assert len(drawn) == 1339
    for plan in drawn[::12]:
        storey = storey_of_rooms(plan.rooms)
        validate_graph(city_graph([Building((storey,), (0.0,))], FLOOR), plan.origin)
    found = [assert_walls_are_where_rays_meet(plan.rooms) for plan in drawn[70::100]]
    assert min(found) > 0
