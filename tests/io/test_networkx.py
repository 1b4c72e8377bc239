import json

import networkx
import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.data import registry
from sg3d_jax.io.networkx import (
    from_networkx,
    graph_from_node_link,
    graph_to_node_link,
    read_networkx,
    read_node_link,
    to_networkx,
)
from sg3d_jax.scene.graph import make_graph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PLANE, PROXIMITY, ROOM, WALL
from sg3d_jax.scene.validate import validate_graph


@pytest.fixture(scope="module")
def graphs():
    """Floors without and cities with proximity edges."""
    return registry.make("s-f", 40) + registry.make("s-c", 3)


def one_room():
    """Rows in no order of concepts, numbers that are not round."""
    normal = np.array([[0.6, -0.8, -0.0], [0, 0, 0], [-0.28, 0.96, 0], [0, 0, 0], [0, 0, 0]])
    return make_graph(
        [PLANE, ROOM, PLANE, FLOOR, WALL],
        np.arange(15).reshape(5, 3) / 7 + 1e-17,
        normal,
        [1 / 3, 0, 2e-5, 0, 0],
        part_of=[[1, 0], [2, 1], [3, 1], [0, 4], [2, 4]],
        proximity=[[0, 2]],
    )


def authors_graph():
    """The same graph with the authors' attributes, where they differ from ours the most."""
    ends = np.array([[0, 0, 0], [0, 1 / 3, 0]])
    graph = networkx.Graph()
    position = one_room().nodes.position
    graph.add_node(7, type="ws", center=position[0], normal=np.array([0.6, -0.8, -0.0]))
    graph.nodes[7].update(length=np.float64(1 / 3), limits=(tuple(ends[0]), ends[1]), y=3)
    graph.add_node(np.int64(2), type="room", center=position[1].tolist(), normal=[0, 0, 1])
    graph.add_node(9, type="ws", center=list(position[2]), normal=(-0.28, 0.96, 0.0), width=9)
    graph.nodes[9].update(length=2e-5)
    graph.add_node("f", type="floor", center=tuple(position[3]), width=4.0)
    graph.add_node(11, type="wall", center=position[4], normal=np.array([0, 0, 1]))
    graph.add_edges_from([(7, 2), (9, 2), ("f", 2), (7, 11), (9, 11), (7, 9)], type="common")
    return graph


def assert_same_graph(left, right):
    for one, other in zip(left.nodes, right.nodes, strict=True):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(undirected_edges(left, relation), undirected_edges(right, relation))


def test_nodes_and_edges_have_the_documented_attributes():
    graph = to_networkx(one_room())
    assert type(graph) is networkx.Graph
    assert list(graph) == [0, 1, 2, 3, 4]
    assert graph.nodes[0] == {
        "concept": "plane",
        "pos": one_room().nodes.position[0].tolist(),
        "normal": [0.6, -0.8, -0.0],
        "width": 1 / 3,
    }
    assert set(graph.nodes[1]) == {"concept", "pos"}
    assert graph.edges[0, 2] == {"kind": "proximity"}
    assert graph.edges[0, 4] == {"kind": "part_of"}


def test_graphs_survive_networkx_bit_for_bit(graphs):
    for graph in [one_room(), *graphs]:
        assert_same_graph(from_networkx(to_networkx(graph)), graph)


def test_graphs_survive_a_node_link_document_bit_for_bit(graphs):
    for graph in [one_room(), *graphs]:
        document = json.loads(json.dumps(graph_to_node_link(graph)))
        assert_same_graph(graph_from_node_link(document), graph)


def test_networkx_reads_our_document_and_we_read_its(graphs):
    for graph in [one_room(), *graphs[-2:]]:
        read = networkx.node_link_graph(graph_to_node_link(graph), edges="edges")
        assert networkx.utils.graphs_equal(read, to_networkx(graph))
        for key in ("edges", "links"):
            written = json.dumps(networkx.node_link_data(to_networkx(graph), edges=key))
            assert_same_graph(graph_from_node_link(json.loads(written)), graph)


def test_the_authors_attributes_are_read_bit_for_bit():
    assert_same_graph(from_networkx(authors_graph()), one_room())


HELD = [{"id": 40, "seen": [1, None]}, {"id": "west"}, {"id": 0, "type": "ws"}, {}, {"id": 9}]


def test_attributes_are_those_of_networkx_and_ids_its_nodes():
    graph = to_networkx(one_room(), HELD, np.array([0.5, 0, 1, 0.75, 0.125]))
    assert list(graph) == [40, "west", 0, 41, 9]
    assert graph.nodes[40]["seen"] == [1, None]
    assert "id" not in graph.nodes[40]
    assert graph.edges["west", 41] == {"kind": "part_of", "confidence": 0.75}
    assert graph.edges[40, 0] == {"kind": "proximity"}
    read = read_networkx(graph)
    assert_same_graph(read.graph, one_room())
    assert read.attributes == [*HELD[:3], {"id": 41}, HELD[4]]
    assert read.edge_confidence.tolist() == [0.5, 0, 1, 0.75, 0.125]


