import json

import networkx
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.io.formats import read_graphs, read_with_attributes, write_graphs
from sg3d_jax.io.json import graph_to_dict
from sg3d_jax.io.networkx import read_networkx, to_networkx
from sg3d_jax.scene.graph import undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY
from tests.two_rooms import two_rooms

HELD = [{"id": row + 3, "seen": [row, None]} for row in range(12)]
SURE = np.linspace(0, 1, 16)
ROOM = {"id": 1, "concept": "room", "pos": [0, 0, 0]}


def networkx_of(graph):
    count = len(undirected_edges(graph, PART_OF))
    return to_networkx(graph, HELD, SURE[:count])


def d3(graph):
    """Returns a graph as D3's force simulation holds it: links point at the nodes themselves."""
    made = networkx_of(graph)
    nodes = {name: {"id": name, "index": i, **made.nodes[name]} for i, name in enumerate(made)}
    links = [{"source": nodes[a], "target": nodes[b], **said} for a, b, said in made.edges.data()]
    return {"nodes": list(nodes.values()), "links": links}


def d3_by_place(graph):
    """Returns a graph as of D3 version 3, in our own words: links name places in the list."""
    said = graph_to_dict(graph)
    nodes = [{key: value for key, value in node.items() if key != "id"} for node in said["nodes"]]
    pairs = [*said["edges"], *said.get("proximity_edges", [])]
    return {"nodes": nodes, "links": [{"source": a, "target": b} for a, b in pairs]}


def cytoscape(graph):
    """Returns a graph as Cytoscape exports it: ids are texts, and it adds names of its own."""
    made = networkx.cytoscape_data(networkx_of(graph))
    for node in made["elements"]["nodes"]:
        node["position"] = {"x": 120.5, "y": -3}
        node["data"].pop("value")
        node["data"] |= {"name": node["data"]["id"], "SUID": 71}
    for edge in made["elements"]["edges"]:
        edge["data"] |= {end: str(edge["data"][end]) for end in ("source", "target")}
    return made


@pytest.mark.parametrize(
    "made",
    [
        lambda graph: networkx.adjacency_data(networkx_of(graph)),
        lambda graph: networkx.adjacency_data(networkx_of(graph).to_directed()),
        lambda graph: networkx.cytoscape_data(networkx_of(graph)),
        lambda graph: networkx.node_link_data(networkx_of(graph).to_directed(), edges="edges"),
        lambda graph: networkx.node_link_data(
            networkx.MultiGraph(networkx_of(graph)), edges="links"
        ),
        d3,
        d3_by_place,
        cytoscape,
    ],
    ids=["adjacency", "both", "cytoscape", "directed", "multigraph", "d3", "places", "exported"],
)
def test_a_graph_of_others_is_the_same_graph(made, request, tmp_path):
    graph, kind = two_rooms(), request.node.callspec.id
    (tmp_path / "a.json").write_text(json.dumps(made(graph)))
    (read,) = read_with_attributes(tmp_path / "a.json")
    for one, other in zip(read.graph.nodes, graph.nodes, strict=True):
        npt.assert_array_equal(one, other)
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(
            undirected_edges(read.graph, relation), undirected_edges(graph, relation)
        )
    if kind == "places":
        return
    ids = [f"{held['id']}" if kind == "exported" else held["id"] for held in HELD]
    assert [held["id"] for held in read.attributes] == ids
    assert [held["seen"] for held in read.attributes] == [held["seen"] for held in HELD]
    assert "name" not in read.attributes[0]
    npt.assert_array_equal(read.edge_confidence, SURE[: len(read.edge_confidence)])


def test_directed_edges_of_both_directions_are_one_and_of_two_meanings_none():
    made = networkx_of(two_rooms()).to_directed()
    assert read_networkx(made).graph.n_edge == read_networkx(made.to_undirected()).graph.n_edge
    source, target = next(iter(made.edges))
    kinds = [made.edges[pair]["kind"] for pair in ((source, target), (target, source))]
    other = "proximity" if kinds[0] == "part_of" else "part_of"
    made.edges[target, source]["kind"] = other
    with pytest.raises(ValueError, match="is there twice, expected once"):
        read_networkx(made)


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ({"nodes": [{"id": 1}], "adjacency": []}, r"adjacency is \[\], expected a list for each"),
        ({"nodes": [ROOM], "adjacency": [[3]]}, r"adjacency\[0\] is 3, expected an object"),
        ({"nodes": [7], "adjacency": [[]]}, r"nodes\[0\] is 7, expected an object with id"),
        ({"elements": []}, r"elements is \[\], expected an object with 'nodes'"),
        ({"elements": {"nodes": 7}}, "elements: there is no list 'nodes', expected"),
        ({"elements": {"nodes": [{}]}}, r"nodes\[0\] is {}, expected an object with data"),
        ({"elements": {"nodes": [{"data": {}}]}}, r"nodes\[0\] is {}, expected an object with id"),
        ({"nodes": [], "links": [{"source": 1}]}, "expected an object with source and target"),
        (
            {"nodes": [ROOM | {"pos": None, "x": 1, "y": 2}], "links": []},
            "node 1 lacks 'z', expected x, y, z",
        ),
    ],
)
def test_a_broken_document_is_refused_in_one_sentence(document, sentence, tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match=sentence) as caught:
        read_graphs(tmp_path / "a.json")
    assert "\n" not in str(caught.value)


