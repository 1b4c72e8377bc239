"""What else files say of nodes: read, mapped, written; and what no graph can hold is refused."""

import json

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sg3d_jax.io.attributes import (
    check_attributes,
    edge_confidence_of,
    node_confidence_of,
    node_ids,
    with_confidence,
)
from sg3d_jax.io.formats import FORMATS, read_graphs, read_with_attributes, write_graphs
from sg3d_jax.io.json import graph_from_dict, graph_to_dict, read_dict
from sg3d_jax.scene.graph import parts_first, subgraph, undirected_edges
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PART_OF, PROXIMITY
from tests.two_rooms import two_rooms

SUFFIX = {"graphml": ".graphml", "npz": ".npz"}
NAMES = [40, 7, "west", 3, 12, 5, 6, 8, "wall", "room", 0, 1]
ATTRIBUTES = [{"id": name, "robot": {"name": f"r{row}"}} for row, name in enumerate(NAMES)]
CARRYING = [to for to in FORMATS if to not in ("npz", "s-graphs")]
HARD = [
    *[0, -7, 2**70, 0.0, -0.0, 1.0, 1 / 3, 1e-300, True, False, None],
    *["", " ", "null", "7", "1.5", "true", "[1, 2]", "[1", '"', '"a"', "{", "\\", "<&>", "ü 😀"],
    *["two\nlines\r\n", "\t", "\x00\x1b", "\ud800", "]]>"],
    *[[], {}, [1, 1.0, "1"], {"a": [None, {"b": True}]}, [[0.1]]],
]


def written_and_read(tmp_path, graph, to, **said):
    path = tmp_path / f"a{SUFFIX.get(to, '.json')}"
    write_graphs(path, [graph], to, **said)
    [read] = read_with_attributes(path)
    return read


def exactly(value):
    """Returns what tells 1 from 1.0 and from True, and 0.0 from -0.0."""
    return json.dumps(value, sort_keys=True)


def shuffled():
    """Returns a graph whose edges stand in another order in files than their ends' rows."""
    return subgraph(two_rooms(), np.random.default_rng(0).permutation(12))


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


def test_npz_has_no_place_for_them(tmp_path):
    path, sure = tmp_path / "a.npz", np.ones(len(parts_first(two_rooms())))
    with pytest.raises(ValueError, match="there are attributes, expected none for npz"):
        write_graphs(path, [two_rooms()], "npz", attributes=[ATTRIBUTES])
    with pytest.raises(ValueError, match="there is edge_confidence, expected none for npz"):
        write_graphs(path, [two_rooms()], "npz", edge_confidence=[sure])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("to", CARRYING)
def test_they_survive_every_other_format(to, tmp_path):
    read = written_and_read(tmp_path, two_rooms(), to, attributes=[ATTRIBUTES])
    assert exactly(read.attributes) == exactly(ATTRIBUTES)
    assert read.edge_confidence is None
    for relation in (PART_OF, PROXIMITY):
        pairs = undirected_edges(read.graph, relation)
        npt.assert_array_equal(pairs, undirected_edges(two_rooms(), relation))


@pytest.mark.parametrize("to", CARRYING)
def test_values_of_every_kind_survive(to, tmp_path):
    held = [{"id": 3, **{f"value {place}": value for place, value in enumerate(HARD)}}]
    held += [{"id": row, "seen": value} for row, value in zip(range(4, 15), HARD, strict=False)]
    read = written_and_read(tmp_path, two_rooms(), to, attributes=[held])
    assert exactly(read.attributes) == exactly(held)


@pytest.mark.parametrize("to", CARRYING)
def test_names_of_every_kind_survive(to, tmp_path):
    names = [value for value in HARD if isinstance(value, str) and value != "\ud800"]
    names += ["self", "node_for_adding", "kind", "source", "key", "type", "name", "node_default"]
    held = [{"id": f"{row}", **dict.fromkeys(names, row)} for row in range(11)]
    held += [{"id": 7, "self": None}]  # beside the name "7"
    read = written_and_read(tmp_path, two_rooms(), to, attributes=[held])
    assert exactly(read.attributes) == exactly(held)


TEXT = st.text(max_size=6)
JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | TEXT | st.sampled_from(HARD),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=5,
)  # fmt: skip


@given(
    to=st.sampled_from(CARRYING),
    ids=st.lists(TEXT | st.integers(), min_size=12, max_size=12, unique=True),
    values=st.lists(JSON_VALUES, min_size=12, max_size=12),
)
@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_ids_and_values_survive(tmp_path, to, ids, values):
    held = [{"id": name, "seen": value} for name, value in zip(ids, values, strict=True)]
    read = written_and_read(tmp_path, two_rooms(), to, attributes=[held])
    assert exactly(read.attributes) == exactly(held)


