"""`sg3d compile`, on random weights of a tiny model."""

import json

import jax
import numpy as np
import pytest
from jax import export

from sg3d_jax.infer import exported
from tests.command_line import refusal, run
from tests.tiny_run import untrained_weights


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    """Files by relative names, and no check that a vmapped scan fails."""
    monkeypatch.chdir(tmp_path)
    with jax.debug_key_reuse(False):
        yield


def test_growing_is_written_for_a_cpu_and_a_gpu(tmp_path, capsys):
    """Also where it calls kernels of the platform, as FD4 does."""
    weights = str(untrained_weights(tmp_path))
    run("compile", weights, "--planes", 13, "-o", "growth.npz")
    assert capsys.readouterr().out.startswith(f"growth.npz: growth of 13 planes by {weights}, 1 ")
    with np.load("growth.npz") as file:
        header = json.loads(str(file["header"]))
        assert set(file.files) == {"header", "program", *header["parameters"]}
        program = export.deserialize(bytearray(file["program"]))
    assert program.platforms == ("cpu", "cuda")
    assert header["weights"] == weights
    assert header["given"]["label"]["shape"] == [13]
    assert header["outputs"]["position"]["shape"] == [1, 32, 3]


def test_what_cannot_be_written_is_refused_before_any_work(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(exported, "export_growth", None)
    one_shot = str(untrained_weights(tmp_path, "ec-l"))
    for arguments, sentence in (
        ((one_shot, "-o", "a.npz"), f"{one_shot} completes planes alone, expected weights of what"),
        (("fd5", "-o", "a.npz"), "unknown weights 'fd5'"),
        (("fd4-s-f", "-o", "a.bin"), "a.bin: the name ends in '.bin', expected .npz"),
        (("fd4-s-f", "-o", "a.npz", "--planes", 1), "--planes must be at least 2, got 1"),
        (("fd4-s-f", "-o", "a.npz", "--planes", 9999), "--planes must be at most 1133, got 9999"),
        (("fd4-s-f", "-o", "a.npz", "--samples", 0), "--samples must be at least 1, got 0"),
        (("fd4-s-f", "-o", "a.npz", "--samples", 9999), "--samples must be at most 1024, got 9999"),
    ):
        assert sentence in refusal(capsys, "compile", *arguments)
