import copy
import json
import warnings
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.data import synthetic
from sg3d_jax.io.formats import read_with_attributes, write_graphs
from sg3d_jax.io.s_graphs import (
    AXES,
    graph_from_messages,
    graph_from_reasoning,
    graph_to_messages,
    graph_to_reasoning,
    planes_from_message,
    planes_to_message,
    read_message,
    read_messages,
)
from sg3d_jax.scene.graph import make_graph, observed_of, undirected_edges
from sg3d_jax.scene.ontology import BUILDING, FEATURES, FLOOR, PART_OF, PLANE, ROOM, WALL
from sg3d_jax.scene.validate import check_observed, validate_graph
from tests.io.documents import places_of

# A flat of two rooms as a robot reports it: ids of vertices, points denser near the robot, normals
# in single precision that lean a little, a plane without points, a floor and a climb of stairs.
MESSAGES = json.loads((Path(__file__).parent / "s_graphs.json").read_text())


def scene(index=0):
    return synthetic.make_scene(synthetic.S_F, 0, index)


def assert_close(left, right):
    npt.assert_array_equal(left.nodes.label, right.nodes.label)
    for name in ("position", *FEATURES):
        one, other = getattr(left.nodes, name), getattr(right.nodes, name)
        npt.assert_allclose(one, other, rtol=0, atol=1e-12)
    npt.assert_array_equal(undirected_edges(left, PART_OF), undirected_edges(right, PART_OF))


def test_planes_of_a_robot_are_read():
    nodes = planes_from_message(MESSAGES["planes"]).nodes
    assert nodes.label.tolist() == [PLANE] * 8
    npt.assert_allclose(nodes.width, [3, 4, 3, 4, 4, 4, 3, 3], atol=1e-3)
    x, y = [-2, 0, 2, 0, 2.2, 5.2, 3.7, 3.7], [0, -1.5, 0, 1.5, 0.5, 0.5, -1.5, 2.5]
    npt.assert_allclose(nodes.position[:, :2], np.stack([x, y], -1), atol=1e-3)
    assert (nodes.position[:, 2] > 1).all()
    sent = sorted((p for axis in AXES for p in MESSAGES["planes"][axis]), key=lambda p: p["id"])
    with_points = [plane for plane in sent if plane["plane_points"]]
    normals = [[plane[key] for key in ("nx", "ny", "nz")] for plane in with_points]
    npt.assert_array_equal(nodes.normal, normals)  # as they are, leaning or not


def test_planes_of_a_robot_keep_their_ids():
    message = copy.deepcopy(MESSAGES["planes"])
    message["x_planes"][0]["id"] = 170  # behind all others
    read = read_message(message)
    sent = [plane for axis in AXES for plane in message[axis] if plane["plane_points"]]
    assert [held["id"] for held in read.attributes] == sorted(plane["id"] for plane in sent)
    assert read.attributes[-1] == {"id": 170}
    first = planes_from_message(MESSAGES["planes"]).nodes.width[0]
    npt.assert_array_equal(read.graph.nodes.width[-1], first)


@pytest.mark.parametrize(
    ("normal", "along"), [([0, 0, -2.0], [1, 0, 0]), ([0.0, 0.9, 0.3], [1, 0, 0])]
)
def test_the_extent_of_a_plane_that_leans_is_horizontal(normal, along):
    message = copy.deepcopy(MESSAGES["planes"])
    plane = message["x_planes"][0]
    plane["nx"], plane["ny"], plane["nz"] = normal
    plane["plane_points"] = [{"x": x, "y": 0.0, "z": z} for x, z in ((1, 2), (4, 0), (2, 1))]
    nodes = planes_from_message(message).nodes
    npt.assert_allclose(nodes.width[0], 3)
    npt.assert_allclose(nodes.position[0], [2.5, 0, 1])
    npt.assert_array_equal(nodes.normal[0], normal)


def test_normals_of_a_robot_point_into_its_rooms():
    graph = graph_from_messages(MESSAGES)
    for plane, room in undirected_edges(graph, PART_OF)[:, :2]:
        if graph.nodes.label[plane] == PLANE and graph.nodes.label[room] == ROOM:
            inwards = graph.nodes.position[room] - graph.nodes.position[plane]
            assert inwards @ graph.nodes.normal[plane] > 0


def test_the_offset_of_a_plane_is_not_its_width():
    message = copy.deepcopy(MESSAGES["planes"])
    for plane in message["x_planes"]:
        plane["d"] = 1e3
    npt.assert_array_equal(
        planes_from_message(message).nodes.width,
        planes_from_message(MESSAGES["planes"]).nodes.width,
    )


