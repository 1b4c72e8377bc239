"""Data sets by name, from a user's file, and by path."""

import json
from pathlib import Path

import numpy as np
import pytest

from sg3d_jax import cli
from sg3d_jax.data import registry
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.data.splits import split_of
from sg3d_jax.io import npz
from sg3d_jax.io.formats import read_with_attributes, write_graphs
from sg3d_jax.scene.graph import ontology_of
from sg3d_jax.scene.ontology import FLOOR, PLANE, ROOM
from sg3d_jax.scene.validate import validate_graph
from tests.own_world import ONTOLOGY, own_world

GENERATED = [name for name, spec in registry.DATASETS.items() if spec.config is not None]
FROM_FILES = [name for name, spec in registry.DATASETS.items() if spec.config is None]
PAPER = ("s-f-square", "s-f", "s-c", "m-f", "m-b", "m-c", "r-f", "r-b", "r-c")


def test_the_nine_data_sets_of_the_paper_are_there():
    assert {name for name, spec in registry.DATASETS.items() if spec.paper is not None} == {*PAPER}


@pytest.mark.parametrize("name", GENERATED)
def test_every_generated_data_set_is_sound_and_has_its_levels(name):
    for graph in registry.make(name, num_graphs=3):
        validate_graph(graph, name)
        assert ontology_of(graph) == registry.get(name).ontology
        held = {ontology_of(graph).names[label] for label in graph.nodes.label}
        assert held <= {*registry.get(name).levels}
        assert registry.get(name).levels[-1] in held


@pytest.mark.parametrize("name", PAPER[:3])
def test_a_generated_data_set_is_as_large_as_in_the_paper(name):
    spec = registry.get(name)
    assert spec.num_graphs == spec.paper.samples


def test_a_graph_depends_on_its_index_and_seed_but_not_on_how_many_are_made():
    two, three, other = (
        registry.make("s-f", num_graphs, seed) for num_graphs, seed in ((2, 0), (3, 0), (2, 1))
    )
    np.testing.assert_array_equal(two[1].nodes.position, three[1].nodes.position)
    assert not np.array_equal(two[1].nodes.position, other[1].nodes.position)


@pytest.mark.parametrize("name", ["S-F", "s_f", "s-f-sqare", "nothing"])
def test_an_unknown_name_is_refused_with_the_names_there_are(name):
    with pytest.raises(ValueError, match="expected one of s-f-square, s-f"):
        registry.load(name)


def test_a_misspelt_name_is_refused_with_the_closest_one():
    with pytest.raises(ValueError, match="did you mean 's-f-square'"):
        registry.make("S-F-sqare")


@pytest.mark.parametrize("name", FROM_FILES)
def test_a_set_that_is_made_from_a_file_says_how(name):
    with pytest.raises(ValueError, match=f"sg3d data import {name} FILE -o {name}.npz"):
        registry.load(name)
    with pytest.raises(ValueError, match=f"{name} is made from a file"):
        registry.header(name)


def test_a_path_is_read_from_its_file(tmp_path):
    graphs = registry.make("s-f", num_graphs=2, seed=7)
    npz.save(tmp_path / "scenes.npz", graphs, registry.header("s-f", seed=7))
    write_graphs(tmp_path / "scenes.jsonl", graphs)
    for name in ("scenes.npz", "scenes.jsonl"):
        loaded = registry.load(tmp_path / name).graphs
        np.testing.assert_array_equal(loaded[1].nodes.position, graphs[1].nodes.position)


