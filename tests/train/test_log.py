import json
import math
import sys
import threading
import time
import types
from pathlib import Path

import pytest

from sg3d_jax.train.log import JsonLines, display, trim, writers


def test_records_are_json_lines_that_are_appended(tmp_path):
    for step in (1, 2):
        JsonLines(tmp_path / "log.jsonl", time.time())("train", step, {"loss": 0.5 / step})
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [(line["kind"], line["step"], line["loss"]) for line in lines] == [
        ("train", 1, 0.5),
        ("train", 2, 0.25),
    ]
    assert all(line["seconds"] >= 0 for line in lines)


def row(kind, step, **values):
    return json.dumps({"kind": kind, "step": step, **values}) + "\n"


def test_records_are_trimmed_to_one_of_each_step_up_to_the_one_that_a_run_goes_on_from(tmp_path):
    path = tmp_path / "log.jsonl"
    whole = row("train", 1) + row("train", 2) + row("validation", 2)
    spoilt = row("train", 1) + row("train", 2, loss=9) + '{"kind": "tra' + row("train", 2)
    path.write_text(spoilt + row("train", 2) + row("validation", 2) + row("train", 3) + '{"kind"')
    trim(path, 2)
    assert path.read_text() == whole
    trim(path, 1)
    assert path.read_text() == row("train", 1)
    trim(path, 0)
    assert path.read_text() == ""


def test_a_whole_log_is_not_touched_and_a_missing_one_not_made(tmp_path):
    path = tmp_path / "log.jsonl"
    trim(path, 4)
    assert not path.exists()
    path.write_text(row("train", 4))
    before = path.stat().st_ino
    trim(path, 4)
    assert path.stat().st_ino == before


def test_a_record_that_cannot_be_written_is_an_error_that_names_the_file(tmp_path):
    if not Path("/dev/full").exists():
        pytest.skip("no device that is always full")
    (tmp_path / "log.jsonl").symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"log\.jsonl: cannot be written \(No space left on device\)"):
        JsonLines(tmp_path / "log.jsonl", time.time())("train", 1, {"loss": 0.5})


def test_a_number_that_json_lacks_is_null(tmp_path):
    record = JsonLines(tmp_path / "log.jsonl", time.time())
    record("validation", 1, {"fgw": math.inf, "gw": math.nan, "w": 1.0})
    line = json.loads((tmp_path / "log.jsonl").read_text(), parse_constant=lambda name: 1 / 0)
    assert (line["fgw"], line["gw"], line["w"]) == (None, None, 1.0)


def test_tensorboard_is_written_if_it_is_installed_and_its_thread_ends(tmp_path):
    tensorboard = pytest.importorskip("tensorboardX.event_file_writer")
    before = set(threading.enumerate())
    with writers(tmp_path, 2) as chosen:
        new = set(threading.enumerate()) - before  # a queue may have one, too
        (made,) = [one for one in new if isinstance(one, tensorboard._EventLoggerThread)]
        for write in chosen:
            write("train", 3, {"loss": 1.5})
    assert not made.is_alive()
    (written,) = (tmp_path / "tensorboard").iterdir()
    assert b"train/loss" in written.read_bytes()
    assert (tmp_path / "log.jsonl").exists()


def test_a_disk_that_is_full_for_tensorboard_is_no_error_of_its_own(tmp_path, monkeypatch):
    seen = []

    class SummaryWriter:
        def __init__(self, directory, purge_step):
            self.directory = directory
            assert purge_step == 3  # what was recorded of step 3 is made again

        def add_scalar(self, name, value, step):
            seen.append((self.directory, name, value, step))

        def close(self):
            raise OSError("No space left on device")

    module = types.SimpleNamespace(SummaryWriter=SummaryWriter)
    monkeypatch.setitem(sys.modules, "tensorboardX", module)

    def diverge(chosen):
        for write in chosen:
            write("train", 3, {"loss": 1.5})
        raise FloatingPointError  # is what the run says, and not the disk

    with pytest.raises(FloatingPointError), writers(tmp_path, 2) as chosen:
        diverge(chosen)
    assert seen == [(str(tmp_path / "tensorboard"), "train/loss", 1.5, 3)]


def test_without_tensorboard_there_are_json_lines_only(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with writers(tmp_path, 2) as chosen:
        assert [type(writer) for writer in chosen] == [JsonLines]
    with pytest.raises(FloatingPointError) as caught, writers(tmp_path, 2):
        raise FloatingPointError
    assert caught.value.__context__ is None  # that it is not installed is no part of the story


def test_off_a_terminal_every_advance_is_one_plain_line_on_stderr(capsys):
    with display(100, 10) as shown:
        shown.advance(20, "loss 1.0000  " + "long " * 40)
        shown.advance(30, "loss 0.5000")
    captured = capsys.readouterr()
    first, second = captured.err.splitlines()
    assert first.startswith("step 20  loss 1.0000")
    assert second == "step 30  loss 0.5000"
    assert captured.out == ""


def test_on_a_terminal_there_is_a_bar_with_the_steps(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with display(100, 10) as shown:
        shown.advance(20, "loss 1.0000")
    err = capsys.readouterr().err
    assert "20/100" in err
    assert "loss 1.0000" in err
    assert "step 20" not in err