def test_a_centroid_is_the_middle_of_a_wall_however_dense_its_points():
    message = copy.deepcopy(MESSAGES["planes"])
    message["x_planes"][0]["plane_points"] += [{"x": -2.02, "y": -1.4, "z": 1.0}] * 91
    position = planes_from_message(message).nodes.position[0]
    npt.assert_allclose(position, [-2.0182, 0, 1.04], atol=1e-2)


def test_planes_keep_the_order_of_their_ids():
    message = copy.deepcopy(MESSAGES["planes"])
    for axis in ("x_planes", "y_planes"):
        message[axis].reverse()
    assert_close(planes_from_message(message), planes_from_message(MESSAGES["planes"]))


@pytest.mark.parametrize("index", range(20))
def test_planes_survive_their_message(index):
    graph = scene(index)
    message = json.loads(json.dumps(planes_to_message(graph)))
    assert_close(planes_from_message(message), observed_of(graph))


def test_a_message_of_planes_says_where_they_are():
    graph = scene()
    message = planes_to_message(graph)
    assert all(abs(plane["nx"]) >= abs(plane["ny"]) for plane in message["x_planes"])
    assert all(abs(plane["ny"]) > abs(plane["nx"]) for plane in message["y_planes"])
    for plane in message["x_planes"] + message["y_planes"]:
        normal = np.array([plane["nx"], plane["ny"], plane["nz"]])
        npt.assert_array_equal(normal, graph.nodes.normal[plane["id"]])
        for point in plane["plane_points"]:
            npt.assert_allclose(normal @ [point[key] for key in "xyz"] + plane["d"], 0, atol=1e-12)


@pytest.mark.parametrize("index", range(20))
def test_a_floor_survives_its_messages(index):
    graph = scene(index)
    messages = json.loads(json.dumps(graph_to_messages(graph)))
    assert_close(graph_from_messages(messages), graph)


def storeys(heights):
    """Returns a graph of one room of two planes on every floor, under one building."""
    count = len(heights)
    label = np.repeat([PLANE, ROOM, FLOOR, BUILDING], [2 * count, count, count, 1])
    position, normal = np.zeros((2, len(label), 3))
    width = np.zeros(len(label))
    position[: 4 * count, 2] = np.concatenate([heights] * 4)
    position[count : 2 * count, 0] = 3
    normal[:count, 0], normal[count : 2 * count, 0], width[: 2 * count] = 1, -1, 2
    first, second, rooms, floors = np.arange(4 * count).reshape(4, count)
    parents = [(first, rooms), (second, rooms), (rooms, floors), (floors, 0 * floors + 4 * count)]
    part_of = np.concatenate([np.stack(pair, axis=-1) for pair in parents])
    return make_graph(label, position, normal, width, part_of)


def test_rooms_go_to_the_floor_of_their_height():
    graph = storeys([0.0, 3.0, 6.0])
    read = graph_from_messages(graph_to_messages(graph))
    assert read.nodes.label.tolist() == [*[PLANE] * 6, *[ROOM] * 3, *[FLOOR] * 3]
    npt.assert_array_equal(undirected_edges(read, PART_OF), undirected_edges(graph, PART_OF)[:9])


def test_floors_at_one_height_are_refused():
    messages = graph_to_messages(storeys([0.0, 0.25]))
    with pytest.raises(ValueError, match=r"^map: floors has two at one height, expected 0\.5 m or"):
        graph_from_messages(messages, "map")


def test_a_robot_s_messages_give_a_whole_graph():
    graph = graph_from_messages(MESSAGES)
    assert graph.nodes.label.tolist() == [*[PLANE] * 8, WALL, ROOM, ROOM, FLOOR]
    pairs = [[0, 9], [1, 9], [2, 8], [2, 9], [3, 9], [4, 8], [4, 10], *[[i, 10] for i in (5, 6, 7)]]
    npt.assert_array_equal(undirected_edges(graph, PART_OF), [*pairs, [9, 11], [10, 11]])
    npt.assert_allclose(graph.nodes.position[8:11, :2], [[2.1, 0.2], [0, 0], [3.7, 0.5]])


def test_ids_of_a_map_are_those_of_its_messages_unless_two_are_the_same():
    messages = copy.deepcopy(MESSAGES)
    messages["rooms"]["rooms"][0]["id"] = 100  # the other room is called as a floor is
    read = read_messages(messages)
    ids = [held.get("id") for held in read.attributes]
    planes = sorted(p["id"] for axis in AXES for p in messages["planes"][axis] if p["plane_points"])
    assert ids == [*planes, 0, 100, None, None]


