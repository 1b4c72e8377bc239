"""Things with a class, in scenes and in files of Hydra's, become nodes that a model may know."""

import dataclasses
import json

import numpy as np
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY, OBJECT_KINDS
from sg3d_jax.io.attributes import with_kinds
from sg3d_jax.io.formats import FORMATS, read_planes, read_with_attributes, write_graphs
from sg3d_jax.io.objects import _NAMES
from sg3d_jax.io.planes import planes_from_dict, planes_to_dict, read_planes_dict
from sg3d_jax.io.records import in_terms_of
from sg3d_jax.io.spark_dsg import graph_to_spark_dsg, read_spark_dsg
from sg3d_jax.io.spark_dsg_document import put_into
from sg3d_jax.scene.graph import make_graph, ontology_of, parts_first
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from tests.furnished_rooms import DOOR, OBJECT, PLANE, ROOM, furnished_rooms, with_kind
from tests.io.test_own_world import assert_same_graph
from tests.own_world import ONTOLOGY as OWN_ONTOLOGY

PLANES = [
    {"id": "north", "centroid": [1.0, 2.0, 0.0], "normal": [0.0, -1.0, 0.0], "width": 2.0},
    {"id": "south", "centroid": [1.0, 0.0, 0.0], "normal": [0.0, 1.0, 0.0], "width": 2.0},
]


def thing(name, **others):
    return {"class": name, "centroid": [1.0, 1.0, 0.4], **others}


def read(things, ontology=FURNISHED_ONTOLOGY, **others):
    document = {"planes": PLANES, "objects": things, **others}
    return read_planes_dict(json.loads(json.dumps(document)), "a.json", ontology)


def called(graph):
    """Returns the concept and the kind of every node but the planes."""
    concepts = ontology_of(graph).concepts
    pairs = zip(graph.nodes.label.tolist(), graph.nodes.kind.astype(int).tolist(), strict=True)
    named = [(concepts[label], kind) for label, kind in pairs if label != PLANE]
    return [(concept.name, concept.kinds[kind - 1] if kind else None) for concept, kind in named]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("bed", ("object", "bed")),
        ("Bed", ("object", "bed")),
        ("beds", ("object", "bed")),
        ("couch", ("object", "sofa")),
        ("chest_of_drawers", ("object", "cupboard")),
        ("Kitchen  Cabinets", ("object", "cupboard")),
        ("refridgerator", ("object", "fridge")),
        ("door", ("door", None)),
        ("screen_door", ("door", None)),
        ("stairway", ("stairs", None)),
        ("chair 12", ("object", "chair")),
        ("objects", ("object", None)),
    ],
)
def test_a_class_is_a_concept_or_a_kind_whatever_a_label_set_calls_it(name, expected):
    made = read([thing(name)])
    assert called(made.graph) == [expected]
    assert made.remarks == ()


def test_all_that_the_table_of_synonyms_leads_to_is_known():
    things = {*OBJECT_KINDS, "door", "stairs"}
    assert {*_NAMES} <= things
    assert not things & {synonym for several in _NAMES.values() for synonym in several}


def test_what_nothing_is_called_like_is_an_object_of_unknown_kind_and_counted():
    named = [thing("lamp"), thing("potted plant"), thing("lamp"), {"centroid": [0.0, 1.0, 0.0]}]
    made = read(named)
    assert called(made.graph) == [("object", None)] * 4
    said = "2 lamp, 1 potted plant, 1 without a class"
    assert made.remarks == (f"took 4 for objects of unknown kind: {said}",)


def test_the_width_is_the_greater_horizontal_extent_and_may_be_missing():
    sizes = [{"size": [0.5, 1.5, 2.5]}, {"size": [0.7, 0.6]}, {"size": None}, {}]
    sizes += [{"size": [0.5, 1.5, 2.5], "width": 0.25}]
    made = read([thing("bed", **size) for size in sizes])
    assert made.graph.nodes.width[2:].tolist() == [1.5, 0.7, 0, 0, 0.25]


def test_every_key_of_a_thing_is_carried_and_nodes_stay_by_concept():
    bed, door = thing("bed", size=[2, 1, 1], id="b7", seen=[3, 4]), thing("door", size=[1, 0, 2])
    made = read([bed, door], doors=[{"centroid": [0.0, 0.0, 1.0], "width": 0.8, "id": 5}])
    assert made.graph.nodes.label.tolist() == [PLANE, PLANE, DOOR, DOOR, OBJECT]
    held = [{"id": "north"}, {"id": "south"}, {"class": "door", "size": [1, 0, 2]}, {"id": 5}]
    held += [{"class": "bed", "size": [2, 1, 1], "id": "b7", "seen": [3, 4]}]
    assert made.attributes == held


