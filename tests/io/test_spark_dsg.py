import importlib
import inspect
import json
import os

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import synthetic
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.io.formats import read_graphs, read_with_attributes, write_graphs, write_into
from sg3d_jax.io.spark_dsg import graph_from_spark_dsg, graph_to_spark_dsg, read_spark_dsg
from sg3d_jax.scene.graph import features_of, make_graph, parts_first, subgraph, undirected_edges
from sg3d_jax.scene.ontology import (
    BUILDING,
    CITY,
    FLOOR,
    PAPER_ONTOLOGY,
    PART_OF,
    PLANE,
    PROXIMITY,
    ROOM,
    WALL,
)

WALLS = ("edges", "metadata")


def city(seed=0):
    """Returns one node of every concept above two rooms of two planes each, and proximity."""
    rng = np.random.default_rng(seed)
    label = [*[PLANE] * 4, WALL, ROOM, ROOM, FLOOR, BUILDING, CITY]
    angle = rng.uniform(0, 6, 4)
    normal = np.zeros((10, 3))
    normal[:4, :2] = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    width = np.zeros(10)
    width[:4] = rng.uniform(0.5, 8, 4)
    part_of = [[0, 5], [1, 5], [2, 6], [3, 6], [1, 4], [2, 4], [5, 7], [6, 7], [7, 8], [8, 9]]
    return make_graph(
        label, rng.normal(0, 9, (10, 3)), normal, width, part_of, [[0, 1], [1, 2], [0, 3]]
    )


def shuffled(seed=0):
    """Returns a graph whose concepts are mixed, as a growth step in mixed order may leave it."""
    return subgraph(city(seed), np.random.default_rng(seed).permutation(10))


def document(walls="edges"):
    return json.loads(json.dumps(graph_to_spark_dsg(city(), walls)))


def assert_same_graph(left, right):
    for one, other in zip(left.nodes, right.nodes, strict=True):
        assert one.tobytes() == other.tobytes()
    for relation in (PART_OF, PROXIMITY):
        npt.assert_array_equal(undirected_edges(left, relation), undirected_edges(right, relation))


def library():
    """Returns their package; .ci/run says where it has installed it, there its absence fails."""
    if "SG3D_HAS_SPARK_DSG" in os.environ:
        return importlib.import_module("spark_dsg")
    return pytest.importorskip("spark_dsg")


@pytest.mark.parametrize("walls", WALLS)
@pytest.mark.parametrize("graph", [city(), shuffled()], ids=["city", "shuffled"])
def test_a_graph_survives_its_file_bit_for_bit(tmp_path, graph, walls):
    write_graphs(tmp_path / "a.json", [graph], "spark-dsg", [{"seed": 1}], walls=walls)
    (read,) = read_graphs(tmp_path / "a.json")
    assert_same_graph(read, graph)
    assert json.loads((tmp_path / "a.json").read_text())["metadata"]["seed"] == 1


def test_edges_that_break_the_hierarchy_survive():
    graph = city()
    nodes = graph.nodes.label, graph.nodes.position
    edges = {"part_of": [[0, 9], [5, 6], [0, 1], [4, 5]], "proximity": [[5, 7], [2, 3]]}
    wild = make_graph(*nodes, **features_of(graph), **edges)
    for walls in WALLS:
        assert_same_graph(graph_from_spark_dsg(graph_to_spark_dsg(wild, walls)), wild)


def test_every_concept_is_a_layer_and_every_symbol_a_letter_and_a_row():
    nodes = graph_to_spark_dsg(city())["nodes"]
    assert [node["layer"] for node in nodes] == [2, 2, 2, 2, 2, 4, 4, 5, 6, 7]
    assert [node["partition"] for node in nodes] == [*[ord("p")] * 4, ord("w"), *[0] * 5]
    symbols = [(chr(node["id"] >> 56), node["id"] & (2**56 - 1)) for node in nodes]
    assert symbols == list(zip("ppppwRRFBC", range(10), strict=True))
    assert nodes[6]["attributes"]["name"] == "room 6"
    assert nodes[6]["id"] == 5908722711110090758


def test_parents_come_first_in_edges():
    made = graph_to_spark_dsg(city())
    layer = {node["id"]: node["layer"] for node in made["nodes"]}
    for edge in made["edges"]:
        if edge["info"]["metadata"]["relation"] == "part_of":
            assert layer[edge["source"]] >= layer[edge["target"]]


