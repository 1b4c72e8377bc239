"""What a run directory says of its run, and who works in it."""

import dataclasses
import json
import os
import socket
import subprocess
import sys

import pytest

from sg3d_jax import origin
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.train.config import Config, to_dict
from sg3d_jax.train.directory import changes_of_origin, check_same_run, held, write_run

HERE = dict.fromkeys(("commit", "code", "jax", "device", "training", "validation"), "1")


def test_the_second_process_is_told_who_holds_a_directory(tmp_path):
    with held(tmp_path):
        holder = f"process {os.getpid()} on {socket.gethostname()} is training in it"
        with pytest.raises(ValueError, match=f"{tmp_path}: {holder}"), held(tmp_path):
            pass
        (tmp_path / "config.json").touch()
    with held(tmp_path):
        pass


def test_a_process_that_is_killed_holds_a_directory_no_longer(tmp_path):
    program = (
        "import fcntl, sys\n"
        "file = open(sys.argv[1], 'a+')\n"
        "fcntl.flock(file, fcntl.LOCK_EX)\n"
        "print('held', file=file, flush=True), print('held', flush=True), sys.stdin.read()"
    )
    lock = str(tmp_path / "lock")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", program, lock], **pipes) as process:
        process.stdout.readline()
        with pytest.raises(ValueError, match="held is training in it"), held(tmp_path):
            pass
        process.kill()
    with held(tmp_path):
        pass


def test_a_directory_in_which_nothing_was_begun_is_removed(tmp_path):
    with pytest.raises(KeyError), held(tmp_path / "run"):
        raise KeyError
    assert not (tmp_path / "run").exists()


def test_origins_are_compared_with_the_last_ones_and_the_commit_is_told_with_the_code(tmp_path):
    assert changes_of_origin(tmp_path, HERE) == []
    write_run(tmp_path, Config(), HERE, 0)
    assert changes_of_origin(tmp_path, HERE) == []
    assert changes_of_origin(tmp_path, HERE | {"commit": "2"}) == []
    assert changes_of_origin(tmp_path, HERE | {"commit": "2", "code": "2"}) == [
        "commit 1 there, 2 here",
        "code 1 there, 2 here",
    ]
    (tmp_path / "origins.jsonl").unlink()
    assert changes_of_origin(tmp_path, HERE) is None


def test_origins_of_steps_that_are_made_again_are_forgotten(tmp_path):
    for step, training in ((0, "1"), (4, "2"), (8, "2"), (8, "3"), (4, "3")):
        write_run(tmp_path, Config(), HERE | {"training": training}, step)
    text = (tmp_path / "origins.jsonl").read_text()
    assert text.count("\n") == 2
    assert '"step": 4' in text.splitlines()[1]
    assert '"training": "3"' in text.splitlines()[1]


def test_a_run_goes_on_although_its_configuration_lacks_what_is_newer_and_as_it_was(tmp_path):
    older = to_dict(Config())
    del older["accumulate"], older["flagg"]["any_cuts"]
    (tmp_path / "config.json").write_text(json.dumps(older))
    assert check_same_run(tmp_path, Config()) == Config().steps
    with pytest.raises(ValueError, match=r"accumulate 1 there, 2 here$"):
        check_same_run(tmp_path, dataclasses.replace(Config(), accumulate=2))


def test_a_run_goes_on_although_concepts_have_other_colours_now(tmp_path):
    config = Config(ontology=FURNISHED_ONTOLOGY)
    write_run(tmp_path, config, HERE, 0)
    path = tmp_path / "config.json"
    path.write_text(path.read_text().replace(FURNISHED_ONTOLOGY.concepts[0].colour, "#123456"))
    assert check_same_run(tmp_path, config) == config.steps


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("config.json", "[]", r"config\.json is \[\], expected an object with 'steps'"),
        ("config.json", '{"steps": "x"}', "has another configuration: .*steps x there"),
        ("origins.jsonl", '{"step": 0}\n3\n', r"origins\.jsonl: line 2 is 3, expected an object"),
        ("origins.jsonl", '{"step": "a"}', "line 1: step is 'a', expected a number"),
        ("origins.jsonl", '{"step"', "line 1: not JSON"),
    ],
)
def test_what_is_no_configuration_or_origin_is_refused_by_file(tmp_path, name, content, sentence):
    (tmp_path / name).write_text(content)
    read = lambda: (check_same_run(tmp_path, Config()), changes_of_origin(tmp_path, HERE))
    with pytest.raises(ValueError, match=sentence):
        read()


def test_the_digest_of_the_code_is_that_of_every_file(tmp_path, monkeypatch):
    monkeypatch.setattr(origin, "PACKAGE", tmp_path)
    (tmp_path / "a.py").write_text("1")
    first = origin.code()
    assert origin.code() == first
    (tmp_path / "a.py").write_text("2")
    assert origin.code() != first
