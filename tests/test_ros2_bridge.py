"""The bridge to S-Graphs, with stand-ins for ROS, its messages and the session."""

import importlib.util
import json
import sys
from collections import OrderedDict
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from sg3d_jax.io.s_graphs import graph_from_messages
from tests import simple_session
from tests.tiny_run import ROOT

MAP = json.loads((Path(__file__).parent / "io" / "s_graphs.json").read_text())
# What fields there are, of those messages that the bridge makes: setting another one is an error.
FIELDS = {
    "RoomsData": {"header", "rooms"},
    "WallsData": {"header", "walls"},
    "FloorData": {"header", "id", "floor_center", "keyframe_ids", "state"},
    "String": {"data"},
    "PlanesData": {"header", "x_planes", "y_planes"},
}


class Node:
    """What the bridge needs of `rclpy.node.Node`."""

    def __init__(self, name):
        self.topics, self.said, self.warnings = {}, [], []

    def declare_parameter(self, name, value):
        return SimpleNamespace(value=value)

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=lambda message: self.said.append((topic, kind, message)))

    def create_subscription(self, kind, topic, callback, depth):
        self.topics[topic] = callback

    def get_logger(self):
        return SimpleNamespace(info=lambda text: None, warning=self.warnings.append)


def set_message_fields(message, values):
    assert {*values} <= FIELDS[type(message).__name__]
    vars(message).update(values)


@pytest.fixture
def bridge(monkeypatch):
    simple_session.install(monkeypatch)
    kinds = {name: type(name, (), {}) for name in FIELDS}
    for name, held in {
        "rclpy": {},
        "rclpy.executors": {"ExternalShutdownException": RuntimeError},
        "rclpy.node": {"Node": Node},
        "rosidl_runtime_py.convert": {"message_to_ordereddict": OrderedDict},
        "rosidl_runtime_py.set_message": {"set_message_fields": set_message_fields},
        "situational_graphs_msgs.msg": kinds,
        "std_msgs.msg": kinds,
    }.items():
        module = ModuleType(name)
        vars(module).update(held)
        monkeypatch.setitem(sys.modules, name, module)
    path = ROOT / "examples" / "ros2_bridge.py"
    script = importlib.util.module_from_spec(importlib.util.spec_from_file_location("bridge", path))
    script.__spec__.loader.exec_module(script)
    return script.Bridge()


def last(bridge, topic):
    return next(vars(message) for name, _, message in reversed(bridge.said) if name == topic)


def test_a_list_of_planes_is_answered_by_rooms_with_the_ids_of_s_graphs(bridge):
    (hear,) = bridge.topics.values()
    hear(MAP["planes"])
    rooms = last(bridge, "room_segmentation/room_data")
    walls = last(bridge, "wall_segmentation/wall_data")
    graph = graph_from_messages({"planes": MAP["planes"], "rooms": rooms, "walls": walls})
    planes = len(graph.nodes.label) - 1
    assert graph.nodes.label[planes:].tolist() == [2]
    assert len(graph.senders) == 2 * planes
    assert [room["id"] for room in rooms["rooms"]] == [0]
    document = json.loads(last(bridge, "scene_graph/spark_dsg")["data"])
    assert "SPARK_DSG_header" in document


def test_it_is_silent_when_nothing_has_changed_and_goes_on_after_a_broken_list(bridge):
    (hear,) = bridge.topics.values()
    hear(MAP["planes"])
    said = len(bridge.said)
    hear(MAP["planes"])
    hear({"x_planes": [{}, {}], "y_planes": []})
    assert len(bridge.said) == said
    (warning,) = bridge.warnings
    assert warning.startswith("s_graphs/all_map_planes: x_planes[0] lacks 'id'")
    fewer = MAP["planes"] | {"x_planes": MAP["planes"]["x_planes"][1:]}
    hear(fewer)
    (room,) = last(bridge, "room_segmentation/room_data")["rooms"]
    gone = MAP["planes"]["x_planes"][0]["id"]
    assert gone not in [plane["id"] for plane in room["planes"]]


def test_it_is_short():
    assert len((ROOT / "examples" / "ros2_bridge.py").read_text().splitlines()) <= 100