def test_lists_may_be_absent_unless_the_document_states_its_concepts():
    assert called(read([]).graph) == []
    document = {"planes": PLANES, "ontology": FURNISHED_ONTOLOGY.to_dict()}
    with pytest.raises(ValueError, match="lacks 'doors', expected exactly ontology, planes, doors"):
        read_planes_dict(document, "a.json")
    with pytest.raises(ValueError, match="has 'sofas', expected exactly planes, doors"):
        read([], sofas=[])


@pytest.mark.parametrize("ontology", [PAPER_ONTOLOGY, OWN_ONTOLOGY], ids=["paper", "own"])
def test_who_knows_no_objects_leaves_them_out_and_says_so(ontology):
    made = read([thing("bed", id=3), thing("lamp"), thing("pillar")], ontology)
    kept = [] if ontology is PAPER_ONTOLOGY else [("pillar", None)]
    assert called(made.graph) == kept
    names = ", ".join(ontology.names)
    remark = f"left out {3 - len(kept)} of objects: the concepts known are {names}"
    assert made.remarks == (remark,)
    assert made.attributes == [{"id": "north"}, {"id": "south"}, *[{"class": "pillar"}] * len(kept)]


def test_what_was_read_is_written_and_read_again_with_its_kinds():
    graph = read([thing("couch", size=[2, 1, 1]), thing("lamp"), thing("door")]).graph
    document = json.loads(json.dumps(planes_to_dict(graph)))
    assert [one["kind"] for one in document["objects"]] == ["sofa", None]
    assert_same_graph(planes_from_dict(document, "again"), graph)
    document["objects"][0]["kind"] = "couch"
    sentence = r"^again: objects\[0\].kind is 'couch', expected null or one of bed, table"
    with pytest.raises(ValueError, match=sentence):
        planes_from_dict(document, "again")


@pytest.mark.parametrize(
    ("item", "sentence"),
    [
        (3, r"objects\[0\] is 3, expected an object with class, centroid and size"),
        ({"class": "bed"}, r"objects\[0\] lacks 'centroid', expected an object with class"),
        (thing(7), r"objects\[0\].class is 7, expected a word"),
        (thing("bed", normal=[1, 0, 0]), r"objects\[0\] has 'normal', expected an object with"),
        (thing("bed", size=[1, 2, 3, 4]), r"objects\[0\].size is .*, expected three numbers"),
        (thing("bed", size=[-1, 2, 3]), r"objects\[0\].size is .*, expected zero metres or more"),
        (thing("bed", width="wide"), r"objects\[0\].width is 'wide', expected a number"),
        (thing("bed", width=-1), r"objects\[0\].width is -1, expected zero metres or more"),
    ],
)
def test_a_thing_that_is_none_is_refused(item, sentence):
    with pytest.raises(ValueError, match=f"^a.json: {sentence}"):
        read([item])


def test_a_list_of_things_that_is_none_is_refused_whoever_reads_it():
    for ontology in (PAPER_ONTOLOGY, FURNISHED_ONTOLOGY):
        with pytest.raises(
            ValueError, match=r"^a\.json: objects is no list, expected a list of ob"
        ):
            read(3, ontology)


def test_lines_of_a_file_are_told_of_the_concepts_and_so_are_tables(tmp_path):
    line = json.dumps({"planes": PLANES, "objects": [thing("bed")]})
    (tmp_path / "a.jsonl").write_text(f"{line}\n{line}\n")
    for graph in read_planes(tmp_path / "a.jsonl", FURNISHED_ONTOLOGY):
        assert called(graph) == [("object", "bed")]
    (tmp_path / "a.csv").write_text("cx,cy,nx,ny,width\n0,0,1,0,2\n3,0,-1,0,2\n")
    (table,) = read_planes(tmp_path / "a.csv", FURNISHED_ONTOLOGY)
    assert ontology_of(table) == FURNISHED_ONTOLOGY


