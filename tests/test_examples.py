"""The examples are scenes that anyone can complete, and scripts that anyone can run."""

import importlib.util
import re

import numpy as np
import pytest

from sg3d_jax.io.formats import read_planes
from sg3d_jax.flagg.grow import growth_capacity
from sg3d_jax.scene.validate import validate_planes
from tests.tiny_run import ROOT

FILES = sorted(
    p for p in (ROOT / "examples").iterdir() if p.is_file() and p.suffix not in {".png", ".py"}
)


def test_there_is_one_of_every_format():
    assert {path.suffix for path in FILES} >= {".json", ".jsonl", ".csv"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_example_is_read_and_sound(path):
    scenes = read_planes(path)
    assert len(scenes) > 1 if path.suffix == ".jsonl" else len(scenes) == 1
    for scene in scenes:
        validate_planes(*scene.nodes[1:4], str(path))
        assert growth_capacity(len(scene.nodes.label)).nodes <= 128
        np.testing.assert_allclose(np.linalg.norm(scene.nodes.normal, axis=1), 1, atol=1e-6)


def test_the_descent_on_fgw_moves_centroids_back_and_draws_it(tmp_path, monkeypatch, capsys):
    path = ROOT / "examples" / "fgw_descent.py"
    script = importlib.util.module_from_spec(importlib.util.spec_from_file_location("d", path))
    script.__spec__.loader.exec_module(script)
    monkeypatch.setattr(script, "STEPS", 60)
    script.main(str(tmp_path / "descent.png"))
    before, after = re.search(r"mean error (\S+) -> (\S+) m", capsys.readouterr().out).groups()
    assert float(after) < float(before) / 2
    assert (tmp_path / "descent.png").stat().st_size > 0
