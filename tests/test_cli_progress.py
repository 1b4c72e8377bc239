"""What is shown of how far a command has come, and what is left of it when it is stopped."""

from pathlib import Path

import pytest
from rich.console import Console

from sg3d_jax.__main__ import Terminated
from sg3d_jax.cli import progress as module
from sg3d_jax.cli.progress import lines_to, progress, rate_text, shown_data
from sg3d_jax.data.watching import watched
from tests.command_line import documents, run, write_lines


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def shown_on(monkeypatch, is_terminal):
    """Lets progress be shown as on a terminal, or elsewhere."""

    def console(**options):
        return Console(**options, force_terminal=is_terminal, width=100)

    monkeypatch.setattr(module, "Console", console)


def shown(monkeypatch, capsys, is_terminal, total=3, quiet=False):
    """Returns what is on stderr after two of so many are done, and checks that stdout is free."""

    shown_on(monkeypatch, is_terminal)
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


@pytest.mark.parametrize(("speed", "said"), [(720.3, "720/s"), (0.0412, "0.041/s"), (None, "")])
def test_a_rate_has_two_digits_that_count(speed, said):
    assert rate_text(speed) == said


def test_data_sets_that_are_made_or_imported_are_counted_unless_it_is_to_be_quiet(
    monkeypatch, capsys
):
    shown_on(monkeypatch, True)
    rooms = [{"poly": [[x, 0], [x + 5, 0], [x + 5, 3], [x, 3]]} for x in (0, 5.1)]
    write_lines("plans.jsonl", [{"building": "home", "storey": 0, "rooms": rooms}] * 4)
    made = "data", "make", "s-f@robot", "-o", "a.npz", "--num-graphs", 3
    imported = "data", "import", "home", "plans.jsonl", "-o", "a.npz", "--like", "p-f"
    for arguments, counts in ((made, ("graphs", "views")), (imported, ("floors", "graphs"))):
        run(*arguments)
        bars = capsys.readouterr().err
        total = "3/3" if arguments is made else "4/4"
        assert all(count in bars for count in (*counts, total))
        run(*arguments, "--quiet")
        assert capsys.readouterr().err == ""


def test_a_bar_ends_with_what_it_counts_even_if_that_fails(monkeypatch, capsys):
    shown_on(monkeypatch, True)
    kept = []

    def broken():
        with shown_data(quiet=False):
            kept.append(watched(range(3), "graphs"))
            next(kept[0])
            raise ValueError("no graph")

    with pytest.raises(ValueError, match="no graph"):
        broken()
    assert capsys.readouterr().err.endswith("\x1b[?25h\r\x1b[1A\x1b[2K")  # shown, then wiped
    assert [*watched([1, 2], "graphs")] == [1, 2]
    assert capsys.readouterr().err == ""


def test_lines_are_there_at_once_and_what_is_missing_is_said(capsys):
    with lines_to(Path("a.jsonl"), 2) as write:
        write({"a": 1})
        assert documents("a.jsonl") == [{"a": 1}]
        write({"a": 2})
    assert capsys.readouterr().err == ""
    with pytest.raises(Terminated):
        _stopped()
    assert documents("a.jsonl") == [{"a": 3}]
    assert capsys.readouterr().err == "sg3d: a.jsonl: has 1 of 2 graphs, all that were done\n"


def _stopped():
    with lines_to(Path("a.jsonl"), 2) as write:
        write({"a": 3})
        raise Terminated


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is full")
def test_a_disk_that_is_full_is_said():
    full = pytest.raises(OSError, match="/dev/full: cannot be written")
    with full, lines_to(Path("/dev/full"), 1) as write:
        write({})
