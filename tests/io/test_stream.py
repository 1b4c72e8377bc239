"""Lines of changes in, lines of what they do to the graph out."""

import io
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.data.replay import DRIVE, replay
from sg3d_jax.io import stream
from sg3d_jax.io.json import read_dict
from sg3d_jax.io.stream import (
    Heard,
    applied,
    changes_to_dict,
    document_of,
    graph_changes_to_dict,
    lines_of,
    map_to_dict,
    read_changes,
)
from sg3d_jax.scene.changes import Changes
from sg3d_jax.scene.graph import observed_of, parts_first
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, ROOM
from tests import own_world, simple_session

PLANE = {"id": "a", "centroid": [0.1, 1 / 3, 2.7], "normal": [0.0, -1.0, 0.0], "width": 4.000000001}
LINE = {
    "planes": [PLANE, PLANE | {"id": 7, "colour": "red"}],
    "removed": [3, "b"],
    "merged": [["c", 7], [4, "a"]],
    "confirmed": [12],
    "forbidden": [5, 6],
    "think": True,
}
MESSAGE = json.loads((Path(__file__).parent / "s_graphs.json").read_text())["planes"]


def read(document, ontology=PAPER_ONTOLOGY, heard=None):
    return read_changes(document, ontology, Heard() if heard is None else heard, "a.jsonl: line 3")


# --- changes in ---


def test_a_line_tells_of_all_changes_at_once():
    changes, _ = read(LINE)
    assert changes.ids == ("a", 7)
    npt.assert_array_equal(changes.observed.nodes.position, [PLANE["centroid"]] * 2)
    npt.assert_array_equal(changes.observed.nodes.normal, [PLANE["normal"]] * 2)
    npt.assert_array_equal(changes.observed.nodes.width, [PLANE["width"]] * 2)
    assert changes[2:] == ((3, "b"), (("c", 7), (4, "a")), (12,), (5, 6), True)


def test_a_line_need_not_tell_of_anything():
    assert read({})[0] == read({"planes": []})[0] == Changes()
    assert changes_to_dict(Changes()) == {}


def test_changes_become_the_line_that_they_are_read_from():
    told = json.loads(json.dumps(changes_to_dict(read(LINE)[0])))
    assert told == LINE | {"planes": [PLANE, PLANE | {"id": 7}]}


def test_other_ontologies_have_their_own_lists():
    """Each concept that is observed has one."""
    graph = own_world.own_world()
    observed = graph.nodes.observed
    part = observed_of(graph)
    line = changes_to_dict(Changes(part, tuple(range(int(observed.sum())))))
    assert {*line} == {"planes", "pillars"}
    back, _ = read(json.loads(json.dumps(line)), own_world.ONTOLOGY)
    assert sorted(back.ids) == [*range(int(observed.sum()))]
    for mine, theirs in zip(back.observed.nodes, part.nodes, strict=True):
        npt.assert_array_equal(mine, theirs[list(back.ids)])


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ([], r" is \[\], expected an object of changes"),
        ({"plane": []}, r" has 'plane', expected any of planes, removed, merged, confirmed, forb"),
        ({"planes": {}}, r": planes is {}, expected a list"),
        ({"planes": [3]}, r": planes\[0\] is 3, expected an object with 'id'"),
        (
            {"planes": [{"id": 1}]},
            r": planes\[0\] lacks 'centroid', expected centroid, normal, width",
        ),
        ({"planes": [PLANE | {"id": None}]}, r": planes\[0\]\.id is None, expected an integer or"),
        ({"planes": [PLANE, PLANE]}, r": planes\[1\]\.id is 'a' again, expected unique ids"),
        ({"planes": [PLANE | {"normal": [1, 0]}]}, r": planes\[0\]\.normal is \[1, 0\], exp"),
        ({"planes": [PLANE | {"width": -1}]}, r": nodes\[0\]\.width is -1, expected zero m"),
        ({"planes": [PLANE | {"width": float("nan")}]}, r": nodes\[0\]\.width is nan, expected"),
        ({"removed": 3}, r": removed is 3, expected a list"),
        ({"think": 1}, r": think is 1, expected true or false"),
        ({"removed": [True]}, r": removed\[0\] is True, expected an id"),
        ({"merged": [[1, 2, 3]]}, r": merged\[0\] is \[1, 2, 3\], expected the id that is gone"),
        ({"merged": [[1, 2.0]]}, r": merged\[0\] is \[1, 2\.0\], expected the id that is gone"),
        ({"confirmed": ["a"]}, r": confirmed\[0\] is 'a', expected the id of a grown node, a num"),
        ({"x_planes": []}, r" lacks 'y_planes', expected"),
        ({"x_planes": [{}, {}], "y_planes": []}, r": x_planes\[0\] lacks 'id', expected"),
    ],
)
def test_what_is_no_change_is_refused_with_its_line(document, sentence):
    with pytest.raises(ValueError, match=rf"^a\.jsonl: line 3{sentence}") as caught:
        read(document)
    assert "\n" not in str(caught.value)


# --- messages ---


def shifted(message, metres):
    """Returns a message whose first x_plane is somewhere else."""
    moved = json.loads(json.dumps(message))
    plane = moved["x_planes"][0]
    plane["d"] -= metres
    for point in plane["plane_points"]:
        point["x"] += metres
    return moved


