"""`sg3d export | view`: what a file says beside its graphs goes along."""

import json

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.cli.files import _names_of
from sg3d_jax.data import registry
from sg3d_jax.io.attributes import Read, node_confidence_of
from sg3d_jax.io.formats import read_graphs, read_with_attributes, write_graphs
from sg3d_jax.io.json import graph_to_dict
from sg3d_jax.scene.graph import observed_of, parts_first
from tests.command_line import SCENES, as_csv, refusal, run, write
from tests.furnished_rooms import furnished_rooms
from tests.two_rooms import two_rooms

NODES = np.linspace(0, 1, 12)
EDGES = np.linspace(1, 0, len(parts_first(two_rooms())))
ATTRIBUTES = [
    {"id": f"n{row}" if row % 2 else row + 7, "confidence": NODES[row], "seen": [row, {"by": None}]}
    for row in range(12)
]


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_ids_further_keys_and_confidence_go_from_format_to_format():
    names = ["a.json", "b.json", "c.graphml", "d.json", "e.jsonl", "f.json", "g.json"]
    formats = ["json", "networkx", "graphml", "spark-dsg", "spark-dsg", "networkx", "json"]
    write_graphs("a.json", [two_rooms()], attributes=[ATTRIBUTES], edge_confidence=[EDGES])
    for source, name, to in zip(names, names[1:], formats[1:], strict=False):
        walls = ("--walls", "metadata") if name == "e.jsonl" else ()
        run("export", source, "-o", name, "--to", to, *walls)
        (read,) = read_with_attributes(name)
        assert json.dumps(read.attributes) == json.dumps(ATTRIBUTES), name
        npt.assert_array_equal(read.edge_confidence, EDGES, err_msg=name)
    with open("a.json") as first, open("g.json") as last:
        assert first.read() == last.read()


def test_columns_of_a_table_do_too():
    rows = as_csv(SCENES[0]).splitlines()
    wide = [f"{row},{cell}" for row, cell in zip(rows, ["id", *range(50, 99)], strict=False)]
    run("export", write("a.csv", "\n".join(wide)), "-o", "a.graphml", "--to", "graphml")
    (read,) = read_with_attributes("a.graphml")
    assert read.attributes == [{"id": 50 + row} for row in range(len(SCENES[0]["planes"]))]


def test_npz_keeps_the_graphs_alone():
    write_graphs("a.json", [two_rooms()], attributes=[ATTRIBUTES], edge_confidence=[EDGES])
    run("export", "a.json", "-o", "a.npz", "--to", "npz")
    (graph,) = read_graphs("a.npz")
    npt.assert_array_equal(graph.nodes.position, two_rooms().nodes.position)


def test_what_a_format_says_itself_is_refused(capsys):
    write_graphs("a.json", [two_rooms()], attributes=[[{"x": 3}, *[{}] * 11]])
    line = refusal(capsys, "export", "a.json", "-o", "a.graphml", "--to", "graphml")
    assert line.startswith("a.graphml: graph 0: nodes[0] has 'x', which the result says itself")


def test_a_view_is_faint_where_the_file_is_unsure(monkeypatch):
    write_graphs("a.jsonl", [two_rooms()] * 2, attributes=[ATTRIBUTES, [{}] * 12])
    write_graphs("b.json", [two_rooms()], "networkx", edge_confidence=[EDGES])
    drawn = []
    monkeypatch.setattr("sg3d_jax.viz.page.save_page", lambda *_, **said: drawn.append(said))
    monkeypatch.setattr("sg3d_jax.viz.figure.save_picture", lambda *_, **said: drawn.append(said))
    run("view", "a.jsonl", "-o", "a.html")
    run("view", "b.json", "-o", "b.png")
    (page, picture) = drawn
    npt.assert_array_equal(page["node_confidence"][0], node_confidence_of(ATTRIBUTES))
    assert page["node_confidence"][1] is None
    assert page["edge_confidence"] == [None, None]
    assert page["node_names"] == [
        [7, "n1", 9, "n3", 11, "n5", 13, "n7", 15, "n9", 17, "n11"],
        [*range(12)],
    ]
    assert page["truth"] is None
    assert picture["node_confidence"] is None
    npt.assert_array_equal(picture["edge_confidence"], EDGES)


def test_a_page_says_how_sure_it_is():
    write_graphs("a.json", [two_rooms()], attributes=[ATTRIBUTES], edge_confidence=[EDGES])
    run("view", "a.json", "-o", "a.html")
    with open("a.html") as file:
        assert "confidence 0.45" in file.read()


def test_a_plan_has_the_names_of_a_file_and_what_differs_from_a_truth(monkeypatch):
    named = [{**held, "name": "hall"} if row == 9 else held for row, held in enumerate(ATTRIBUTES)]
    write_graphs("a.json", [two_rooms()], attributes=[named])
    write_graphs("b.jsonl", [observed_of(two_rooms()), two_rooms()])
    write_graphs("c.jsonl", [two_rooms()] * 2, attributes=[[{}] * 12, named])
    drawn = []
    monkeypatch.setattr("sg3d_jax.viz.plan.save_plan", lambda *said: drawn.append(said))
    run("view", "a.json", "-o", "a.png", "--plan")
    run("view", "b.jsonl", "-o", "b.svg", "--plan", "--index", 1, "--truth", "b.jsonl")
    pages = []
    monkeypatch.setattr("sg3d_jax.viz.page.save_page", lambda *_, **said: pages.append(said))
    run("view", "a.json", "-o", "a.html", "--truth", "b.jsonl")
    assert [len(graph.nodes.label) for graph in pages[0]["truth"]] == [8]
    run("view", "b.jsonl", "-o", "b.html", "--index", 1, "--truth", "c.jsonl")
    assert pages[1]["truth_names"] == [drawn[0][2]]
    (named, alone) = drawn
    assert named[2][8:] == [15, "hall", 17, "n11"]
    npt.assert_array_equal(named[3], NODES)
    assert named[4] is None
    assert alone[2] == [*range(12)]
    assert alone[3] is None
    npt.assert_array_equal(alone[4].nodes.label, two_rooms().nodes.label)