def test_every_node_has_one_parent_in_a_layer_further_up_and_walls_are_no_parents():
    made = graph_to_spark_dsg(city())
    layer = {node["id"]: node["layer"] for node in made["nodes"]}
    parents = [e["target"] for e in made["edges"] if layer[e["source"]] > layer[e["target"]]]
    ids = [node["id"] for node in made["nodes"]]
    assert sorted(parents) == sorted(ids[:4] + ids[5:9])


def test_walls_in_metadata_are_no_edges():
    made = graph_to_spark_dsg(city(), "metadata")
    part_of = [e for e in made["edges"] if e["info"]["metadata"]["relation"] == "part_of"]
    children = [edge["target"] for edge in part_of]
    assert len(part_of) == 8
    assert len(set(children)) == len(children)
    wall = made["nodes"][4]["id"]
    held = [node["attributes"]["metadata"].get("walls") for node in made["nodes"]]
    assert held == [None, [wall], [wall], *[None] * 7]


SURE = np.linspace(0, 1, 10)  # of edges
HELD = [{"id": f"n{row}", "confidence": row / 9, "seen": [row, None]} for row in range(10)]


@pytest.mark.parametrize("walls", WALLS)
def test_metadata_say_what_else_is_known_and_how_sure_it_is(walls):
    made = json.loads(json.dumps(graph_to_spark_dsg(city(), walls, HELD, SURE)))
    ids, kept = zip(*((n["id"], n["attributes"]["metadata"]) for n in made["nodes"]), strict=True)
    assert {name: kept[5][name] for name in HELD[5]} == HELD[5]
    said = {frozenset((e["source"], e["target"])): e["info"]["metadata"] for e in made["edges"]}
    for (part, whole), value in zip(parts_first(city()).tolist(), SURE, strict=True):
        if walls == "metadata" and whole == 4:
            assert kept[part]["walls_confidence"] == [value]
        else:
            of_edge = said[frozenset((ids[part], ids[whole]))]
            assert of_edge == {"relation": "part_of", "confidence": value}
    assert said[frozenset(ids[:2])] == {"relation": "proximity"}
    read = read_spark_dsg(made)
    assert_same_graph(read.graph, city())
    assert read.attributes == HELD
    npt.assert_array_equal(read.edge_confidence, SURE)


def test_in_whatever_order_a_document_lists_nodes_and_edges_the_same_is_read():
    made = graph_to_spark_dsg(city(), "edges", HELD, SURE)
    read = read_spark_dsg(made | {key: made[key][::-1] for key in ("nodes", "edges")})
    assert_same_graph(read.graph, city())
    assert read.attributes == HELD
    npt.assert_array_equal(read.edge_confidence, SURE)


@pytest.mark.parametrize("said", [None, "high", [0.5, 0.5], [2], ["high"]])
def test_confidence_of_walls_that_is_none_is_let_through(said):
    made = graph_to_spark_dsg(city(), "metadata", HELD, SURE)
    made["nodes"][1]["attributes"]["metadata"]["walls_confidence"] = said
    read = read_spark_dsg(made)
    assert read.edge_confidence is None
    assert read.attributes == HELD


def test_only_what_was_not_observed_is_predicted():
    predicted = [n["attributes"]["is_predicted"] for n in graph_to_spark_dsg(city())["nodes"]]
    assert predicted == [False] * 4 + [True] * 6


def test_colours_are_those_of_the_pictures():
    colour = graph_to_spark_dsg(city())["nodes"][0]["attributes"]["color"]
    assert colour == {"r": 0x1D, "g": 0x4E, "b": 0xD8, "a": 255}


def test_a_box_holds_the_planes_below_a_node():
    label, no_normal = [PLANE, PLANE, ROOM, FLOOR, BUILDING], [0.0, 0.0, 0.0]
    position = [[0, 1, 1], [2, 0, 1], [9, 9, 9], [9, 9, 9], [0, 0, 0]]
    normal = [[1, 0, 0], [0, 1, 0], *[no_normal] * 3]
    graph = make_graph(label, position, normal, [2, 4, 0, 0, 0], [[0, 2], [1, 2], [2, 3]])
    boxes = [n["attributes"]["bounding_box"] for n in graph_to_spark_dsg(graph)["nodes"]]
    assert [box["type"] for box in boxes] == ["AABB"] * 4 + ["INVALID"]
    assert [box["dimensions"] for box in boxes[:2]] == [[0, 2, 0], [4, 0, 0]]
    for box in boxes[2:4]:
        assert box["dimensions"] == [4, 2, 0]
        assert box["world_P_center"] == [2, 1, 1]


