"""Published files are read exactly, and whatever else a pickle asks for is refused unread."""

import gc
import pickle
import struct
import zipfile
from pathlib import Path

import networkx
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.io import published as module
from sg3d_jax.io.published import read_published
from sg3d_jax.scene.graph import features_of, make_graph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PART_OF, PLANE, PROXIMITY
from sg3d_jax.scene.validate import validate_graph

SHARED = Path(__file__).parents[3] / "shared" / "data"
PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)
TYPES = ("ws", *PAPER_ONTOLOGY.names[1:])


def published(graph, seed=0, ids=None):
    """Returns a graph of ours as the authors have theirs: in another order, with all its traps."""
    rng = np.random.default_rng(seed)
    label, position = graph.nodes.label, graph.nodes.position
    normal, width = graph.nodes.normal, graph.nodes.width
    ids = ids or [2 * row + 5 for row in range(len(label))]
    theirs = networkx.Graph()
    for row in np.argsort(rng.permutation(PAPER_ONTOLOGY.num_concepts)[label], kind="stable"):
        centre = position[row].copy()
        attributes = {
            "type": TYPES[label[row]],
            "center": centre if row % 2 else list(centre),
            "x": centre,
            "viz": {"type": "Point", "feat": "ro", "data": np.array([]), "center": centre},
        }
        if label[row] == PLANE:
            along = np.array([-normal[row, 1], normal[row, 0], 0]) * width[row] * 0.75
            attributes |= {
                "normal": normal[row],
                "length": width[row],
                "limits": [centre + along, centre - along],
                "y": 3,
                "canonic_normal_index": [1, 0, 0],
                "linewidth": 2.0,
            }
        else:
            attributes |= {"normal": [0, 0, 1], "width": 1.5, "polygon": [(0.0, 1.0), (2.0, 3.0)]}
        theirs.add_node(ids[row], **attributes)
    for relation in (PROXIMITY, PART_OF):
        for i, j in undirected_edges(graph, relation):
            target = np.int64(ids[j]) if relation == PROXIMITY and type(ids[j]) is int else ids[j]
            theirs.add_edge(ids[i], target, type="common", label=0, viz_feat="a", x=[])
    views = theirs.nodes, theirs.edges  # are cached now, and pickled with the graph
    assert all(views)
    return theirs


def assert_same_graph(left, right):
    for one, other in zip(left.nodes, right.nodes, strict=True):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(undirected_edges(left, relation), undirected_edges(right, relation))


def refusal(path):
    with pytest.raises(ValueError, match="expected") as caught:
        read_published(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}: ")
    assert "\n" not in sentence
    assert len(sentence) < len(str(path)) + 250
    return sentence.removeprefix(f"{path}: ")


@pytest.fixture(scope="module")
def graphs():
    """A floor of two rooms or more, and a city with proximity edges; the smallest of several."""
    floors = [graph for graph in registry.make("s-f", 40) if len(graph.nodes.label) > 10]
    floor = min(floors, key=lambda graph: len(graph.nodes.label))
    city = min(registry.make("s-c", 4), key=lambda graph: len(graph.nodes.label))
    assert len(undirected_edges(city, PROXIMITY)) > 0
    return [floor, city]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "m-f.pkl"


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("core", [b"numpy._core.", b"numpy.core."])
def test_graphs_are_read_bit_for_bit_in_every_protocol(graphs, protocol, core, path):
    theirs = published(graphs[0])
    theirs.add_edge(5, 7, type="common")  # two planes: near each other, whatever the edge says
    pickled = pickle.dumps([theirs, theirs], protocol)
    if protocol < 4:  # names are lines, so that the old name of the same module fits in
        pickled = pickled.replace(b"numpy._core.", core)
    path.write_bytes(pickled)
    part_of = undirected_edges(graphs[0], PART_OF)
    nodes = graphs[0].nodes.label, graphs[0].nodes.position
    edges = {"part_of": part_of, "proximity": [[0, 1]]}
    expected = make_graph(*nodes, **features_of(graphs[0]), **edges)
    for read in read_published(path):
        assert_same_graph(read, expected)