NEO4J = """<graphml xmlns="http://graphml.graphdrawing.org/xmlns">
<key id="concept" for="node" attr.name="concept"/><key id="pos" for="node" attr.name="pos"/>
<key id="x" for="node" attr.name="x"/><key id="y" for="node" attr.name="y"/>
<key id="z" for="node" attr.name="z"/><key id="normal" for="node" attr.name="normal"/>
<key id="width" for="node" attr.name="width"/><key id="label" for="edge" attr.name="label"/>
<graph id="G" edgedefault="directed">
<node id="n0" labels=":Plane"><data key="concept">plane</data><data key="x">1.5</data>
<data key="y">-2</data><data key="z">0</data><data key="normal">[0.0,1.0,0.0]</data>
<data key="width">3.25</data></node>
<node id="n1" labels=":Room"><data key="concept">room</data><data key="pos">[1, 2, 3]</data></node>
<edge id="e0" source="n0" target="n1" label="IN"><data key="label">IN</data></edge>
</graph></graphml>"""
YED = """<graphml xmlns="http://graphml.graphdrawing.org/xmlns"
 xmlns:y="http://www.yworks.com/xml/graphml">
<key attr.name="concept" attr.type="string" for="node" id="d0"/>
<key attr.name="x" attr.type="string" for="node" id="d1"/>
<key attr.name="y" attr.type="string" for="node" id="d2"/>
<key attr.name="z" attr.type="string" for="node" id="d3"/>
<key for="node" id="d4" yfiles.type="nodegraphics"/><key for="port" id="d5" yfiles.type="ports"/>
<key for="node" id="d6" yfiles.type="nodedescription"/>
<graph edgedefault="directed" id="G">{}
<edge id="e0" source="n0" target="n1"/></graph></graphml>"""
YED_NODE = """<node id="n{}"><data key="d0">{}</data><data key="d1">{}</data>
<data key="d2">2</data><data key="d3">0.0</data><data key="d6"/><data key="d4"><y:ShapeNode>
<y:Geometry height="30.0" width="30.0" x="507.0" y="299.0"/><y:NodeLabel>hall</y:NodeLabel>
</y:ShapeNode></data></node>"""
IGRAPH = """<graphml xmlns="http://graphml.graphdrawing.org/xmlns">
<key id="v_concept" for="node" attr.name="concept" attr.type="string"/>
<key id="v_x" for="node" attr.name="x" attr.type="double"/>
<key id="v_y" for="node" attr.name="y" attr.type="double"/>
<key id="v_z" for="node" attr.name="z" attr.type="double"/>
<key id="v_normal_x" for="node" attr.name="normal_x" attr.type="double"/>
<key id="v_normal_y" for="node" attr.name="normal_y" attr.type="double"/>
<key id="v_normal_z" for="node" attr.name="normal_z" attr.type="double"/>
<key id="v_width" for="node" attr.name="width" attr.type="double"/>
<graph id="G" edgedefault="undirected">{}<edge source="n0" target="n1"/></graph></graphml>"""
IGRAPH_NODE = """<node id="n{}"><data key="v_concept">{}</data><data key="v_x">{}</data>
<data key="v_y">0</data><data key="v_z">0</data><data key="v_normal_x">{n}</data>
<data key="v_normal_y">{n}</data><data key="v_normal_z">{n}</data>
<data key="v_width">{n}</data></node>"""


@pytest.mark.parametrize(
    ("text", "position"),
    [
        (NEO4J, [[1.5, -2, 0], [1, 2, 3]]),
        (
            YED.format(YED_NODE.format(0, "room", "1.5") + YED_NODE.format(1, "floor", "4")),
            [[1.5, 2, 0], [4, 2, 0]],
        ),
        (
            IGRAPH.format(
                IGRAPH_NODE.format(0, "room", 1.5, n="NaN")
                + IGRAPH_NODE.format(1, "floor", 4, n="NaN")
            ),
            [[1.5, 0, 0], [4, 0, 0]],
        ),
    ],
    ids=["neo4j", "yed", "igraph"],
)
def test_numbers_may_be_texts_and_every_node_may_have_every_attribute(text, position, tmp_path):
    (tmp_path / "a.graphml").write_text(text)
    (graph,) = read_graphs(tmp_path / "a.graphml")
    npt.assert_array_equal(graph.nodes.position, position)
    npt.assert_array_equal(undirected_edges(graph, PART_OF), [[0, 1]])
    if text is NEO4J:
        npt.assert_array_equal(graph.nodes.normal[0], [0, 1, 0])
        assert graph.nodes.width[0] == 3.25


def test_what_gephi_saves_is_read(tmp_path):
    graph = two_rooms()
    write_graphs(tmp_path / "a.graphml", [graph], "graphml")
    networkx.write_gexf(networkx.read_graphml(tmp_path / "a.graphml"), tmp_path / "a.gexf")
    (read,) = read_with_attributes(tmp_path / "a.gexf")
    npt.assert_array_equal(read.graph.nodes.label, graph.nodes.label)
    npt.assert_array_equal(read.graph.nodes.position, graph.nodes.position)
    npt.assert_array_equal(undirected_edges(read.graph, PART_OF), undirected_edges(graph, PART_OF))
    assert read.attributes == [{"id": row} for row in range(12)]
