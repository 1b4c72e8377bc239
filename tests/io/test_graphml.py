import networkx
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.io.graphml import read_graphml, write_graphml
from sg3d_jax.io.networkx import to_networkx
from sg3d_jax.scene.graph import make_graph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PLANE, PROXIMITY, ROOM


def one_room():
    return make_graph(
        [PLANE, ROOM, PLANE, FLOOR],
        np.arange(12).reshape(4, 3) / 7 - 1e-17,
        [[0.6, -0.8, -0.0], [0, 0, 0], [-0.28, 0.96, 0], [0, 0, 0]],
        [1 / 3, 0, 2e-5, 0],
        part_of=[[1, 0], [2, 1], [3, 1]],
        proximity=[[0, 2]],
    )


def assert_same_graph(left, right):
    for one, other in zip(left.nodes, right.nodes, strict=True):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(undirected_edges(left, relation), undirected_edges(right, relation))


def test_graphs_survive_their_file_bit_for_bit(tmp_path):
    graphs = [one_room(), *registry.make("s-f", 20), *registry.make("s-c", 2)]
    for graph in graphs:
        write_graphml(tmp_path / "a.graphml", graph)
        assert_same_graph(read_graphml(tmp_path / "a.graphml").graph, graph)
    assert len(list(tmp_path.iterdir())) == 1


def test_others_see_scalars(tmp_path):
    write_graphml(tmp_path / "a.graphml", one_room())
    graph = networkx.read_graphml(tmp_path / "a.graphml", node_type=int)
    assert graph.nodes[0]["normal_y"] == -0.8
    assert set(graph.nodes[1]) == {"concept", "x", "y", "z"}
    assert graph.edges[0, 2] == {"kind": "proximity"}
    assert set(to_networkx(one_room()).edges) == set(graph.edges)


HELD = [
    {"id": 7, "seen": 3, "sure": 0.5, "open": True, "note": "north"},
    {"id": "7", "seen": [1, {"a": None}], "note": "two\nlines", "none": None},
    {"id": "west"},
    {"open": False, "note": "[no list"},
]


def test_others_see_attributes_as_scalars_and_ids_as_ids(tmp_path):
    write_graphml(tmp_path / "a.graphml", one_room(), HELD, np.array([0.25, 1, 0.5]))
    graph = networkx.read_graphml(tmp_path / "a.graphml")
    assert list(graph) == ["7", '"7"', "west", "8"]
    own = {"concept", "x", "y", "z", "width", "normal_x", "normal_y", "normal_z"}
    said = [{k: v for k, v in held.items() if k not in own} for held in graph.nodes.values()]
    assert said == [
        {"seen": 3, "sure": 0.5, "open": True, "note": "north"},
        {"seen": '[1, {"a": null}]', "note": '"two\\nlines"', "none": "null"},
        {},
        {"open": False, "note": '"[no list"'},
    ]
    assert graph.edges["7", '"7"'] == {"kind": "part_of", "confidence": 0.25}
    read = read_graphml(tmp_path / "a.graphml")
    assert read.attributes == [*HELD[:3], {"id": 8, **HELD[3]}]
    assert read.edge_confidence.tolist() == [0.25, 1, 0.5]


def test_what_others_wrote_is_carried_as_they_wrote_it(tmp_path):
    write_graphml(tmp_path / "a.graphml", one_room())
    graph = networkx.read_graphml(tmp_path / "a.graphml", node_type=int)
    graph.nodes[0].update(label="a", modularity=float("nan"), note="{curly", size=3.0, r=1)
    graph.nodes[0]["deep"] = "[" * 10_000
    networkx.write_graphml(
        networkx.relabel_nodes(graph, {0: "n0", 1: "01"}), tmp_path / "a.graphml"
    )
    read = read_graphml(tmp_path / "a.graphml")
    assert_same_graph(read.graph, one_room())
    foreign = {"modularity": "nan", "note": "{curly", "size": 3.0, "r": 1, "deep": "[" * 10_000}
    assert read.attributes == [{"id": "n0", **foreign}, {"id": "01"}, {"id": 2}, {"id": 3}]
    assert read.edge_confidence is None


def test_a_broken_graph_is_not_written(tmp_path):
    graph = one_room()
    graph.nodes.position[1, 0] = np.nan
    with pytest.raises(ValueError, match=r"a.graphml: nodes\[1\].position is \[nan"):
        write_graphml(tmp_path / "a.graphml", graph)
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("graphml") / "a.graphml"
    write_graphml(path, one_room())
    return path.read_bytes()


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (b"</graphml>", b"", "not GraphML that can be read"),
        (b"<graphml", b"\x00<graphml", "not GraphML that can be read"),
        (b"<node id", b"<knot id", "not GraphML that can be read"),
        (b'target="2"', b'target="17"', "node '17' lacks both 'concept' and 'type', exp"),
        (b'target="1"', b'target="0"', r"edge \[0, 0\] is a loop, expected"),
        (b">plane<", b">attic<", "node '0': concept is 'attic', expected one of"),
        (b">part_of<", b">door<", "kind is 'door', expected"),
        (b">-0.8<", b">nan<", "node '0' lacks 'normal_y', expected normal_x"),
        (b'<data key="d1">', b'<data key="d17">', "not GraphML that can be read"),
        (b'attr.name="normal_y"', b'attr.name="n"', "node '0' lacks 'normal_y', expected"),
        (b'attr.name="width"', b'attr.name="breadth"', "node '0' lacks 'width', expected"),
        (b'<node id="1"', b'<node id="0"', "node '0' twice, expected once"),
        (b'<node id="0"', b"<node", "a node has no id, expected one"),
        (
            b"<graph ",
            b'<key id="d9" attr.name="a" attr.type="int"/>' * 2 + b"<graph ",
            "key 'd9' twice, exp",
        ),
        (b'<data key="d2">', b'<data key="d1">', "node '0' has 'width' twice, expected once"),
        (b">-0.8<", b">-0_0.8<", "node '0' has '-0_0.8', expected a number"),
        (b">-0.8<", ">\u0663<".encode(), "node '0' has '\u0663', expected a number"),
        (b"</graph>", b"</graph><graph/>", "holds 2 graphs, expected one"),
    ],
)
def test_a_broken_file_is_refused_in_one_sentence(written, old, new, sentence, tmp_path):
    assert old in written
    (tmp_path / "b.graphml").write_bytes(written.replace(old, new, 1))
    with pytest.raises(ValueError, match=rf"b\.graphml: .*({sentence})") as caught:
        read_graphml(tmp_path / "b.graphml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{}", b"<html></html>", b"\xff\xfe", None])
def test_another_file_is_refused_in_one_sentence(content, tmp_path):
    if content is not None:
        (tmp_path / "b.graphml").write_bytes(content)
    with pytest.raises(ValueError, match=r"b\.graphml: .*expected|b\.graphml: not GraphML"):
        read_graphml(tmp_path / "b.graphml")
