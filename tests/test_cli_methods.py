"""`sg3d train | evaluate | complete | table | sheet` for every method of the paper."""

import dataclasses
import functools
import itertools
import json
import os

import jax
import numpy as np
import pytest

from sg3d_jax.infer import complete as completing
from sg3d_jax.io.formats import read_graphs, write_graphs
from sg3d_jax.metrics import fgw, report
from sg3d_jax.metrics.fgw import FGW
from sg3d_jax.scene.graph import observed_of
from sg3d_jax.scene.ontology import FLOOR, PLANE
from sg3d_jax.train import evaluation, loop
from sg3d_jax.train.config import DataConfig, to_json
from sg3d_jax.train.methods import METHODS
from sg3d_jax.train.weights import load_weights
from sg3d_jax.viz import figure
from tests.command_line import SCENES, documents, observed, refusal, run, write
from tests.tiny_run import (
    CONFIGS,
    shortest_run,
    small_floors,
    untrained_weights,
)

pytestmark = pytest.mark.slow

FD4 = load_weights("fd4-s-f")


@pytest.fixture(scope="module", autouse=True)
def _no_check_of_key_reuse():
    """JAX takes a vmapped scan over keys for their reuse."""
    with jax.debug_key_reuse(False):
        yield


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("weights")


untrained = functools.cache(untrained_weights)


@pytest.fixture(scope="module", params=["ec-square", "ec-l", "midi-or", "midi"])
def weights(request, folder):
    return request.param, str(untrained(folder, request.param))


def write_floors():
    write_graphs("floors.jsonl", small_floors())
    return "floors.jsonl"


@pytest.fixture
def scored(monkeypatch):
    """Records what is scored, and scores it at once."""
    pairs = []

    def score(made, truth, pieces):
        assert pieces is None or len(pieces) == len(made)
        pairs.extend(zip(made, truth, strict=True))
        tables = {name: {} for name in ("precision", "recall", "failures")}
        return {"fgw": 0.5, "node_count_error": {"absolute": {}}, **tables}

    monkeypatch.setattr(report, "score", score)
    return pairs


def test_a_method_is_trained_stored_and_scored(tmp_path, capsys, monkeypatch, scored):
    monkeypatch.setattr(loop, "fgw_pairs", lambda *graphs: FGW(0.5, 0.4, 0.6, None, True, 1))
    config = shortest_run(tmp_path, "ec-square")
    config = dataclasses.replace(config, model=dataclasses.replace(config.model, threshold=1e9))
    imports = "import json\nfrom sg3d_jax.train.config import from_dict\n"
    write("tiny.py", f"{imports}CONFIG = from_dict(json.loads({to_json(config)!r}))\n")
    run("train", "tiny.py")
    out = capsys.readouterr()
    path = os.path.join("runs", "tiny", "weights.npz")
    sentence = "weights of step 2, which has the best validation FGW, 0.5000"
    assert out.out == f"{path}: {sentence}\n"
    kinds = [line["kind"] for line in documents(os.path.join("runs", "tiny", "log.jsonl"))]
    assert kinds == ["train", "validation"]
    run("evaluate", os.path.join("runs", "tiny", "weights.npz"), "-o", "a.json")
    with open("a.json") as file:
        assert json.load(file)["method"] == "ec-square"


def test_weights_are_evaluated_by_the_name_of_their_method(weights, scored):
    method, path = weights
    run("evaluate", path, "--num-graphs", 1, "-o", "a.json")
    ((made, truth),) = scored
    with open("a.json") as file:
        result = json.load(file)
    assert (result["method"], result["weights"], result["data"]) == (method, path, "floors")
    assert result["diffusion_steps"] == (None if method.startswith("ec") else 2)
    assert ("halted" in result["scores"]) == METHODS[method].grows
    assert (FLOOR in truth.nodes.label) == (not method.startswith("ec"))
    if method == "midi-or":
        assert len(made.nodes.label) == len(truth.nodes.label)


