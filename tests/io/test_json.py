import gzip
import json
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.io.json import graph_from_dict, graph_to_dict, read_dict
from sg3d_jax.scene.graph import make_graph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.validate import validate_graph

SHARED = Path(__file__).parents[3] / "shared" / "data"


def one_room(seed=0, proximity=((0, 2),)):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 6, 2)
    normal = np.zeros((4, 3))
    normal[[0, 2], :2] = np.stack([np.cos(angle), np.sin(angle)], -1)
    return make_graph(
        [PLANE, ROOM, PLANE, FLOOR],
        rng.normal(size=(4, 3)),
        normal,
        [*rng.uniform(1, 2, 1), 0, *rng.uniform(1, 2, 1), 0],
        part_of=[[1, 0], [2, 1], [3, 1]],
        proximity=proximity,
    )


def assert_same_graph(left, right):
    for one, other in zip(left.nodes, right.nodes, strict=True):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(undirected_edges(left, relation), undirected_edges(right, relation))


def test_the_document_has_the_published_form():
    document = graph_to_dict(one_room(proximity=()), halt_reason="halted", seed=3)
    assert [*document] == ["nodes", "edges", "halt_reason", "seed"]
    assert [node["label"] for node in document["nodes"]] == ["plane", "room", "plane", "floor"]
    assert [*document["nodes"][0]] == ["id", "label", "position", "normal", "width"]
    assert document["nodes"][1]["normal"] is None
    assert document["nodes"][1]["width"] is None


def test_edges_name_the_child_first():
    assert graph_to_dict(one_room())["edges"] == [[0, 1], [2, 1], [1, 3]]


def test_an_extra_key_cannot_replace_the_graph():
    with pytest.raises(TypeError, match="nodes"):
        graph_to_dict(one_room(), nodes=[])


def test_a_graph_survives_its_text_bit_for_bit():
    document = json.loads(json.dumps(graph_to_dict(one_room(), seed=1)))
    assert_same_graph(graph_from_dict(document), one_room())
    assert document["seed"] == 1


def test_ids_may_be_any_integers_or_names():
    document = graph_to_dict(one_room())
    names = [17, "room", 4, -1]
    for node, name in zip(document["nodes"], names, strict=True):
        node["id"] = name
    for key in ("edges", "proximity_edges"):
        document[key] = [[names[u], names[v]] for u, v in document[key]]
    assert_same_graph(graph_from_dict(document), one_room())


def test_how_sure_edges_are_stands_beside_them():
    document = graph_to_dict(one_room(), edge_confidence=np.array([0.5, 1, 0.25]), seed=3)
    assert [*document] == ["nodes", "edges", "proximity_edges", "edge_confidence", "seed"]
    assert document["edges"] == [[0, 1], [2, 1], [1, 3]]
    assert document["edge_confidence"] == [0.5, 1, 0.25]
    document["edges"] = document["edges"][::-1]
    assert read_dict(document).edge_confidence.tolist() == [0.25, 1, 0.5]


@pytest.mark.parametrize("said", [None, 3, [0.5, 0.5], [0.5] * 4, [0.5, 0.5, "high"], [2, 0, 0]])
def test_what_is_no_confidence_of_its_edges_is_let_through(said):
    document = graph_to_dict(one_room()) | {"edge_confidence": said}
    assert read_dict(document).edge_confidence is None


def test_a_graph_that_breaks_the_hierarchy_can_be_read():
    document = graph_to_dict(one_room()) | {"edges": [[0, 3]]}
    graph = graph_from_dict(document)
    npt.assert_array_equal(undirected_edges(graph, PART_OF), [[0, 3]])


def broken(change):
    document = graph_to_dict(one_room())
    change(document)
    return document


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ([], "there is no list 'nodes'"),
        ({"nodes": []}, "there is no list 'edges'"),
        ({"nodes": [], "edges": []}, "nodes is empty"),
        ({"nodes": [], "edges": [[0, 1]]}, r"edges\[0\] names 0, expected the id of a node"),
        ({"nodes": [1], "edges": []}, r"nodes\[0\] is 1, expected an object"),
        (broken(lambda d: d["nodes"][2].pop("id")), r"nodes\[2\] lacks 'id'"),
        (broken(lambda d: d["nodes"][2].update(id=[])), r"nodes\[2\].id is \[\], expected an"),
        (broken(lambda d: d["nodes"][2].update(id=1)), r"nodes\[2\].id is 1 again"),
        (broken(lambda d: d["nodes"][1].update(label="attic")), r"nodes\[1\].label is 'attic'"),
        (broken(lambda d: d["nodes"][1].update(label=[1])), r"nodes\[1\].label is \[1\]"),
        (broken(lambda d: d["nodes"][1].update(position=None)), r"nodes\[1\].position is None"),
        (broken(lambda d: d["nodes"][0].update(normal=None)), r"nodes\[0\].normal is \[0, 0, 0\]"),
        (broken(lambda d: d["nodes"][0].update(width=-1)), r"nodes\[0\].width is -1"),
        (broken(lambda d: d["nodes"][1].update(width=2)), r"nodes\[1\].width is 2, expected zero"),
        (broken(lambda d: d["edges"].append([0, 9])), r"edges\[3\] names 9"),
        (broken(lambda d: d["edges"].append([0, 1.0])), r"edges\[3\] names 1.0"),
        (broken(lambda d: d["edges"].append([0, [1]])), r"edges\[3\] names \[1\]"),
        (broken(lambda d: d["edges"].append([0, 1, 2])), r"edges\[3\] is \[0, 1, 2\], expected a"),
        (broken(lambda d: d["edges"].append([1, 0])), "is there twice"),
        (broken(lambda d: d["edges"].append([1, 1])), "is a loop"),
        (broken(lambda d: d.update(proximity_edges=None)), "proximity_edges is no list"),
    ],
)
def test_a_broken_document_is_refused_in_one_sentence(document, sentence):
    with pytest.raises(ValueError, match=rf"^graphs\.jsonl: line 2: .*{sentence}") as caught:
        graph_from_dict(document, "graphs.jsonl: line 2")
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the original authors' sample is not here")
@pytest.mark.parametrize("name", ["S-F-square", "S-F", "S-C"])
def test_graphs_of_the_original_generator_are_sound(name):
    with gzip.open(SHARED / f"original_{name}.json.gz") as file:
        documents = json.load(file)[:20]
    for index, document in enumerate(documents):
        graph = graph_from_dict(document)
        validate_graph(graph, f"{name}: graph {index}")
        assert len(undirected_edges(graph, PART_OF)) == len(document["edges"])
        assert len(undirected_edges(graph, PROXIMITY)) == len(document["proximity_edges"])
