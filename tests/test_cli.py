"""The command line, run in this process on random weights of a tiny model."""

import csv
import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import sg3d_jax
from sg3d_jax import __version__
from sg3d_jax.data import registry
from sg3d_jax.flagg.grow import HALT_REASONS
from sg3d_jax.infer import complete as completing
from sg3d_jax.infer.confidence import Confidence
from sg3d_jax.io.formats import read_graphs, write_graphs
from sg3d_jax.metrics.paper import SCORES
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from tests.command_line import (
    SCENES,
    as_csv,
    documents,
    observed,
    refusal,
    run,
    write,
    write_lines,
)
from tests.tiny_run import CONFIGS, ROOT, small_floors, untrained_weights

PNG = b"\x89PNG\r\n"


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return str(untrained_weights(tmp_path_factory.mktemp("weights")))


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    """Files by relative names, and no check that a vmapped scan fails."""
    monkeypatch.chdir(tmp_path)
    with jax.debug_key_reuse(False):
        yield


def test_planes_become_a_graph_and_a_picture(weights, capsys):
    write("planes.json", SCENES[0])
    run(
        *("complete", "planes.json", "-o", "graph.json", "--picture", "graph.png"),
        *("--weights", weights, "--seed", 5),
    )
    with open("graph.json") as file:
        document = json.load(file)
    assert observed(document) == SCENES[0]  # the same floats
    nodes = document["nodes"]
    assert [node["id"] for node in nodes] == list(range(len(nodes)))
    num_planes = len(SCENES[0]["planes"])
    assert {node["label"] for node in nodes[:num_planes]} == {"plane"}
    for node in nodes[num_planes:]:
        assert node["label"] in PAPER_ONTOLOGY.names[1:]
        assert node["normal"] is None
        assert node["width"] is None
        assert np.isfinite(node["position"]).all()
    assert all(0 <= end < len(nodes) for edge in document["edges"] for end in edge)
    assert document["halt_reason"] in HALT_REASONS[1:]
    assert document["seed"] == 5
    assert document["weights"] == weights
    with open("graph.png", "rb") as file:
        assert file.read(len(PNG)) == PNG
    assert "graph.json: scene 0 sample 0" in capsys.readouterr().out
    assert sorted(os.listdir(".")) == ["graph.json", "graph.png", "planes.json"]
    assert len(read_graphs("graph.json")[0].nodes.label) == len(nodes)


def test_scenes_come_out_in_their_order(weights):
    write_lines("planes.jsonl", SCENES)
    run("complete", "planes.jsonl", "-o", "graphs.jsonl", "--weights", weights)
    grown = documents("graphs.jsonl")
    assert [observed(document) for document in grown] == SCENES
    assert [document["scene"] for document in grown] == [0, 1, 2]


def test_samples_differ_and_come_scene_by_scene(weights):
    write_lines("planes.jsonl", SCENES[:2])
    run(
        *("complete", "planes.jsonl", "-o", "graphs.jsonl", "--weights", weights, "--samples", 3),
        *("--picture", "graph.svg"),
    )
    grown = documents("graphs.jsonl")
    assert [(one["scene"], one["sample"]) for one in grown] == [
        (scene, index) for scene in range(2) for index in range(3)
    ]
    assert len({json.dumps(one["nodes"]) for one in grown}) == 6
    assert os.path.getsize("graph.svg") > 0


def test_a_table_gives_what_json_gives(weights):
    write("planes.json", SCENES[1])
    write("planes.csv", as_csv(SCENES[1]))
    for name in ("json", "csv"):
        run("complete", f"planes.{name}", "-o", f"from_{name}.json", "--weights", weights)
    with open("from_json.json") as one, open("from_csv.json") as other:
        assert one.read() == other.read()


def test_the_seed_fixes_the_sample(weights):
    write("planes.json", SCENES[0])
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        run(
            *("complete", "planes.json", "-o", f"{name}.json", "--weights", weights),
            *("--seed", seed, "--candidates", 1),
        )
    one, again, other = (Path(f"{name}.json").read_text() for name in "abc")
    assert one == again
    assert json.loads(one)["nodes"] != json.loads(other)["nodes"]


