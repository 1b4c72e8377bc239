"""Graphs in every format: nothing is lost, and what is no graph is refused."""

import json

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.io.formats import FORMATS, read_graphs, read_planes, write_graphs
from sg3d_jax.io.s_graphs import planes_to_message
from sg3d_jax.scene.graph import observed_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY
from sg3d_jax.scene.padding import bucket, pad

NUM_GRAPHS = 18  # benchmarks/round_trips.py takes 500
SUFFIX = {"graphml": ".graphml", "npz": ".npz"}  # of a file with one graph; .json for the others


@pytest.fixture(scope="module")
def graphs():
    """Floors without and cities with proximity edges."""
    cities = NUM_GRAPHS // 6
    return registry.make("s-f", NUM_GRAPHS - cities) + registry.make("s-c", cities)


EXACT = [to for to in FORMATS if to != "s-graphs"]  # messages have points, and only some concepts


def assert_same(graph, expected):
    for one, other in zip(graph.nodes, expected.nodes, strict=True):
        assert one.dtype == other.dtype
        npt.assert_array_equal(one, other, strict=True)
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(
            undirected_edges(graph, relation), undirected_edges(expected, relation)
        )


@pytest.mark.parametrize("suffix", [".npz", ".graphml", ".json", ".jsonl"])
def test_a_padded_graph_is_written_without_padding_as_the_suffix_says(graphs, suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    write_graphs(path, [pad(graphs[0], bucket(100))])
    (read,) = read_graphs(path)
    npt.assert_array_equal(read.nodes.position, graphs[0].nodes.position)


@pytest.mark.parametrize("to", ["json", "networkx", "spark-dsg"])
def test_graphs_survive_json_lines(graphs, to, tmp_path):
    write_graphs(tmp_path / "graphs.jsonl", graphs, to)
    read = read_graphs(tmp_path / "graphs.jsonl")
    assert len(read) == NUM_GRAPHS
    for graph, expected in zip(read, graphs, strict=True):
        assert_same(graph, expected)


def test_graphs_survive_spark_dsg_with_walls_as_metadata(graphs, tmp_path):
    write_graphs(tmp_path / "graphs.jsonl", graphs, "spark-dsg", walls="metadata")
    for graph, expected in zip(read_graphs(tmp_path / "graphs.jsonl"), graphs, strict=True):
        assert_same(graph, expected)


def test_graphs_survive_npz(graphs, tmp_path):
    write_graphs(tmp_path / "graphs.npz", graphs, "npz")
    for graph, expected in zip(read_graphs(tmp_path / "graphs.npz"), graphs, strict=True):
        assert_same(graph, expected)


def test_graphs_survive_graphml(graphs, tmp_path):
    for expected in graphs:
        write_graphs(tmp_path / "graph.graphml", [expected], "graphml")
        (graph,) = read_graphs(tmp_path / "graph.graphml")
        assert_same(graph, expected)


@pytest.mark.parametrize(
    ("to", "place"), [("json", None), ("networkx", "graph"), ("spark-dsg", "metadata")]
)
def test_one_graph_has_a_file_of_its_own_and_keeps_what_else_is_said(graphs, to, place, tmp_path):
    path = tmp_path / "graph.JSON"
    write_graphs(path, graphs[:1], to, [{"halt_reason": "HALTED"}])
    document = json.loads(path.read_text())
    assert (document[place] if place else document)["halt_reason"] == "HALTED"
    (graph,) = read_graphs(path)
    assert_same(graph, graphs[0])


@pytest.mark.parametrize("to", EXACT)
def test_planes_are_read_off_graphs_of_every_format(graphs, to, tmp_path):
    path = tmp_path / f"graph{SUFFIX.get(to, '.json')}"
    write_graphs(path, graphs[:1], to)
    (planes,) = read_planes(path)
    assert_same(planes, observed_of(graphs[0]))


def test_planes_as_a_robot_sends_them_are_read(graphs, tmp_path):
    path = tmp_path / "planes.json"
    path.write_text(json.dumps(planes_to_message(graphs[0])))
    (planes,) = read_planes(path)
    npt.assert_allclose(planes.nodes.position, observed_of(graphs[0]).nodes.position, atol=1e-9)


@pytest.mark.parametrize("to", FORMATS)
def test_a_broken_graph_is_not_written(graphs, to, tmp_path):
    broken = graphs[0]._replace(
        nodes=graphs[0].nodes._replace(position=graphs[0].nodes.position * np.nan)
    )
    with pytest.raises(ValueError, match=r"graph 0: nodes\[0\].position is \[nan"):
        write_graphs(tmp_path / f"graph{SUFFIX.get(to, '.json')}", [broken], to)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "to", "count", "sentence"),
    [
        ("a.json", "json", 2, "a.json: holds one graph, expected the name of a .jsonl file for 2"),
        ("a.graphml", "graphml", 2, "a.graphml: holds one graph, expected one of them"),
        ("a.json", "json", 0, "for 0 graphs"),
        ("a.npz", "json", 1, "the name ends in '.npz', expected .json or .jsonl for json"),
        ("a.json", "npz", 1, "the name ends in '.json', expected .npz for npz"),
        ("a.json", "yaml", 1, "the format is 'yaml', expected one of json, networkx"),
    ],
)
def test_a_file_that_cannot_hold_them_is_refused(graphs, name, to, count, sentence, tmp_path):
    with pytest.raises(ValueError, match=sentence):
        write_graphs(tmp_path / name, graphs[:count], to)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.xyz", b"", "the name ends in '.xyz', expected one of .json"),
        ("a", b"", "the name ends in ''"),
        ("a.json", b"{}", "no key that tells what it is, expected nodes and edges, or planes"),
        ("a.json", b"[1]", "no key that tells what it is"),
        ("a.json", b"{", "not JSON at line 1"),
        ("a.jsonl", b'{"planes": []}\n{"nodes": 3}', "a.jsonl: line 1: planes holds no planes"),
        ("a.npz", b"PK", "not an npz file"),
    ],
)
def test_a_file_of_nothing_known_is_refused(name, content, sentence, tmp_path):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=sentence) as caught:
        read_graphs(path)
    assert str(caught.value).startswith(str(path))