def test_a_message_tells_what_the_one_before_did_not():
    names = sorted(plane["id"] for axis in ("x_planes", "y_planes") for plane in MESSAGE[axis])
    first, heard = read(MESSAGE)
    assert sorted(first.ids) == [name for name in names if name in first.ids]
    again, heard = read(MESSAGE, heard=heard)
    assert again == Changes()
    moved, heard = read(shifted(MESSAGE, 0.3), heard=heard)
    (name,) = moved.ids
    assert name == MESSAGE["x_planes"][0]["id"]
    before = first.observed.nodes.position[first.ids.index(name)]
    npt.assert_allclose(moved.observed.nodes.position[0] - before, [0.3, 0, 0], atol=1e-9)
    without = MESSAGE | {"x_planes": MESSAGE["x_planes"][1:]}
    gone, heard = read(without, heard=heard)
    assert gone == Changes(removed=(name,))
    assert read(shifted(MESSAGE, 0.3), heard=heard)[0].ids == (name,)


def test_what_creeps_is_told_when_it_is_a_millimetre_off_what_was_told():
    _, heard = read(MESSAGE)
    told = []
    for step in range(1, 6):
        changes, heard = read(shifted(MESSAGE, 0.0004 * step), heard=heard)
        told.append(len(changes.ids))
    assert told == [0, 0, 1, 0, 0]


def test_a_message_of_fewer_than_two_planes_is_as_one_without():
    """A robot that sets out has seen one; it is told when there are two."""
    one = {"x_planes": MESSAGE["x_planes"][:1], "y_planes": []}
    nothing, heard = read(one)
    assert nothing == Changes()
    pointless = [plane | {"plane_points": []} for plane in MESSAGE["y_planes"]]
    assert read(one | {"y_planes": pointless}, heard=heard)[0] == Changes()
    first, heard = read(MESSAGE, heard=heard)
    gone, heard = read(one, heard=heard)
    assert gone == Changes(removed=first.ids)
    assert read(MESSAGE, heard=heard)[0].ids == first.ids


def test_a_map_of_other_concepts_refuses_messages():
    with pytest.raises(ValueError, match=r"line 3 is a message of S-Graphs, expected changes of"):
        read(MESSAGE, own_world.ONTOLOGY)


# --- lines ---


def test_lines_come_with_their_numbers_and_empty_ones_are_left_out(tmp_path, monkeypatch):
    content = b'{}\n\n  \n{"removed": [1]}\r\n{"a'
    path = tmp_path / "drive.jsonl"
    path.write_bytes(content)
    expected = [(1, b"{}"), (4, b'{"removed": [1]}'), (5, b'{"a')]
    assert [*lines_of(str(path))] == [(f"{path}: line {n}", line) for n, line in expected]
    monkeypatch.setattr(stream.sys, "stdin", SimpleNamespace(buffer=io.BytesIO(content)))
    assert [*lines_of("-")] == [(f"standard input: line {n}", line) for n, line in expected]


@pytest.mark.parametrize("name", ["nothing.jsonl", "."])
def test_what_is_no_file_is_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=f"^{name}: no such file, expected one to read, or - for"):
        lines_of(name)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        (b'{"a', "here: not JSON at line 1 column 2"),
        (b'{"a": "\xff"}', "here: byte 7 is not UTF-8, expected JSON"),
    ],
)
def test_a_line_that_is_no_document_is_refused(line, sentence):
    with pytest.raises(ValueError, match=sentence):
        document_of(line, "here")


# --- graph changes out ---


@pytest.fixture(scope="module")
def drive():
    """What a robot tells of a floor, of which all but two planes are gone at the end."""
    steps = replay(registry.make("s-f", 1)[0], DRIVE, 0, 0)
    return [*(step.changes for step in steps), Changes(removed=steps[-1].ids[2:])]


def test_lines_applied_one_by_one_are_the_whole_graph(drive):
    session, nodes, seen = simple_session.begin(None, 40), {}, set()
    for number, told in enumerate(drive, 1):
        session, done = simple_session.update(None, None, session, told)
        line = json.loads(json.dumps(graph_changes_to_dict(done, PAPER_ONTOLOGY, number)))
        assert {*line} == {"update", "added", "changed", "removed", "events", "remarks"}
        nodes = applied(nodes, line)
        seen |= {key for key, value in line.items() if value}
        graph, ids = simple_session.graph_of(session), simple_session.ids_of(session)
        rows = np.flatnonzero(graph.nodes.label == ROOM).tolist()
        assert [f"room-{name}" for name in nodes] == [ids[row] for row in rows]
        for row, node in zip(rows, nodes.values(), strict=True):
            assert node["label"] == "room"
            assert node["position"] == graph.nodes.position[row].tolist()
            pairs = parts_first(graph).tolist()
            assert node["observed"] == [ids[part] for part, whole in pairs if whole == row]
            assert node["since"] == session.born[node["id"]]
    assert seen == {"update", "added", "changed", "removed", "events", "remarks"}


def test_a_whole_graph_can_be_read_and_no_id_is_taken_for_another(drive):
    """The map counts from zero, as the caller does."""
    session, _ = simple_session.update(None, None, simple_session.begin(None), drive[0])
    session, _ = simple_session.update(None, None, session, drive[1])
    graph, nodes = simple_session.graph_of(session), simple_session.nodes_of(session)
    document = map_to_dict(graph, simple_session.ids_of(session), nodes.values(), 2)
    back, attributes = read_dict(json.loads(json.dumps(document)))[:2]
    npt.assert_array_equal(parts_first(back), parts_first(graph))
    ids = [held["id"] for held in attributes]
    assert ids == [*session.planes, "room-0", "room-1"]
    sure = [node.confidence for node in nodes.values()]
    assert attributes[-2:] == [
        {"id": f"room-{name}", "since": name + 1, "confidence": sure[name]} for name in nodes
    ]
    assert attributes[0] == {"id": ids[0]}
    assert document["update"] == 2
