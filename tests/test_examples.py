"""The examples are scenes that anyone can complete, and scripts that anyone can run."""

import importlib.util
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from sg3d_jax.data import registry
from sg3d_jax.infer.lanes import growth_capacity
from sg3d_jax.io import npz
from sg3d_jax.io.formats import read_planes
from sg3d_jax.scene.validate import check_observed
from sg3d_jax.train import checkpoint
from sg3d_jax.train.methods import METHODS
from tests.command_line import documents, refusal, run
from tests.tiny_run import NODES, ROOT, small_floors

EXAMPLES = ROOT / "examples"
FILES = sorted(p for p in EXAMPLES.iterdir() if p.is_file() and p.suffix not in {".png", ".py"})
OWN_FILL = EXAMPLES / "own_fill.py"
# What makes a run of `own_fill.py` last seconds: two calls of two steps each.
SHORT = (
    *("--data.name", "floors.npz", "--data.num-graphs", "None", "--capacities", str(NODES)),
    *("--model.width", "8", "--model.layers", "1", "--flagg.width", "8", "--flagg.depth", "1"),
    *("--optimiser.warmup-steps", "1", "--batch", "2", "--steps", "4", "--steps-per-call", "2"),
    *("--validate-every", "2", "--validation-graphs", "1"),
)


def test_there_is_one_of_every_format():
    assert {path.suffix for path in FILES} >= {".json", ".jsonl", ".csv"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_example_is_read_and_sound(path):
    scenes = read_planes(path)
    assert len(scenes) > 1 if path.suffix == ".jsonl" else len(scenes) == 1
    for scene in scenes:
        check_observed(scene, str(path))
        assert growth_capacity(len(scene.nodes.label)).nodes <= 128
        np.testing.assert_allclose(np.linalg.norm(scene.nodes.normal, axis=1), 1, atol=1e-6)


def test_the_descent_on_fgw_moves_centroids_back_and_draws_it(tmp_path, monkeypatch, capsys):
    path = EXAMPLES / "fgw_descent.py"
    script = importlib.util.module_from_spec(importlib.util.spec_from_file_location("d", path))
    script.__spec__.loader.exec_module(script)
    monkeypatch.setattr(script, "STEPS", 60)
    script.main(str(tmp_path / "descent.png"))
    before, after = re.search(r"mean error (\S+) -> (\S+) m", capsys.readouterr().out).groups()
    assert float(after) < float(before) / 2
    assert (tmp_path / "descent.png").stat().st_size > 0


# --- a Fill model of one's own ---


@pytest.fixture(scope="module")
def own_run(tmp_path_factory):
    """A folder with a run of `own_fill.py`, and that run as its first checkpoint left it."""
    save, folder = checkpoint.save, tmp_path_factory.mktemp("own_fill")

    def save_and_copy(*arguments):
        save(*arguments)
        if not Path("cut_short").exists():
            shutil.copytree("run", "cut_short")

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(checkpoint, "save", save_and_copy)
        npz.save(folder / "floors.npz", small_floors(), registry.header("s-f-square"))
        run("train", OWN_FILL, *SHORT, "-o", "run")
    del METHODS["anchor"]
    return folder


@pytest.fixture
def in_own_run(own_run, monkeypatch):
    monkeypatch.chdir(own_run)
    yield
    METHODS.pop("anchor", None)


@pytest.mark.usefixtures("in_own_run")
def test_own_fill__goes_on_where_it_was_cut_short():
    assert steps_trained("cut_short") == [2]
    run("train", OWN_FILL, *SHORT, "-o", "cut_short")
    assert steps_trained("cut_short") == [2, 4]
    with np.load("run/weights.npz") as whole, np.load("cut_short/weights.npz") as resumed:
        assert whole.files == resumed.files
        assert all(whole[name].tobytes() == resumed[name].tobytes() for name in whole.files)


def steps_trained(folder):
    return [line["step"] for line in documents(f"{folder}/log.jsonl") if line["kind"] == "train"]


@pytest.mark.usefixtures("in_own_run")
def test_own_fill__is_scored():
    run("evaluate", "run/weights.npz", "--code", OWN_FILL, "--num-graphs", 1, "-o", "result.json")
    result = json.loads(Path("result.json").read_text())
    assert (result["method"], result["data"], result["graphs"]) == ("anchor", "floors", 1)
    assert np.isfinite(result["scores"]["fgw"]["mean"])


@pytest.mark.usefixtures("in_own_run")
def test_own_fill__completes_scenes():
    weights = "run/weights.npz"
    arguments = "--weights", weights, "--code", OWN_FILL, "--candidates", 1
    run("complete", "floors.npz", "-o", "grown.jsonl", *arguments)
    grown = documents("grown.jsonl")
    assert len(grown) == len(small_floors())
    assert all(document["grown"] for document in grown)


@pytest.mark.parametrize(
    "command",
    [
        ("evaluate", "run/weights.npz"),
        ("complete", "floors.npz", "-o", "refused.jsonl", "--weights", "run/weights.npz"),
    ],
    ids=" ".join,
)
@pytest.mark.usefixtures("in_own_run")
def test_own_fill__must_be_run_by_whoever_has_its_weights(command, capsys):
    assert refusal(capsys, *command) == (
        "run/weights.npz: unknown method 'anchor', expected one of ec-square, ec-l, midi-or, fd4, "
        "midi, or one of your own: run the file that registers it first (--code FILE)"
    )