def test_nodes_are_put_in_order_of_concepts_and_else_stay_as_they_were(graphs, path):
    assert set(graphs[1].nodes.label.tolist()) == set(range(PAPER_ONTOLOGY.num_concepts))
    path.write_bytes(pickle.dumps([published(graphs[1], seed) for seed in range(2)]))
    for read in read_published(path):
        assert_same_graph(read, graphs[1])


def test_ids_may_be_names(graphs, path):
    names = [f"floor_{row}" for row in range(len(graphs[0].nodes.label))]
    path.write_bytes(pickle.dumps([published(graphs[0], ids=names)]))
    assert_same_graph(read_published(path)[0], graphs[0])


def test_arrays_are_read_whatever_their_layout(graphs, path):
    theirs = published(graphs[0])
    for node, attributes in theirs.nodes.items():
        kind = (">f8", "<f8", "=f8")[node % 3]
        attributes["center"] = np.asarray(attributes["center"]).astype(kind)
        if "limits" in attributes:
            order = "F" if node % 2 else "C"
            attributes["limits"] = np.asarray(attributes["limits"], order=order)
            attributes["length"] = None
    path.write_bytes(pickle.dumps([theirs]))
    (read,) = read_published(path)
    npt.assert_array_equal(read.nodes.position, graphs[0].nodes.position)
    npt.assert_allclose(read.nodes.width, 1.5 * graphs[0].nodes.width, rtol=1e-12)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_graphs_share_is_in_each_of_them(graphs, protocol, path):
    first, second, third = (published(graphs[0], seed) for seed in range(3))
    for key, attributes in first.nodes.items():
        second.nodes[key]["center"] = attributes["center"]
        third._node[key] = attributes
    third.graph["others"] = [first, second]
    shared = [first, second, second, third, first]
    path.write_bytes(pickle.dumps(shared, protocol))
    read = read_published(path)
    assert len(read) == 5
    for graph in read:
        assert_same_graph(graph, graphs[0])


@pytest.mark.usefixtures("_unchecked")
def test_one_graph_at_a_time_is_kept(graphs, path, monkeypatch):
    monkeypatch.setattr(gc, "collect", lambda: 0)  # takes long with all that tests have imported
    path.write_bytes(pickle.dumps([published(graphs[0], seed) for seed in range(20)]))
    size = path.stat().st_size
    for read in read_published(path, most=size + 400_000):
        assert_same_graph(read, graphs[0])
    path.write_bytes(pickle.dumps([[published(graphs[0], seed) for seed in range(20)]]))
    assert refusal(path).startswith("graph 0: there are no")
    with pytest.raises(ValueError, match="describes more than fits into memory"):
        read_published(path, most=size + 100_000)


def test_a_graph_or_a_list_too_large_is_refused(graphs, path, monkeypatch):
    path.write_bytes(pickle.dumps([published(graphs[0])] * 3))
    monkeypatch.setattr(module, "MAX_GRAPHS", 2)
    assert refusal(path) == "there are 3 graphs, expected 2 at most"
    monkeypatch.undo()
    size = len(graphs[0].nodes.label) + len(graphs[0].senders)
    monkeypatch.setattr(module, "MAX_SIZE", size)
    assert len(read_published(path)) == 3
    monkeypatch.setattr(module, "MAX_SIZE", size - 1)
    expected = f"graph 0: there are {size} nodes and ends of edges, expected {size - 1} at most"
    assert refusal(path) == expected


def zipped(path, members, **options):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content, **options)
    return path


@pytest.mark.parametrize("name", ["m-f.zip", "m-f.pkl"])
def test_a_zip_is_opened_whatever_is_beside_the_pickle(graphs, name, tmp_path):
    pickled = pickle.dumps([published(graph) for graph in graphs])
    extra = {"__MACOSX/data/._m-f.pkl": b"x", ".DS_Store": b"x", "data/README.md": b"x"}
    path = zipped(tmp_path / name, {"data/": b"", "data/m-f.pkl": pickled} | extra)
    for read, graph in zip(read_published(path), graphs, strict=True):
        assert_same_graph(read, graph)


