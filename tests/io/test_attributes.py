"""What else files say of nodes: read, mapped, written; and what no graph can hold is refused."""

import json

import pytest

from sg3d_jax.io.attributes import check_attributes, node_ids
from sg3d_jax.io.formats import FORMATS, read_graphs, read_with_attributes, write_graphs
from sg3d_jax.io.json import graph_from_dict, graph_to_dict, read_dict
from sg3d_jax.scene.graph import undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY
from tests.two_rooms import two_rooms

SUFFIX = {"graphml": ".graphml", "npz": ".npz"}
NAMES = [40, 7, "west", 3, 12, 5, 6, 8, "wall", "room", 0, 1]
ATTRIBUTES = [{"id": name, "robot": {"name": f"r{row}"}} for row, name in enumerate(NAMES)]


def test_ids_and_further_keys_survive_a_document():
    document = json.loads(json.dumps(graph_to_dict(two_rooms(), ATTRIBUTES, seed=3)))
    assert [node["id"] for node in document["nodes"]] == NAMES
    assert document["nodes"][1]["robot"] == {"name": "r1"}
    assert [*document["nodes"][1]] == ["id", "label", "position", "normal", "width", "robot"]
    read = read_dict(document)
    assert read.attributes == ATTRIBUTES
    for relation in (PART_OF, PROXIMITY):
        expected = undirected_edges(two_rooms(), relation).tolist()
        assert undirected_edges(read.graph, relation).tolist() == expected
        assert undirected_edges(graph_from_dict(document), relation).tolist() == expected


def test_a_file_keeps_them(tmp_path):
    path = tmp_path / "graphs.jsonl"
    write_graphs(path, [two_rooms()] * 2, attributes=[ATTRIBUTES, [{}] * 12])
    one, other = read_with_attributes(path)
    assert one.attributes == ATTRIBUTES
    assert other.attributes == [{"id": row} for row in range(12)]


@pytest.mark.parametrize("to", FORMATS)
def test_every_format_has_as_many_as_nodes(to, tmp_path):
    path = tmp_path / f"graph{SUFFIX.get(to, '.json')}"
    write_graphs(path, [two_rooms()], to)
    [read] = read_with_attributes(path)
    assert len(read.attributes) == 12
    assert read_graphs(path)[0].nodes.label.tolist() == read.graph.nodes.label.tolist()
    if to != "json":
        with pytest.raises(ValueError, match=f"there are attributes, expected none for {to}"):
            write_graphs(path, [two_rooms()], to, attributes=[ATTRIBUTES])


@pytest.mark.parametrize(
    ("given", "ids"),
    [
        ([None] * 3, [0, 1, 2]),
        ([0, 1, None], [0, 1, 2]),
        ([7, 3, None, None], [7, 3, 8, 9]),
        (["a", "b", None], ["a", "b", 2]),
        ([None, 5, None], [6, 5, 8]),
        ([-4, None], [-4, 1]),
        ([2, 1, 0], [2, 1, 0]),
        ([], []),
    ],
)
def test_nodes_without_an_id_have_one_that_no_other_has(given, ids):
    assert node_ids([{} if name is None else {"id": name} for name in given]) == ids


@pytest.mark.parametrize(
    ("held", "sentence"),
    [
        ({"label": "door"}, "has 'label', which the result says itself, expected another name"),
        ({"position": 3}, "has 'position', which"),
        ({"normal": None}, "has 'normal', which"),
        ({"id": 1.5}, ".id is 1.5, expected an integer or a name"),
        ({"id": True}, ".id is True, expected an integer or a name"),
        ({"id": None}, ".id is None, expected an integer or a name"),
        ({"id": [1]}, r".id is \[1\], expected an integer or a name"),
        ({"id": 4}, ".id is 4 again, expected unique ids"),
        ({"seen": float("nan")}, r" is {'seen': nan}, expected JSON \("),
        ({"seen": {1, 2}}, r" is {'seen': {1, 2}}, expected JSON \("),
    ],
)
def test_what_no_document_can_hold_is_refused_in_one_sentence(held, sentence, tmp_path):
    attributes = [{"id": 4}, held]
    with pytest.raises(ValueError, match=rf"^a\.json: nodes\[1\] ?{sentence}") as caught:
        check_attributes(attributes, "a.json")
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=rf"graph 0: nodes\[1\] ?{sentence}"):
        write_graphs(tmp_path / "a.json", [two_rooms()], attributes=[[*attributes, *[{}] * 10]])
    assert list(tmp_path.iterdir()) == []


def test_any_other_names_are_let_through():
    check_attributes([{}, {"id": "x", "centroid": 3, "": None, "ID": 4}, {"id": 0}], "a.json")
