"""A made-up ontology in every format: pillars observed beside the planes, flats above the rooms."""

import copy
import dataclasses
import json

import networkx
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.io import npz
from sg3d_jax.io.formats import FORMATS, read_graphs, read_planes, write_graphs
from sg3d_jax.io.json import graph_from_dict, graph_to_dict
from sg3d_jax.io.networkx import graph_from_node_link, graph_to_node_link, to_networkx
from sg3d_jax.io.planes import planes_from_dict, planes_to_dict, write_planes
from sg3d_jax.io.s_graphs import graph_from_messages, graph_to_messages
from sg3d_jax.io.spark_dsg import graph_from_spark_dsg, graph_to_spark_dsg
from sg3d_jax.scene.graph import make_graph, observed_of, ontology_of, subgraph, undirected_edges
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PART_OF, PROXIMITY, Ontology, Rule
from sg3d_jax.scene.validate import validate_graph
from tests.own_world import FLAT, ONTOLOGY, PILLAR, PLANE, own_world

SUFFIX = {"graphml": ".graphml", "npz": ".npz"}  # of a file with one graph; .json for the others
EXACT = [to for to in FORMATS if to != "s-graphs"]  # messages are of the paper's concepts


def assert_same_graph(left, right):
    assert ontology_of(left) == ontology_of(right)
    for one, other in zip(left.nodes, right.nodes, strict=True):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(undirected_edges(left, relation), undirected_edges(right, relation))


def mixed():
    """Returns the world with its nodes in no order of concepts."""
    return subgraph(own_world(), np.random.default_rng(0).permutation(21))


def test_the_world_of_these_tests_is_sound():
    validate_graph(own_world(), "world")
    assert np.bincount(own_world().nodes.label).tolist() == [12, 2, 1, 3, 2, 1]


@pytest.mark.parametrize("to", EXACT)
@pytest.mark.parametrize("graph", [own_world(), mixed()], ids=["sorted", "mixed"])
def test_a_graph_and_its_ontology_survive_every_format(tmp_path, graph, to):
    path = tmp_path / f"a{SUFFIX.get(to, '.json')}"
    write_graphs(path, [graph], to)
    (read,) = read_graphs(path)
    assert_same_graph(read, graph)
    validate_graph(read, "read")


@pytest.mark.parametrize("to", ["json", "networkx", "spark-dsg"])
def test_lines_of_one_file_may_have_ontologies_of_their_own(tmp_path, to):
    graphs = [own_world(), registry.make("s-f", 1)[0], mixed()]
    write_graphs(tmp_path / "a.jsonl", graphs, to)
    for read, graph in zip(read_graphs(tmp_path / "a.jsonl"), graphs, strict=True):
        assert_same_graph(read, graph)


def test_an_npz_file_has_one_ontology(tmp_path):
    graphs = [own_world(), registry.make("s-f", 1)[0]]
    with pytest.raises(ValueError, match="graph 1 has another ontology than graph 0, expected one"):
        write_graphs(tmp_path / "a.npz", graphs, "npz")
    assert not list(tmp_path.iterdir())


def test_a_header_keeps_no_ontology_of_other_graphs(tmp_path):
    npz.save(tmp_path / "a.npz", [own_world()], {"name": "flats"})
    header = npz.load(tmp_path / "a.npz").header
    assert header["ontology"] == json.loads(json.dumps(ONTOLOGY.to_dict()))
    npz.save(tmp_path / "b.npz", registry.make("s-f", 1), header)
    graphs, header = npz.load(tmp_path / "b.npz")
    assert "ontology" not in header
    assert ontology_of(graphs[0]) is PAPER_ONTOLOGY


def test_the_place_of_the_ontology_is_the_documented_one():
    stated, graph = json.loads(json.dumps(ONTOLOGY.to_dict())), own_world()
    for document in (
        graph_to_dict(graph),
        graph_to_node_link(graph)["graph"],
        graph_to_spark_dsg(graph)["metadata"],
        to_networkx(graph).graph,
        planes_to_dict(graph),
    ):
        assert json.loads(json.dumps(document["ontology"])) == stated