def test_a_wrong_mode_is_refused():
    with pytest.raises(ValueError, match="walls is 'tree', expected 'edges' or 'metadata'"):
        inspect.unwrap(graph_to_spark_dsg)(city(), "tree")  # past the check of types


def test_a_broken_graph_is_not_written(tmp_path):
    graph = city()
    graph.nodes.width[0] = np.nan
    with pytest.raises(ValueError, match=r"a\.json: graph 0: nodes\[0\]\.width is nan"):
        write_graphs(tmp_path / "a.json", [graph], "spark-dsg")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("walls", WALLS)
def test_their_library_sees_the_same_graph(tmp_path, walls):
    spark_dsg, graph = library(), city()
    write_graphs(tmp_path / "a.json", [graph], "spark-dsg", walls=walls)
    written = json.loads((tmp_path / "a.json").read_text())
    loaded = spark_dsg.DynamicSceneGraph.load(str(tmp_path / "a.json"))
    ids = [node["id"] for node in written["nodes"]]
    assert {node.id.value for node in loaded.nodes} == set(ids)
    for label, concept in enumerate(PAPER_ONTOLOGY.concepts):
        inside = {node.id.value for node in loaded.get_layer(concept.layer).nodes}
        assert inside == {ids[row] for row in np.flatnonzero(graph.nodes.label == label)}
    pairs = {frozenset((edge.source, edge.target)) for edge in loaded.edges}
    assert pairs == {frozenset((edge["source"], edge["target"])) for edge in written["edges"]}
    for row, name in enumerate(ids):
        attributes = loaded.get_node(name).attributes
        npt.assert_array_equal(attributes.position, graph.nodes.position[row])
        assert attributes.is_predicted == (graph.nodes.label[row] != PLANE)
    assert loaded.num_edges() == len(written["edges"])
    assert loaded.get_node(ids[6]).get_parent() == ids[7]
    rooms = [loaded.get_node(name).get_parent() for name in ids[:4]]
    assert rooms == [ids[5], ids[5], ids[6], ids[6]]
    assert set(loaded.get_node(ids[7]).children()) == {ids[5], ids[6]}
    assert set(loaded.get_node(ids[0]).siblings()) == {ids[1], ids[3]}
    assert (ids[4] in loaded.get_node(ids[1]).siblings()) == (walls == "edges")


@pytest.mark.parametrize("walls", WALLS)
def test_what_their_library_saves_again_is_the_same_graph(tmp_path, walls):
    spark_dsg = library()
    for graph in (city(), shuffled(), synthetic.make_scene(synthetic.S_F, 0, 3)):
        write_graphs(tmp_path / "a.json", [graph], "spark-dsg", walls=walls)
        spark_dsg.DynamicSceneGraph.load(str(tmp_path / "a.json")).save(str(tmp_path / "b.json"))
        (read,) = read_graphs(tmp_path / "b.json")
        assert_same_graph(read, graph)


@pytest.mark.parametrize("walls", WALLS)
def test_what_else_is_known_survives_their_library(tmp_path, walls):
    spark_dsg = library()
    said = {"attributes": [HELD], "edge_confidence": [SURE]}
    write_graphs(tmp_path / "a.json", [city()], "spark-dsg", walls=walls, **said)
    loaded = spark_dsg.DynamicSceneGraph.load(str(tmp_path / "a.json"))
    assert loaded.get_node(spark_dsg.NodeSymbol("R", 5)).attributes.metadata.get()["id"] == "n5"
    loaded.save(str(tmp_path / "b.json"))
    (read,) = read_with_attributes(tmp_path / "b.json")
    assert_same_graph(read.graph, city())
    assert read.attributes == HELD
    npt.assert_array_equal(read.edge_confidence, SURE)


def test_no_field_of_theirs_is_missing(tmp_path):
    spark_dsg = library()
    write_graphs(tmp_path / "a.json", [city()], "spark-dsg")
    spark_dsg.DynamicSceneGraph.load(str(tmp_path / "a.json")).save(str(tmp_path / "b.json"))
    ours, theirs = (json.loads((tmp_path / name).read_text()) for name in ("a.json", "b.json"))
    assert set(ours) == set(theirs)
    attributes = ({n["id"]: n["attributes"] for n in both["nodes"]} for both in (ours, theirs))
    for name, fields in next(attributes).items():
        same = dict(fields, bounding_box=None)  # kept in single precision by them
        theirs_of = {node["id"]: node["attributes"] for node in theirs["nodes"]}
        assert same == dict(theirs_of[name], bounding_box=None)


