import struct
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.io.formats import read_graphs, read_with_attributes
from sg3d_jax.scene.graph import parts_first
from sg3d_jax.scene.ontology import FLOOR, PLANE, ROOM, WALL

SHARED = Path(__file__).parents[3] / "shared" / "data" / "s_graphs_dump_SE1_R4"
PLANES = {  # a room of 4 m by 3 m, and what is behind its eastern wall; n . x + d = 0
    3: ("x", [1.0, 0.0, 0.0, 0.0]),
    4: ("x", [-1.0, 0.0, 0.0, 4.0]),
    5: ("y", [0.0, 1.0, 0.0, 0.0]),
    6: ("y", [0.0, -1.0, 0.0, 3.0]),
    7: ("x", [1.0, 0.0, 0.0, -4.2]),
}
CLOUD = np.array([[4.2, 1.0, 0.5], [4.2, 2.0, 1.5], [4.2, 1.2, 1.0]], np.float32)
POSE = "1 0 0 2\n0 1 0 1.5\n0 0 1 0.5\n0 0 0 1"
G2O = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nFIX 0\nVERTEX_FLOOR 9 2 1.5 -0.25 0 0 0 1\n"


def pcd(points, kind="binary"):
    fields = "FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
    header = f"# .PCD v0.7\nVERSION 0.7\n{fields}WIDTH 0\nPOINTS {len(points)}\nDATA {kind}\n"
    if kind == "ascii":
        return (header + "\n".join(f"{x} {y} {z} 0\n" for x, y, z in points)).encode()
    return header.encode() + b"".join(struct.pack("<fffI", *point, 7) for point in points)


def old(folder):
    """Writes a map as S-Graphs saved it in 2022: a name on one line, numbers below."""
    for number, (name, (axis, values)) in enumerate(PLANES.items()):
        place = folder / f"{number:06}" / f"{axis}_planes"
        place.mkdir(parents=True)
        values = "\n".join(map(str, values))
        text = f"id\n{name}\nPlane\n0\n0\n1\n0\nplane_node_pose\n{values}\ntype\n{axis}\nfixed\n0\n"
        (place / f"{axis}_plane_data").write_text(text)
    (place / "cloud_seg_map.pcd").write_bytes(pcd(CLOUD))
    keys = ("x1", "x2", "y1", "y2")
    ids = "".join(f"plane_{key}_id \n{name}\n" for key, name in zip(keys, PLANES, strict=False))
    (folder / "000000" / "room_data").write_text(f"id\n8\n{ids}room_node \n{POSE}\n")
    (folder / "graph.g2o").write_text(G2O)


def new(folder):
    """Writes it as S-Graphs does since 2024: a name and its numbers on a line, and walls."""
    (folder / "graph.g2o").write_text("")
    for name, (axis, values) in PLANES.items():
        place = folder / f"{axis}_vert_planes" / f"{name}"
        place.mkdir(parents=True)
        text = f"id {name}\nplane_node_pose {' '.join(map(str, values))}\ntype {axis}\n"
        (place / f"{axis}_plane_data.txt").write_text(text)
    (place / "cloud_seg_map.pcd").write_bytes(pcd(CLOUD, "ascii"))
    wall = "id 10\nplane_type x\nplane1_id 4\nplane2_id 7\nwall_point 4 1 0\n"
    room = "id 8\n" + "".join(f"plane_{k}_id {n}\n" for k, n in (("x1", 3), ("x2", 4), ("y1", 5)))
    for kind, text in (
        ("room", f"{room}plane_y2_id 6\nroom_node {POSE}\n"),
        ("wall", f"{wall}wall_pose 4.1 1.5 0.5\n"),
        ("floor", f"id 9\nfloor_node {POSE.replace('0.5', '-0.25')}\ncolor 1 2 3\n"),
    ):
        (folder / f"{kind}s" / "0").mkdir(parents=True)
        (folder / f"{kind}s" / "0" / f"{kind}_data.txt").write_text(text)