def test_planes_are_completed_by_every_method(weights):
    method, path = weights
    graph = small_floors()[8]
    write_graphs("floor.json", [graph])
    run("complete", "floor.json", "-o", "graph.jsonl", "--weights", path)
    (document,) = documents("graph.jsonl")
    (made,) = read_graphs("graph.jsonl")
    num_planes = (graph.nodes.label == PLANE).sum()
    assert made.nodes.position[:num_planes].tolist() == graph.nodes.position[:num_planes].tolist()
    assert (document["halt_reason"] == "ONE_SHOT") == (not METHODS[method].grows)


def test_planes_alone_do_not_tell_an_oracle_how_many_nodes_there_are(weights, capsys):
    method, path = weights
    write("planes.json", SCENES[0])
    arguments = "complete", "planes.json", "-o", "graph.jsonl", "--weights", path
    if method == "midi-or":
        assert "MiDi+Or must be told how many nodes there are" in refusal(capsys, *arguments)
    else:
        run(*arguments)
        assert [observed(document) for document in documents("graph.jsonl")] == SCENES[:1]


def test_diffusion_steps_are_those_of_every_method_that_diffuses(weights, capsys, scored):
    method, path = weights
    arguments = "evaluate", path, "--diffusion-steps", 501
    sentence = "must be in 1..500, got 501"
    if METHODS[method].steps is None:
        sentence = f"{method} has no diffusion steps, got 501"
    assert sentence in refusal(capsys, *arguments)


def test_what_most_of_several_candidates_have_is_kept(folder, scored, monkeypatch):
    path, chosen = str(untrained(folder, "midi")), []

    def last(candidates, num_given):
        chosen.append(candidates)
        return candidates[-1], len(candidates) - 1

    monkeypatch.setattr(completing, "consensus", last)
    run("evaluate", path, "--num-graphs", 1, "--candidates", 2, "-o", "a.json")
    ((_, second),) = chosen
    assert scored[0][0] is second
    with open("a.json") as file:
        result = json.load(file)
    assert result["candidates"] == 2
    for name in ("calibration error nodes", "calibration error edges"):
        assert 0 <= result["scores"][name]["mean"] <= 1
    write("planes.json", SCENES[0])
    run("complete", "planes.json", "-o", "b.jsonl", "--weights", path, "--candidates", 2)
    (document,) = documents("b.jsonl")
    assert observed(document) == SCENES[0]


def test_one_candidate_says_nothing_of_calibration(folder, scored):
    run("evaluate", str(untrained(folder, "midi")), "--num-graphs", 1, "-o", "a.json")
    with open("a.json") as file:
        assert not [name for name in json.load(file)["scores"] if "calibration" in name]


def test_candidates_are_refused_where_there_are_none(folder, capsys):
    for arguments, sentence in (
        ((untrained(folder, "midi"), "--candidates", 0), "--candidates must be at least 1, got 0"),
        (("rand-s-f", "--candidates", 2), "rand-s-f has no trained weights, expected 1 candidate"),
    ):
        assert sentence in refusal(capsys, "evaluate", *arguments)


@pytest.mark.parametrize("method", ["ec-square", "ec-l"])
def test_edge_classifiers_are_refused_more_than_a_floor(method, folder, capsys):
    for data, top in (("s-c", "city"), ("r-b", "building")):
        line = refusal(capsys, "evaluate", untrained(folder, method), "--data", data)
        assert line.startswith(f"{data} reaches up to a {top}, expected a floor at most")


