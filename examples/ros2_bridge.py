"""A ROS 2 node beside S-Graphs: planes in, rooms, walls, floors and a Spark-DSG out, as they come.

    python examples/ros2_bridge.py --ros-args -p weights:=midi-general -p diffusion_steps:=8

It hears the list of planes, and speaks where S-Graphs listens to its own reasoning, which is then
to be switched off. Planes have the ids of S-Graphs, all else those of the map, which stay. It
speaks when the graph has changed. S-Graphs forgets no room: one that is gone is not repeated. A
list that comes during an update takes the place of the one that waits.

Tried: with stand-ins for rclpy and the messages (tests/test_ros2_bridge.py), on lists of planes as
S-Graphs publishes them. Not tried: under ROS, with S-Graphs, on a robot.
"""

import json
from contextlib import suppress
from typing import Any

import rclpy  # ty: ignore[import-not-found]
from rclpy.executors import ExternalShutdownException  # ty: ignore[import-not-found]
from rclpy.node import Node  # ty: ignore[import-not-found]
from rosidl_runtime_py.convert import message_to_ordereddict  # ty: ignore[import-not-found]
from rosidl_runtime_py.set_message import set_message_fields  # ty: ignore[import-not-found]
from situational_graphs_msgs.msg import FloorData, PlanesData, RoomsData, WallsData  # ty: ignore[import-not-found]
from std_msgs.msg import String  # ty: ignore[import-not-found]

from sg3d_jax.infer.session import begin, graph_of, ids_of, nodes_of, update
from sg3d_jax.io.s_graphs import graph_to_messages
from sg3d_jax.io.spark_dsg import graph_to_spark_dsg
from sg3d_jax.io.stream import Heard, read_changes
from sg3d_jax.train import DEFAULT_WEIGHTS
from sg3d_jax.train.weights import load_weights, with_diffusion_steps

PLANES = "s_graphs/all_map_planes"
SPOKEN = {
    "rooms": (RoomsData, "room_segmentation/room_data"),
    "walls": (WallsData, "wall_segmentation/wall_data"),
    "floors": (FloorData, "floor_plan/floor_data"),
    "spark_dsg": (String, "scene_graph/spark_dsg"),
}


class Bridge(Node):
    """Keeps the map, and speaks of it whenever planes have changed it."""

    def __init__(self) -> None:
        """Loads weights, and listens."""
        super().__init__("sg3d_bridge")
        weights = self.declare_parameter("weights", DEFAULT_WEIGHTS).value
        steps = self.declare_parameter("diffusion_steps", 8).value
        self.trained = with_diffusion_steps(load_weights(weights), steps)
        self.session, self.heard = begin(self.trained.model.ontology), Heard()
        self.speakers = {
            name: self.create_publisher(kind, topic, 10) for name, (kind, topic) in SPOKEN.items()
        }
        self.create_subscription(PlanesData, PLANES, self.hear, 1)

    def hear(self, message: Any) -> None:
        """Takes in a list of planes; one that is broken is left out, and said."""
        model, params = self.trained.model, self.trained.params
        try:
            planes = message_to_ordereddict(message)
            changes, heard = read_changes(planes, model.ontology, self.heard, PLANES)
            session, done = update(model, params, self.session, changes)
        except ValueError as error:
            self.get_logger().warning(str(error))
            return
        self.session, self.heard = session, heard
        for remark in done.remarks:
            self.get_logger().info(remark)
        if done.added or done.changed or done.removed:
            self.speak()

    def speak(self) -> None:
        """Publishes the graph."""
        graph, nodes = graph_of(self.session), nodes_of(self.session)
        names = ids_of(self.session)
        said = with_ids(graph_to_messages(graph), [*names[: -len(nodes) or None], *nodes])
        attributes = [{"id": name} for name in names]
        spark_dsg = json.dumps(graph_to_spark_dsg(graph, attributes=attributes))
        messages = [("rooms", said["rooms"]), ("walls", said["walls"])]
        messages += [("floors", floor) for floor in said["floors"]]
        for name, fields in (*messages, ("spark_dsg", {"data": spark_dsg})):
            message = SPOKEN[name][0]()
            set_message_fields(message, fields)
            self.speakers[name].publish(message)


def with_ids(value: Any, ids: list[int | str]) -> Any:
    """Returns messages, or a part of them, with ids in place of rows of a graph."""
    if isinstance(value, list):
        return [with_ids(each, ids) for each in value]
    if not isinstance(value, dict):
        return value
    return {key: ids[part] if key == "id" else with_ids(part, ids) for key, part in value.items()}


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Bridge())