@pytest.mark.parametrize("write", [old, new])
def test_a_saved_map_is_read(write, tmp_path):
    write(tmp_path)
    (read,) = read_with_attributes(tmp_path)
    nodes = read.graph.nodes
    walls = [WALL] if write is new else []
    assert nodes.label.tolist() == [PLANE] * 5 + walls + [ROOM, FLOOR]
    npt.assert_allclose(
        nodes.position[:5],
        [[0, 1.5, 0.5], [4, 1.5, 0.5], [2, 0, 0.5], [2, 3, 0.5], [4.2, 1.5, 1.0]],
        atol=1e-6,
    )
    npt.assert_allclose(nodes.width[:5], [3, 3, 4, 4, 1], atol=1e-6)
    npt.assert_array_equal(nodes.position[-2:], [[2, 1.5, 0.5], [2, 1.5, -0.25]])
    room = 6 if write is new else 5
    expected = [[plane, room] for plane in range(4)] + [[room, room + 1]]
    expected += [[1, 5], [4, 5]] if write is new else []
    assert sorted(parts_first(read.graph).tolist()) == sorted(expected)
    ids = [*PLANES, *([10] if write is new else []), 8]
    assert [held.get("id") for held in read.attributes[:-1]] == ids
    assert read.remarks == ()


def test_planes_whose_extent_nothing_tells_are_counted(tmp_path):
    old(tmp_path)
    next(tmp_path.rglob("*.pcd")).unlink()
    (read,) = read_with_attributes(tmp_path / "graph.g2o")
    assert [held.get("id") for held in read.attributes] == [3, 4, 5, 6, 8, None]
    (remark,) = read.remarks
    assert remark.startswith("left out 1 planes that have neither a cloud")


def test_vertices_and_edges_alone_give_planes_and_rooms(tmp_path):
    lines = [f"VERTEX_PLANE {i} {' '.join(map(str, v))} 0.2 0.2" for i, (_, v) in PLANES.items()]
    lines += ["VERTEX_ROOM 8 2 1.5 0.5 0 0 0 1", "EDGE_ROOM_4PLANES 8 3 4 5 6 0 0 0.1 0 0.1"]
    (tmp_path / "graph.g2o").write_text(G2O + "\n".join(lines))
    (graph,) = read_graphs(tmp_path / "graph.g2o")
    assert graph.nodes.label.tolist() == [PLANE] * 4 + [ROOM, FLOOR]
    npt.assert_allclose(graph.nodes.width[:4], [3, 3, 4, 4])


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        (
            "graph.g2o",
            "VERTEX_PLANE 1 x 0 0 0",
            "g2o: line 1 is 'VERTEX_PLANE 1 x 0 0 0', expected",
        ),
        ("graph.g2o", "VERTEX_ROOM 1 2", "g2o: line 1 is 'VERTEX_ROOM 1 2', expected an id and"),
        (
            "000000/room_data",
            "id\n8\nroom_node\n1 2",
            "room_node is .*, expected 16 finite",
        ),
        ("000001/x_planes/x_plane_data", "plane_node_pose 1 0 0 0", "data: id is .*, expected 1"),
        ("000001/x_planes/x_plane_data", "id 4", r"plane_node_pose is \[\], expected 4"),
        ("000004/x_planes/cloud_seg_map.pcd", "VERSION 0.7", "has no line DATA, expected a PCD"),
        (
            "000004/x_planes/cloud_seg_map.pcd",
            pcd(CLOUD).replace(b"DATA binary\n", b"DATA binary_compressed\n"),
            "DATA binary_compressed.*expected a PCD file of points",
        ),
        ("000004/x_planes/cloud_seg_map.pcd", pcd(CLOUD)[:-9], "cannot be read"),
        (
            "000001/x_planes/x_plane_data",
            "id 4 plane_node_pose -1 0 0 1e308",
            "x_plane_data: a point of the plane is far away, expected points within 1e",
        ),
    ],
)
def test_a_broken_map_is_refused_in_one_sentence(name, content, sentence, tmp_path):
    old(tmp_path)
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=sentence) as caught:
        read_graphs(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_folder_of_something_else_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"there is no graph\.g2o, expected a map that S-Graphs"):
        read_graphs(tmp_path)


@pytest.mark.skipif(not SHARED.exists(), reason="needs a recording of S-Graphs")
def test_a_recording_is_read():
    (read,) = read_with_attributes(SHARED)
    assert np.bincount(read.graph.nodes.label).tolist() == [12, 0, 4, 1]
    room = read.attributes.index({"id": 70})
    planes = [part for part, whole in parts_first(read.graph).tolist() if whole == room]
    assert [read.attributes[plane]["id"] for plane in planes] == [59, 60, 61, 62]
    npt.assert_allclose(read.graph.nodes.width[planes[0]], 3.25, atol=0.02)  # of its points
