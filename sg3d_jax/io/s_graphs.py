"""Planes from S-Graphs and scene graphs for it: ROS 2 messages as plain dicts, without ROS.

The dicts have the fields of `situational_graphs_msgs` and `situational_graphs_reasoning_msgs`, as
rosidl's `message_to_ordereddict` or a reader of bags gives them. Fields that we do not need are
ignored, and left to their defaults in what we write. A node's id is its row number.

A plane of S-Graphs is n . x + d = 0, so `d` is an offset and not the width, which the paper calls
d: the width comes from the points. Its normal points to where the robot saw it from, into the
room, as ours does: the front end makes d positive in the frame of the sensor, the back end only
turns and moves that plane into the map, and what would turn it to the origin of the map,
`correct_plane_direction`, is commented out where planes are published.

Source: snt-arg/lidar_situational_graphs, msg/ and src/s_graphs (frontend/plane_analyzer.cpp,
backend/plane_mapper.cpp, visualization/graph_publisher.cpp); snt-arg/situational_graphs_msgs,
RoomData.msg and FloorData.msg; snt-arg/situational_graphs_reasoning, graph_reasoning_node.py.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.io.attributes import ID, Attributes, Read, is_id, node_ids
from sg3d_jax.io.files import field, number
from sg3d_jax.io.planes import planes
from sg3d_jax.scene.graph import SceneGraph, extended, ontology_of, parts_first
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PLANE, ROOM, WALL
from sg3d_jax.scene.validate import check_observed, validate_graph

AXES: Final = ("x_planes", "y_planes")  # by the larger part of the normal
MIN_STOREY: Final = 0.5  # metres; S-Graphs takes floors less apart for one
ON_STAIRS: Final = 1  # FloorData.state: tells of a climb, not of a floor
HEADER: Final = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"}
GEOMETRY: Final = "Geometric_info"
NODE_TYPES: Final = {PLANE: "Plane", ROOM: "Finite Room"}


class _Part(NamedTuple):
    """A wall, a room or a floor of a message."""

    label: int
    position: list[float]
    planes: list[int]  # rows
    name: int | str | None = None  # its id, if it has one


def planes_from_message(message: Any, where: str = "message") -> SceneGraph:
    """Returns the planes of a PlanesData message as `read_message` does, without attributes."""
    return read_message(message, where).graph


def read_message(message: Any, where: str = "message") -> Read:
    """Returns the planes of a PlanesData message as a host graph without edges, and their ids.

    The width is the extent of the points along the wall. The centroid is the mean of the points,
    but along the wall it is the middle of their extent. Planes without points, which S-Graphs sends
    and its own reasoning skips too, are left out.

    Args:
      message: a parsed PlanesData, not yet trusted; metres.
      where: what an error starts with, such as "planes.json".

    Returns:
      Planes in the order of their ids.

    Raises:
      ValueError: one sentence that names the plane, the field and what was expected.

    Differs: the authors take half the sum of two extreme points and set z to zero. A plain mean is
      no centroid either: a wall is seen by more points a metre where the robot is near.
    """
    graph, row_of_id = _planes(message, where)
    return Read(graph, [{ID: name} for name in row_of_id])


def planes_to_message(graph: SceneGraph) -> dict[str, Any]:
    """Returns the planes of a host graph as a PlanesData message; their points are their ends."""
    return {"header": HEADER, **_by_axis(_plane_records(graph).values())}


def graph_from_messages(messages: Any, where: str = "messages") -> SceneGraph:
    """Returns the host graph of the messages of one map, as `read_messages` without attributes."""
    return read_messages(messages, where).graph


def read_messages(messages: Any, where: str = "messages") -> Read:
    """Returns the host graph of the messages of one map, and the ids of its nodes.

    A message does not say which rooms are on a floor; S-Graphs gives rooms the height of theirs,
    so a room belongs to the floor that is nearest in height.

    Args:
      messages: "planes", a PlanesData, and any of "walls", a WallsData; "rooms", a RoomsData;
        "floors", a list of FloorData. Not yet trusted; metres.
      where: what an error starts with, such as "map.json".

    Returns:
      Planes in the order of their ids, then walls, rooms and floors in the order of the messages.
      A wall, a room or a floor has no id if another node has the same.

    Raises:
      ValueError: one sentence that names the message, the field and what was expected.
    """
    planes, row_of_id = _planes(field(messages, "planes", where), f"{where}: planes")
    walls = _parts(messages, "walls", "wall_center", row_of_id, where)
    rooms = _parts(messages, "rooms", "room_center", row_of_id, where)
    floors = _floors(messages.get("floors") or [], f"{where}: floors")
    graph = _assembled(planes, [*walls, *rooms], floors, where)
    names = [*row_of_id, *(part.name for part in (*walls, *rooms, *floors))]
    seen = Counter(names)
    attributes = [
        {ID: name} if row < len(row_of_id) or (name is not None and seen[name] == 1) else {}
        for row, name in enumerate(names)
    ]
    return Read(graph, attributes)


def graph_to_messages(graph: SceneGraph, attributes: Attributes | None = None) -> dict[str, Any]:
    """Returns a host graph as messages of one map, for `graph_from_messages` or S-Graphs.

    S-Graphs takes rooms of two x_planes and two y_planes, or of two of one axis only, and walls of
    two planes; the message holds them all. There is none for buildings and cities, nor for any
    other concept; in an ontology that is not the paper's, its names tell what is meant.

    Args:
      graph: unpadded, metres.
      attributes: of each node; an `id` that is an integer is its id, as that of a plane that came
        from S-Graphs. Nothing else has a place in a message.

    Returns:
      "planes", a PlanesData; "walls", a WallsData; "rooms", a RoomsData; "floors", of FloorData.
    """
    planes, children = _plane_records(graph), _planes_by_parent(graph)

    def records(concept: int) -> list[tuple[int, dict[str, Any], list[dict[str, Any]]]]:
        rows = _rows(graph, concept)
        points = [xyz(graph.nodes.position[row]) for row in rows]
        parts = [[planes[child] for child in children.get(row, [])] for row in rows]
        return list(zip(rows, points, parts, strict=True))

    made = {
        "planes": planes_to_message(graph),
        "walls": {"header": HEADER, "walls": [_wall_record(*each) for each in records(WALL)]},
        "rooms": {"header": HEADER, "rooms": [_room_record(*each) for each in records(ROOM)]},
        "floors": [_floor_record(row, point) for row, point, _ in records(FLOOR)],
    }
    if attributes is None:
        return made
    given = [held.get(ID) for held in attributes]
    return _with_ids(made, node_ids([{ID: n} if type(n) is int else {} for n in given]))


def _with_ids(value: Any, ids: Sequence[int | str]) -> Any:
    """Returns messages, or a part of them, with ids in place of rows of a graph."""
    if isinstance(value, list):
        return [_with_ids(each, ids) for each in value]
    if not isinstance(value, dict):
        return value
    return {key: ids[part] if key == ID else _with_ids(part, ids) for key, part in value.items()}


def graph_from_reasoning(message: Any, planes: Any, where: str = "message") -> SceneGraph:
    """Returns the host graph of a Graph message, which names rooms, and the planes it is about.

    Args:
      message: a parsed Graph of situational_graphs_reasoning_msgs, not yet trusted.
      planes: the PlanesData of the same map: a Graph has neither centroids nor widths.
      where: what an error starts with, such as "graph.json".

    Returns:
      Planes in the order of their ids, then rooms in the order of the message, as high as the mean
      of their planes: the message has them at zero.

    Raises:
      ValueError: one sentence that names the message, the field and what was expected.
    """
    graph, row_of_id = _planes(planes, f"{where}: planes")
    rooms: dict[int, _Part] = {}
    for index, node in enumerate(_list(message, "nodes", where)):
        here = f"{where}: nodes[{index}]"
        kind, name = field(node, "type", here), _id(node, "id", here)
        if kind not in NODE_TYPES.values():
            names = " or ".join(NODE_TYPES.values())
            raise ValueError(f"{here}.type is {kind!r:.40}, expected {names}")
        if kind == NODE_TYPES[ROOM]:
            if name in rooms:
                raise ValueError(f"{here}.id is {name} again, expected unique ids of rooms")
            rooms[name] = _Part(ROOM, _geometry(node, here), [])
    for index, edge in enumerate(_list(message, "edges", where)):
        here = f"{where}: edges[{index}]"
        room = _known(_id(edge, "origin_node", here), rooms, f"{here}.origin_node", "a room")
        plane = _id(edge, "target_node", here)
        room.planes.append(_known(plane, row_of_id, f"{here}.target_node", "a plane with points"))
    return _assembled(graph, [_at_planes(room, graph) for room in rooms.values()], [], where)


def graph_to_reasoning(graph: SceneGraph, name: str = "ONLINE") -> dict[str, Any]:
    """Returns the planes and rooms of a host graph as a Graph message.

    Args:
      graph: unpadded, metres.
      name: of the message; S-Graphs uses "ONLINE" for its map and "Prior" for a plan.
    """
    planes, rooms, children = _plane_records(graph), _rows(graph, ROOM), _planes_by_parent(graph)
    geometry = [(PLANE, i, [p[key] for key in ("nx", "ny", "nz", "d")]) for i, p in planes.items()]
    geometry += [(ROOM, i, [*graph.nodes.position[i, :2].tolist(), 0.0]) for i in rooms]
    return {
        "name": name,
        "nodes": [
            {"id": row, "type": NODE_TYPES[kind], "attributes": [_attribute(GEOMETRY, values)]}
            for kind, row, values in geometry
        ],
        "edges": [
            {
                "origin_node": room,
                "target_node": plane,
                "attributes": [_attribute(f"EdgeRoom{len(children[room])}Planes", [])],
            }
            for room in rooms
            for plane in children.get(room, [])
        ],
    }


def _planes(message: Any, where: str) -> tuple[SceneGraph, dict[int, int]]:
    """Returns the checked planes, and the row of each id."""
    seen: dict[int, np.ndarray | None] = {}
    for axis in AXES:
        for index, record in enumerate(_list(message, axis, where)):
            here = f"{where}: {axis}[{index}]"
            name = _id(record, "id", here)
            if name in seen:
                raise ValueError(f"{here}.id is {name} again, expected unique ids of planes")
            seen[name] = _plane(record, here)
    rows = {name: row for name, row in sorted(seen.items()) if row is not None}
    table = np.array([*rows.values()], np.float64).reshape(-1, 7)
    graph = planes(table[:, :3], table[:, 3:6], table[:, 6])
    check_observed(graph, where)
    return graph, {name: row for row, name in enumerate(rows)}


def _plane(record: dict[str, Any], where: str) -> np.ndarray | None:
    """Returns centroid, normal and width, float64[7]; None if there are no points."""
    normal = np.array([_finite(record, key, where) for key in ("nx", "ny", "nz")])
    if not normal.any():
        raise ValueError(f"{where} has the normal [0, 0, 0], expected length 1")
    points = _list(record, "plane_points", where)
    if not points:
        return None
    inside = f"{where}.plane_points"
    cloud = np.array([_point(point, f"{inside}[{i}]") for i, point in enumerate(points)])
    centroid, _, width = middle_and_width(cloud, normal)
    if width == 0:
        raise ValueError(f"{inside} is no longer than a point, expected points along a wall")
    return np.array([*centroid, *normal, width])


def middle_and_width(
    cloud: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.floating[Any]]:
    """Returns the middle of a plane's points, in which direction it runs, and how far.

    Args:
      cloud: float[n, 3], at least one point, metres.
      normal: float[3].

    Returns:
      float[3], the mean of the points, but along the plane the middle of their extent; float[3],
      unit, horizontal; and their extent, metres.
    """
    along = _along(normal)
    with np.errstate(over="ignore", invalid="ignore"):  # validated as centroid and width
        reach, mean = cloud @ along, cloud.mean(axis=0)
        middle = mean + along * ((reach.min() + reach.max()) / 2 - mean @ along)
        return middle, along, np.ptp(reach)


def _along(normal: np.ndarray) -> np.ndarray:
    """Returns the horizontal direction in which a plane runs, float64[3]; any of a level one."""
    x, y = normal[:2] / max(np.abs(normal).max(), np.finfo(float).tiny)
    length = np.hypot(x, y)
    return np.array([-y / length, x / length, 0.0]) if length else np.array([1.0, 0.0, 0.0])


def _parts(
    messages: Any, key: str, centre: str, row_of_id: Mapping[int, int], where: str
) -> list[_Part]:
    """Returns the walls of a WallsData or the rooms of a RoomsData."""
    if messages.get(key) is None:
        return []
    parts, label = [], WALL if key == "walls" else ROOM
    for index, record in enumerate(_list(messages[key], key, f"{where}: {key}")):
        here = f"{where}: {key}.{key}[{index}]"
        pose = field(field(record, centre, here), "position", f"{here}.{centre}")
        rows: dict[int, None] = {}  # `planes` repeats what is in the other two
        for lists in (*AXES, "planes"):
            for place, plane in enumerate(_list(record, lists, here) if lists in record else []):
                inside = f"{here}.{lists}[{place}]"
                name = _id(plane, "id", inside)
                rows[_known(name, row_of_id, f"{inside}.id", "a plane with points")] = None
        point = _point(pose, f"{here}.{centre}.position")
        parts.append(_Part(label, point, list(rows), _name(record)))
    return parts


def _floors(records: Any, where: str) -> list[_Part]:
    if not isinstance(records, list):
        raise ValueError(f"{where} is {records!r:.40}, expected a list of FloorData")
    floors = []
    for index, record in enumerate(records):
        here = f"{where}[{index}]"
        centre = field(field(record, "floor_center", here), "position", f"{here}.floor_center")
        if record.get("state") != ON_STAIRS:
            point = _point(centre, f"{here}.floor_center.position")
            floors.append(_Part(FLOOR, point, [], _name(record)))
    heights = sorted(floor.position[2] for floor in floors)
    if any(above - below < MIN_STOREY for below, above in pairwise(heights)):
        raise ValueError(
            f"{where} has two at one height, expected {MIN_STOREY} m or more between floors, by "
            "which rooms are told apart"
        )
    return floors


def _assembled(
    planes: SceneGraph, parts: Sequence[_Part], floors: Sequence[_Part], where: str
) -> SceneGraph:
    """Returns the graph of planes, walls and rooms, and floors; rooms go to their floors."""
    num_planes, nodes = len(planes.nodes.label), [*parts, *floors]
    heights = np.array([floor.position[2] for floor in floors])
    pairs = []
    for row, part in enumerate(parts, num_planes):
        pairs += [(plane, row) for plane in part.planes]
        if part.label == ROOM and floors:
            nearest = int(np.argmin(np.abs(heights - part.position[2])))
            pairs.append((row, num_planes + len(parts) + nearest))
    label, position = [node.label for node in nodes], [node.position for node in nodes]
    graph = extended(planes, label, np.array(position, np.float64), np.array(pairs, np.int32))
    validate_graph(graph, where, rules=False)  # edges are right by how they were made
    return graph


def _at_planes(room: _Part, planes: SceneGraph) -> _Part:
    if not room.planes:
        return room
    height = float(planes.nodes.position[room.planes, 2].mean())
    return room._replace(position=[*room.position[:2], height])


def _geometry(node: dict[str, Any], where: str) -> list[float]:
    """Returns the position of a room of a Graph."""
    for index, attribute in enumerate(_list(node, "attributes", where)):
        here = f"{where}.attributes[{index}]"
        if field(attribute, "name", here) == GEOMETRY:
            values = _list(attribute, "fl_value", here)
            if len(values) != 3:
                raise ValueError(f"{here}.fl_value is {values!r:.40}, expected three numbers")
            return _point(dict(zip("xyz", values, strict=True)), f"{here}.fl_value")
    raise ValueError(f"{where}.attributes has no {GEOMETRY!r}, expected the place of a room")


def _known(name: int, rows: Mapping[int, Any], where: str, expected: str) -> Any:
    if name not in rows:
        raise ValueError(f"{where} is {name}, expected the id of {expected}")
    return rows[name]


def _list(record: Any, key: str, where: str) -> list[Any]:
    value = field(record, key, where)
    if not isinstance(value, list):
        raise ValueError(f"{where}: {key} is {value!r:.40}, expected a list")
    return value


def _name(record: dict[str, Any]) -> int | str | None:
    return record[ID] if is_id(record.get(ID)) else None


def _id(record: Any, key: str, where: str) -> int:
    value = field(record, key, where)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{where}.{key} is {value!r:.40}, expected an integer")
    return value


def _point(record: Any, where: str) -> list[float]:
    return [_finite(record, key, where) for key in "xyz"]


def _finite(record: Any, key: str, where: str) -> float:
    value = number(field(record, key, where), f"{where}.{key}")
    if not np.isfinite(value):
        raise ValueError(f"{where}.{key} is {value}, expected a finite number")
    return value


def _rows(graph: SceneGraph, concept: int) -> list[int]:
    """Returns the rows of one of the paper's concepts, which its name tells in any ontology."""
    names, name = ontology_of(graph).names, PAPER_ONTOLOGY.names[concept]
    return [row for row, label in enumerate(graph.nodes.label.tolist()) if names[label] == name]