def test_one_scene_may_go_to_json_lines(weights):
    write("planes.json", SCENES[0])
    run("complete", "planes.json", "-o", "graph.jsonl", "--weights", weights)
    assert [observed(document) for document in documents("graph.jsonl")] == SCENES[:1]


def test_a_graph_that_did_not_come_to_its_end_is_warned_of(weights, capsys, monkeypatch):
    sure = Confidence(0.0, 0.0, 0.0, None)
    grown = completing.Completion(
        small_floors()[0], "CAPACITY", 3, np.arange(4), sure, (), np.ones(4, int)
    )
    monkeypatch.setattr(
        completing, "complete_each", lambda *arguments, **options: (one for one in [[grown]])
    )
    run("complete", write("a.json", SCENES[0]), "-o", "graph.json", "--weights", weights)
    warning = "sg3d: warning: scene 0 sample 0 stopped by CAPACITY, so its graph is incomplete\n"
    assert capsys.readouterr().err == warning
    with open("graph.json") as file:
        assert json.load(file)["halt_reason"] == "CAPACITY"


def changed(**fields):
    first, *rest = SCENES[0]["planes"]
    return {"planes": [*rest, {**first, **fields}]}


def in_millimetres(scene):
    return {
        "planes": [
            {
                "centroid": [1000 * x for x in plane["centroid"]],
                "normal": plane["normal"],
                "width": 1000 * plane["width"],
            }
            for plane in scene["planes"]
        ]
    }


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.json", changed(width=float("nan")), "width is nan, expected finite numbers"),
        ("a.json", changed(centroid=[0, float("inf"), 0]), "expected finite numbers"),
        ("a.json", changed(normal=[0, 0, 0]), "normal is [0, 0, 0], expected length 1"),
        ("a.json", changed(width=-2), "width is -2, expected zero metres or more"),
        ("a.json", {"planes": []}, "planes holds no planes, expected at least two"),
        ("a.json", {"planes": SCENES[0]["planes"][:1]}, "planes holds one plane"),
        (
            "a.json",
            {"planes": SCENES[0]["planes"][:1] * 3},
            "planes holds one plane, having merged 2 planes (exactly repeated), expected at least",
        ),
        ("a.json", in_millimetres(SCENES[0]), "looks like millimetres"),
        ("a.json", "{", "not JSON at line 1 column 2"),
        ("a.json", "", "not JSON at line 1 column 1"),
        ("a.json", changed(label="door"), "has 'label', which the result says itself, expected"),
        ("a.json", {"planes": [p | {"id": 3} for p in SCENES[0]["planes"]]}, "id is 3 again"),
        ("a.jsonl", json.dumps(SCENES[0]) + "\n{}\n", "line 2: the document has no key"),
        ("a.csv", as_csv(SCENES[0]).replace("cx", "x"), "missing column 'cx'"),
        ("a.csv", as_csv(SCENES[0]).replace("width", "width,label"), "has 7 cells, expected 8"),
        ("a.txt", "", "the name ends in '.txt', expected one of .json, .jsonl"),
    ],
)
def test_bad_planes_are_refused(weights, capsys, name, content, sentence):
    write(name, content)
    line = refusal(
        capsys, "complete", name, "-o", "graph.json", "--picture", "a.png", "--weights", weights
    )
    assert line.startswith(name)
    assert sentence in line