@pytest.mark.usefixtures("_unchecked")
@pytest.mark.skipif(not SHARED.is_dir(), reason="the authors' sample is not here")
@pytest.mark.parametrize(("name", "count"), [("S-F", 20), ("S-C", 12)])
def test_graphs_of_the_original_generator_are_read_as_unpickled(name, count):
    file = SHARED / f"published_format_{name}.pkl"
    read = read_published(file)
    with pytest.warns(DeprecationWarning, match="numpy.core"), file.open("rb") as stream:
        expected = pickle.load(stream)
    assert len(read) == len(expected) == count
    for graph, theirs in zip(read, expected, strict=True):
        validate_graph(graph, name)
        nodes = sorted(theirs.nodes.values(), key=lambda node: TYPES.index(node["type"]))
        npt.assert_array_equal(graph.nodes.position, [node["center"] for node in nodes])
        widths = [node["length"] for node in nodes if node["type"] == "ws"]
        npt.assert_array_equal(graph.nodes.width[: len(widths)], widths)
        edges = sum(len(undirected_edges(graph, relation)) for relation in (PART_OF, PROXIMITY))
        assert edges == theirs.number_of_edges()
        assert np.sum(graph.nodes.label == FLOOR) == sum(n["type"] == "floor" for n in nodes)


# What a pickle might try, and that it is not done.


class Call:
    """Pickled as a call of a function."""

    def __init__(self, function, *arguments, state=None):
        self.reduced = (function, arguments, *([state] if state is not None else []))

    def __reduce__(self):
        return self.reduced

    def __call__(self):
        """The result of one call may be called in turn."""


def hostile_calls(marker):
    """Each leaves a file behind, if it is run."""
    import os

    write = f"open({str(marker)!r}, 'w').close()"
    return {
        "posix.system": Call(os.system, f"touch {marker}"),
        "os.mkdir": Call(os.mkdir, str(marker)),
        "eval": Call(eval, write),
        "exec": Call(exec, write),
        "getattr": Call(Call(getattr, Call(__import__, "os"), "mkdir"), str(marker)),
        "numpy.save": Call(np.save, str(marker), 1),
        "networkx.write_edgelist": Call(networkx.write_edgelist, networkx.Graph(), str(marker)),
    }


def places_for(value, graph):
    """A value where it can be in a pickle."""
    node = next(iter(graph.nodes))
    inside, edge, attribute, state = (graph.copy() for _ in range(4))
    inside.nodes[node]["center"] = value
    edge.add_edge(*next(iter(graph.edges)), x=[value])
    attribute.graph["name"] = {"deep": [(value,)]}
    state._node = Call(dict, state=value)
    return {
        "alone": value,
        "in the list": [graph, value],
        "in a node": [inside],
        "in an edge": [edge],
        "in the graph": [attribute],
        "as a state": [state],
    }


HOSTILE = sorted(hostile_calls("x"))


@pytest.mark.usefixtures("_unchecked")
@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", HOSTILE)
def test_what_a_pickle_would_run_is_named_and_not_run(graphs, name, protocol, path, tmp_path):
    marker = tmp_path / "marker"
    call = hostile_calls(marker)[name]
    for place, value in places_for(call, published(graphs[0])).items():
        path.write_bytes(pickle.dumps(value, protocol))
        assert refusal(path).startswith("the pickle asks for "), place
        assert not any(tmp_path.glob("marker*")), place


@pytest.mark.parametrize("name", HOSTILE)
def test_those_pickles_do_run_elsewhere(name, tmp_path):
    pickle.loads(pickle.dumps(hostile_calls(tmp_path / "marker")[name]))
    assert any(tmp_path.glob("marker*"))


def test_the_refusal_says_what_was_asked_for(path):
    import os

    path.write_bytes(pickle.dumps(Call(os.system, "true")))
    expected = "the pickle asks for posix.system, expected a pickled list of networkx graphs"
    assert refusal(path) == expected


def text(value):
    return pickle.BINUNICODE + struct.pack("<I", len(value)) + value.encode()


def name(module, attribute):
    return text(module) + text(attribute) + pickle.STACK_GLOBAL