def test_rooms_and_buildings_that_their_library_made_are_read(tmp_path):
    spark_dsg = library()
    graph, places = spark_dsg.DynamicSceneGraph(), {"R": "ROOMS", "B": "BUILDINGS"}
    for symbol, position in (("R1", [1, 2, 3]), ("B0", [4, 5, 6]), ("R0", [0, 0, 0.1])):
        attributes = spark_dsg.RoomNodeAttributes()
        attributes.position = np.array(position, float)
        name = spark_dsg.NodeSymbol(symbol[0], int(symbol[1])).value
        graph.add_node(places[symbol[0]], name, attributes)
    rooms = [spark_dsg.NodeSymbol("R", index).value for index in (0, 1)]
    for pair in ([spark_dsg.NodeSymbol("B", 0).value, rooms[0]], rooms):
        graph.insert_edge(*pair)
    graph.save(str(tmp_path / "a.json"))
    (read,) = read_graphs(tmp_path / "a.json")
    assert read.nodes.label.tolist() == [ROOM, ROOM, BUILDING]
    npt.assert_array_equal(read.nodes.position, [[0, 0, 0.1], [1, 2, 3], [4, 5, 6]])
    npt.assert_array_equal(undirected_edges(read, PART_OF), [[0, 2]])
    npt.assert_array_equal(undirected_edges(read, PROXIMITY), [[0, 1]])


def hydra():
    """Returns the layers of Hydra around one object, one room and one building."""

    def key(layer, partition=0):
        return {"layer": layer, "partition": partition}

    def node(letter, layer, **fields):
        attributes = {"type": "SemanticNodeAttributes", "position": [0.0, 1.0, 2.0]}
        return {"id": ord(letter) << 56, **key(layer), "attributes": attributes | fields}

    edge = {"source": ord("B") << 56, "target": ord("R") << 56, "info": {"type": "EdgeAttributes"}}
    names = {"AGENTS": 2, "OBJECTS": 2, "PLACES": 3, "ROOMS": 4, "BUILDINGS": 5}
    return {
        "SPARK_DSG_header": {"project_name": "main", "version": {"major": 1, "minor": 1}},
        "layer_keys": [key(layer) for layer in range(2, 6)],
        "layer_names": {name: key(layer) for name, layer in names.items()},
        "nodes": [node("R", 4, metadata=None), node("B", 5)],
        "edges": [edge],
    }


def test_layers_without_nodes_may_have_any_name():
    read = graph_from_spark_dsg(hydra())
    assert read.nodes.label.tolist() == [ROOM, BUILDING]
    npt.assert_array_equal(undirected_edges(read, PART_OF), [[0, 1]])


def test_symbols_that_are_not_numbered_by_row_are_ids():
    assert read_spark_dsg(document()).attributes == [{}] * 10
    foreign = hydra()
    foreign["nodes"][0]["id"] += 5
    foreign["edges"][0]["target"] += 5
    foreign["nodes"][0]["attributes"]["metadata"] = {"id": "hall", "label": "big", "door": 3}
    read = read_spark_dsg(foreign)
    assert read.graph.nodes.label.tolist() == [BUILDING, ROOM]
    assert read.attributes == [{"id": ord("B") << 56}, {"id": "hall", "door": 3}]


def saved_by_hydra(version="new"):
    """Returns a room and a building with objects, places, a robot and a mesh, as Hydra has them.

    Places have the letter of our planes; "old" and "oldest" are encodings of earlier versions.
    """
    made = hydra()
    pose = {"type": "AgentNodeAttributes", "position": [0.0, 0.0, 0.0]}
    others = [(ord("O"), 2, 0), (ord("p"), 3, 0), (ord("p"), 3, 0), (ord("a"), 2, ord("a"))]
    for number, (letter, layer, partition) in enumerate(others):
        place = {"layer": layer, "partition": partition}
        made["nodes"].append({"id": (letter << 56) + number, **place, "attributes": pose})
    ids = [node["id"] for node in made["nodes"]]
    info = {"type": "EdgeAttributes", "metadata": None}
    made["edges"] += [{"source": ids[i], "target": ids[j], "info": info} for i, j in HYDRA_EDGES]
    made["layer_keys"].append({"layer": 2, "partition": ord("a")})
    made |= {"mesh": {"points": []}, "metadata": {"run": 7}}
    if version != "new":
        del made["layer_keys"]
        made["SPARK_DSG_header"]["version"] = {"major": 1, "minor": 0, "patch": 9}
        made["layer_ids"] = [2, 3, 4, 5]
        made["layer_names"] = {name: v["layer"] for name, v in made["layer_names"].items()}
        for node in made["nodes"]:
            if node.pop("partition"):
                node["timestamp"] = 140141314973
    if version == "oldest":
        del made["layer_names"], made["SPARK_DSG_header"]
    return made