def test_other_bad_input_to_complete_is_refused(weights, capsys, tmp_path):
    write("a.json", SCENES[0])
    write_lines("a.jsonl", SCENES)
    (tmp_path / "folder.json").mkdir()
    broken = write("broken.npz", "no weights")
    sound = ("complete", "a.json", "-o", "graph.json", "--weights", weights)
    for arguments, sentence in (
        ((*sound, "--samples", 0), "--samples must be at least 1, got 0"),
        ((*sound, "--seed", -1), "--seed must be at least 0, got -1"),
        ((*sound, "--lanes", 0), "--lanes must be at least 1, got 0"),
        ((*sound, "--lanes", 10**12), "--lanes must be at most 1024, got 1000000000000"),
        ((*sound, "--samples", 10**12), "samples and candidates together must be at most 100000"),
        ((*sound, "--candidates", 10**6), "together must be at most 100000, got 1000000"),
        ((*sound, "--diffusion-steps", 0), "diffusion steps must be in 1..500, got 0"),
        ((*sound, "--diffusion-steps", 501), "diffusion steps must be in 1..500, got 501"),
        ((*sound[:-1], "fd5"), "unknown weights 'fd5', expected the path of an npz file or one of"),
        ((*sound[:-1], broken), "broken.npz: not an npz file of plain arrays"),
        (("complete", "b.json", *sound[2:]), "b.json: No such file or directory"),
        ((*sound, "-o", "nowhere/graph.json"), "nowhere/graph.json: cannot be written"),
        ((*sound, "-o", "folder.json"), "folder.json: cannot be written"),
        ((*sound, "-o", "graph"), "graph: the name ends in '', expected .json or .jsonl"),
        ((*sound, "--picture", "nowhere/a.png"), "nowhere/a.png: cannot be written"),
        ((*sound, "--picture", "a.bmp"), "a.bmp: the name ends in '.bmp', expected .png or .pdf"),
        (
            (*sound, "--samples", 2),
            "graph.json: holds one graph, expected the name of a .jsonl file",
        ),
        (("complete", "a.jsonl", *sound[2:]), "of a .jsonl file for 3 graphs"),
    ):
        assert sentence in refusal(capsys, *arguments)


def test_a_folder_without_permission_is_refused_before_growing(weights, capsys, monkeypatch):
    write("a.json", SCENES[0])
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # nothing stops root
    line = refusal(capsys, "complete", "a.json", "-o", "graph.json", "--weights", weights)
    assert line.startswith("graph.json: cannot be written")


def test_a_graph_is_drawn(capsys):
    graphs = [{"nodes": [node(0, "room")], "edges": []}, {"nodes": [node(7, "floor")], "edges": []}]
    write_lines("graphs.jsonl", graphs)
    run("view", "graphs.jsonl", "-o", "a.png", "--index", 1)
    with open("a.png", "rb") as file:
        assert file.read(len(PNG)) == PNG
    capsys.readouterr()
    for arguments, sentence in (
        (("graphs.jsonl", "-o", "b.png", "--index", 2), "--index must be in 0..1, got 2"),
        (("s-f", "-o", "b.png", "--index", -1), "--index must be at least 0, got -1"),
        (("s-f", "-o", "b.png", "--index", 10**12), "graphs are asked for, expected 0 to 200000"),
        (("nothing.json", "-o", "b.png"), "nothing.json: No such file"),
        (("graphs.jsonl", "-o", "b.xyz"), "expected"),
        (("graphs.jsonl", "-o", "nowhere/b.png"), "nowhere/b.png"),
        (("s-g", "-o", "b.png"), "unknown data set 's-g'"),
        (("m-f", "-o", "b.png"), "m-f cannot be generated"),
    ):
        assert sentence in refusal(capsys, "view", *arguments)


@pytest.mark.parametrize(("options", "count"), [((), 100), (("--index", 2), 1)])
def test_a_page_shows_a_data_set(capsys, options, count):
    run("view", "s-f-square", "-o", "a.html", *options)
    assert capsys.readouterr().out.startswith(f"a.html: page of {count} graph")
    with open("a.html") as file:
        assert file.readline().lower().startswith("<!doctype html>")


@pytest.mark.parametrize("to", ["json", "networkx", "spark-dsg", "graphml", "npz"])
def test_graphs_are_exported_to_every_format(capsys, to):
    name = f"a.{to if to in ('graphml', 'npz') else 'json'}"
    run("export", "s-f", "-o", name, "--to", to, "--index", 3)
    assert capsys.readouterr().out == f"{name}: 1 graph as {to}\n"
    (graph,) = read_graphs(name)
    expected = registry.make("s-f", 4)[3]
    np.testing.assert_array_equal(graph.nodes.position, expected.nodes.position)
    run("export", name, "-o", "again.jsonl")
    (again,) = read_graphs("again.jsonl")
    np.testing.assert_array_equal(again.nodes.position, expected.nodes.position)


def test_walls_may_be_exported_as_metadata():
    for walls in ("edges", "metadata"):
        run("export", "s-f", "-o", "a.json", "--to", "spark-dsg", "--index", 0, "--walls", walls)
        with open("a.json") as file:
            nodes = json.load(file)["nodes"]
        layers = {(node["layer"], node["partition"]) for node in nodes}
        assert len(layers) == 4
    assert len(read_graphs("a.json")[0].nodes.label) == len(registry.make("s-f", 1)[0].nodes.label)