def test_graphml_has_the_ontology_as_text(tmp_path):
    write_graphs(tmp_path / "a.graphml", [own_world()], "graphml")
    read = networkx.read_graphml(tmp_path / "a.graphml", node_type=int)
    assert json.loads(read.graph["ontology"]) == json.loads(json.dumps(ONTOLOGY.to_dict()))
    assert set(read.nodes[12]) == {"concept", "x", "y", "z"}  # a pillar


def test_the_paper_s_ontology_is_not_said():
    graph = registry.make("s-f", 1)[0]
    for document in (
        graph_to_dict(graph),
        graph_to_node_link(graph)["graph"],
        graph_to_spark_dsg(graph)["metadata"],
        to_networkx(graph).graph,
        planes_to_dict(graph),
    ):
        assert "ontology" not in document


def test_a_concept_without_features_has_none_in_a_document():
    nodes = {
        "json": graph_to_dict(own_world())["nodes"],
        "networkx": graph_to_node_link(own_world())["nodes"],
        "spark": [n["attributes"]["metadata"] for n in graph_to_spark_dsg(own_world())["nodes"]],
    }
    assert nodes["json"][12] == {
        "id": 12,
        "label": "pillar",
        "position": [2.5, 1.0, 1.2],
        "normal": None,
        "width": None,
    }
    assert nodes["networkx"][12] == {"id": 12, "concept": "pillar", "pos": [2.5, 1.0, 1.2]}
    assert nodes["spark"][12] == {}
    assert nodes["spark"][0] == {"normal": [1.0, 0.0, 0.0], "width": 3.0}


def test_a_feature_of_a_concept_that_has_none_is_refused():
    document = graph_to_dict(own_world())
    document["nodes"][12]["width"] = 3.0
    with pytest.raises(ValueError, match=r"nodes\[12\].width is 3, expected zero: only planes"):
        graph_from_dict(document)
    document = graph_to_node_link(own_world())
    document["nodes"][12]["width"] = 3.0
    with pytest.raises(ValueError, match=r"node 12: width is 3\.0, expected none: only planes"):
        graph_from_node_link(document)


# --- node-link: edges that do not say what they are ---


def test_edges_without_a_kind_are_told_by_the_rules():
    document = graph_to_node_link(own_world())
    for edge in document["edges"]:
        del edge["kind"]
    assert_same_graph(graph_from_node_link(document), own_world())


def test_an_edge_that_no_rule_tells_is_refused():
    document = graph_to_node_link(own_world())
    document["edges"].append({"source": 12, "target": 18})
    with pytest.raises(ValueError, match=r"edge \(12, 18\) joins pillar and flat, expected two th"):
        graph_from_node_link(document)


# --- Spark-DSG ---


def test_layers_letters_and_colours_are_those_of_the_ontology():
    made = graph_to_spark_dsg(own_world())
    layers = [concept.layer for concept in ONTOLOGY.concepts]
    assert [*made["layer_names"]] == layers
    assert [key["layer"] for key in made["layer_keys"]] == [2, 2, 2, 5, 6, 7]
    pillar, flat = made["nodes"][12], made["nodes"][18]
    assert (pillar["layer"], chr(pillar["id"] >> 56)) == (2, "i")
    assert (flat["layer"], chr(flat["id"] >> 56)) == (6, "A")
    assert flat["attributes"]["name"] == "flat 18"
    assert flat["attributes"]["color"] == {"r": 0xDB, "g": 0x27, "b": 0x77, "a": 255}
    predicted = [node["attributes"]["is_predicted"] for node in made["nodes"]]
    assert predicted == [False] * 14 + [True] * 7