def test_a_name_is_a_method_on_a_data_set(monkeypatch):
    loaded = []
    monkeypatch.setattr(evaluation, "names", lambda: ["ec-square-s-f-square", "fd4-s-f"])
    monkeypatch.setattr(evaluation, "load_weights", lambda name: loaded.append(name) or FD4)
    for name, weights, data in (
        ("fd4-s-f", "fd4-s-f", "s-f"),
        ("ec-square-s-f-square", "ec-square-s-f-square", "s-f-square"),
        ("ec-square-s-f", "ec-square-s-f-square", "s-f"),  # trained once
        ("ec-square-p-f", "ec-square-s-f-square", "p-f"),
    ):
        method = evaluation.load_contender(name)
        assert (loaded.pop(), method.weights, method.data.name) == (weights, weights, data)
        assert evaluation.load_contender(name, "a.npz").data.name == "a.npz"


def test_weights_of_several_sets_are_scored_on_one_that_is_named(monkeypatch):
    config = dataclasses.replace(FD4.config, data=DataConfig("s-f+s-c", title="both", views=9))
    monkeypatch.setattr(evaluation, "load_weights", lambda name: FD4._replace(config=config))
    with pytest.raises(ValueError, match="is not of one data set, expected --data with one"):
        evaluation.load_contender("w.npz")
    assert evaluation.load_contender("w.npz", "s-c").data == DataConfig("s-c")


@pytest.mark.parametrize("name", ["fd4-m-f", "midi-r-c", "midi-or-m-f"])
def test_weights_that_do_not_come_with_the_package_are_refused_with_a_way_to_get_them(capsys, name):
    line = refusal(capsys, "evaluate", name)
    assert f"`sg3d train {name}` trains them" in line
    assert f"`sg3d evaluate runs/{name}/weights.npz`" in line


def sizes(graphs):
    return np.array([len(graph.nodes.label) for graph in graphs], float)


def test_methods_are_drawn_on_the_same_scenes(folder, monkeypatch):
    rows, captions = [], []
    monkeypatch.setattr(
        figure,
        "contact_sheet",
        lambda drawn, path, said: (rows.extend(drawn), captions.extend(said)),
    )
    monkeypatch.setattr(fgw, "fgw_pairs", lambda made, true: FGW(sizes(true), 0, 0, None, True, 1))
    write_floors()
    weights = untrained(folder, "ec-l")
    options = "--data", "floors.jsonl", "--num-graphs", 2, "--split", "all", "--first", 3
    run("sheet", "rand-s-f", weights, *options, "-o", "a.png")
    titles, graphs = zip(*rows, strict=True)
    assert titles == ("Rand", "EC-L", "truth")
    planes = [[observed_of(graph).nodes.position.tolist() for graph in row] for row in graphs]
    assert planes[0] == planes[1] == planes[2]
    assert [len(graph.nodes.label) for graph in graphs[2]] == [
        len(graph.nodes.label) for graph in small_floors()[3:5]
    ]
    targets = graphs[2], [METHODS["ec-l"].target(graph) for graph in graphs[2]]
    expected = [
        f"{index}: FGW {size:.3f}"
        for truth in targets
        for index, size in enumerate(sizes(truth).tolist(), 3)
    ]
    assert captions == [*expected, "3", "4"]


def test_bad_input_to_sheet_is_refused(capsys):
    sound = "rand-s-f", "--data", write_floors(), "-o", "a.png"
    for arguments, sentence in (
        (("-o", "a.png"), "the number of methods must be at least 1, got 0"),
        (("fd4-s-f", "fd4-s-f-square", "-o", "a.png"), "fd4-s-f-square is of s-f-square and"),
        ((*sound, "--num-graphs", 0), "--num-graphs must be at least 1, got 0"),
        ((*sound, "--first", -1), "--first must be at least 0, got -1"),
        ((*sound, "--first", 2), "--first must be in 0..1, got 2"),
        ((*sound, "--seed", -1), "--seed must be at least 0, got -1"),
        ((*sound, "-o", "a.txt"), "a.txt: the name ends in '.txt', expected .png"),
        (("fd5", *sound[1:]), "unknown weights 'fd5'"),
    ):
        assert sentence in refusal(capsys, "sheet", *arguments)