GRAPH = name("networkx.classes.graph", "Graph")
MADE = GRAPH + b")\x81"  # an empty Graph
WORDS = {
    "a method by a dotted name": (name("networkx.classes.graph", "Graph.add_node"), "asks for"),
    "a class of a class": (name("networkx.classes.graph", "Graph.__class__"), "asks for"),
    "another graph": (name("networkx.classes.digraph", "DiGraph"), "asks for"),
    "globals of an admitted module": (name("numpy", "load"), "asks for numpy.load"),
    "a name of several lines": (name("os\n: fine", "system"), "asks for os"),
    "a global by line": (b"cos\nsystem\n", "asks for os.system"),
    "a backslash in a name": (b"cnumpy\\q\nload\n", "asks for numpy"),
    "a name without an end": (b"cnumpy\nload", "is cut short, broken or no pickle"),
    "INST": (b"(ios\nsystem\n", "uses INST"),
    "OBJ": (b"(" + GRAPH + b"o", "uses OBJ"),
    "NEWOBJ_EX": (GRAPH + b")}\x92", "uses NEWOBJ_EX"),
    "EXT1": (b"\x82\x01", "uses EXT1"),
    "EXT2": (b"\x83\x01\x00", "uses EXT2"),
    "EXT4": (b"\x84\x01\x00\x00\x00", "uses EXT4"),
    "PERSID": (b"Pid\n", "uses PERSID"),
    "BINPERSID": (b"K\x01Q", "uses BINPERSID"),
    "NEXT_BUFFER": (b"\x97", "uses NEXT_BUFFER"),
    "a call of an object": (MADE + b")R", "is cut short, broken or no pickle"),
    "a call of a text": (text("os.system") + b")R", "is cut short, broken or no pickle"),
    "a call without a tuple": (GRAPH + b"]R", "is cut short, broken or no pickle"),
    "a state of a class": (GRAPH + b"}b", "is cut short, broken or no pickle"),
    "a state of a list": (b"]}b", "is cut short, broken or no pickle"),
    "a second state": (MADE + b"}b}b", "second state"),
    "items of an object": (MADE + b"K\x01a", "is cut short, broken or no pickle"),
    "keys of an object": (MADE + b"K\x01K\x02s", "is cut short, broken or no pickle"),
    "a memo of 64 GiB": (b"]r\xff\xff\xff\xff]", "is cut short, broken or no pickle"),
    "a memo of any size": (b"]p" + b"9" * 40 + b"\n]", "is cut short, broken or no pickle"),
    "the last of the memo": (b"]p0\ng-1\n", "is cut short, broken or no pickle"),
    "what is not in the memo": (b"h\x07", "is cut short, broken or no pickle"),
    "an array of a TiB": (b"\x96" + struct.pack("<Q", 2**40), "is cut short, broken or no"),
    "bytes of 16 EiB": (b"\x8e" + b"\xff" * 8, "is cut short, broken or no pickle"),
    "an integer of 2000 bytes": (
        b"\x8b" + struct.pack("<i", 2000) + b"\x7f" * 2000,
        "an integer of 15999 bits",
    ),
    "a nested key": (b"}" + b")" + b"\x85" * 10**5 + b"Ns", "has a key that is a tuple"),
    "a list as key": (b"}]Ns", "is cut short, broken or no pickle"),
    "an empty stack": (b"", "is cut short, broken or no pickle"),
    "no mark": (b"]e", "is cut short, broken or no pickle"),
    "a list in itself": (b"](h\x00e", "is cut short, broken or no pickle"),
    "two values": (b"]]", "is cut short, broken or no pickle"),
    "no list": (b"N", "holds no list or an empty one"),
    "an empty list": (b"]", "holds no list or an empty one"),
    "a list of numbers": (b"]K\x01a", "graph 0: there are no _node and _adj"),
    "a class in a list": (b"]" + GRAPH + b"a", "graph 0: there are no _node and _adj"),
    "a graph without a state": (b"]" + MADE + b"a", "graph 0: there are no _node and _adj"),
    "slots as a state": (b"]" + MADE + b"N}\x86ba", "graph 0: there are no _node and _adj"),
    "itself as a state": (b"]" + MADE + b"\x94h\x00ba", "graph 0: there are no _node and _adj"),
    "an unknown word": (b"\xff", "is cut short, broken or no pickle"),
}


@pytest.mark.usefixtures("_unchecked")
@pytest.mark.parametrize("attack", WORDS)
def test_a_word_that_does_more_than_build_values_is_refused(attack, path):
    words, sentence = WORDS[attack]
    path.write_bytes(b"\x80\x04" + words + b".")
    assert sentence in refusal(path)


