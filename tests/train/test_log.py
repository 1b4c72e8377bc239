import json
import math
import sys
import time
import types

from sg3d_jax.train.log import JsonLines, display, writers


def test_records_are_json_lines_that_are_appended(tmp_path):
    for step in (1, 2):
        JsonLines(tmp_path / "log.jsonl", time.time())("train", step, {"loss": 0.5 / step})
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [(line["kind"], line["step"], line["loss"]) for line in lines] == [
        ("train", 1, 0.5),
        ("train", 2, 0.25),
    ]
    assert all(line["seconds"] >= 0 for line in lines)


def test_a_number_that_json_lacks_is_null(tmp_path):
    record = JsonLines(tmp_path / "log.jsonl", time.time())
    record("validation", 1, {"fgw": math.inf, "gw": math.nan, "w": 1.0})
    line = json.loads((tmp_path / "log.jsonl").read_text(), parse_constant=lambda name: 1 / 0)
    assert (line["fgw"], line["gw"], line["w"]) == (None, None, 1.0)


def test_tensorboard_is_written_if_it_is_installed(tmp_path, monkeypatch):
    seen = []

    class SummaryWriter:
        def __init__(self, directory):
            self.directory = directory

        def add_scalar(self, name, value, step):
            seen.append((self.directory, name, value, step))

    module = types.SimpleNamespace(SummaryWriter=SummaryWriter)
    monkeypatch.setitem(sys.modules, "tensorboardX", module)
    for write in writers(tmp_path):
        write("train", 3, {"loss": 1.5})
    assert seen == [(str(tmp_path / "tensorboard"), "train/loss", 1.5, 3)]
    assert (tmp_path / "log.jsonl").exists()


def test_without_tensorboard_there_are_json_lines_only(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    assert [type(writer) for writer in writers(tmp_path)] == [JsonLines]


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