def _planes_by_parent(graph: SceneGraph) -> dict[int, list[int]]:
    planes, children = set(_rows(graph, PLANE)), dict[int, list[int]]()
    for part, whole in parts_first(graph).tolist():
        if part in planes and whole not in planes:
            children.setdefault(whole, []).append(part)
    return children


def _plane_records(graph: SceneGraph) -> dict[int, dict[str, Any]]:
    """Returns a PlaneData for every plane, by row."""
    position, normal, width = graph.nodes.position, graph.nodes.normal, graph.nodes.width
    records = {}
    for row in _rows(graph, PLANE):
        nx, ny, nz = normal[row].tolist()
        half = _along(normal[row]) * width[row] / 2
        records[row] = {
            "header": HEADER,
            "id": row,
            "nx": nx,
            "ny": ny,
            "nz": nz,
            "d": -float(normal[row] @ position[row]),
            "plane_orientation": xyz(normal[row]),
            "plane_points": [xyz(position[row] + end) for end in (-half, half)],
        }
    return records


def _by_axis(planes: Iterable[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    lists: dict[str, list[dict[str, Any]]] = {axis: [] for axis in AXES}
    for plane in planes:
        lists[AXES[abs(plane["ny"]) > abs(plane["nx"])]].append(plane)
    return lists


def _wall_record(row: int, point: dict[str, float], planes: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "header": HEADER,
        "id": row,
        "wall_center": _pose(point),
        "wall_point": point,
        **_by_axis(planes),
    }


def _room_record(row: int, point: dict[str, float], planes: list[dict[str, Any]]) -> dict[str, Any]:
    ends = [end for plane in planes for end in plane["plane_points"]] or [point]
    length = {key: max(e[key] for e in ends) - min(e[key] for e in ends) for key in "xyz"}
    return {
        "header": HEADER,
        "id": row,
        "neighbour_ids": [],
        "room_length": length,
        "room_center": _pose(point),
        "cluster_center": point,
        **_by_axis(planes),
        "planes": planes,
    }


def _floor_record(row: int, point: dict[str, float]) -> dict[str, Any]:
    return {
        "header": HEADER,
        "id": row,
        "floor_center": _pose(point),
        "keyframe_ids": [],
        "state": 0,
    }


def _attribute(name: str, values: list[float]) -> dict[str, Any]:
    return {"name": name, "str_value": "", "fl_value": values}


def _pose(point: dict[str, float]) -> dict[str, Any]:
    return {"position": point, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def xyz(values: np.ndarray) -> dict[str, float]:
    """Returns a point of a message."""
    return dict(zip("xyz", values.tolist(), strict=True))
