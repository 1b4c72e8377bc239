"""Runs of several processes, and of others later."""

import itertools
import socket
import subprocess
import sys

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.train.loop import train
from tests.tiny_run import ROOT
from tests.train.wide_run import CONFIG, end_at, use


def interrupt():
    raise KeyboardInterrupt


@pytest.mark.slow
def test_a_run_goes_on_from_one_process_to_two_and_back_bit_for_bit(tmp_path, monkeypatch):
    """One process is interrupted, two with two devices each are killed, one comes to the end."""
    use(monkeypatch.setattr)
    expected = np.load(train(CONFIG, tmp_path / "at once").weights)["arr_0"]
    with monkeypatch.context() as patch:
        end_at(6, interrupt, patch.setattr)
        with pytest.raises(KeyboardInterrupt):
            train(CONFIG, tmp_path / "run")
    said = killed_at(10, tmp_path / "run")
    assert "another process of this run has failed, expected it to say why" in said[0].split("\n")
    assert "'here alone'" in said[1]
    steps = sorted(path.name for path in (tmp_path / "run" / "checkpoints").iterdir())
    assert steps == ["4", "8"]
    done = train(CONFIG, tmp_path / "run")
    assert done.step == CONFIG.steps  # the last ones are the best
    npt.assert_array_equal(np.load(done.weights)["arr_0"], expected)


def killed_at(step, directory):
    """Trains with two processes that are killed before a step; returns what each of them said."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, "-m", "tests.train.one_of_several", str(directory), address, "2"]
    processes = [
        subprocess.Popen(
            [*command, str(number), str(step)], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        for number in range(2)
    ]
    said = [
        "".join(itertools.takewhile(lambda line: line != "stopped\n", process.stdout))
        for process in processes
    ]
    for process in processes:
        process.kill()
        process.communicate()
    return said