def test_bad_input_to_export_is_refused(capsys):
    scene, scenes = write("a.json", SCENES[0]), write_lines("a.jsonl", SCENES)
    for arguments, sentence in (
        ((scenes, "-o", "b.json"), "b.json: holds one graph, expected the name of a .jsonl file"),
        ((scene, "-o", "b.npz"), "b.npz: the name ends in '.npz', expected .json or .jsonl"),
        ((scene, "-o", "b.json", "--index", 1), "a.json: --index must be in 0..0, got 1"),
        ((scene, "-o", "b.json", "--walls", "metadata"), "--walls metadata is for --to spark-dsg"),
    ):
        assert sentence in refusal(capsys, "export", *arguments)


def node(name, label):
    return {"id": name, "label": label, "position": [0, 0, 1]}


def test_a_data_set_is_made_and_described(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")  # off a terminal no cell is cut
    run("data", "make", "s-f", "-o", "a.npz", "--num-graphs", 3, "--seed", 4)
    assert capsys.readouterr().out == "a.npz: 3 graphs\n"
    made, expected = registry.load("a.npz").graphs, registry.make("s-f", 3, 4)
    assert [graph.nodes.position.tolist() for graph in made] == [
        graph.nodes.position.tolist() for graph in expected
    ]
    run("data", "describe", "a.npz", "-o", "statistics.json")
    shown = capsys.readouterr().out
    assert "[30]" in shown  # the paper's |V|
    assert "…" not in shown
    with open("statistics.json") as file:
        assert json.load(file)["a.npz"]["num_graphs"] == 3


def test_every_data_set_is_listed(capsys):
    run("data", "describe")
    out = capsys.readouterr().out
    assert [name for name in registry.DATASETS if name not in out] == []


def test_a_data_set_is_imported_checked_and_drawn(capsys):
    run("export", "s-f", "-o", "a.npz", "--to", "npz", "--index", 0)
    run("data", "import", "r-f", "a.npz", "-o", "b.npz")
    capsys.readouterr()
    run("data", "check", "b.npz")
    assert capsys.readouterr().out == "b.npz: 1 graph, all sound\n"
    run("data", "sheet", "b.npz", "-o", "sheet.png")
    assert os.path.getsize("sheet.png") > 0
    room_alone = {"nodes": [node(0, "room"), node(1, "floor")], "edges": [[0, 1]]}
    write_lines("c.jsonl", [room_alone])
    capsys.readouterr()
    run("data", "check", "c.jsonl")
    assert "empty room: 1 in 1 graph, first in graph 0" in capsys.readouterr().out


def test_bad_input_to_data_is_refused(capsys):
    for arguments, sentence in (
        (("make", "s-g", "-o", "a.npz"), "unknown data set 's-g'"),
        (("make", "s-f", "-o", "a.npz", "--num-graphs", 0), "--num-graphs must be at least 1"),
        (("make", "s-f", "-o", "a.npz", "--seed", -1), "--seed must be at least 0"),
        (("make", "s-f", "-o", "a.txt"), "the name ends in '.txt', expected .npz"),
        (("make", "s-f", "-o", "nowhere/a.npz"), "nowhere/a.npz: cannot be written"),
        (("make", "p-f", "-o", "a.npz"), "sg3d data import p-f FILE -o p-f.npz"),
        (("describe", "nothing"), "unknown data set 'nothing'"),
        (("describe", write("b.npz", "x")), "b.npz"),
        (("import", "s-g", "b.npz", "-o", "a.npz", "--like", "s-h"), "unknown data set 's-h'"),
        (("import", "m-f", "b.npz", "-o", "a.npz"), "b.npz: not an npz file"),
        (("import", "m-f", "b.npz", "-o", "a.txt"), "a.txt: the name ends in '.txt'"),
        (("import", "m-f", "c.zip", "-o", "a.npz"), "c.zip"),
        (("check", "nothing.jsonl"), "nothing.jsonl: No such file"),
        (("sheet", "s-f", "-o", "a.txt"), "a.txt: the name ends in '.txt'"),
        (("sheet", "s-f", "-o", "a.png", "--num-graphs", 0), "--num-graphs must be at least 1"),
    ):
        assert sentence in refusal(capsys, "data", *arguments)


def test_weights_are_evaluated(weights, capsys, monkeypatch):
    captions = []
    monkeypatch.setattr(
        "sg3d_jax.viz.figure.contact_sheet", lambda rows, path, said: captions.extend(said)
    )
    run(
        *("evaluate", weights, "--num-graphs", 2, "-o", "scores.json", "--sheet", "worst.png"),
        *("--split", "validation", "--seeds", 0, 1, "--row", "scores.csv"),
    )
    with open("scores.json") as file:
        content = json.load(file)
    about = [content[name] for name in ("method", "weights", "split", "graphs", "seeds")]
    assert about == ["fd4", weights, "validation", 2, [0, 1]]
    assert content["command"].startswith(f"sg3d evaluate {weights}")
    assert content["machine"]["cores"] == os.cpu_count()
    assert len(content["seconds"]) == 2
    fgw = [np.mean(one["fgw_per_graph"]) for one in content["runs"]]
    assert content["scores"]["fgw"]["mean"] == pytest.approx(np.mean(fgw))
    assert content["scores"]["fgw"]["sd"] == pytest.approx(np.std(fgw, ddof=1))
    assert {*SCORES} <= {*content["scores"]}
    assert 0 <= content["scores"]["halted"]["mean"] <= 1
    assert f"{content['scores']['fgw']['mean']:.4f}" in capsys.readouterr().out
    with open("scores.csv") as file:
        (row,) = csv.DictReader(file)
    assert float(row["gin"]) == content["scores"]["gin"]["mean"]
    assert row["seeds"] == "0 1"
    found = content["runs"][0]["fgw_per_graph"]
    worst = sorted(range(2), key=lambda index: -found[index])
    assert captions == [*map(str, worst), *(f"{i}: FGW {found[i]:.3f}" for i in worst)]


def test_rand_and_graphs_of_others_are_evaluated_and_put_in_a_table(capsys):
    write_graphs("floors.jsonl", small_floors())
    floors = "--data", "floors.jsonl"
    run("evaluate", "rand", *floors, "-o", "rand.json")
    run("evaluate", "rand-sized-s-f", *floors, "-o", "rand-sized.json")
    run("evaluate", "floors.jsonl", *floors, "--split", "all", "-o", "floors.json")
    names = [f"{name}.json" for name in ("floors", "rand-sized", "rand")]
    capsys.readouterr()
    run("table", *names)
    lines = capsys.readouterr().out.strip().split("\n")
    shown = [line.split(" | ")[0] for line in lines[2:]]
    assert shown == ["| Rand", "| Rand, sized", "| floors.jsonl"]
    assert "| floors.jsonl | 0.000 | 0.000 |" in lines[-1]
    run("table", *names, "--to", "latex", "-o", "table.tex")
    with open("table.tex") as file:
        assert file.readline() == "\\begin{tabular}{lrrrrrrr}\n"


def test_bad_input_to_evaluate_is_refused(weights, capsys):
    write_graphs("floors.jsonl", registry.make("s-f", 10))
    write_graphs("others.jsonl", registry.make("s-f", 10, seed=1))
    for arguments, sentence in (
        (("fd5",), "unknown weights 'fd5'"),
        ((weights, "--data", "s-g"), "unknown data set 's-g'"),
        ((weights, "--num-graphs", 0), "--num-graphs must be at least 1, got 0"),
        ((weights, "--seeds", -1), "--seeds must be at least 0, got -1"),
        ((weights, "-o", "scores.txt"), "the name ends in '.txt', expected .json"),
        ((weights, "--row", "scores.txt"), "the name ends in '.txt', expected .csv"),
        ((weights, "--sheet", "nowhere/a.png"), "nowhere/a.png: cannot be written"),
        ((weights, "--diffusion-steps", 0), "diffusion steps must be in 1..500, got 0"),
        (("rand",), "rand is not of one data set, expected --data with one"),
        (("rand", "--data", "s-f", "--diffusion-steps", 3), "rand has no diffusion steps, got 3"),
        (("rand", "--data", write("a.npz", "x")), "a.npz: not an npz file"),
        (("floors.jsonl", "--data", "floors.jsonl"), "holds 10 graphs, expected one for 2 scenes"),
        (
            ("others.jsonl", "--data", "floors.jsonl", "--split", "all"),
            "others.jsonl: graph 0 has other planes than its scene",
        ),
    ):
        assert sentence in refusal(capsys, "evaluate", *arguments)


def test_bad_input_to_table_is_refused(capsys):
    for arguments, sentence in (
        ((), "the number of results must be at least 1, got 0"),
        ((write("a.json", {"method": "x"}),), "a.json lacks 'data', expected `sg3d evaluate -o`"),
        ((write_lines("a.jsonl", [{}, {}]),), "a.jsonl: holds several results, expected one"),
        (
            (write("d.json", {"method": "x", "data": "y", "scores": {"fgw": 3}}),),
            "d.json: scores.'fgw' has the mean None, expected a finite number",
        ),
        ((write("b.json", "x"),), "b.json: not JSON"),
        (("nothing.json",), "nothing.json: No such file"),
        ((write("c.json", {}), "-o", "table.txt"), "table.txt: the name ends in '.txt'"),
    ):
        assert sentence in refusal(capsys, "table", *arguments)


@pytest.mark.parametrize("arguments", [[], ["--help"]])
def test_help_names_every_command(capsys, arguments):
    with pytest.raises(SystemExit) as caught:
        run(*arguments)
    assert caught.value.code == 0
    out = capsys.readouterr().out
    assert "usage: sg3d" in out
    commands = "complete", "view", "export", "train", "evaluate", "table", "sheet", "data"
    assert [name for name in commands if name not in out] == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["complete"], ["planes", "--picture", "--samples", "--seed", "--weights"]),
        (["view"], ["--index", "--plan", "--truth"]),
        (["compile"], ["--planes", "--samples"]),
        (["evaluate"], ["--num-graphs", "--split", "--seeds", "--sheet"]),
        (["table"], ["--to", "latex"]),
        (["sheet"], ["--num-graphs", "--first", "--seed"]),
        (["train"], ["configs/", "METHOD-DATASET", "NAME --help"]),
        (["train", CONFIGS / "test.py"], ["--steps", "--model.layers", "--output"]),
        (["export"], ["--to", "spark-dsg", "--walls"]),
        (["data"], ["make", "import", "describe", "check", "sheet"]),
        (["data", "make"], ["--num-graphs"]),
    ],
)
def test_every_command_explains_itself(capsys, monkeypatch, arguments, words):
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit) as caught:
        run(*arguments, "--help")
    assert caught.value.code == 0
    out = capsys.readouterr().out
    assert [word for word in words if word not in out] == []