HYDRA_EDGES = [(0, 3), (0, 4), (3, 2), (3, 4), (5, 3)]  # room to places, place to object, ...


@pytest.mark.parametrize(
    ("version", "remarks"),
    [
        ("new", []),
        ("old", ["read the encoding of Spark-DSG 1.0.9 like the newest"]),
        ("oldest", ["read the encoding of Spark-DSG before 1.0 (no header) like the newest"]),
    ],
)
def test_layers_that_are_no_concepts_are_left_out_and_counted(version, remarks, tmp_path):
    building = ord("B") << 56
    text = json.dumps(saved_by_hydra(version)).replace(f"{building}", f"{building + 1}")
    (tmp_path / "dsg.json").write_text(text)  # symbols are numbered as our rows are
    (read,) = read_with_attributes(tmp_path / "dsg.json")
    assert read.graph.nodes.label.tolist() == [ROOM, BUILDING]
    npt.assert_array_equal(undirected_edges(read.graph, PART_OF), [[0, 1]])
    assert read.attributes == [{"id": ord("R") << 56}, {"id": building + 1}]
    said = "2 of PLACES; 1 of AGENTS and OBJECTS; 1 of layer 2, partition 97; the mesh"
    assert read.remarks == (f"left out what is in no layer of ours: {said}", *remarks)


def test_a_file_of_other_layers_alone_is_refused():
    foreign = saved_by_hydra()
    del foreign["nodes"][:2]
    foreign["edges"] = []
    sentence = "^dsg: left out .* 2 of PLACES.*, expected nodes of PLANES, WALLS, ROOMS"
    with pytest.raises(ValueError, match=sentence):
        graph_from_spark_dsg(foreign, "dsg")


def test_a_binary_file_is_named_for_what_it_is(tmp_path):
    (tmp_path / "dsg.sparkdsg").write_bytes(b"\x00")
    with pytest.raises(ValueError, match="binary Spark-DSG, expected its JSON"):
        read_graphs(tmp_path / "dsg.sparkdsg")


def test_names_are_those_that_a_person_gave():
    named = [{}] * 5 + [{"name": "kitchen"}] + [{}] * 4
    made = graph_to_spark_dsg(city(), attributes=named)
    assert [node["attributes"]["name"] for node in made["nodes"][4:7]] == [
        *("wall 4", "kitchen", "room 6")
    ]
    for node in made["nodes"]:
        node["attributes"]["metadata"].pop("name", None)  # as a file of Hydra's
    assert read_spark_dsg(made).attributes == named


@pytest.mark.parametrize("version", ["new", "oldest"])
def test_our_layers_stand_beside_hydras(version, tmp_path):
    theirs = saved_by_hydra(version)
    (tmp_path / "dsg.json").write_text(json.dumps(theirs))
    held = [{"id": ord("R") << 56} if row == 5 else {} for row in range(10)]
    remarks = write_into(tmp_path / "a.json", city(), tmp_path / "dsg.json", held)
    made = json.loads((tmp_path / "a.json").read_text())
    assert remarks == [f"{tmp_path / 'dsg.json'}: replaced 1 of its nodes by ours"]
    assert made["mesh"] == theirs["mesh"]
    assert made["metadata"]["run"] == 7
    assert [node["attributes"] for node in made["nodes"][:4]] == [
        node["attributes"] for node in theirs["nodes"][2:]
    ]
    ids = {node["id"] for node in made["nodes"]}
    assert len(ids) == len(made["nodes"]) == 14
    ends = [(edge["source"], edge["target"]) for edge in made["edges"]]
    assert ends[:5] == [(edge["source"], edge["target"]) for edge in theirs["edges"][1:]]
    assert {end for pair in ends for end in pair} <= ids
    (read,) = read_with_attributes(tmp_path / "a.json")
    assert_same_graph(subgraph(read.graph, [1, 2, 3, 4, 5, 0, 6, 7, 8, 9]), city())
    assert read.attributes[0]["id"] == ord("R") << 56  # the room is the one that Hydra knows