@pytest.mark.parametrize("graph", [two_rooms(), shuffled()], ids=["sorted", "shuffled"])
@pytest.mark.parametrize(
    ("to", "options"), [*((to, {}) for to in CARRYING), ("spark-dsg", {"walls": "metadata"})]
)
def test_confidence_survives(to, options, graph, tmp_path):
    rng = np.random.default_rng(1)
    of_nodes, of_edges = rng.uniform(size=12), rng.uniform(size=len(parts_first(graph)))
    of_nodes[:2], of_edges[:2] = [0, 1], [1, 0]
    held = with_confidence([{}] * 12, of_nodes)
    said = {"attributes": [held], "edge_confidence": [of_edges]}
    read = written_and_read(tmp_path, graph, to, **said, **options)
    npt.assert_array_equal(node_confidence_of(read.attributes), of_nodes)
    npt.assert_array_equal(read.edge_confidence, of_edges)
    npt.assert_array_equal(parts_first(read.graph), parts_first(graph))


@pytest.mark.parametrize("to", CARRYING)
def test_of_several_graphs_some_may_have_confidence(to, tmp_path):
    if to == "graphml":
        pytest.skip("one graph a file")
    sure = np.full(len(parts_first(two_rooms())), 0.25)
    write_graphs(tmp_path / "a.jsonl", [two_rooms()] * 2, to, edge_confidence=[None, sure])
    one, other = read_with_attributes(tmp_path / "a.jsonl")
    assert one.edge_confidence is None
    npt.assert_array_equal(other.edge_confidence, sure)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda c: c[:-1], r"edge_confidence has shape \[11\], expected \[12\]"),
        (lambda c: c[None], r"edge_confidence has shape \[1, 12\], expected \[12\]"),
        (lambda c: c + 0.75, r"edge_confidence\[0\] is 1.25, expected 0 to 1"),
        (lambda c: c * np.nan, r"edge_confidence\[0\] is nan, expected 0 to 1"),
        (lambda c: c - 1, r"edge_confidence\[0\] is -0.5, expected 0 to 1"),
    ],
)
@pytest.mark.parametrize("to", CARRYING)
def test_what_is_no_confidence_of_its_edges_is_refused(to, change, sentence, tmp_path):
    path, sure = tmp_path / f"a{SUFFIX.get(to, '.json')}", np.full(12, 0.5)
    with pytest.raises(ValueError, match=rf"a\.\w+: graph 0: {sentence}"):
        write_graphs(path, [two_rooms()], to, edge_confidence=[change(sure)])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("said", [None, "high", True, 87, -0.5, float("nan"), [0.5]])
def test_what_others_call_confidence_is_none(said):
    assert node_confidence_of([{"confidence": said}]) is None
    assert edge_confidence_of([[0, 1], [1, 2]], [0.5, said]) is None
    assert edge_confidence_of([], []) is None
    values = node_confidence_of([{"confidence": said}, {"confidence": 1}, {}])
    npt.assert_array_equal(values, [np.nan, 1, np.nan])


def test_edges_come_in_the_order_of_the_graph():
    values = edge_confidence_of([[3, 2], [0, 3], [1, 2], [3, 1]], [0.1, 0.2, 0.3, 0.4])
    npt.assert_array_equal(values, [0.2, 0.3, 0.4, 0.1])


def test_a_confidence_of_one_s_own_is_kept():
    held = [{"id": 4}, {"confidence": "high"}, {}]
    given = with_confidence(held, np.array([0.5, 0.25, 1]))
    assert given == [{"confidence": 0.5, "id": 4}, {"confidence": "high"}, {"confidence": 1.0}]
    assert held == [{"id": 4}, {"confidence": "high"}, {}]
    assert with_confidence(held, None) is held


@pytest.mark.parametrize(
    ("to", "name"),
    [
        *((to, name) for to in CARRYING for name in ("label", "position", "normal", "width")),
        *(("networkx", name) for name in ("concept", "pos")),
        *(("graphml", name) for name in ("concept", "pos", "x", "z", "normal_y")),
        *(("spark-dsg", name) for name in ("walls", "walls_confidence")),
    ],
)
def test_what_a_format_says_itself_is_refused(to, name, tmp_path):
    path, held = tmp_path / f"a{SUFFIX.get(to, '.json')}", [{}, {name: 3}, *[{}] * 10]
    sentence = f"graph 0: nodes\\[1\\] has '{name}', which the result says itself, expected another"
    with pytest.raises(ValueError, match=sentence):
        write_graphs(path, [two_rooms()], to, attributes=[held])
    assert list(tmp_path.iterdir()) == []


def test_attributes_of_another_number_of_nodes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="there are attributes of 3 nodes, expected those of 12"):
        write_graphs(tmp_path / "a.json", [two_rooms()], attributes=[[{}] * 3])


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
        check_attributes(attributes, PAPER_ONTOLOGY, "a.json")
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=rf"graph 0: nodes\[1\] ?{sentence}"):
        write_graphs(tmp_path / "a.json", [two_rooms()], attributes=[[*attributes, *[{}] * 10]])
    assert list(tmp_path.iterdir()) == []


def test_any_other_names_are_let_through():
    held = [{}, {"id": "x", "centroid": 3, "": None, "ID": 4, "kind": "load-bearing"}, {"id": 0}]
    check_attributes(held, PAPER_ONTOLOGY, "a.json")