def test_a_refused_pickle_leaves_nothing_for_the_next(graphs, path):
    good = pickle.dumps([published(graphs[0])])
    for words in (
        GRAPH + b"}" + text("__reduce__") + b"Nsb",
        GRAPH + b"N}" + text("x") + b"Ns\x86b",
    ):
        path.write_bytes(b"\x80\x04" + words + b".")
        refusal(path)
        path.write_bytes(good)
        assert_same_graph(read_published(path)[0], graphs[0])


def changed(graph, kind, without=None, **attributes):
    """The graph with other attributes of its first node of a type."""
    graph = published(graph)
    node = next(node for node, held in graph.nodes.items() if held["type"] == kind)
    graph.nodes[node].update(attributes)
    graph.nodes[node].pop(without, None)
    return graph


def endless():
    value = [0.0]
    value.append(value)
    return value


BROKEN = [
    ("ws", {"without": "type"}, "lacks both 'concept' and 'type'"),
    ("ws", {"without": "center"}, "lacks 'center'"),
    ("ws", {"without": "normal"}, "lacks 'normal'"),
    ("ws", {"type": "attic"}, "type is 'attic', expected one of"),
    ("ws", {"type": np.array([1])}, "type is [1], expected one of"),
    ("ws", {"center": np.zeros(2)}, "center is [0.0, 0.0], expected three numbers"),
    ("ws", {"center": np.zeros((3, 3))}, "expected a number"),
    ("ws", {"center": np.zeros(10**5)}, "expected three numbers"),
    ("ws", {"center": np.array([None, 0, 0])}, "_reconstruct>, expected three numbers"),
    ("ws", {"center": np.zeros(3, complex)}, ">, expected three numbers"),
    ("ws", {"center": np.zeros(3, "datetime64[s]")}, ">, expected three numbers"),
    ("ws", {"center": np.zeros(3, "f4,f4")}, ">, expected three numbers"),
    ("ws", {"center": np.zeros(3, "S8")}, ">, expected three numbers"),
    ("ws", {"center": np.dtype("f8")}, "<numpy.dtype>, expected three numbers"),
    ("ws", {"center": [0, 0, np.str_("x")]}, ">, expected a number"),
    ("ws", {"center": [0, 0, True]}, "expected a number"),
    ("ws", {"center": endless()}, "expected three numbers"),
    ("ws", {"center": [0.0, 0.0, endless()]}, "expected a number"),
    ("ws", {"center": {0: 1.0}}, "expected three numbers"),
    ("ws", {"length": "two"}, "length is 'two', expected a number"),
    ("ws", {"length": -1.0}, ".width is -1, expected zero metres or more"),
    ("ws", {"length": np.nan}, ".width is nan, expected finite numbers"),
    ("ws", {"normal": np.zeros(3)}, ".normal is [0, 0, 0], expected length 1"),
    ("room", {"center": [0.0, np.inf, 0.0]}, ".position is [0, inf, 0], expected finite"),
    ("floor", {"type": "ws"}, "lacks 'length'"),
    ("floor", {"type": "wall"}, "joins wall and room, expected two that are observed, or a part"),
]


@pytest.mark.parametrize(("kind", "change", "sentence"), BROKEN)
def test_a_broken_node_is_refused_in_one_sentence(graphs, kind, change, sentence, path):
    change = change | ({"limits": None} if kind == "floor" else {})
    path.write_bytes(pickle.dumps([published(graphs[0]), changed(graphs[0], kind, **change)], 4))
    found = refusal(path)
    assert found.startswith("graph 1: ")
    assert sentence in found


def test_what_is_wrong_with_the_pickle_is_told_before_what_is_wrong_with_a_graph(graphs, path):
    good, bad = published(graphs[0]), changed(graphs[0], "ws", type="attic")
    pickled = pickle.dumps([good, good, bad, bad, good])
    path.write_bytes(pickled)
    assert refusal(path).startswith("graph 2: node ")
    path.write_bytes(pickled[:-1])
    assert refusal(path).startswith("the file is cut short")
    path.write_bytes(pickle.dumps([good, [bad], good])[:-1] + b"0N.")
    assert refusal(path).startswith("the pickle holds no list")