def test_between_nodes_that_are_ours_there_are_our_edges_alone(tmp_path):
    (tmp_path / "dsg.json").write_text(json.dumps(saved_by_hydra()))
    known = {5: {"id": ord("R") << 56}, 8: {"id": ord("B") << 56}}
    held = [known.get(row, {}) for row in range(10)]
    assert write_into(tmp_path / "a.json", city(), tmp_path / "dsg.json", held) == []
    made = json.loads((tmp_path / "a.json").read_text())
    ends = {frozenset((edge["source"], edge["target"])) for edge in made["edges"]}
    assert frozenset(ord(letter) << 56 for letter in "RB") not in ends  # theirs; ours has a floor
    assert len(ends) == len(made["edges"])


def test_edges_of_what_is_replaced_go_with_it_and_are_counted(tmp_path):
    (tmp_path / "dsg.json").write_text(json.dumps(saved_by_hydra()))
    (remark,) = write_into(tmp_path / "a.json", city(), tmp_path / "dsg.json")
    assert remark.endswith("replaced 2 of its nodes by ours, and left out 2 of their edges")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"layer": 0}, r"nodes\[1\] lies in layer 0, partition 0, expected one of PLANES"),
        ({"attributes": {"weight": float("nan")}}, "holds NaN or infinity"),
        ({"id": ord("R") << 56}, r"nodes\[1\]\.id is \d+, expected one that no node before it has"),
    ],
)
def test_a_node_that_could_not_be_read_again_is_not_added_to(change, sentence, tmp_path):
    theirs = saved_by_hydra()
    theirs["nodes"][0]["id"] = ord("R") << 56
    theirs["nodes"][1] |= change
    (tmp_path / "dsg.json").write_text(json.dumps(theirs))
    with pytest.raises(ValueError, match=rf"dsg\.json: {sentence}"):
        write_into(tmp_path / "a.json", city(), tmp_path / "dsg.json")
    assert not (tmp_path / "a.json").exists()


def test_a_layer_of_theirs_where_ours_must_be_is_named(tmp_path):
    theirs = saved_by_hydra()
    theirs["layer_keys"].append({"layer": 6, "partition": 0})
    theirs["layer_names"]["CAMPUS"] = {"layer": 6, "partition": 0}
    (tmp_path / "dsg.json").write_text(json.dumps(theirs))
    sentence = r"dsg\.json: layer 6, partition 0 is CAMPUS, expected it free for BUILDINGS"
    with pytest.raises(ValueError, match=sentence):
        write_into(tmp_path / "a.json", city(), tmp_path / "dsg.json")


def test_what_hydra_saved_is_added_to_and_opened_by_their_library(tmp_path):
    spark_dsg, path = library(), str(tmp_path / "dsg.json")
    graph = spark_dsg.DynamicSceneGraph()
    graph.add_layer(2, ord("a"), "")
    symbol = spark_dsg.NodeSymbol
    for letter, layer, partition, kind in (
        ("O", 2, 0, spark_dsg.ObjectNodeAttributes),
        ("p", 3, 0, spark_dsg.PlaceNodeAttributes),
        ("R", 4, 0, spark_dsg.RoomNodeAttributes),
        ("B", 5, 0, spark_dsg.SemanticNodeAttributes),
        ("a", 2, ord("a"), spark_dsg.AgentNodeAttributes),
    ):
        attributes = kind()
        attributes.position = np.ones(3)
        assert graph.add_node(layer, symbol(letter, 0), attributes, partition)
    for pair in ("BR", "Rp", "pO", "pa"):
        assert graph.insert_edge(*(symbol(letter, 0) for letter in pair))
    graph.save(path)
    (read,) = read_with_attributes(path)
    assert read.graph.nodes.label.tolist() == [ROOM, BUILDING]
    held = [{"id": symbol("R", 0).value} if row == 5 else {} for row in range(10)]
    write_into(tmp_path / "b.json", city(), path, held)
    loaded = spark_dsg.DynamicSceneGraph.load(str(tmp_path / "b.json"))
    assert loaded.get_node(symbol("p", 0)).get_parent() == symbol("R", 0).value
    assert loaded.get_node(symbol("O", 0)).get_parent() == symbol("p", 0).value
    sizes = {name: loaded.get_layer(name).num_nodes() for name in loaded.layer_names}
    assert sizes["PLANES"] == 4
    assert sizes["OBJECTS"] == sizes["PLACES"] == sizes["BUILDINGS"] == 1
    planes = [*loaded.get_layer("PLANES").nodes]
    assert all(plane.has_parent() and plane.get_parent() >> 56 == ord("R") for plane in planes)