def test_a_plan_is_a_picture_and_a_truth_is_for_a_plan(capsys):
    write_graphs("a.json", [two_rooms()])
    for arguments, sentence in (
        (("-o", "a.html", "--plan"), "a.html: the name ends in '.html', expected .png or"),
        (("-o", "a.html", "--plan", "--follow"), "--plan is for a picture of one graph"),
        (("-o", "a.png", "--truth", "a.json"), "--truth is for --plan"),
    ):
        assert refusal(capsys, "view", "a.json", *arguments).startswith(sentence)


# --- streams ---


def stream(name, graphs):
    """Writes a stream that begins with a map without anything in it."""
    lines = ['{"nodes": [], "edges": []}', *(json.dumps(graph_to_dict(graph)) for graph in graphs)]
    return write(name, "".join(line + "\n" for line in lines))


def test_a_stream_is_drawn_line_by_line_on_a_page_that_loads_itself_again(monkeypatch):
    drawn = []
    monkeypatch.setattr("sg3d_jax.viz.page.save_page", lambda *said: drawn.append(said))
    stream("a.jsonl", [two_rooms(), observed_of(two_rooms())])
    run("view", "a.jsonl", "-o", "a.html", "--follow")
    sizes = [len(graphs[0].nodes.label) for graphs, *_ in drawn]
    assert sizes == [12, 8, 8]
    assert [said[2] for said in drawn] == [f"a.jsonl: line {n}" for n in (2, 3, 3)]
    assert [said[6] for said in drawn] == [2.0, 2.0, 0]


def test_the_last_page_of_a_stream_stays():
    run("view", stream("a.jsonl", [two_rooms()]), "-o", "a.html", "--follow")
    with open("a.html") as file:
        assert '"reload":0.0' in file.read()


def test_what_is_no_stream_of_graphs_is_refused(capsys):
    stream("a.jsonl", [])
    write("b.jsonl", json.dumps({"update": 1, "added": []}))
    for arguments, sentence in (
        (("a.jsonl", "-o", "a.html"), "a.jsonl: there are no graphs, expected one a line"),
        (("a.jsonl", "-o", "a.png"), "a.png: the name ends in '.png', expected .html"),
        (("a.jsonl", "-o", "a.html", "--index", 1), "--index is for one graph of several, got 1"),
        (("b.jsonl", "-o", "a.html"), "b.jsonl: line 1: there is no list 'nodes', expected nodes"),
    ):
        assert refusal(capsys, "view", *arguments, "--follow").startswith(sentence)


def test_our_layers_are_added_to_a_file_of_hydra_s_and_what_is_left_out_is_said(capsys):
    key = {"layer": 3, "partition": 0}
    place = {"id": ord("p") << 56, **key, "attributes": {"type": "PlaceNodeAttributes"}}
    theirs = {
        "SPARK_DSG_header": {},
        "layer_keys": [key],
        "layer_names": {"PLACES": key},
        "nodes": [place],
        "edges": [],
    }
    write_graphs("a.json", [two_rooms()], attributes=[ATTRIBUTES])
    arguments = ("-o", "b.json", "--to", "spark-dsg", "--into", write("dsg.json", theirs))
    run("export", "a.json", *arguments)
    assert capsys.readouterr().out == "b.json: dsg.json with the layers of a.json\n"
    run("export", "b.json", "-o", "c.json")
    remark = "sg3d: remark: b.json: left out what is in no layer of ours: 1 of PLACES\n"
    assert capsys.readouterr().err == remark
    (read,) = read_with_attributes("c.json")
    assert json.dumps(read.attributes) == json.dumps(ATTRIBUTES)
    for odd, sentence in (
        (("--to", "json", "--into", "dsg.json"), "--into is for --to spark-dsg, got --to json"),
        (("--into", "dsg.json", "--to", "spark-dsg", "--walls", "metadata"), "--into has walls as"),
        (("--columns", "x=cx"), "a.json: columns are named, expected a .csv file"),
        (("--columns", "x"), "--columns has 'x', expected such as x=cx,y=cy"),
    ):
        assert sentence in refusal(capsys, "export", "a.json", "-o", "d.json", *odd)


def test_a_graph_is_sent_to_s_graphs_and_a_table_with_a_header_of_one_s_own_is_read():
    run("export", "s-f", "-o", "map.json", "--to", "s-graphs", "--index", 0)
    run("export", "map.json", "-o", "a.json")
    (back,), (graph,) = read_graphs("a.json"), registry.make("s-f", 1)
    npt.assert_array_equal(back.nodes.label, graph.nodes.label)
    npt.assert_array_equal(parts_first(back), parts_first(graph))
    rows = as_csv(SCENES[0]).replace("width", "length", 1).replace("cx", "x", 1)
    run("export", write("b.csv", rows), "-o", "b.json", "--columns", "length=width,x=cx")
    (read,) = read_graphs("b.json")
    npt.assert_array_equal(read.nodes.width, [plane["width"] for plane in SCENES[0]["planes"]])


def test_nodes_are_called_by_a_name_or_by_their_kind():
    held = [{}] * 4 + [{"id": "b4"}, {}, {"name": "pantry"}, {}, {}]
    called = _names_of(Read(furnished_rooms(), held))
    assert called == [0, 1, 2, 3, "bed b4", "bedroom 5", "pantry", "department 7", 8]