@pytest.mark.parametrize("arguments", [["complet", "a.json"], ["data", "mak"], ["train"]])
def test_an_unknown_command_is_refused(capsys, arguments):
    with pytest.raises(SystemExit) as caught:
        run(*arguments)
    assert caught.value.code == 2
    assert "sg3d" in capsys.readouterr().err


def test_the_program_runs_as_a_process(tmp_path):
    program = [sys.executable, "-c", "from sg3d_jax.cli import main; main()"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = functools.partial(
        subprocess.run, env=environment, capture_output=True, text=True, cwd=tmp_path, timeout=100
    )
    version = process([*program, "--version"])
    assert (version.returncode, version.stdout, version.stderr) == (0, f"sg3d {__version__}\n", "")
    refused = process([*program, "complete", "a.json", "-o", "b.json"])
    assert refused.returncode == 2
    assert refused.stderr.startswith("sg3d: a.json: No such file")
    assert refused.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_command_line_answers_without_waiting_for_jax():
    program = "import sys, sg3d_jax.cli; print(*{name.split('.')[0] for name in sys.modules})"
    loaded = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True
    )
    assert {"jax", "flax", "orbax", "optax", "matplotlib"} & set(loaded.stdout.split()) == set()


@pytest.mark.parametrize("name", sg3d_jax.__all__)
def test_every_public_name_is_there(name):
    assert callable(getattr(sg3d_jax, name)) or name in ("NODE_CAPACITIES", "PAPER_ONTOLOGY")
    assert name in dir(sg3d_jax)


def test_another_name_is_not():
    with pytest.raises(AttributeError, match="module 'sg3d_jax' has no attribute 'compleat'"):
        _ = sg3d_jax.compleat