@pytest.mark.usefixtures("_unchecked")
def test_a_deeply_nested_value_is_refused(graphs, path):
    pickled = pickle.dumps([changed(graphs[0], "room", center=["here"])], 4)
    assert b"\x8c\x04here" in pickled
    for deep in (b"]" * 10**4 + b"a" * (10**4 - 1), b")" + b"\x85" * 10**4):
        path.write_bytes(pickled.replace(b"\x8c\x04here", deep))
        assert "expected" in refusal(path)


def _loop(graph):
    graph._adj[5][5] = {}


def _missing_end(graph):
    graph._adj[5][1000] = {}
    graph._adj[1000] = {5: {}}


def _one_way(graph):
    graph._adj[5].pop(next(iter(graph._adj[5])))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (_loop, "is a loop, expected two nodes"),
        (_missing_end, "an edge names 1000, expected the id of a node"),
        (_one_way, "has no opposite, expected an undirected graph"),
        (lambda graph: graph.__dict__.pop("_adj"), "there are no _node and _adj"),
        (lambda graph: graph.__dict__.update(_adj=[]), "there are no _node and _adj"),
        (lambda graph: graph._adj.update({5: None}), "node 5 has no neighbours in _adj"),
        (lambda graph: graph._node.update({5: None}), "node 5 has no attributes"),
        (lambda graph: graph._node.update({True: {}}), "a node has id True, expected an integer"),
        (lambda graph: graph._node.update({1.5: {}}), "a node has id 1.5, expected an integer"),
        (lambda graph: graph._node.update({np.int64(10**6): {}}), "node 1000000 lacks both"),
        (lambda graph: graph._node.clear(), "an edge names"),
    ],
)
def test_broken_edges_and_ids_are_refused_in_one_sentence(graphs, change, sentence, path):
    graph = published(graphs[0])
    change(graph)
    path.write_bytes(pickle.dumps([graph]))
    assert sentence in refusal(path)


@pytest.mark.parametrize("protocol", [2, 5])
def test_one_node_under_two_keys_is_refused(graphs, protocol, path):
    graph = published(graphs[0])
    graph._node[np.int64(10**6)] = graph._node[5]
    graph._node[10**6 + 1] = graph._node[5]
    pickled = pickle.dumps([graph], protocol)
    number = struct.pack("<i", 10**6 + 1)
    assert pickled.count(number) == 1
    path.write_bytes(pickled.replace(number, struct.pack("<i", 10**6)))
    assert "node 1000000 is there twice" in refusal(path)


def test_another_file_is_refused_in_one_sentence(tmp_path):
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
    files = {
        b"": "the file is empty",
        pointer: "the file is a git-lfs pointer, not the data",
        b"<html></html>": "is cut short, broken or no pickle",
        b"\x89PNG\r\n\x1a\n": "the pickle uses PERSID",
        b"PK\x03\x04": "the zip is cut short or broken",
    }
    for content, sentence in files.items():
        (tmp_path / "m-f.pkl").write_bytes(content)
        assert sentence in refusal(tmp_path / "m-f.pkl")
    (tmp_path / "m-f.zip").write_bytes(b"hello")
    assert "the zip is cut short or broken" in refusal(tmp_path / "m-f.zip")
    assert "No such file" in refusal(tmp_path / "none.zip")
    assert "expected a file to read" in refusal(tmp_path)


def test_a_zip_without_its_one_pickle_is_refused_in_one_sentence(tmp_path):
    assert "holds 0 pickles" in refusal(zipped(tmp_path / "a.zip", {"a.txt": b"x"}))
    assert "holds 2 pickles" in refusal(zipped(tmp_path / "b.zip", {"a.pkl": b"x", "b.p": b"x"}))
    lzma = zipped(tmp_path / "c.zip", {"a.pkl": b"x"}, compress_type=zipfile.ZIP_LZMA)
    assert "is compressed by method 14, expected deflate" in refusal(lzma)
    big = zipped(tmp_path / "d.zip", {"a.pkl": b"x"}).read_bytes()
    place = big.index(b"PK\x01\x02")
    (tmp_path / "e.zip").write_bytes(big[: place + 24] + b"\xf0" * 4 + big[place + 28 :])
    assert "holds a pickle of 4042322160 bytes" in refusal(tmp_path / "e.zip")
    (tmp_path / "f.zip").write_bytes(big[: place + 8] + b"\x01" + big[place + 9 :])
    assert "is encrypted" in refusal(tmp_path / "f.zip")