def test_a_graph_of_the_paper_s_concepts_is_one_of_others_that_have_them(tmp_path):
    nodes = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    normal, width = [[1, 0, 0], [-1, 0, 0], [0, 0, 0]], [2, 2, 0]
    for to in ("json", "npz"):
        graph = make_graph([0, 0, 2], nodes, normal, width, part_of=[(0, 2), (1, 2)])
        write_graphs(tmp_path / f"a.{to}", [graph], to)
        (made,) = read_with_attributes(tmp_path / f"a.{to}", ontology=FURNISHED_ONTOLOGY)
        assert made.graph.nodes.label.tolist() == [PLANE, PLANE, ROOM]
        assert ontology_of(made.graph) == FURNISHED_ONTOLOGY
        (same,) = read_with_attributes(tmp_path / f"a.{to}", ontology=OWN_ONTOLOGY)
        assert same.graph.nodes.label.tolist() == [0, 0, 3]


def test_a_graph_stays_of_its_concepts_where_others_do_not_have_them():
    city = make_graph([0, 0, 5], np.zeros((3, 3)))
    assert in_terms_of(city, OWN_ONTOLOGY) is city  # knows no cities
    stated = make_graph([0, 0], np.zeros((2, 3)), ontology=OWN_ONTOLOGY)
    assert in_terms_of(stated, FURNISHED_ONTOLOGY) is stated
    plane, *others = FURNISHED_ONTOLOGY.concepts
    narrow = dataclasses.replace(plane, features=("normal",))
    ontology = dataclasses.replace(FURNISHED_ONTOLOGY, concepts=(narrow, *others))
    assert in_terms_of(city, ontology) is city


# --- files of Hydra's ---


def hydra(*objects, **metadata):
    """Returns planes and a room of ours in a file of Hydra's that has objects of its own."""
    room = make_graph(
        [PLANE, PLANE, ROOM],
        [[1, 2, 0], [1, 0, 0], [1, 1, 0]],
        [[0, -1, 0], [0, 1, 0], [0, 0, 0]],
        [2, 2, 0],
        part_of=[(0, 2), (1, 2)],
        ontology=FURNISHED_ONTOLOGY,
    )
    made = graph_to_spark_dsg(room)
    key = made["layer_names"]["OBJECTS"]
    for index, fields in enumerate(objects):
        attributes = {"type": "ObjectNodeAttributes", "position": [1, 1, 0], "metadata": {}}
        node = {"id": (ord("O") << 56) + 10 + index, **key, "attributes": attributes | fields}
        made["nodes"].append(node)
    made["metadata"] = metadata
    return json.loads(json.dumps(made)), f"_l{key['layer']}p{key['partition']}"


def test_objects_of_hydra_are_told_by_its_label_names_and_their_boxes():
    box = {"type": "AABB", "dimensions": [0.5, 1.5, 2.5], "world_P_center": [0, 0, 0]}
    wide = {"type": "AABB", "dimensions": [3, 2, 1], "world_P_center": [0, 0, 0]}
    named = [
        {"semantic_label": 7, "name": "O(10)", "bounding_box": box},
        {"semantic_label": 4, "name": "chair", "bounding_box": wide},
        {"semantic_label": 9, "name": "table_3"},
        {"semantic_label": 9, "name": "O(13)", "bounding_box": {"type": "INVALID"}},
    ]
    document, space = hydra(*named)
    document["metadata"] = {"labelspaces": {space: [[4, "screen_door"], [7, "couch"]]}}
    made = read_spark_dsg(document, "dsg.json", FURNISHED_ONTOLOGY)
    kinds = [("object", "sofa"), ("door", None), ("object", "table"), ("object", None)]
    assert called(made.graph)[1:] == kinds
    assert made.graph.nodes.width[3:].tolist() == [1.5, 3, 0, 0]
    classes = ["couch", "screen_door", "table", None]
    assert [held.get("class") for held in made.attributes[3:]] == classes
    assert made.attributes[3]["id"] == (ord("O") << 56) + 10
    assert made.remarks == ("took 1 for objects of unknown kind: 1 without a class",)


def test_objects_of_hydra_are_left_out_by_who_knows_none():
    document, _ = hydra({"name": "bed"})
    made = read_spark_dsg(document, "dsg.json")
    assert made.graph.nodes.label.tolist() == [0, 0, 2]
    assert made.remarks == ("left out what is in no layer of ours: 1 of OBJECTS",)