def test_networkx_carries_attributes_through_its_documents():
    document = json.loads(json.dumps(graph_to_node_link(one_room(), HELD, np.full(5, 0.5))))
    graph = networkx.node_link_graph(document, edges="edges")
    assert networkx.utils.graphs_equal(graph, to_networkx(one_room(), HELD, np.full(5, 0.5)))
    read = read_node_link(networkx.node_link_data(graph, edges="edges"))
    assert_same_graph(read.graph, one_room())
    assert read.attributes[:3] == HELD[:3]
    assert read.edge_confidence.tolist() == [0.5] * 5


def test_what_others_say_of_nodes_is_read_as_json_and_our_own_names_are_left_out():
    graph = authors_graph()
    graph.nodes[7].update(id="n7", label="north", seen=np.float32(0.5), cloud=np.eye(2))
    read = read_networkx(networkx.relabel_nodes(graph, {9: (4, 2)}))
    assert read.attributes == [
        {"id": 7, "y": 3, "seen": 0.5, "cloud": [[1, 0], [0, 1]]},
        {"id": 2},
        {},  # no document of ours could hold that id
        {"id": "f"},
        {"id": 11},
    ]
    assert json.dumps(read.attributes)
    assert read.edge_confidence is None


@pytest.mark.parametrize("node", [0, 3])
def test_edges_have_confidence_if_each_part_of_edge_says_so(node):
    graph = to_networkx(one_room(), edge_confidence=np.full(5, np.float64(0.5)))
    assert read_networkx(graph).edge_confidence.tolist() == [0.5] * 5
    graph.edges[0, 2]["confidence"] = "near"  # proximity
    assert read_networkx(graph).edge_confidence.tolist() == [0.5] * 5
    graph.edges[1, node]["confidence"] = "high"
    assert read_networkx(graph).edge_confidence is None


def test_attributes_that_networkx_could_not_tell_from_ours_are_refused():
    for held, sentence in (
        ([{}, {"pos": 3}], r"attributes: nodes\[1\] has 'pos', which the result says itself"),
        ([{"id": 3}, {"id": 3}], r"attributes: nodes\[1\].id is 3 again, expected unique ids"),
    ):
        with pytest.raises(ValueError, match=sentence):
            to_networkx(one_room(), [*held, {}, {}, {}])
    with pytest.raises(ValueError, match=r"graph: edge_confidence\[1\] is 2\.0, expected 0 to 1"):
        to_networkx(one_room(), edge_confidence=np.array([1.0, 2, 1, 1, 1]))


@pytest.mark.parametrize(
    ("length", "limits", "width"),
    [
        (2.5, [[0, 0, 0], [0, 4, 0]], 2.5),  # stale, as published
        (5.5, [[0, 0, 0], [4, 0, 0]], 5.5),
        (4.0, [[0, 0, 0], [4, 1e-8, 0]], 4.0),  # along x: not a bit of it changes
        (0, [[0, 0, 0], [0, 4, 0]], 4.0),
        (0, [[0, 0, 0], [4, 3, 0]], 5.0),
        (3.0, [[1, 1, 0], [4, 5, 0]], 5.0),  # x only
        (None, [[0, 0, 0], [0, 4, 0]], 4.0),
        (3.0, None, 3.0),
        (3.0, [[1], [2]], 3.0),
        (0.0, [[1, 1, 0], [1, 1, 0]], 0.0),
    ],
)
def test_the_width_is_the_length_unless_that_is_no_length(length, limits, width):
    graph = authors_graph()
    graph.nodes[7].update(length=length, limits=limits)
    assert from_networkx(graph).nodes.width[0] == width


def test_an_edge_that_breaks_the_hierarchy_survives_if_it_says_what_it_is():
    graph = to_networkx(one_room())
    graph.add_edge(0, 3, kind="part_of")
    assert [0, 3] in undirected_edges(from_networkx(graph), PART_OF).tolist()


def changed(graph, node=None, without=None, **attributes):
    graph = graph.copy()
    graph.nodes[node].update(attributes)
    graph.nodes[node].pop(without, None)
    return graph


def joined(graph, *edge, **attributes):
    graph = graph.copy()
    graph.add_edge(*edge, **attributes)
    return graph


def cyclic():
    value = []
    value.append(value)
    return value


