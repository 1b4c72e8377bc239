"""What is shown of how far a command has come, and what is left of it when it is stopped."""

import os
import signal
from pathlib import Path

import pytest
from rich.console import Console

from sg3d_jax.cli import progress as module
from sg3d_jax.cli.progress import lines_to, progress
from tests.command_line import documents


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def shown(monkeypatch, capsys, is_terminal, total=3, quiet=False):
    """Returns what is on stderr after two of so many are done, and checks that stdout is free."""

    def console(**options):
        return Console(**options, force_terminal=is_terminal, width=100)

    monkeypatch.setattr(module, "Console", console)
    with progress(total, "scenes", quiet) as advance:
        for _ in range(2):
            advance()
        print("a line")
    captured = capsys.readouterr()
    assert captured.out == "a line\n"
    return captured.err


def test_a_terminal_shows_how_many_are_done_and_nothing_else_does(monkeypatch, capsys):
    bar = shown(monkeypatch, capsys, True)
    assert "scenes" in bar
    assert "2/3" in bar
    assert shown(monkeypatch, capsys, False) == ""
    assert shown(monkeypatch, capsys, True, quiet=True) == ""
    assert shown(monkeypatch, capsys, True, total=1) == ""


def test_lines_are_there_at_once_and_what_is_missing_is_said(capsys):
    with lines_to(Path("a.jsonl"), 2) as write:
        write({"a": 1})
        assert documents("a.jsonl") == [{"a": 1}]
        write({"a": 2})
    assert capsys.readouterr().err == ""
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as ended:
        _stopped()
    assert ended.value.code == 128 + signal.SIGTERM
    assert documents("a.jsonl") == [{"a": 3}]
    assert capsys.readouterr().err == "sg3d: a.jsonl: has 1 of 2 graphs, all that were done\n"
    assert signal.getsignal(signal.SIGTERM) == before


def _stopped():
    with lines_to(Path("a.jsonl"), 2) as write:
        write({"a": 3})
        os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is full")
def test_a_disk_that_is_full_is_said():
    full = pytest.raises(OSError, match="/dev/full: cannot be written")
    with full, lines_to(Path("/dev/full"), 1) as write:
        write({})