def test_label_names_and_boxes_that_are_none_say_nothing():
    broken = {"semantic_label": 7, "name": 3, "bounding_box": {"dimensions": "big"}}
    for spaces in (3, {"": 3}, {"x": [[7, "bed"]]}):
        document, space = hydra(broken, labelspaces=spaces)
        made = read_spark_dsg(document, "dsg.json", FURNISHED_ONTOLOGY)
        assert (called(made.graph)[1:], made.graph.nodes.width[3]) == ([("object", None)], 0)
    document, space = hydra(broken)
    document["metadata"] = {"labelspaces": {space: [3, [7], [7, 7], ["7", "bed"]]}}
    made = read_spark_dsg(document, "dsg.json", FURNISHED_ONTOLOGY)
    assert called(made.graph)[1:] == [("object", None)]


def test_hydra_s_places_stay_where_our_objects_replace_its_own():
    named = {"name": "bed", "semantic_label": 4}
    theirs, _ = hydra(named, named)
    read = read_spark_dsg(theirs, "dsg.json", FURNISHED_ONTOLOGY)
    ours = graph_to_spark_dsg(read.graph, attributes=read.attributes)
    keys = ours["layer_names"]
    assert [keys[name]["layer"] for name in ("PLANES", "DOORS", "STAIRS", "OBJECTS")] == [2] * 4
    hydras = {"OBJECTS": 2, "PLACES": 3, "ROOMS": 4}
    theirs["layer_names"] = {name: {"layer": n, "partition": 0} for name, n in hydras.items()}
    theirs["layer_keys"] = [*theirs["layer_names"].values()]
    place = {"id": ord("p") << 56, "layer": 3, "partition": 0, "attributes": {}}
    beds = [node | {"partition": 0} for node in theirs["nodes"][3:]]
    edge = {"source": place["id"], "target": beds[1]["id"], "info": {}}
    made, remarks = put_into(theirs | {"nodes": [place, *beds], "edges": [edge]}, ours, "dsg.json")
    assert edge in made["edges"]  # the bed is ours now, under its old symbol
    assert [node["id"] for node in made["nodes"][-2:]] == [bed["id"] for bed in beds]
    assert made["layer_names"]["PLACES"]["layer"] == 3
    assert remarks == []


# --- and what comes out ---


CHANCES = [[0.125, 0.75, 0.0, 0.12], [0.004, 0.0, 0.99996, 0.006], [0.3, 0.3, 0.4, 0], [0] * 4]
HELD = [{"id": "a"}, {}, {}, {}, {"class": "bed"}, {"confidence": 0.5}, {}, {}, {}]
KINDS = [
    {"confidence": 0.5, "kinds": {"living room": 0.75, "bedroom": 0.125, "bathroom": 0.12}},
    {"kinds": {"kitchen": 1.0, "bathroom": 0.006}},
    {"kinds": {"common": 0.4, "flat": 0.3, "department": 0.3}},
]


def test_likely_kinds_are_attributes_of_what_was_grown_the_likeliest_first():
    graph = furnished_rooms()
    held = with_kinds(HELD, graph, CHANCES)
    assert held == [*HELD[:5], *KINDS, {}]
    assert [*held[5]["kinds"]] == ["living room", "bedroom", "bathroom"]
    assert with_kinds(HELD, graph, None) == HELD


@pytest.mark.parametrize("to", [to for to in FORMATS if to not in ("npz", "s-graphs")])
def test_kinds_and_the_rooms_of_a_door_are_in_every_format(tmp_path, to):
    graph = with_kind(furnished_rooms(), 6, 0)  # of one room it is unknown
    held = with_kinds(HELD, graph, CHANCES)
    path = tmp_path / f"a.{'graphml' if to == 'graphml' else 'json'}"
    for options in [{}, {"walls": "metadata"}] if to == "spark-dsg" else [{}]:
        write_graphs(path, [graph], to, attributes=[held], **options)
        (again,) = read_with_attributes(path)
        assert_same_graph(again.graph, graph)
        assert [one.get("kinds") for one in again.attributes] == [one.get("kinds") for one in held]
        wholes = [whole for part, whole in parts_first(again.graph).tolist() if part == 2]
        assert wholes == [5, 6]


def test_a_door_names_its_rooms_where_hydra_has_one_parent():
    graph = furnished_rooms()
    made = graph_to_spark_dsg(graph, "metadata")
    ids = [node["id"] for node in made["nodes"]]
    said = [node["attributes"]["metadata"].get("rooms") for node in made["nodes"]]
    assert said[2:5] == [[ids[5], ids[6]], [ids[6]], None]
