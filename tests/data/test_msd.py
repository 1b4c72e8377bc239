"""The table of MSD becomes floors: on small tables of the same form, made here."""

import csv
import io
import re
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapely import affinity

from sg3d_jax.data import msd
from sg3d_jax.data.buildings import Building, city_graph
from sg3d_jax.data.levels import LEVELS
from sg3d_jax.data.msd import read_floors
from sg3d_jax.scene.ontology import FLOOR
from sg3d_jax.scene.validate import validate_graph

# As the release has them, with the index that pandas leaves in front.
COLUMNS = """
apartment_id site_id building_id plan_id floor_id unit_id area_id unit_usage entity_type
entity_subtype geom elevation height zoning roomtype
"""
HEADER = ["", *COLUMNS.split()]

# An apartment: a corridor, a bedroom and an L-shaped living room above it, a balcony.
CORRIDOR = shapely.box(0, 0, 6, 2)
BEDROOM = shapely.box(0, 2.2, 3.4, 6)
LIVING = shapely.Polygon([(3.6, 2.2), (6, 2.2), (6, 7), (4.6, 7), (4.6, 6), (3.6, 6)])
TERRACE = shapely.box(0, 6.3, 3.4, 8)
ROOMS = [
    ("Corridor", CORRIDOR),
    ("Bedroom", BEDROOM),
    ("Livingroom", LIVING),
    ("Balcony", TERRACE),
]
LONG_WALL = shapely.box(0, 2, 6, 2.2)
BETWEEN = shapely.box(3.4, 2.2, 3.6, 6)
OUTER = shapely.box(0, 6, 3.4, 6.3)
COLUMN = shapely.box(1, 0.9, 1.2, 1.1)  # all its edges look at one plane
FACADE = shapely.box(-0.3, 0, 0, 2)
WALLS = [("Structure", shape) for shape in (COLUMN, LONG_WALL, FACADE, BETWEEN, OUTER)]
FRONT_DOOR = ("Entrance Door", shapely.box(-0.3, 0.5, 0, 1.4))
DOORS = [
    FRONT_DOOR,
    ("Door", shapely.box(1.5, 2, 2.3, 2.2)),
    ("Door", shapely.box(4.5, 2, 5.3, 2.2)),
]
WINDOW = ("Window", shapely.box(1, 6, 2.6, 6.3))
APARTMENT = [*ROOMS, *WALLS, *DOORS, WINDOW]


def rows(drawn, apartment="a1", floor="11", building="1"):
    """Rows of the table for what is drawn of one apartment, or of shared space."""
    entity = {"Structure": "separator", "Door": "opening", "Window": "opening"}
    return [
        {
            "": "7",
            "apartment_id": apartment,
            "site_id": "3",
            "building_id": building,
            "plan_id": floor,
            "floor_id": floor,
            "unit_usage": "RESIDENTIAL" if apartment else "PUBLIC",
            "entity_type": entity.get(kind, "area"),
            "geom": shape if isinstance(shape, str) else shape.wkt,
            "elevation": "2.9",
            "height": "2.6",
            "roomtype": kind,
        }
        for kind, shape in drawn
    ]


def table(*groups):
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, HEADER, restval="")
    writer.writeheader()
    for group in groups:
        writer.writerows(group)
    return text.getvalue()


def write(tmp_path, *groups):
    path = tmp_path / "msd.csv"
    path.write_text(table(*groups), encoding="utf-8", newline="")
    return path


def read_one(tmp_path, drawn):
    """The only floor of a table of one apartment."""
    floors, left_out = read_floors(write(tmp_path, rows(drawn)))
    assert left_out == []
    return floors[0].storey