def saved_before_1_0_3():
    """Returns an object, a room and a robot as Hydra saved them without a header."""
    old = {"layer_ids": [2, 4], "directed": False, "multigraph": False, "edges": [], "nodes": []}
    middle = [1.75, 1.5, 2.25]
    box = {"type": "AABB", "min": [0, 1, 2], "max": [3.5, 2, 2.5], "world_P_center": middle}
    no_rotation = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
    for letter, kind, layer, more in (
        ("O", "ObjectNodeAttributes", 2, {"color": [219, 128, 223], "semantic_label": 5}),
        ("R", "RoomNodeAttributes", 4, {"color": [255, 0, 0], "semantic_label": 0}),
    ):
        attributes = {"type": kind, "position": middle, "name": f"{letter}(0)", **more}
        attributes |= {"is_active": True, "last_update_time_ns": 112}
        attributes["bounding_box"] = box | {"world_R_center": no_rotation}
        if letter == "O":
            attributes |= {"mesh_connections": [602], "registered": True}
            attributes["world_R_object"] = no_rotation
        old["nodes"].append({"id": ord(letter) << 56, "layer": layer, "attributes": attributes})
    robot = {"type": "AgentNodeAttributes", "position": [0, 0, 0], "world_R_body": no_rotation}
    robot |= {"is_active": False, "last_update_time_ns": 0, "external_key": 0}
    robot |= {"dbow_ids": None, "dbow_values": None}
    of_robot = {"id": ord("a") << 56, "layer": 2, "timestamp": 3647910000, "attributes": robot}
    old["nodes"].append(of_robot)
    return old


def test_a_box_of_two_corners_has_a_size():
    made = read_spark_dsg(saved_before_1_0_3(), ontology=FURNISHED_ONTOLOGY)
    assert sorted(made.graph.nodes.width.tolist()) == [0, 3.5]


@pytest.mark.parametrize("corner", [None, [1, 2], [1, 2, "3"]])
def test_a_box_of_broken_corners_stays_as_it_is(corner):
    old = saved_before_1_0_3()
    old["nodes"][0]["attributes"]["bounding_box"]["min"] = corner
    assert read_spark_dsg(old, ontology=FURNISHED_ONTOLOGY).graph.nodes.width.tolist() == [0, 0]


def test_an_old_file_with_our_layers_is_one_of_the_newest(tmp_path):
    old = saved_before_1_0_3()
    (tmp_path / "dsg.json").write_text(json.dumps(old))
    write_into(tmp_path / "a.json", city(), tmp_path / "dsg.json")
    made = json.loads((tmp_path / "a.json").read_text())
    assert made["SPARK_DSG_header"] == document()["SPARK_DSG_header"]
    box = made["nodes"][0]["attributes"]["bounding_box"]
    assert box == old["nodes"][0]["attributes"]["bounding_box"] | {"dimensions": [3.5, 1, 0.5]}


def test_an_old_file_with_our_layers_is_opened_by_their_library(tmp_path):
    spark_dsg = library()
    (tmp_path / "dsg.json").write_text(json.dumps(saved_before_1_0_3()))
    write_into(tmp_path / "a.json", city(), tmp_path / "dsg.json")
    loaded = spark_dsg.DynamicSceneGraph.load(str(tmp_path / "a.json"))
    sizes = {name: loaded.get_layer(name).num_nodes() for name in loaded.layer_names}
    assert (sizes["OBJECTS"], sizes["PLANES"], sizes["ROOMS"]) == (1, 4, 2)
    before = spark_dsg.DynamicSceneGraph.load(str(tmp_path / "dsg.json"))
    thing = spark_dsg.NodeSymbol("O", 0)
    boxes = [graph.get_node(thing).attributes.bounding_box for graph in (before, loaded)]
    assert boxes[0].dimensions.tolist() == boxes[1].dimensions.tolist() == [3.5, 1, 0.5]


def broken(change):
    made = document("metadata")
    change(made)
    return made


def broken_node(index, *path, value):
    def change(made):
        holder = made["nodes"][index]
        for key in path[:-1]:
            holder = holder[key]
        holder[path[-1]] = value

    return broken(change)