@pytest.mark.parametrize(
    ("graph", "sentence"),
    [
        (networkx.Graph(), "nodes is empty, expected"),
        (changed(authors_graph(), 7, "type"), "node 7 lacks both 'concept' and 'type', exp"),
        (changed(authors_graph(), 7, type="attic"), "node 7: type is 'attic', expected one of"),
        (changed(authors_graph(), 7, type=["ws"]), r"node 7: type is \['ws'\], expected one of"),
        (changed(authors_graph(), 7, "center"), "node 7 lacks 'center', expected"),
        (changed(authors_graph(), 7, "normal"), "node 7 lacks 'normal', expected"),
        (changed(authors_graph(), 9, "length"), "node 9 lacks 'length', expected"),
        (changed(authors_graph(), 7, center=np.zeros(2)), r"center is \[0.0, 0.0\], expected thr"),
        (changed(authors_graph(), 7, center=np.eye(3)), "center is .*, expected a number"),
        (changed(authors_graph(), 7, center=cyclic() * 3), "center is .*, expected a number"),
        (changed(authors_graph(), 7, center="abc"), "center is 'abc', expected three numbers"),
        (changed(authors_graph(), 7, length=True), "length is True, expected a number"),
        (changed(authors_graph(), 7, length=-1), r"nodes\[0\].width is -1, expected"),
        (changed(authors_graph(), 7, normal=[0, 0, 0]), r"nodes\[0\].normal is .*expected length"),
        (changed(authors_graph(), 7, limits=[["a", 0, 0], [0, 0, 0]]), "limits is 'a', expected a"),
        (changed(authors_graph(), 2, center=[0, np.nan, 0]), r"nodes\[1\].position is \[0, nan"),
        (changed(to_networkx(one_room()), 0, "width"), "node 0 lacks 'width', expected"),
        (changed(to_networkx(one_room()), 1, width=2), "node 1: width is 2, expected none"),
        (changed(to_networkx(one_room()), 1, pos=None), "node 1 lacks 'pos', expected"),
        (joined(authors_graph(), 7, 7), r"edge \[0, 0\] is a loop, expected"),
        (joined(authors_graph(), 7, "f"), r"edge \(7, 'f'\) joins plane and floor, expected"),
        (joined(authors_graph(), 2, 11), r"edge \(2, 11\) joins wall and room, expected"),
        (joined(to_networkx(one_room()), 0, 2, kind="door"), r"edge \(0, 2\): kind is 'door', exp"),
    ],
)
def test_a_broken_graph_is_refused_in_one_sentence(graph, sentence):
    with pytest.raises(ValueError, match=rf"^a\.json: .*{sentence}") as caught:
        from_networkx(graph, "a.json")
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


def broken(change):
    document = graph_to_node_link(one_room())
    change(document)
    return document


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ([], r"there is \[\], expected an object"),
        ({"nodes": []}, "there is no list 'edges'"),
        ({"edges": []}, "there is no list 'nodes'"),
        (broken(lambda d: d.update(links=[{}])), "there are both edges and links, expected either"),
        (broken(lambda d: d.update(links=[{}], edges=[])), "both edges and links, expected either"),
        (broken(lambda d: d["nodes"].append(3)), r"nodes\[5\] is 3, expected an object with id"),
        (broken(lambda d: d["nodes"][2].pop("id")), r"nodes\[2\] is \{.*expected an object with"),
        (broken(lambda d: d["nodes"][2].update(id=1)), "node 1 is there twice"),
        (broken(lambda d: d["nodes"][2].update(id=[])), r"a node has id \[\], expected a number"),
        (broken(lambda d: d["edges"][1].pop("source")), r"edges\[1\] is .*with source and target"),
        (broken(lambda d: d["edges"][1].update(source=17)), "an edge names 17, expected the id"),
        (broken(lambda d: d["edges"][1].update(source={})), "an edge names {}, expected the id"),
        (
            broken(lambda d: d["edges"][1].update(kind=["x"])),
            r"kind is \['x'\], expected proximity",
        ),
    ],
)
def test_a_broken_document_is_refused_in_one_sentence(document, sentence):
    with pytest.raises(ValueError, match=rf"^g\.jsonl: line 2: .*{sentence}") as caught:
        graph_from_node_link(document, "g.jsonl: line 2")
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


JUNK = st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(["ws", "", "id"])


def places(document):
    """Every (container, key) of a document."""
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in list(items):
        yield document, key
        if isinstance(value, (dict, list)):
            yield from places(value)


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_a_corrupted_document_is_refused_or_means_what_it_says(data):
    document = graph_to_node_link(one_room())
    for _ in range(data.draw(st.integers(1, 3))):
        container, key = data.draw(st.sampled_from(list(places(document))))
        container[key] = data.draw(JUNK | st.lists(JUNK, max_size=3))
    graph, refusal = None, ""
    try:
        graph = graph_from_node_link(document, "a.json")
    except ValueError as error:
        refusal = str(error)
    if graph is None:
        assert refusal.startswith("a.json: ")
        assert "\n" not in refusal
    else:
        validate_graph(graph, "read", rules=False)
        again = graph_to_node_link(graph)
        said = np.array([node["pos"] for node in document["nodes"]], np.float64)
        npt.assert_array_equal([node["pos"] for node in again["nodes"]], said)
        ends = [frozenset((edge["source"], edge["target"])) for edge in document["edges"]]
        assert len(again["edges"]) == len(set(ends))  # both directions of an edge are one