def test_a_missing_file_is_refused_by_its_name(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.npz: no such file"):
        registry.load(tmp_path / "nowhere.npz")


def test_the_header_says_how_the_set_was_made():
    header = json.loads(json.dumps(registry.header("s-f", seed=3)))
    assert header["name"] == "s-f"
    assert header["seed"] == 3
    assert header["generator"]["merge_ratio"] == registry.get("s-f").config.merge_ratio


def test_a_set_for_test_only_is_split_so(tmp_path):
    write_graphs(tmp_path / "recorded.jsonl", registry.make("s-f", 4))
    graphs, header = registry.import_file("r-f", tmp_path / "recorded.jsonl")
    assert [len(part) for part in split_of(header, len(graphs))] == [0, 0, 4]
    assert (header["name"], header["file"]) == ("r-f", "recorded.jsonl")


def test_the_first_graphs_of_a_file_keep_their_parts(tmp_path):
    parts = ["test", "train", "validation"]
    npz.save(tmp_path / "a.npz", registry.make("s-f", 3), {"parts": parts, "origins": [*"abc"]})
    graphs, header = registry.load(tmp_path / "a.npz", num_graphs=2)
    assert len(graphs) == 2
    assert (header["parts"], header["origins"]) == (parts[:2], ["a", "b"])


@pytest.mark.parametrize("name", ["s-c", "m-b", "r-c"])
def test_a_file_of_another_level_is_refused(name, tmp_path):
    write_graphs(tmp_path / "floors.jsonl", registry.make("s-f", 2))
    with pytest.raises(ValueError, match="graph 0 reaches up to a floor, expected a"):
        registry.import_file(name, tmp_path / "floors.jsonl")


def broken_floor():
    graph = registry.make("s-f", 1)[0]
    label = graph.nodes.label.copy()
    label[label == 1] = 2  # walls become rooms: planes with several rooms are sound, so are these
    label[-1] = 1  # the floor becomes a wall over rooms
    return graph._replace(nodes=graph.nodes._replace(label=label))


def test_graphs_that_break_the_hierarchy_are_no_data_set(tmp_path):
    write_graphs(tmp_path / "broken.jsonl", [broken_floor()])
    with pytest.raises(ValueError, match=r"graph 0: edge .* joins wall and room as part_of"):
        registry.load(tmp_path / "broken.jsonl")


def test_an_import_is_refused_with_the_file_and_what_was_left_out(tmp_path):
    path = tmp_path / "plans.jsonl"
    room = {"poly": [[0, 0], [4, 0], [4, 3], [0, 3]]}
    plans = [{"building": f"b{i}", "storey": 0, "rooms": [room]} for i in range(6)]
    path.write_text("\n".join(map(json.dumps, plans)))
    with pytest.raises(ValueError, match="there are no floors, expected at least one") as caught:
        registry.import_file("p-f", path)
    assert str(caught.value).startswith(f"{path}: there are no floors")
    assert str(caught.value).endswith(
        "; 6 are left out, first b0 storey 0: there are 1 rooms, expected at least 2"
    )
    write_graphs(tmp_path / "broken.jsonl", [broken_floor()])
    for name in ("mine", "s-f"):
        with pytest.raises(ValueError, match=r"broken\.jsonl: graph 0: edge .* as part_of"):
            registry.import_file(name, tmp_path / "broken.jsonl")


def test_graphs_in_millimetres_are_no_data_set(tmp_path):
    graph = registry.make("s-f", 1)[0]
    position, width = 1000 * graph.nodes.position, 1000 * graph.nodes.width
    nodes = graph.nodes._replace(position=position, width=width)
    write_graphs(tmp_path / "a.json", [graph._replace(nodes=nodes)])
    with pytest.raises(ValueError, match=r"a\.json: graph 0: planes spans .* like millimetres"):
        registry.import_file("mine", tmp_path / "a.json")


@pytest.mark.parametrize("count", [-1, 10**12])
@pytest.mark.parametrize("name", ["s-f", "s-f@robot"])
def test_fewer_graphs_than_none_and_more_than_memory_holds_are_refused_at_once(name, count):
    with pytest.raises(ValueError, match=f"{count} graphs are asked for, expected 0 to 200000"):
        registry.make(name, count)


# --- what a robot sees of a set ---


@pytest.mark.parametrize("name", ["s-f@robot", "s-c@mild", "s-f-square@merged"])
def test_a_view_of_a_set_is_a_set_of_its_own(name):
    base = name.split("@")[0]
    graphs, header = registry.load(name, 3, seed=2)
    for one, other in zip(graphs, registry.make(name, 3, seed=2), strict=True):
        np.testing.assert_array_equal(one.nodes.position, other.nodes.position)
    for graph in graphs:
        validate_graph(graph, name)
    assert registry.is_name(name)
    assert header == registry.header(name, seed=2)
    assert json.loads(json.dumps(header))["view"]
    assert (header["name"], header["seed"]) == (name, 2)
    spec, of_base = registry.get(name), registry.get(base)
    assert spec.title == f"{of_base.title}@{name.split('@')[1]}"
    assert (spec.top, spec.num_graphs, spec.paper) == (of_base.top, of_base.num_graphs, None)


def test_graph_i_of_a_view_is_of_graph_i_with_true_widths():
    bases, seen = registry.make("s-f", 30), registry.make("s-f@clean", 30)
    stale = 0
    for base, graph in zip(bases, seen, strict=True):
        np.testing.assert_array_equal(graph.nodes.position, base.nodes.position)
        stale += (graph.nodes.width != base.nodes.width).sum()
    assert stale > 10


def test_a_view_of_a_file_keeps_its_parts_and_origins(tmp_path):
    parts = ["test", "train", "validation"]
    graphs = registry.make("s-f", 3)
    npz.save(tmp_path / "p-f.npz", graphs, {"name": "p-f", "parts": parts, "origins": [*"abc"]})
    name = f"{tmp_path / 'p-f.npz'}@strong"
    seen, header = registry.load(name, num_graphs=2)
    assert (header["parts"], header["origins"]) == (parts[:2], ["a", "b"])
    assert header["name"] == "p-f@strong"
    assert registry.is_name(name)
    for graph, base in zip(seen, graphs, strict=False):
        assert not np.array_equal(graph.nodes.width, base.nodes.width)
    npz.save(tmp_path / "seen.npz", seen, header)
    assert registry.load(tmp_path / "seen.npz").header["view"]["missing"] == 0.1


def test_a_view_that_is_not_there_is_refused_with_those_there_are():
    with pytest.raises(ValueError, match=r"s-f has no view 'robt', expected one of robot, mild"):
        registry.load("s-f@robt")
    with pytest.raises(ValueError, match=r"unknown data set 's-g', expected one of"):
        registry.load("s-g@robot")
    with pytest.raises(ValueError, match=r"sg3d data import p-f FILE -o p-f\.npz"):
        registry.load("p-f@robot")
    with pytest.raises(ValueError, match=r"nowhere\.npz: no such file"):
        registry.load("nowhere.npz@robot")


def test_a_file_whose_name_has_an_at_is_a_file(tmp_path):
    graphs = registry.make("s-f", 2)
    for name in ("me@home.npz", "me@robot"):
        npz.save(tmp_path / "a.npz", graphs, {})
        (tmp_path / "a.npz").rename(tmp_path / name)
        assert not registry.is_name(str(tmp_path / name))
    np.testing.assert_array_equal(
        registry.load(tmp_path / "me@home.npz").graphs[1].nodes.width, graphs[1].nodes.width
    )


def test_the_command_line_makes_and_draws_what_a_robot_sees(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cli.main(["data", "make", "s-f", "-o", "a.npz", "--num-graphs", "3"])
    for name, output in (("s-f@robot", "b.npz"), ("a.npz@merged", "c.npz")):
        cli.main(["data", "make", name, "-o", output, "--num-graphs", "2"])
        cli.main(["data", "sheet", name, "-o", "sheet.png", "--num-graphs", "2"])
        assert f"sheet.png: 2 graphs of {name}" in capsys.readouterr().out
        made, expected = registry.load(output).graphs, registry.make(name, 2)
        for one, other in zip(made, expected, strict=True):
            np.testing.assert_array_equal(one.nodes.position, other.nodes.position)
    with pytest.raises(SystemExit):
        cli.main(["data", "make", "a.npz", "-o", "d.npz"])
    assert "a.npz is a file, expected the name of a data set" in capsys.readouterr().err


# --- data sets of the user's own ---


@pytest.mark.parametrize("name", ["flats", "s-g", "S-F", "my set.v2"])
def test_graphs_of_any_format_may_be_filed_under_any_name(name, tmp_path):
    graphs = registry.make("s-f", 2) + registry.make("s-c", 1)  # of several levels
    write_graphs(tmp_path / "mine.jsonl", graphs)
    made, header = registry.import_file(name, tmp_path / "mine.jsonl")
    assert header == {"name": name, "source": "The user's own file.", "file": "mine.jsonl"}
    for one, other in zip(made, graphs, strict=True):
        np.testing.assert_array_equal(one.nodes.position, other.nodes.position)
    npz.save(tmp_path / "mine.npz", made, header)
    assert len(registry.load(tmp_path / "mine.npz").graphs) == 3


def test_a_set_of_the_user_s_own_may_have_an_ontology_of_its_own(tmp_path):
    write_graphs(tmp_path / "flats.json", [own_world()])
    dataset = registry.import_file("flats", tmp_path / "flats.json")
    npz.save(tmp_path / "flats.npz", *dataset)
    (graph,) = registry.load(tmp_path / "flats.npz").graphs
    assert ontology_of(graph) == ONTOLOGY
    with pytest.raises(ValueError, match="graph 0 has another ontology, expected the paper's"):
        registry.import_file("flats", tmp_path / "flats.json", like="r-f")
    with pytest.raises(ValueError, match="graph 0 has another ontology, expected the paper's"):
        registry.import_file("s-f", tmp_path / "flats.json")


def test_a_file_is_read_as_those_of_the_set_that_it_is_like(tmp_path):
    rooms = [[[x, 0], [x + 3, 0], [x + 3, 4], [x, 4]] for x in (0.0, 3.1, 6.2)]
    lines = [
        json.dumps({"building": f"b{i}", "storey": 0, "rooms": [{"poly": room} for room in rooms]})
        for i in range(6)
    ]
    (tmp_path / "plans.jsonl").write_text("\n".join(lines))
    graphs, header = registry.import_file(
        "offices", tmp_path / "plans.jsonl", 3, like="p-f", turn=True
    )
    expected, theirs = registry.import_file("p-f", tmp_path / "plans.jsonl", 3)
    for one, other in zip(graphs, expected, strict=True):
        np.testing.assert_array_equal(one.nodes.position, other.nodes.position)
    assert (header["name"], header["like"]) == ("offices", "p-f")
    for key in ("parts", "origins", "left_out", "seed", "file"):
        assert header[key] == theirs[key]
    with pytest.raises(ValueError, match="no key that tells what it is"):
        registry.import_file("offices", tmp_path / "plans.jsonl")


@pytest.mark.parametrize("name", ["p-f-kinds", "flats"])
def test_labels_of_real_rooms_are_kinds_and_views_of_the_set_keep_them(name, tmp_path):
    rooms = [[[x, 0], [x + 3, 0], [x + 3, 4], [x, 4]] for x in (0.0, 3.1, 6.2)]
    labels = "bedroom", "kitchen+entrance", "PS"
    drawn = [{"poly": one, "label": label} for one, label in zip(rooms, labels, strict=True)]
    (tmp_path / "plans.jsonl").write_text(
        json.dumps({"building": "b", "storey": 0, "rooms": drawn})
    )
    like = None if name == "p-f-kinds" else "p-f-kinds"
    graphs, header = registry.import_file(name, tmp_path / "plans.jsonl", like=like)
    npz.save(tmp_path / "kinds.npz", graphs, header)
    for seen_as in ("", "@clean"):
        (graph,) = registry.load(f"{tmp_path / 'kinds.npz'}{seen_as}").graphs
        validate_graph(graph, name)
        concepts = FURNISHED_ONTOLOGY.concepts
        kinds = [
            concepts[label].kinds[int(kind) - 1]
            for label, kind in zip(graph.nodes.label, graph.nodes.kind, strict=True)
            if kind
        ]
        assert kinds == ["bedroom", "kitchen", "storage", "flat"]


def test_one_s_own_floor_is_imported_as_it_stands_and_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rooms = [[[x, 0], [x + 3000, 0], [x + 3000, 4000], [x, 4000]] for x in (0, 3100, 6200)]
    drawn = [{"poly": room, "name": f"room {i}"} for i, room in enumerate(rooms)]
    drawn.append({"poly": []})
    Path("plan.jsonl").write_text(json.dumps({"building": "home", "storey": 1, "rooms": drawn}))
    cli.main(["data", "import", "home", "plan.jsonl", "-o", "home.npz", "--like", "p-f"])
    said = capsys.readouterr().out
    for sentence in ("taken to be in mm", "all for test", "left out home storey 1: rooms[3].poly"):
        assert sentence in said
    cli.main(["export", "home.npz", "-o", "home.json"])
    (read,) = read_with_attributes("home.json")
    names = [held.get("name") for held in read.attributes]
    label = read.graph.nodes.label
    assert [name for name in names if name] == [*(f"room {i}" for i in range(3)), "home storey 1"]
    assert [int(label[row]) for row, name in enumerate(names) if name] == [ROOM] * 3 + [FLOOR]
    assert set(np.abs(read.graph.nodes.normal[label == PLANE]).ravel().tolist()) == {0, 1}
    for arguments in (("p-f", "plan.jsonl", 0, None, "mm"), ("home", "plan.jsonl", 0, None, "mm")):
        with pytest.raises(ValueError, match="units is for floor plans of one's own"):
            registry.import_file(*arguments)


def test_a_set_like_one_for_test_only_is_for_test_only_and_its_top_is_checked(tmp_path):
    write_graphs(tmp_path / "recorded.jsonl", registry.make("s-f", 4))
    _, header = registry.import_file("lab", tmp_path / "recorded.jsonl", like="r-f")
    assert header["parts"] == ["test"] * 4
    with pytest.raises(
        ValueError, match="graph 0 reaches up to a floor, expected a building as in"
    ):
        registry.import_file("lab", tmp_path / "recorded.jsonl", like="r-b")


def test_what_a_set_is_like_has_to_be_known_and_a_known_set_is_like_itself(tmp_path):
    write_graphs(tmp_path / "a.jsonl", registry.make("s-f", 1))
    with pytest.raises(ValueError, match=r"unknown data set 'p-g', expected one of .*p-f"):
        registry.import_file("offices", tmp_path / "a.jsonl", like="p-g")
    with pytest.raises(ValueError, match="r-f is read as its own files are, expected another name"):
        registry.import_file("r-f", tmp_path / "a.jsonl", like="p-f")


def test_the_command_line_imports_describes_checks_and_draws_a_set_of_any_name(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    write_graphs("flats.jsonl", [own_world(), own_world()])
    for arguments, sentence in (
        (("import", "flats", "flats.jsonl", "-o", "flats.npz"), "flats.npz: 2 graphs"),
        (("describe", "flats.npz"), "pillar"),
        (("check", "flats.npz"), "flats.npz: 2 graphs, all sound"),
        (("sheet", "flats.npz", "-o", "sheet.png"), "sheet.png: 2 graphs of flats.npz"),
    ):
        cli.main(["data", *arguments])
        assert sentence in capsys.readouterr().out
    assert (tmp_path / "sheet.png").stat().st_size > 0
    with pytest.raises(SystemExit):
        cli.main(["data", "import", "flats", "flats.jsonl", "-o", "b.npz", "--like", "p-g"])
    assert "unknown data set 'p-g'" in capsys.readouterr().err
    assert not (tmp_path / "b.npz").exists()