METADATA = ("attributes", "metadata")


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        ([], r"the document is \[\], expected a Spark-DSG graph"),
        ({}, "SPARK_DSG_header is missing, expected an object"),
        (broken(lambda d: d.pop("SPARK_DSG_header")), "SPARK_DSG_header is missing"),
        (broken(lambda d: d.pop("layer_keys")), "layer_keys is missing, expected a list"),
        (broken(lambda d: d.update(edges=3)), "edges is 3, expected a list"),
        (broken(lambda d: d.update(nodes=[], edges=[])), "nodes is empty, expected at least one"),
        (broken(lambda d: d.update(nodes=[7])), r"nodes\[0\] is 7, expected an object"),
        (
            broken(lambda d: d["layer_keys"].pop()),
            r"\['CITIES'\] is layer 7, partition 0, expected",
        ),
        (
            broken(lambda d: d["layer_names"].update(ROOMS=4)),
            r"\['ROOMS'\] is 4, expected an object",
        ),
        (
            broken(lambda d: d["layer_names"]["ROOMS"].update(layer=5)),
            r"\['FLOORS'\] is layer 5, partition 0 like ROOMS, expected a layer of its own",
        ),
        (
            broken_node(3, "layer", value=8),
            r"nodes\[3\] lies in layer 8, partition 112, expected one",
        ),
        (
            broken_node(3, "partition", value=1),
            r"nodes\[3\] lies in layer 2, partition 1, expected",
        ),
        (
            broken_node(3, "partition", value=ord("w")),
            r"nodes\[3\].normal is .*, expected zero: only planes",
        ),
        (
            broken(lambda d: d["nodes"][5].update(layer=2, partition=ord("p"))),
            r"nodes\[5\].normal is \[0, 0, 0\], expected length 1",
        ),
        (broken_node(3, "id", value=1.5), r"nodes\[3\].id is 1.5, expected an integer below 2\^64"),
        (broken_node(3, "id", value=2**64), r"nodes\[3\].id is 18446744073709551616, expected"),
        (broken_node(3, "id", value=True), r"nodes\[3\].id is True, expected an integer"),
        (
            broken_node(1, "id", value=ord("p") << 56),
            r"nodes\[1\].id is \d+ again, expected unique",
        ),
        (broken(lambda d: d["nodes"][3].pop("attributes")), r"nodes\[3\] lacks 'attributes'"),
        (
            broken_node(3, "attributes", "type", value="PlaneNodeAttributes"),
            r"nodes\[3\].attributes.type is 'PlaneNodeAttributes', expected one of Semantic",
        ),
        (
            broken_node(3, "attributes", "position", value=[0, 0]),
            r"nodes\[3\].attributes.position is \[0, 0\], expected three numbers",
        ),
        (
            broken_node(3, "attributes", "position", value=[0, 0, float("nan")]),
            r"nodes\[3\].position is \[0, 0, nan\], expected finite",
        ),
        (broken_node(3, *METADATA, value=[]), r"nodes\[3\].attributes.metadata is \[\], expected"),
        (
            broken_node(3, *METADATA, value={}),
            r"nodes\[3\].normal is \[0, 0, 0\], expected length 1",
        ),
        (broken_node(3, *METADATA, "normal", value="x"), r"metadata.normal is 'x', expected three"),
        (broken_node(3, *METADATA, "width", value=None) | {"edges": 0}, "edges is 0"),
        (broken_node(3, *METADATA, "width", value=-1), r"nodes\[3\].width is -1, expected zero"),
        (broken_node(1, *METADATA, "walls", value=4), "metadata.walls is 4, expected a list"),
        (
            broken_node(1, *METADATA, "walls", value=[4]),
            r"walls\[0\] is 4, expected the id of a wall",
        ),
        (
            broken_node(1, *METADATA, "walls", value=[ord("p") << 56]),
            r"metadata.walls\[0\] is \d+, expected the id of a wall",
        ),
        (
            broken(lambda d: d["edges"][2].update(source=5)),
            r"edges\[2\].source is 5, expected the id",
        ),
        (broken(lambda d: d["edges"][2].update(target=0.5)), r"edges\[2\].target is 0.5, expected"),
        (broken(lambda d: d["edges"][2].pop("info")), r"edges\[2\] lacks 'info'"),
        (
            broken(lambda d: d["edges"][2].update(info=None)),
            r"edges\[2\].info is None, expected an",
        ),
        (
            broken(lambda d: d["edges"][2]["info"]["metadata"].update(relation="near")),
            r"edges\[2\].info.metadata.relation is 'near', expected proximity or part_of",
        ),
        (broken(lambda d: d["edges"].append(d["edges"][0])), "is there twice, expected once"),
        (
            broken(lambda d: d["edges"][0].update(target=d["edges"][0]["source"])),
            "is a loop, expected two nodes",
        ),
    ],
)
def test_a_broken_document_is_refused_in_one_sentence(made, sentence):
    with pytest.raises(ValueError, match=rf"^dsg\.json: .*{sentence}") as caught:
        graph_from_spark_dsg(made, "dsg.json")
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)