def test_a_box_holds_pillars_too():
    graph = own_world()
    graph.nodes.position[12, :2] = -1, -2
    boxes = [n["attributes"]["bounding_box"] for n in graph_to_spark_dsg(graph)["nodes"]]
    assert boxes[12]["dimensions"] == [0, 0, 0]
    assert boxes[12]["world_P_center"] == [-1, -2, 1.2]
    npt.assert_allclose(boxes[15]["dimensions"], [5, 5, 0])  # its room


def several_wholes():
    """Returns the world where a pillar bears any number of flats, and the first bears both."""
    rules = (*ONTOLOGY.rules, Rule("pillar", "flat", single=False))
    graph = own_world()
    return make_graph(
        graph.nodes.label,
        graph.nodes.position,
        graph.nodes.normal,
        graph.nodes.width,
        part_of=[*undirected_edges(graph, PART_OF), (12, 18), (12, 19)],
        ontology=dataclasses.replace(ONTOLOGY, rules=rules),
    )


def test_whatever_a_part_may_have_several_of_goes_to_its_metadata():
    graph = several_wholes()
    made = json.loads(json.dumps(graph_to_spark_dsg(graph, "metadata")))
    ids = [node["id"] for node in made["nodes"]]
    kept = [node["attributes"]["metadata"] for node in made["nodes"]]
    assert kept[12] == {"flats": [ids[18], ids[19]]}
    assert [row for row, metadata in enumerate(kept) if "walls" in metadata] == [1, 4]
    children = [edge["target"] for edge in made["edges"]]
    assert len(set(children)) == len(children)  # each has one parent
    assert_same_graph(graph_from_spark_dsg(made), graph)


def test_a_whole_of_another_concept_in_metadata_is_refused():
    made = graph_to_spark_dsg(several_wholes(), "metadata")
    made["nodes"][12]["attributes"]["metadata"]["flats"][1] = made["nodes"][15]["id"]
    sentence = r"nodes\[12\].attributes.metadata.flats\[1\] is \d+, expected the id of a flat"
    with pytest.raises(ValueError, match=sentence):
        graph_from_spark_dsg(made)


# --- planes, and what else is observed ---


def test_what_is_observed_is_read_off_a_graph_of_every_format(tmp_path):
    for to in EXACT:
        path = tmp_path / f"a{SUFFIX.get(to, '.json')}"
        write_graphs(path, [own_world()], to)
        (read,) = read_planes(path)
        assert_same_graph(read, observed_of(own_world()))


def test_a_document_of_planes_has_a_list_for_every_concept_that_is_observed(tmp_path):
    document = planes_to_dict(own_world())
    assert [*document] == ["ontology", "planes", "pillars"]
    assert document["pillars"] == [{"centroid": [2.5, 1.0, 1.2]}, {"centroid": [6.0, 2.0, 1.2]}]
    write_planes(tmp_path / "a.json", own_world())
    (read,) = read_planes(tmp_path / "a.json")
    assert_same_graph(read, observed_of(own_world()))


def test_what_is_observed_need_not_be_called_planes(tmp_path):
    pillar, flat = ONTOLOGY.concepts[PILLAR], ONTOLOGY.concepts[FLAT]
    columns = Ontology((pillar, flat), (Rule("pillar", "flat"),))
    graph = make_graph([0, 0, 1], np.eye(3), part_of=[(0, 2), (1, 2)], ontology=columns)
    write_planes(tmp_path / "a.json", graph)
    (read,) = read_graphs(tmp_path / "a.json")
    assert_same_graph(read, observed_of(graph))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda d: d.pop("pillars"),
            "the scene lacks 'pillars', expected exactly ontology, planes",
        ),
        (lambda d: d.pop("ontology"), "the scene has 'pillars', expected exactly planes"),
        (lambda d: d.update(pillars=3), "pillars is no list, expected a list of pillars"),
        (lambda d: d.update(flats=[]), "the scene has 'flats', expected exactly ontology"),
        (
            lambda d: d["pillars"][1].update(width=2),
            r"pillars\[1\] has 'width', expected centroid",
        ),
        (lambda d: d["pillars"][1].pop("centroid"), r"pillars\[1\] lacks 'centroid', expected"),
        (
            lambda d: d["pillars"][1].update(centroid=[0, 1]),
            r"pillars\[1\].centroid is \[0, 1\], exp",
        ),
    ],
)
def test_a_broken_document_of_planes_is_refused(change, sentence):
    document = json.loads(json.dumps(planes_to_dict(own_world())))
    change(document)
    with pytest.raises(ValueError, match=rf"^a\.json: {sentence}"):
        planes_from_dict(document, "a.json")