@pytest.fixture
def trained_with(monkeypatch):
    """Records with what `sg3d train` calls the training loop."""
    calls = []

    def train(config, directory, accept_changes):
        calls.append((config, directory))
        return loop.Finished(directory / "weights.npz", 3, 0.25)

    monkeypatch.setattr(loop, "train", train)
    return calls


def test_fields_are_overridden_by_their_names(trained_with, capsys):
    run(
        *("train", CONFIGS / "test.py", "--steps", 4, "--batch", 2, "-o", "there"),
        *("--model.layers", 3, "--optimiser.learning-rate", "1e-4", "--flagg.coins", 1, 2),
    )
    ((config, directory),) = trained_with
    assert (config.steps, config.batch, config.model.layers) == (4, 2, 3)
    assert config.optimiser.learning_rate == 1e-4
    assert config.flagg.coins == (1, 2)
    assert config.capacities == (96,)  # of the file
    assert str(directory) == "there"
    assert capsys.readouterr().out.startswith("there/weights.npz")


def test_a_run_without_a_directory_has_the_name_of_its_configuration(trained_with):
    run("train", CONFIGS / "test.py")
    assert str(trained_with[0][1]) == os.path.join("runs", "test")


def test_a_name_is_trained_in_a_directory_of_that_name(trained_with):
    run("train", "midi-or-s-c", "--model.resamplings", 2, "--data.num-graphs", 10)
    ((config, directory),) = trained_with
    assert (config.method, config.data.name, config.data.num_graphs) == ("midi-or", "s-c", 10)
    assert config.model.resamplings == 2
    assert config.flagg is None
    assert str(directory) == os.path.join("runs", "midi-or-s-c")


def test_bad_input_to_train_is_refused(capsys):
    for arguments, sentence in (
        (("rand-s-f",), "rand has nothing to train"),
        (("fd5-s-f",), "fd5-s-f: neither a configuration file nor METHOD-DATASET"),
        (("ec-l-s-c",), "s-c reaches up to a city, expected a floor at most, because ec-l"),
        (("fd4-p-f",), "p-f is made of a file that you have"),
        (("nothing.py",), "nothing.py: no such configuration file"),
        ((write("empty.py", ""),), "empty.py: expected a variable CONFIG"),
        ((CONFIGS / "test.py", "--steps", 9), "steps is 9, expected a multiple of steps_per_call"),
        ((CONFIGS / "test.py", "--data.name", "s-g", "-o", "run"), "unknown data set 's-g'"),
    ):
        assert sentence in refusal(capsys, "train", *arguments)


def test_a_loss_that_is_not_finite_is_one_line(capsys, monkeypatch):
    def diverge(*given):
        raise FloatingPointError("the loss is nan")

    monkeypatch.setattr(loop, "train", diverge)
    assert refusal(capsys, "train", CONFIGS / "test.py") == "the loss is nan"


def test_control_c_is_one_line(capsys, monkeypatch):
    def interrupt(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(loop, "train", interrupt)
    with pytest.raises(SystemExit) as caught:
        run("train", CONFIGS / "test.py")
    assert caught.value.code == 130
    assert capsys.readouterr().err == "sg3d: interrupted\n"


def test_what_an_evaluation_has_made_before_it_is_stopped_can_be_scored(
    folder, monkeypatch, scored
):
    write_floors()
    options = "--data", "floors.jsonl", "--split", "all"
    each = evaluation.complete_each

    def stopped(*arguments, **options):
        yield from itertools.islice(each(*arguments, **options), 3)
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluation, "complete_each", stopped)
    with pytest.raises(SystemExit):
        run("evaluate", untrained(folder, "midi"), *options, "--graphs", "made.jsonl")
    assert scored == []
    run("evaluate", "made.jsonl", *options, "--num-graphs", 3)
    for (made, truth), floor in zip(scored, small_floors()[:3], strict=True):
        assert truth.nodes.position.tolist() == floor.nodes.position.tolist()
        assert made.nodes.position.tolist() != truth.nodes.position.tolist()
