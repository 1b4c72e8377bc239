"""The examples are scenes that anyone can complete, and scripts that anyone can run."""

import dataclasses
import functools
import importlib.util
import json
import re
import runpy
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.data import registry
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.flagg.kinds import kind_loss
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.infer.lanes import growth_capacity
from sg3d_jax.io import npz
from sg3d_jax.io.formats import read_planes
from sg3d_jax.io.planes import read_planes_dict
from sg3d_jax.scene.graph import ontology_of
from sg3d_jax.scene.padding import Capacity
from sg3d_jax.scene.validate import check_observed, validate_graph
from sg3d_jax.train import checkpoint, loop
from sg3d_jax.train.methods import METHODS, build_model, register_fill
from sg3d_jax.train.step import TrainState
from sg3d_jax.train.weights import save_weights
from tests.command_line import documents, refusal, run
from tests.tiny_run import MODELS, NODES, ROOT, STATISTICS, small_floors
from tests.two_rooms import on_device, random_params

pytestmark = pytest.mark.slow

EXAMPLES = ROOT / "examples"
FILES = sorted(p for p in EXAMPLES.iterdir() if p.suffix in {".json", ".jsonl", ".csv"})
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


def test_objects_of_an_example_are_known_and_one_s_own_class_among_them():
    document = json.loads((EXAMPLES / "furnished.json").read_text())
    made = read_planes_dict(document, "furnished.json", FURNISHED_ONTOLOGY)
    assert made.remarks == ()
    assert sorted({*made.graph.nodes.label.tolist()}) == [0, 1, 2, 3]  # planes, doors, stairs too
    own = script_of("own_concept").ONTOLOGY
    window = {"class": "windows", "centroid": [0, 0, 1.4], "size": [1.2, 0.1, 1]}
    made = read_planes_dict(document | {"objects": [window]}, "furnished.json", own)
    assert own.names[made.graph.nodes.label.max()] == "window"


def script_of(name):
    """Returns an example as a module, without running its main."""
    path = EXAMPLES / f"{name}.py"
    script = importlib.util.module_from_spec(importlib.util.spec_from_file_location(name, path))
    script.__spec__.loader.exec_module(script)
    return script


def test_the_descent_on_fgw_moves_centroids_back_and_draws_it(tmp_path, monkeypatch, capsys):
    script = script_of("fgw_descent")
    monkeypatch.setattr(script, "STEPS", 60)
    script.main(str(tmp_path / "descent.png"))
    before, after = re.search(r"mean error (\S+) -> (\S+) m", capsys.readouterr().out).groups()
    assert float(after) < float(before) / 2
    assert (tmp_path / "descent.png").stat().st_size > 0


# --- a class of one's own ---


def test_own_concept__starts_from_weights_that_do_not_know_it_and_learns(tmp_path):
    script, known = script_of("own_concept"), tmp_path / "known.npz"
    floors = [floor for floor in registry.make("o-f", 13) if len(floor.nodes.label) < 50]
    with_windows = [script.with_windows(floor) for floor in floors]
    for floor in with_windows:
        validate_graph(floor, "floor")
        assert ontology_of(floor) == script.CONFIG.ontology
        assert (floor.nodes.label == script.ONTOLOGY.label_of("window")).sum() >= 3
    config = dataclasses.replace(
        script.CONFIG,
        model=MODELS["midi"],
        flagg=FlaggConfig(width=4, depth=1),
        initial=str(known),
    )
    before = dataclasses.replace(config, ontology=FURNISHED_ONTOLOGY, initial=None)
    capacity = Capacity(64, 256)
    (_, statistics, given), (model, _, params) = (
        built(of, on_device(graph, capacity))
        for of, graph in ((before, floors[0]), (config, with_windows[0]))
    )
    save_weights(known, before, statistics, given)
    state = TrainState(params, params, (), jnp.int32(0))
    params = loop.start_from_weights(config, state).params
    concepts, of_given = (windows_of(of.halt, slice(0, 11)) for of in (params, given))
    np.testing.assert_array_equal(concepts[2:], of_given[1:10])
    assert not concepts[1].any()  # nothing is known of windows yet

    graph = on_device(with_windows[0], capacity)

    @jax.jit
    @jax.grad
    def gradient_of(params):  # of the modules that compile in a second
        told = kind_loss(model.kinds.logits(params.kinds, graph), graph, graph)
        return told + model.halt.logit(params.halt, graph)

    gradient = gradient_of(params)
    for of in (gradient.halt, gradient.kinds):
        assert np.isfinite(windows_of(of)).all()
        assert windows_of(of).any()


def windows_of(params, rows=1):
    """Returns the weights of the input that tells windows, or of several, in a module."""
    return np.asarray(params["params"]["gine"]["nodes"]["kernel"])[rows]


def built(config, graph):
    """Returns a model, the statistics that it was made with, and parameters drawn at random."""
    statistics = STATISTICS._replace(label=(0.1,) * config.ontology.num_concepts)
    model = build_model(config.model, config.flagg, statistics, config.ontology)
    return model, statistics, random_params(model.init, graph)


# --- a Fill model of one's own ---


@pytest.fixture(scope="module")
def own_run(tmp_path_factory):
    """A folder with a run of `own_fill.py`, and that run as its first checkpoint left it.

    The file is run once; the classes that later commands register are then those of that run, and
    so are their compiled programs.
    """
    save, folder = checkpoint.save, tmp_path_factory.mktemp("own_fill")
    run_once = functools.cache(runpy.run_path)

    def run_path(path):
        made = run_once(path)
        if path == str(OWN_FILL):
            register_fill("anchor", made["AnchorConfig"], made["AnchorFill"])
        return made

    def save_and_copy(*arguments):
        save(*arguments)
        if not Path("cut_short").exists():
            shutil.copytree("run", "cut_short")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runpy, "run_path", run_path)
        with pytest.MonkeyPatch.context() as first:
            first.chdir(folder)
            first.setattr(checkpoint, "save", save_and_copy)
            npz.save(folder / "floors.npz", small_floors(), registry.header("s-f-square"))
            run("train", OWN_FILL, *SHORT, "-o", "run")
        del METHODS["anchor"]
        yield folder


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