# --- ontologies that are none ---


def put(*path, value):
    """Returns a function that changes an ontology."""

    def change(ontology):
        for key in path[:-1]:
            ontology = ontology[key]
        ontology[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (put("concepts", value=3), "expected concepts and rules"),
        (put("concepts", 0, value=[]), "expected concepts and rules"),
        (put("concepts", 0, "name", value=3), "expected concepts and rules"),
        (put("concepts", 0, "observed", value="yes"), "expected concepts and rules"),
        (put("concepts", 0, "weight", value=1), "expected concepts and rules"),
        (put("concepts", 0, "features", value=["age"]), "feature of plane is 'age', expected of"),
        (put("concepts", 0, "colour", value="blue"), "colour of plane is 'blue', expected such as"),
        (put("concepts", 1, "layer", value="PLANES"), "layer 'PLANES' is there twice, expected"),
        (put("rules", 0, "whole", value="attic"), "unknown concept 'attic', expected one of"),
        (put("rules", 0, "part", value="floor"), "floor is part of wall, expected a concept fur"),
    ],
)
def test_a_broken_ontology_is_refused_in_one_sentence_by_every_format(tmp_path, change, sentence):
    stated = json.loads(json.dumps(ONTOLOGY.to_dict()))
    change(stated)
    for to, (document, place) in {
        "json": (graph_to_dict(own_world()), ()),
        "networkx": (graph_to_node_link(own_world()), ("graph",)),
        "spark-dsg": (graph_to_spark_dsg(own_world()), ("metadata",)),
        "planes": (planes_to_dict(own_world()), ()),
    }.items():
        document = copy.deepcopy(document)
        holder = document[place[0]] if place else document
        holder["ontology"] = stated
        path = tmp_path / f"{to}.json"
        path.write_text(json.dumps(document))
        assert_refused(path, sentence)


def test_a_graphml_file_whose_ontology_is_no_json_is_refused(tmp_path):
    write_graphs(tmp_path / "a.graphml", [own_world()], "graphml")
    text = (tmp_path / "a.graphml").read_text()
    (tmp_path / "a.graphml").write_text(text.replace('{"concepts"', '"concepts"', 1))
    assert_refused(tmp_path / "a.graphml", "ontology: not JSON at line 1")


def test_an_npz_header_with_a_broken_ontology_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    npz.save(path, [own_world()], {})
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays["header"]))
    header["ontology"]["rules"] = 3
    np.savez(path, **(arrays | {"header": np.array(json.dumps(header))}))
    assert_refused(path, "header: expected concepts and rules")


def assert_refused(path, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        read_graphs(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


# --- S-Graphs, which knows the paper's concepts ---


def test_s_graphs_is_told_of_what_it_knows_by_name():
    graph = own_world()
    read = graph_from_messages(json.loads(json.dumps(graph_to_messages(graph))))
    assert ontology_of(read) is PAPER_ONTOLOGY
    names = [PAPER_ONTOLOGY.names[label] for label in read.nodes.label]
    assert names == ["plane"] * 12 + ["wall"] + ["room"] * 3 + ["floor"]
    rows = [row for row, label in enumerate(graph.nodes.label) if label not in (PILLAR, FLAT)]
    npt.assert_allclose(read.nodes.position, graph.nodes.position[rows], atol=1e-12)
    assert (graph.nodes.label[:12] == PLANE).all()
