"""Maps that S-Graphs has saved: a folder with `graph.g2o`, and what lies beside it.

Every plane, room, wall and floor has a text file of names and numbers, in folders that differ from
version to version (`000003/x_planes/x_plane_data`, or `x_vert_planes/3/x_plane_data.txt`): they are
found by their names wherever they are. The extent of a plane comes from its cloud of points,
`cloud_seg_map.pcd` beside it; without one, from its corners with the other planes of its rooms. A
folder without such files is read from the vertices and edges of `graph.g2o` alone.

Source: snt-arg/lidar_situational_graphs, include/s_graphs/common (plane, room, wall and floor
save()), of 2022 and 2025; g2o of the VERTEX_ and EDGE_ types that it registers.
Tried: on a dump of 2022 (`SE1_R4` of snt-arg/graph_matching). The newer form follows the source.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.io.attributes import Read
from sg3d_jax.io.files import read_bytes, read_text
from sg3d_jax.io.s_graphs import AXES, middle_and_width, read_messages, xyz
from sg3d_jax.scene.validate import MAX_COORDINATE

GRAPH: Final = "graph.g2o"
CLOUD: Final = "cloud_seg_map.pcd"
POSE: Final = "plane_node_pose"  # of a plane in the map: normal and offset
PLANES_OF_ROOM: Final = ("plane_x1_id", "plane_x2_id", "plane_y1_id", "plane_y2_id")
PLANES_OF_WALL: Final = ("plane1_id", "plane2_id")
MAX_FILES: Final = 20_000
MAX_HEADER: Final = 4096  # bytes
UPRIGHT: Final = 0.5  # sine of the least angle at which two planes of a room make a corner

Fields = dict[str, list[float]]


def read_dump(path: str | Path) -> Read:
    """Returns the host graph of a map that S-Graphs saved: planes, walls, rooms and floors.

    Args:
      path: the folder, or its graph.g2o.

    Returns:
      As `read_messages`; a remark counts planes whose extent nothing tells.

    Raises:
      ValueError: one sentence that names the file and the field.
    """
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    if not (folder / GRAPH).is_file():
        raise ValueError(f"{path}: there is no {GRAPH}, expected a map that S-Graphs saved")
    planes = {axis: _records(folder, f"{axis[0]}_plane_data") for axis in AXES}
    rooms, walls = _records(folder, "room_data"), _records(folder, "wall_data")
    floors = _records(folder, "floor_data")
    vertices, edges = _g2o(folder / GRAPH)
    centres = {_number(f, "id", w): _translation(f, "room_node", w) for w, f in rooms.items()}
    members = {
        _number(f, "id", w): [_number(f, key, w) for key in PLANES_OF_ROOM if key in f]
        for w, f in rooms.items()
    }
    if any(planes.values()):
        coefficients = {
            _number(fields, "id", where): (axis, _numbers(fields, POSE, 4, where), where)
            for axis, of_axis in planes.items()
            for where, fields in of_axis.items()
        }
    else:
        where = f"{folder / GRAPH}"
        coefficients = {
            name: (AXES[abs(v[1]) > abs(v[0])], v[:4], where)
            for name, v in vertices.get("VERTEX_PLANE", {}).items()
        }
        centres = {name: v[:3] for name, v in vertices.get("VERTEX_ROOM", {}).items()}
        members = edges
    ends = _ends(coefficients, centres, members)
    message: dict[str, list[Any]] = {axis: [] for axis in AXES}
    for name, (axis, values, _) in coefficients.items():
        if name in ends:
            plane = dict(zip(("nx", "ny", "nz", "d"), values, strict=True))
            message[axis].append({"id": name, **plane, "plane_points": ends[name]})
    found = [_pose(_translation(f, "floor_node", w)) for w, f in floors.items()]
    found = found or [_pose(v[:3]) for v in vertices.get("VERTEX_FLOOR", {}).values()]
    messages = {
        "planes": message,
        "rooms": {"rooms": [_room(n, c, members.get(n, ()), ends) for n, c in centres.items()]},
        "walls": {"walls": [_wall(fields, where, ends) for where, fields in walls.items()]},
        "floors": [{"floor_center": pose} for pose in found],
    }
    read, lost = read_messages(messages, f"{path}"), len(coefficients) - len(ends)
    remark = f"left out {lost} planes that have neither a cloud of points nor corners with others"
    return read._replace(remarks=(remark,) if lost else ())


def _records(folder: Path, stem: str) -> dict[str, Fields]:
    """Returns the fields of the text files of one name, by where they are."""
    found = [path for name in (stem, f"{stem}.txt") for path in folder.rglob(name)]
    if len(found) > MAX_FILES:
        raise ValueError(f"{folder}: has {len(found)} files {stem}, expected {MAX_FILES} at most")
    return {f"{path}": _fields(read_text(path)) for path in sorted(found)}


def _fields(text: str) -> Fields:
    """Returns the numbers that follow each name."""
    fields: Fields = {}
    values: list[float] = []
    for token in text.split():
        try:
            values.append(float(token))
        except ValueError:
            values = fields.setdefault(token, [])
    return fields


def _numbers(fields: Fields, key: str, count: int, where: str) -> list[float]:
    values = fields.get(key, [])
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError(f"{where}: {key} is {values!r:.60}, expected {count} finite numbers")
    return values


def _number(fields: Fields, key: str, where: str) -> int:
    (value,) = _numbers(fields, key, 1, where)
    return int(value)


def _translation(fields: Fields, key: str, where: str) -> list[float]:
    """Returns the place of a pose: of a matrix of four rows, the last column."""
    return _numbers(fields, key, 16, where)[3:12:4]


def _g2o(path: Path) -> tuple[dict[str, dict[int, list[float]]], dict[int, list[int]]]:
    """Returns the vertices of a file by type and id, and the planes of each room."""
    vertices: dict[str, dict[int, list[float]]] = {}
    members: dict[int, list[int]] = {}
    for number, line in enumerate(read_text(path).split("\n"), 1):
        kind, *cells = line.split() or [""]
        room = kind.startswith("EDGE_ROOM_") and kind.endswith("PLANES")
        if not room and not kind.startswith("VERTEX_"):
            continue
        try:
            values = [float(cell) for cell in cells]
            count = 1 + int(kind[len("EDGE_ROOM_")]) if room else 0  # the room, and its planes
            names = [int(cell) for cell in cells[:count]]
        except ValueError as error:
            raise ValueError(f"{path}: line {number} is {line!r:.40}, expected numbers") from error
        if len(values) < 4 or not all(map(math.isfinite, values)):
            raise ValueError(f"{path}: line {number} is {line!r:.40}, expected an id and numbers")
        if room:
            members.setdefault(names[0], []).extend(names[1:])
        else:
            vertices.setdefault(kind, {})[int(values[0])] = values[1:]
    return vertices, members


def _ends(
    coefficients: Mapping[int, tuple[str, list[float], str]],
    centres: Mapping[int, Sequence[float]],
    members: Mapping[int, Sequence[int]],
) -> dict[int, list[dict[str, float]]]:
    """Returns both ends of each plane whose extent something tells, as points of a message."""
    corners: dict[int, list[list[float]]] = {}
    for room, names in members.items():
        for one in names:
            for other in names:
                if one in coefficients and other in coefficients and room in centres:
                    point = _corner(coefficients[one][1], coefficients[other][1])
                    if point is not None:
                        corners.setdefault(one, []).append([*point, centres[room][2]])
    ends = {}
    for name, (_, values, where) in coefficients.items():
        cloud = _cloud(Path(where).with_name(CLOUD))
        points = cloud if len(cloud) else np.array(corners.get(name, np.zeros((0, 3))))
        if not (np.abs(points) <= MAX_COORDINATE).all():  # false for nan
            expected = f"points within {MAX_COORDINATE:g} m"
            raise ValueError(f"{where}: a point of the plane is far away, expected {expected}")
        if len(points):
            centre, along, width = middle_and_width(points, np.array(values[:3]))
            if width > 0:
                half = along * width / 2
                ends[name] = [xyz(centre - half), xyz(centre + half)]
    return ends


def _corner(one: Sequence[float], other: Sequence[float]) -> list[float] | None:
    """Returns where two upright planes n . x + d = 0 meet, float[2]; None if they hardly do."""
    across = one[0] * other[1] - one[1] * other[0]
    if abs(across) < UPRIGHT:
        return None
    x = one[1] * other[3] - other[1] * one[3]
    y = other[0] * one[3] - one[0] * other[3]
    return [x / across, y / across]


def _cloud(path: Path) -> np.ndarray:
    """Returns the points of a PCD file, float64[n, 3], metres; none if there is no file.

    Source: the PCD format of the Point Cloud Library, version 0.7, ascii and binary.
    """
    if not path.is_file():
        return np.zeros((0, 3))
    data = read_bytes(path)
    start = data.find(b"\nDATA ", 0, MAX_HEADER)
    end = data.find(b"\n", start + 1, MAX_HEADER) + 1
    if start < 0 or not end:
        raise ValueError(f"{path}: has no line DATA, expected a PCD file")
    lines = [line.split() for line in data[: end - 1].decode("latin-1").split("\n")]
    header = {name: values for name, *values in filter(None, lines)}
    try:
        counts = header.get("COUNT", ["1"] * len(header["FIELDS"]))
        form = [
            (name, f"<{ {'F': 'f', 'U': 'u', 'I': 'i'}[kind] }{int(size)}", (int(count),))
            for name, kind, size, count in zip(
                header["FIELDS"], header["TYPE"], header["SIZE"], counts, strict=True
            )
        ]
        (number,), (kind,) = map(int, header["POINTS"]), header["DATA"]
        if kind == "ascii":
            told = [line for line in data[end:].decode("latin-1").splitlines() if line.strip()]
            rows = np.loadtxt(told[:number], ndmin=2, comments=None)
            points = rows[:, [header["FIELDS"].index(axis) for axis in "xyz"]]
        elif kind == "binary":
            table: Any = np.frombuffer(data, np.dtype(form), number, end)
            points = np.column_stack([table[axis][:, 0] for axis in "xyz"])
        else:
            raise ValueError(f"DATA {kind}")
    except (KeyError, ValueError, TypeError, IndexError) as error:
        expected = "a PCD file of points in x, y, z, ascii or binary"
        raise ValueError(f"{path}: cannot be read ({error!r:.60}), expected {expected}") from error
    points = points.astype(np.float64)
    return points[np.isfinite(points).all(axis=1)]


def _room(
    name: int, centre: Sequence[float], planes: Iterable[int], ends: Mapping[int, Any]
) -> dict[str, Any]:
    held = [{"id": plane} for plane in planes if plane in ends]
    return {"id": name, "room_center": _pose(centre), "planes": held}


def _wall(fields: Fields, where: str, ends: Mapping[int, Any]) -> dict[str, Any]:
    pose = _pose(_numbers(fields, "wall_pose", 3, where))
    planes = [_number(fields, key, where) for key in PLANES_OF_WALL]
    held = [{"id": plane} for plane in planes if plane in ends]
    return {"id": _number(fields, "id", where), "wall_center": pose, "planes": held}


def _pose(point: Sequence[float]) -> dict[str, Any]:
    return {"position": dict(zip("xyz", point, strict=True))}