def test_a_map_is_one_json_and_comes_back_as_its_messages(tmp_path):
    (tmp_path / "map.json").write_text(json.dumps(MESSAGES))
    (read,) = read_with_attributes(tmp_path / "map.json")
    said = {"attributes": [read.attributes]}
    write_graphs(tmp_path / "a.json", [read.graph], "s-graphs", **said)
    made = json.loads((tmp_path / "a.json").read_text())
    assert set(made) == {"planes", "walls", "rooms", "floors"}
    (again,) = read_with_attributes(tmp_path / "a.json")
    assert_close(again.graph, read.graph)
    assert [held for held in read.attributes if held] == [
        held for held, old in zip(again.attributes, read.attributes, strict=True) if old
    ]


def test_only_the_planes_are_required():
    graph = graph_from_messages({"planes": MESSAGES["planes"], "floors": None})
    assert_close(graph, planes_from_message(MESSAGES["planes"]))


def test_messages_hold_what_s_graphs_reads():
    messages = graph_to_messages(graph_from_messages(MESSAGES))
    (wall,), (room, _) = messages["walls"]["walls"], messages["rooms"]["rooms"]
    assert [plane["id"] for plane in wall["x_planes"]] == [2, 4]
    assert wall["y_planes"] == []
    assert [plane["id"] for plane in room["x_planes"]] == [0, 2]
    assert [plane["id"] for plane in room["y_planes"]] == [1, 3]
    assert [plane["id"] for plane in room["planes"]] == [0, 1, 2, 3]
    assert room["room_center"]["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1}
    npt.assert_allclose([room["room_length"][key] for key in "xy"], [4, 3], atol=1e-3)


def test_a_reasoning_graph_names_planes_and_rooms():
    graph = graph_from_messages(MESSAGES)
    message = graph_to_reasoning(graph, "Prior")
    assert message["name"] == "Prior"
    assert [node["type"] for node in message["nodes"]] == ["Plane"] * 8 + ["Finite Room"] * 2
    (plane,) = message["nodes"][0]["attributes"]
    assert plane["name"] == "Geometric_info"
    npt.assert_allclose(plane["fl_value"], [1, 0, 0, 2], atol=4e-3)  # it leans a little
    assert message["nodes"][9]["attributes"][0]["fl_value"] == [3.7, 0.5, 0.0]
    edge = {"name": "EdgeRoom4Planes", "str_value": "", "fl_value": []}
    assert message["edges"][0] == {"origin_node": 9, "target_node": 0, "attributes": [edge]}
    assert len(message["edges"]) == 8


@pytest.mark.parametrize("index", range(5))
def test_rooms_survive_a_reasoning_graph_and_its_planes(index):
    graph = scene(index)
    message = json.loads(json.dumps(graph_to_reasoning(graph)))
    read = graph_from_reasoning(message, planes_to_message(graph))
    keep = np.flatnonzero((graph.nodes.label == PLANE) | (graph.nodes.label == ROOM))
    assert read.nodes.label.tolist() == graph.nodes.label[keep].tolist()
    npt.assert_allclose(read.nodes.position, graph.nodes.position[keep], atol=1e-12)
    place = np.full(len(graph.nodes.label), -1)
    place[keep] = np.arange(len(keep))
    pairs = place[undirected_edges(graph, PART_OF)]
    npt.assert_array_equal(undirected_edges(read, PART_OF), pairs[(pairs >= 0).all(axis=-1)])


def broken(*path, value):
    """Returns the messages with one value replaced, or removed if it is `...`."""
    messages = copy.deepcopy(MESSAGES)
    holder = messages
    for key in path[:-1]:
        holder = holder[key]
    if value is ...:
        del holder[path[-1]]
    else:
        holder[path[-1]] = value
    return messages


PLANE_0 = ("planes", "x_planes", 0)
POINT = {"x": 0.0, "y": 0.0, "z": 0.0}


@pytest.mark.parametrize(
    ("messages", "sentence"),
    [
        ([], r"\[\], expected an object with 'planes'"),
        ({}, "lacks 'planes'"),
        (broken("planes", value=3), "planes is 3, expected an object with 'x_planes'"),
        (broken("planes", "y_planes", value=...), "planes lacks 'y_planes'"),
        (broken("planes", "y_planes", value={}), "y_planes is {}, expected a list"),
        (broken(*PLANE_0, value=7), r"x_planes\[0\] is 7, expected an object"),
        (broken(*PLANE_0, "id", value=...), r"x_planes\[0\] lacks 'id'"),
        (broken(*PLANE_0, "id", value=3.0), r"x_planes\[0\].id is 3.0, expected an integer"),
        (broken(*PLANE_0, "id", value=True), r"x_planes\[0\].id is True, expected an integer"),
        (broken("planes", "y_planes", 0, "id", value=3), r"y_planes\[0\].id is 3 again, expected"),
        (broken(*PLANE_0, "nx", value="1"), r"x_planes\[0\].nx is '1', expected a number"),
        (broken(*PLANE_0, "nx", value=np.nan), r"x_planes\[0\].nx is nan, expected a finite"),
        (
            broken(*PLANE_0, value=dict(MESSAGES["planes"]["x_planes"][0], nx=0, ny=0, nz=0)),
            r"x_planes\[0\] has the normal \[0, 0, 0\], expected length 1",
        ),
        (broken(*PLANE_0, "plane_points", value=...), r"x_planes\[0\] lacks 'plane_points'"),
        (
            broken(*PLANE_0, "plane_points", value=[1]),
            r"plane_points\[0\] is 1, expected an object",
        ),
        (broken(*PLANE_0, "plane_points", 1, "y", value=np.inf), r"points\[1\].y is inf, expected"),
        (
            broken(*PLANE_0, "plane_points", value=[POINT]),
            "is no longer than a point, expected poin",
        ),
        (broken(*PLANE_0, "plane_points", 1, "y", value=1e308), "expected numbers within 1e"),
        (broken("planes", value={"x_planes": [], "y_planes": []}), "planes holds no planes"),
        (broken("walls", "walls", value=...), "walls lacks 'walls'"),
        (broken("walls", "walls", 0, "wall_center", value=...), r"walls\[0\] lacks 'wall_center'"),
        (
            broken("walls", "walls", 0, "x_planes", 0, "id", value=60),
            r"walls\[0\].x_planes\[0\].id is 60, expected the id of a plane with points",
        ),
        (
            broken("rooms", "rooms", 1, "planes", 2, "id", value=77),
            r"rooms.rooms\[1\].planes\[2\].id is 77, expected the id of a plane with points",
        ),
        (
            broken("rooms", "rooms", 1, "planes", value=4),
            r"rooms\[1\]: planes is 4, expected a list",
        ),
        (
            broken("rooms", "rooms", 0, "room_center", "position", "z", value=None),
            r"rooms\[0\].room_center.position.z is None, expected a number",
        ),
        (broken("floors", value={"id": 1}), "floors is .*, expected a list of FloorData"),
        (broken("floors", 0, "floor_center", value=...), r"floors\[0\] lacks 'floor_center'"),
        (broken("floors", 1, "state", value=0), "floors has two at one height"),
    ],
)
def test_broken_messages_are_refused_in_one_sentence(messages, sentence):
    with pytest.raises(ValueError, match=rf"^map\.json.*{sentence}") as caught:
        graph_from_messages(messages, "map.json")
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


def reasoning(*path, value):
    message = graph_to_reasoning(graph_from_messages(MESSAGES))
    holder = message
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    return message


@pytest.mark.parametrize(
    ("message", "sentence"),
    [
        ([], "expected an object with 'nodes'"),
        (
            reasoning("nodes", 0, "type", value="Tree"),
            r"nodes\[0\].type is 'Tree', expected Plane",
        ),
        (reasoning("nodes", 9, "id", value=9), r"nodes\[9\].id is 9 again, expected unique"),
        (
            reasoning("nodes", 9, "attributes", value=[]),
            "has no 'Geometric_info', expected",
        ),
        (
            reasoning("nodes", 9, "attributes", 0, "fl_value", value=[1.0]),
            r"nodes\[9\].attributes\[0\].fl_value is \[1.0\], expected three numbers",
        ),
        (
            reasoning("edges", 3, "origin_node", value=0),
            r"edges\[3\].origin_node is 0, expected",
        ),
        (
            reasoning("edges", 3, "target_node", value=9),
            r"edges\[3\].target_node is 9, expected",
        ),
        (reasoning("edges", 1, "target_node", value=0), "is there twice, expected once"),
    ],
)
def test_a_broken_reasoning_graph_is_refused_in_one_sentence(message, sentence):
    planes = planes_to_message(graph_from_messages(MESSAGES))
    with pytest.raises(ValueError, match=rf"^graph\.json.*{sentence}") as caught:
        graph_from_reasoning(message, planes, "graph.json")
    assert "\n" not in str(caught.value)


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["x", "id", "planes", "position"]), inner)
    ),
    max_leaves=8,
)


@given(place=st.sampled_from(sorted(places_of(MESSAGES), key=str)), value=JSON_VALUES)
@settings(deadline=None, max_examples=60)
def test_any_value_anywhere_is_refused_or_gives_a_sound_graph(place, value):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        graph, message = read_or_message(broken(*place, value=value))
    if graph is None:
        assert message.startswith("map")
        assert "\n" not in message
    else:
        check_observed(observed_of(graph), "map")
        # Normals that lean, or are of another length, are mended on the way in.
        level = graph.nodes.observed[:, None] * [1.0, 0.0, 0.0]
        validate_graph(graph._replace(nodes=graph.nodes._replace(normal=level)), "map")


def read_or_message(messages):
    try:
        return graph_from_messages(messages, "map"), None
    except ValueError as error:
        return None, str(error)
