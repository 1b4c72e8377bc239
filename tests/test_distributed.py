"""Several processes: which share is whose, and that they come to what one comes to."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from sg3d_jax import distributed
from sg3d_jax.distributed import gathered, initialise, is_first, own_file, share
from sg3d_jax.metrics import report
from tests.command_line import documents, run, weights_at_random
from tests.one_of_two import total
from tests.tiny_run import ROOT


@pytest.fixture
def of(monkeypatch):
    """Makes this process one of several."""

    def be(here, processes):
        monkeypatch.setattr(jax, "process_index", lambda: here)
        monkeypatch.setattr(jax, "process_count", lambda: processes)

    return be


@pytest.mark.parametrize(("count", "processes"), [(7, 3), (2, 3), (0, 2), (5, 1)])
def test_shares__joined_are_all_and_of_like_size(of, count, processes):
    shares = []
    for here in range(processes):
        of(here, processes)
        shares.append(share(range(count)))
        assert is_first() == (here == 0)
    assert [item for one in shares for item in one] == list(range(count))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


def test_files_of_shares__sort_as_the_shares_do(of):
    names = []
    for here in range(11):
        of(here, 11)
        names.append(str(own_file(Path("made/graphs.jsonl"))))
    assert names[0] == "made/graphs.00-of-11.jsonl"
    assert names == sorted(names)
    with pytest.raises(ValueError, match="-: cannot hold what 11 processes write, expected the n"):
        own_file(Path("-"))


def test_a_process_that_is_alone__has_everything(monkeypatch):
    monkeypatch.delenv(distributed.ADDRESS_VARIABLE, raising=False)
    initialise()
    assert is_first()
    assert share([1, 2]) == gathered([1, 2]) == [1, 2]
    assert own_file(Path("a.jsonl")) == Path("a.jsonl")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((None, 2, 1), "process 1 of 2 has no coordinator, expected its address"),
        (("10.0.0.1", 2, 1), "the coordinator is '10.0.0.1', expected an address such as"),
        (("10.0.0.1:80", 2, 2), "this is process 2 of 2, expected a number from 0"),
        (("10.0.0.1:80", 2, None), "10.0.0.1:80: nobody says how many processes there are"),
        (("auto", None, None), "auto: nobody says how many processes there are"),
    ],
)
def test_numbers_that_do_not_fit__are_refused(monkeypatch, arguments, sentence):
    def refuse(address, num_processes, process_id, **_):
        assert address == (None if arguments[0] == "auto" else arguments[0])
        raise ValueError("The process id of the current process must be defined.")

    monkeypatch.delenv(distributed.ADDRESS_VARIABLE, raising=False)
    monkeypatch.setattr(jax.distributed, "initialize", refuse)
    with pytest.raises(ValueError, match=sentence):
        initialise(*arguments)


@pytest.mark.slow
def test_two_processes__come_to_what_one_comes_to(tmp_path, monkeypatch, capsys):
    """Each deals its share of the scenes to its devices, of which one has two and one has four."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(report, "score", total)
    with weights_at_random(tmp_path) as weights, jax.debug_key_reuse(False):
        command = ["evaluate", str(weights), "--split", "all", "--num-graphs", "5"]
        run(*command, "-o", "a.json", "--graphs", "graphs.jsonl")
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    worker = os.environ.get("PYTEST_XDIST_WORKER", "main")
    command += ["-o", "b.json", "--graphs", "shared.jsonl", "--coordinator", address]
    command += ["--num-processes", "2"]
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "tests.one_of_two", *command, "--process-id", str(here)],
            env={
                **os.environ,
                "PYTHONPATH": str(ROOT),
                "PYTEST_XDIST_WORKER": f"{worker}-process-{here}",  # for a cache of its own
            },
            stderr=subprocess.PIPE,
            text=True,
        )
        for here in range(2)
    ]
    said = [process.communicate(timeout=600)[1] for process in processes]
    assert [process.returncode for process in processes] == [0, 0], said
    parts = [documents(f"shared.{here}-of-2.jsonl") for here in range(2)]
    assert [len(part) for part in parts] == [2, 3]
    assert [*parts[0], *parts[1]] == documents("graphs.jsonl")
    one, two = (json.loads(Path(name).read_text()) for name in ("a.json", "b.json"))
    assert two["scores"] == one["scores"]
    assert two["graphs"] == 5