def test_the_table_of_swiss_dwellings_is_the_same_apartment(tmp_path):
    raw = {"Corridor": "CORRIDOR", "Bedroom": "ROOM", "Livingroom": "LIVING_DINING"}
    raw |= {"Balcony": "TERRACE", "Structure": "WALL", "Entrance Door": "ENTRANCE_DOOR"}
    sink = rows([("Kitchen", shapely.box(1, 1, 1.5, 1.5))])[0] | {"entity_type": "feature"}
    text = table(rows(APARTMENT), [sink])
    lines = list(csv.DictReader(io.StringIO(text)))
    for line in lines:
        kind = line.pop("roomtype")
        line["entity_subtype"] = raw.get(kind, kind.upper())
        line["geometry"] = line.pop("geom")
    with (tmp_path / "geometries.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(lines[0]))
        writer.writeheader()
        writer.writerows(lines)
    (floor,), left_out = read_floors(tmp_path / "geometries.csv")
    assert left_out == []
    assert floor.rooms == ("Corridor", "Bedroom", "Livingroom", "Balcony")
    for one, other in zip(floor.storey, read_one(tmp_path, APARTMENT), strict=True):
        np.testing.assert_array_equal(one, other)


def why_left_out(tmp_path, drawn):
    floors, (reason,) = read_floors(write(tmp_path, rows(drawn)))
    assert floors == []
    return reason


def moved(drawn, rng):
    """The same apartment, turned, stretched and carried somewhere."""
    angle, stretch, shift = rng.uniform(0, 360), rng.uniform(0.9, 1.3), rng.uniform(-40, 40, 2)

    def move(shape):
        shape = affinity.scale(shape, stretch, 1, origin=(0, 0))
        return affinity.translate(affinity.rotate(shape, angle, origin=(0, 0)), *shift)

    return [(kind, move(shape)) for kind, shape in drawn]


def city(num_buildings=6):
    """Buildings of two floors of two apartments, with stairs that they share."""
    rng = np.random.default_rng(0)
    groups = []
    for building in range(num_buildings):
        for storey in range(2):
            floor = str(100 * building + storey)
            for flat in "ab":
                drawn = moved(APARTMENT, rng)
                groups.append(rows(drawn, f"{flat}{floor}", floor, str(building)))
            shared = [("Stairs", shapely.box(0, 0, 3, 3)), ("Structure", shapely.box(3, 0, 3.2, 3))]
            groups.append(rows(shared, "", floor, str(building)))
    return groups


# --- the conversion ---


def test_every_edge_of_a_room_is_a_plane_looking_inwards(tmp_path):
    storey = read_one(tmp_path, APARTMENT)
    assert np.bincount(storey.room).tolist() == [4, 4, 6, 4]
    for room, (_, shape) in enumerate(ROOMS):
        mine = storey.room == room
        inside = shapely.points(storey.plane[mine] + 1e-3 * storey.normal[mine])
        assert shapely.contains(shape, inside).all()
        np.testing.assert_allclose(storey.width[mine].sum(), shape.length)
        centroid = [shape.centroid.x, shape.centroid.y]
        np.testing.assert_allclose(storey.room_centre[room], centroid)


def test_doors_and_straight_corners_do_what_the_authors_let_them_do(tmp_path):
    straight = shapely.Polygon([(0, 0), (2, 0), (6, 0), (6, 2), (0, 2), (0, 2)])
    drawn = [("Corridor", straight), *APARTMENT[1:]]
    storey = read_one(tmp_path, drawn)
    widths = sorted(storey.width[storey.room == 0].tolist())
    assert widths == pytest.approx([2, 2, 2, 4, 6])  # a repeated corner is none, a straight one is


def test_walls_are_the_structures_that_two_planes_look_at(tmp_path):
    storey = read_one(tmp_path, APARTMENT)
    centres = [[shape.centroid.x, shape.centroid.y] for shape in (LONG_WALL, BETWEEN, OUTER)]
    np.testing.assert_allclose(storey.wall_centre, centres)
    planes = [storey.plane[storey.wall[storey.wall[:, 1] == wall, 0]] for wall in range(3)]
    expected = [[[1.7, 2.2], [3, 2]], [[3.4, 4.1], [3.6, 4.1]], [[1.7, 6], [1.7, 6.3]]]
    for found, place in zip(planes, expected, strict=True):
        np.testing.assert_allclose(sorted(found.tolist()), place)


def test_a_wall_along_several_rooms_has_a_plane_of_each(tmp_path):
    # Corners of the wall where the rooms end, as where walls meet.
    notched = shapely.Polygon([(0, 2), (6, 2), (6, 2.2), (3.5, 2.2), (3.5, 2.2001), (0, 2.2)])
    drawn = [*ROOMS, ("Structure", notched), *DOORS, WINDOW]
    storey = read_one(tmp_path, drawn)
    assert sorted(storey.room[storey.wall[:, 0]]) == [0, 1, 2]


def test_holes_of_rooms_have_no_planes(tmp_path):
    holed = CORRIDOR.difference(shapely.box(3, 0.8, 3.4, 1.2))
    storey = read_one(tmp_path, [("Corridor", holed), *APARTMENT[1:]])
    assert np.bincount(storey.room).tolist() == [4, 4, 6, 4]


def test_an_apartment_without_walls_has_rooms_all_the_same(tmp_path):
    storey = read_one(tmp_path, [("Bedroom", BEDROOM)])
    assert storey.wall.shape == (0, 2)
    assert storey.wall_centre.shape == (0, 2)
    validate_graph(city_graph([Building((storey,), (0.0,))], FLOOR), "one room")


def plain_walls(drawn):
    """The rule of the authors, edge by edge: (centre of wall, centres of its planes)."""
    rooms = [shape for kind, shape in drawn if kind in dict(ROOMS)]
    found = []
    for wall in (shape for kind, shape in drawn if kind == "Structure"):
        planes = set()
        for start, end in segments(wall):
            middle, normal = (start + end) / 2, left(end - start)
            if wall.contains(shapely.Point(middle + 0.01 * normal)):
                normal = -normal
            for room in rooms:
                if room.contains(shapely.Point(middle + 0.01 * normal)):
                    centres = [(a + b) / 2 for a, b in segments(room)]
                    nearest = min(centres, key=lambda c: np.linalg.norm(c - middle))
                    planes.add(tuple(np.round(nearest, 6)))
        if len(planes) > 1:
            found.append((tuple(np.round([wall.centroid.x, wall.centroid.y], 6)), sorted(planes)))
    return sorted(found)


def segments(shape):
    return pairwise(np.array(shape.exterior.coords))


def left(vector):
    return np.array([-vector[1], vector[0]]) / np.linalg.norm(vector)


@given(st.integers(0, 10_000))
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_walls_agree_with_the_rule_applied_edge_by_edge(tmp_path, seed):
    drawn = moved(APARTMENT, np.random.default_rng(seed))
    storey = read_one(tmp_path, drawn)
    found = []
    for wall, centre in enumerate(storey.wall_centre):
        planes = storey.plane[storey.wall[storey.wall[:, 1] == wall, 0]]
        found.append((tuple(np.round(centre, 6)), sorted(map(tuple, np.round(planes, 6)))))
    assert [wall for wall, _ in sorted(found)] == [wall for wall, _ in plain_walls(drawn)]
    for (_, mine), (_, theirs) in zip(sorted(found), plain_walls(drawn), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=2e-6)


# --- which apartments ---


def test_rooms_are_connected_by_passages_doors_and_windows_of_balconies(tmp_path):
    next_door = ("Bedroom", shapely.box(0, 2.03, 3.4, 6))
    assert len(read_one(tmp_path, [ROOMS[0], next_door]).room_centre) == 2
    through = [ROOMS[1], ROOMS[3], WINDOW]
    assert len(read_one(tmp_path, through).room_centre) == 2


APART = {
    "no doors": [*ROOMS, *WALLS],
    "a door beside": [*ROOMS[:2], ("Door", shapely.box(4.5, 2, 5.3, 2.2))],
    "a window between two rooms": [ROOMS[1], ("Bedroom", TERRACE), WINDOW],
    "a window too small once halved": [*ROOMS[1::2], ("Window", shapely.box(1, 6, 1.2, 6.3))],
}


@pytest.mark.parametrize("name", APART)
def test_apartments_whose_rooms_are_apart_are_left_out(tmp_path, name):
    reason = why_left_out(tmp_path, APART[name])
    assert reason.startswith("11_a1: the rooms are in ")


def test_apartments_of_two_storeys_and_shared_spaces_are_none_of_ours(tmp_path):
    upper = rows(APARTMENT, "a1", "12", "1")
    path = write(tmp_path, rows(APARTMENT), upper, rows(APARTMENT, "", "12"), rows(ROOMS, "b", "9"))
    floors, left_out = read_floors(path)
    assert floors == []
    assert [reason.split(":")[0] for reason in left_out] == ["9_b"]


def test_floors_come_in_the_order_of_the_table_each_with_its_building(tmp_path):
    floors, left_out = read_floors(write(tmp_path, *city()))
    assert left_out == []
    expected = [
        (str(b), f"{100 * b + storey}_{flat}{100 * b + storey}")
        for b in range(6)
        for storey in range(2)
        for flat in "ab"
    ]
    assert [(floor.building, floor.origin) for floor in floors] == expected


@pytest.mark.parametrize(("limit", "expected"), [(1, 2), (2, 2), (3, 4), (99, 24)])
def test_reading_ends_with_the_floor_that_reaches_the_limit(tmp_path, limit, expected):
    floors, _ = read_floors(write(tmp_path, *city()), max_apartments=limit)
    assert len(floors) == expected


@pytest.mark.parametrize("name", LEVELS)
def test_apartments_are_stacked_like_any_floors(tmp_path, name):
    floors, _ = read_floors(write(tmp_path, *city()))
    graphs, parts, origins, _ = LEVELS[name](floors, rotate=False)
    assert len(graphs) == len(floors)
    assert set(parts) == {"train", "validation", "test"}
    for graph, origin in zip(graphs, origins, strict=True):
        validate_graph(graph, origin)


ODD = {
    "there are no rooms": WALLS,
    "roomtype 'Garage' is not one of MSD's": [*APARTMENT, ("Garage", CORRIDOR)],
    "a Bedroom is no simple polygon": [("Bedroom", "POLYGON ((0 0, 3 3, 3 0, 0 3, 0 0))")],
    "a Corridor is no simple polygon": [("Corridor", "LINESTRING (0 0, 3 3)")],
    "a Kitchen is no simple polygon": [("Kitchen", "POLYGON EMPTY")],
    "a Dining is no simple polygon": [("Dining", "POLYGON ((0 0, 1 0, 2 0, 0 0))")],
}


@pytest.mark.parametrize("reason", ODD)
def test_apartments_that_nobody_could_tell_are_left_out_with_a_reason(tmp_path, reason):
    assert reason in why_left_out(tmp_path, ODD[reason])


# --- broken tables ---


def without(column):
    reader = list(csv.reader(io.StringIO(table(rows(APARTMENT)), newline="")))
    place = reader[0].index(column)
    text = io.StringIO(newline="")
    csv.writer(text).writerows([row[:place] + row[place + 1 :] for row in reader])
    return text.getvalue()


def with_cell(column, value):
    drawn = rows(APARTMENT)
    drawn[2][column] = value
    return table(drawn)


GOOD = table(rows(APARTMENT), rows(moved(APARTMENT, np.random.default_rng(1)), "a2", "12"))
CURVE = "CIRCULARSTRING (0 0, 1 1, 2 0)"
BROKEN = {
    "there is no column geom": without("geom"),
    "there is no column apartment_id, expected": without("apartment_id"),
    "there is no column apartment_id": "once upon a time\n",
    "no column apartment_id": "",
    "line 4: floor_id is empty, expected that of apartment a1": with_cell("floor_id", ""),
    "line 4: building_id is empty": with_cell("building_id", ""),
    r"line 4: geom is 'POLYGON \(\(0 0, 1 1": with_cell("geom", "POLYGON ((0 0, 1 1))"),
    "line 4: geom is 'nonsense', expected WKT": with_cell("geom", "nonsense"),
    "line 4: geom is '', expected WKT": with_cell("geom", ""),
    "CIRCULARSTRING .0 0, 1 1, 2 0.', expected WKT without": with_cell("geom", CURVE),
    r"floor_id and apartment_id are '\\x07' and 'a1', expected": with_cell("floor_id", "\a"),
    "nan 1, 0 0..', expected metres within": with_cell("geom", "POLYGON ((0 0, 1 0, nan 1, 0 0))"),
    "expected metres within 1e": with_cell("geom", "POLYGON ((0 0, 1 0, 1e300 1, 0 0))"),
    "line 2 has not as many cells as the header": GOOD.replace('"', ""),
    "line 28 has not as many cells": GOOD + "7,a1,3,1\r\n",
    "unexpected end of data": GOOD[:-60],
    "not a table": GOOD + '"',
}


@pytest.mark.parametrize("sentence", BROKEN)
def test_a_broken_table_is_refused_with_one_sentence(tmp_path, sentence):
    path = tmp_path / "msd.csv"
    path.write_text(BROKEN[sentence], encoding="utf-8", newline="")
    with pytest.raises(ValueError, match=sentence) as caught:
        read_floors(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("drawn", "reason"),
    [
        ([("Bedroom", shapely.box(0, 0, 4000, 3000))], "the median room has 1.2e.07 square metres"),
        (
            [("Bedroom", shapely.Point(0, 0).buffer(3, 250))] * 5,
            "there are 5005 corners, expected at",
        ),
        ([("Bedroom", BEDROOM)] * 400 + [("Structure", BETWEEN)] * 99, "39600 edges of walls"),
    ],
)
def test_an_apartment_that_is_too_large_is_left_out(tmp_path, drawn, reason):
    (tmp_path / "msd.csv").write_text(table(rows(drawn)), encoding="utf-8", newline="")
    floors, left_out = read_floors(tmp_path / "msd.csv")
    assert floors == []
    assert re.search(rf"11_a1: {reason}", left_out[0])


def test_a_table_larger_than_the_release_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "msd.csv"
    path.write_text(GOOD, encoding="utf-8", newline="")
    monkeypatch.setattr(msd, "MAX_BYTES", 100)
    with pytest.raises(ValueError, match=r"msd\.csv: the file is too large, expected 100 bytes"):
        read_floors(path)


def test_what_is_no_text_or_no_file_is_refused(tmp_path):
    path = tmp_path / "msd.csv"
    with pytest.raises(ValueError, match="No such file"):
        read_floors(path)
    path.write_bytes(b"PK\x03\x04\xff\xfe")
    with pytest.raises(ValueError, match="not UTF-8"):
        read_floors(path)
