"""`sg3d follow` and `sg3d data replay`: lines in, lines out, whatever ends them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy.testing as npt
import pytest

from sg3d_jax.__main__ import Terminated
from sg3d_jax.io import npz, stream
from sg3d_jax.io.formats import read_with_attributes, write_graphs
from sg3d_jax.scene.graph import observed_of
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from tests import simple_session
from tests.command_line import documents, refusal, run, write_lines
from tests.tiny_run import ROOT, small_floors

PROGRAM = """
from tests import simple_session
simple_session.install()
from sg3d_jax import cli
cli.main()
"""


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simple_session.install(monkeypatch)


def plane(name, x=0.0):
    return {"id": name, "centroid": [x, 0.0, 1.0], "normal": [1.0, 0.0, 0.0], "width": 2.0}


LINES = [
    {"planes": [plane(0), plane(1, 3.0)]},
    {"planes": [plane("b", 5.0), plane(2, 7.0)]},
    {"planes": [plane(0, 0.5)], "merged": [[2, "b"]]},
    {"removed": [0, 1]},
]


def follow(capsys, *arguments):
    run("follow", *arguments)
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_every_line_is_answered_by_what_it_changes(capsys):
    answers = follow(capsys, write_lines("drive.jsonl", LINES))
    assert [answer["update"] for answer in answers] == [1, 2, 3, 4]
    first = {"label": "room", "position": [1.5, 0.0, 1.0], "observed": [0, 1], "parts": []}
    assert answers[0]["added"] == [
        {"id": 0, **first, "since": 1, "confidence": pytest.approx(1 / 3)}
    ]
    assert [node["id"] for node in answers[2]["changed"]] == [0, 1]
    assert answers[2]["events"] == [{"kind": "shrunk", "id": 1, "others": []}]
    assert answers[3]["removed"] == [0]
    assert answers[3]["remarks"] == ["a remark"]


def test_what_a_map_needs_is_compiled_before_its_first_line_if_asked(monkeypatch, capsys):
    monkeypatch.setattr(simple_session, "WARM", [])
    source = write_lines("drive.jsonl", LINES)
    assert follow(capsys, source, "--planes", 60) == follow(capsys, source)
    assert simple_session.WARM == [60]


def test_or_by_the_whole_graph_in_a_file(capsys):
    write_lines("drive.jsonl", LINES)
    assert follow(capsys, "drive.jsonl", "--graphs", "-o", "graphs.jsonl", "--seed", 3) == []
    graphs = documents("graphs.jsonl")
    assert [[node["id"] for node in graph["nodes"]] for graph in graphs] == [
        [0, 1, "room-3"],
        [0, 1, "b", 2, "room-3", "room-4"],
        [0, 1, "b", "room-3", "room-4"],
        ["b", "room-4"],
    ]
    assert [graph["update"] for graph in graphs] == [1, 2, 3, 4]
    assert graphs[1]["nodes"][4]["since"] == 1
    assert len(read_with_attributes("graphs.jsonl")) == 4


def test_lines_come_from_standard_input_and_are_answered_one_by_one(monkeypatch, capsys):
    """The second line is given only when the first has been answered."""
    answered = []

    def lines():
        for line in LINES:
            yield json.dumps(line).encode() + b"\n"
            answered.append(capsys.readouterr().out)

    monkeypatch.setattr(stream.sys, "stdin", SimpleNamespace(buffer=lines()))
    run("follow", "-")
    assert [json.loads(line)["update"] for line in answered] == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("{", "drive.jsonl: line 3: not JSON at line 1 column 2 (Expecting property name"),
        ('{"room": []}', "drive.jsonl: line 3 has 'room', expected any of planes, removed, merged"),
        ('{"removed": [9]}', "drive.jsonl: line 3: removed: 9 is unknown, expected what is in the"),
    ],
)
def test_a_bad_line_ends_it_when_all_before_have_been_answered_and_kept(line, sentence, capsys):
    lines = [json.dumps(each) for each in (*LINES[:2], *LINES)]
    lines[2] = line
    Path("drive.jsonl").write_text("\n".join(lines))
    with pytest.raises(SystemExit) as caught:
        run("follow", "drive.jsonl", "--log", "log.jsonl")
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert err.startswith(f"sg3d: {sentence}")
    assert err.count("\n") == 1
    assert [json.loads(each)["update"] for each in out.splitlines()] == [1, 2]
    assert documents("log.jsonl") == LINES[:2]


def test_what_cannot_be_followed_is_refused_before_anything_is_written(capsys):
    write_lines("drive.jsonl", LINES)
    line = refusal(capsys, "follow", "nothing.jsonl", "-o", "a.jsonl", "--log", "b.jsonl")
    assert line.startswith("nothing.jsonl: no such file")
    for arguments, sentence in (
        (("-o", "a.json"), "a.json: the name ends in '.json', expected .jsonl"),
        (("--log", "no/a.jsonl"), "no/a.jsonl: cannot be written"),
        (("--seed", -1), "--seed must be at least 0"),
        (("--diffusion-steps", 0), "--diffusion-steps must be at least 1"),
    ):
        assert refusal(capsys, "follow", "drive.jsonl", *arguments).startswith(sentence)


def test_weights_that_do_not_grow_are_refused(monkeypatch, capsys):
    other = SimpleNamespace(model=SimpleNamespace(ontology=PAPER_ONTOLOGY))
    monkeypatch.setattr("sg3d_jax.train.weights.load_weights", lambda name: other)
    write_lines("drive.jsonl", LINES)
    assert refusal(capsys, "follow", "drive.jsonl", "--weights", "ec-l-s-f") == (
        "ec-l-s-f completes planes alone, expected weights of what grows"
    )


def test_the_log_has_the_map_go_on_where_it_was(capsys):
    write_lines("drive.jsonl", LINES)
    whole = follow(capsys, "drive.jsonl", "--log", "whole.jsonl")
    write_lines("first.jsonl", LINES[:2])
    write_lines("rest.jsonl", LINES[2:])
    first = follow(capsys, "first.jsonl", "--log", "log.jsonl")
    with open("log.jsonl", "a") as file:
        file.write('{"planes": [{"id"')  # killed while it wrote
    rest = follow(capsys, "rest.jsonl", "--log", "log.jsonl")
    assert first + rest == whole
    assert documents("log.jsonl") == documents("whole.jsonl") == LINES


def test_a_line_is_on_disk_before_it_is_answered(monkeypatch, capsys):
    kept = []

    def fsync(file):
        kept.append((documents("log.jsonl"), len(capsys.readouterr().out.splitlines())))

    monkeypatch.setattr(os, "fsync", fsync)
    run("follow", write_lines("drive.jsonl", LINES[:3]), "--log", "log.jsonl")
    answers = [count for _, count in kept]
    assert answers == [0, 1, 1]  # since the line before
    assert [lines for lines, _ in kept] == [LINES[:1], LINES[:2], LINES[:3]]


def test_ctrl_c_ends_it_without_a_traceback(monkeypatch, capsys):
    def lines():
        yield json.dumps(LINES[0]).encode()
        raise KeyboardInterrupt

    monkeypatch.setattr(stream.sys, "stdin", SimpleNamespace(buffer=lines()))
    with pytest.raises(SystemExit) as caught:
        run("follow")
    assert caught.value.code == 130
    out, err = capsys.readouterr()
    assert json.loads(out)["update"] == 1
    assert err == "sg3d: interrupted\n"


def test_sigterm_ends_it_with_all_that_was_answered_in_the_log(monkeypatch, capsys):
    def lines():
        yield json.dumps(LINES[0]).encode()
        raise Terminated

    monkeypatch.setattr(stream.sys, "stdin", SimpleNamespace(buffer=lines()))
    with pytest.raises(Terminated):
        run("follow", "--log", "log.jsonl")
    assert len(capsys.readouterr().out.splitlines()) == 1
    assert documents("log.jsonl") == LINES[:1]


def test_a_closed_pipe_ends_it_quietly_with_all_in_the_log(monkeypatch, capsys):
    reader, writer = os.pipe()

    def lines():
        yield json.dumps(LINES[0]).encode()
        os.close(reader)
        yield json.dumps(LINES[1]).encode()
        raise AssertionError("nobody reads what this line is answered")

    monkeypatch.setattr(stream.sys, "stdin", SimpleNamespace(buffer=lines()))
    with os.fdopen(writer, "w") as closed:
        monkeypatch.setattr(sys, "stdout", closed)
        with pytest.raises(SystemExit) as caught:
            run("follow", "--log", "log.jsonl")
    assert caught.value.code == 128 + signal.SIGPIPE
    assert capsys.readouterr().err == ""
    assert documents("log.jsonl") == LINES[:2]


def test_after_a_kill_it_goes_on_as_if_nothing_had_happened(capsys):
    """The first process is killed for good while it waits for the third line."""
    command = [sys.executable, "-c", PROGRAM, "follow", "--log", "log.jsonl"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment, **pipes) as killed:
        killed.stdin.write(b"".join(json.dumps(line).encode() + b"\n" for line in LINES[:2]))
        killed.stdin.flush()
        answers = [json.loads(killed.stdout.readline()) for _ in range(2)]
        killed.kill()
    answers += follow(capsys, write_lines("rest.jsonl", LINES[2:]), "--log", "log.jsonl")
    assert answers == follow(capsys, write_lines("drive.jsonl", LINES))


# --- replays ---


def test_a_replay_of_any_data_set_can_be_followed(capsys):
    run("data", "replay", "s-f-square", "-o", "drive.jsonl", "--truth", "truth.jsonl", "--index", 2)
    steps = len(documents("drive.jsonl"))
    assert capsys.readouterr().out == f"drive.jsonl: {steps} steps through graph 2 of s-f-square\n"
    follow(capsys, "drive.jsonl", "--graphs", "-o", "graphs.jsonl")
    grown, truth = read_with_attributes("graphs.jsonl"), read_with_attributes("truth.jsonl")
    for mine, theirs in zip(grown, truth, strict=True):
        planes = [by_id(read) for read in (mine, theirs)]
        assert {*planes[0]} == {*planes[1]}
        for name, row in planes[0].items():
            npt.assert_array_equal(row, planes[1][name])


def by_id(read):
    nodes = observed_of(read.graph).nodes
    ids = [held["id"] for held in read.attributes[: len(nodes.label)]]
    return {name: nodes.position[row] for row, name in enumerate(ids)}


def test_a_replay_may_be_of_a_part_of_a_split(capsys):
    floors = small_floors()
    npz.save("floors.npz", floors, {"parts": ["train"] * 9 + ["test"]})
    write_graphs("last.json", floors[9:])
    run("data", "replay", "floors.npz", "-o", "a.jsonl", "--split", "test", "--how", "clean")
    run("data", "replay", "last.json", "-o", "b.jsonl", "--how", "clean")
    assert documents("a.jsonl") == documents("b.jsonl")
    capsys.readouterr()
    options = ("-o", "c.jsonl", "--split", "test", "--index", 1)
    assert refusal(capsys, "data", "replay", "floors.npz", *options) == (
        "floors.npz: --index must be in 0..0, got 1"
    )
