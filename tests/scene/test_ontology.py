import dataclasses
import json
import pickle

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.scene.graph import FEATURES
from sg3d_jax.scene.ontology import (
    BUILDING,
    CITY,
    FLOOR,
    PAPER_ONTOLOGY,
    PLANE,
    ROOM,
    WALL,
    Ontology,
    Rule,
    ontology_from_dict,
)
from tests import own_world
from tests.unchecked import unchecked

BOTH = pytest.mark.parametrize("ontology", [PAPER_ONTOLOGY, own_world.ONTOLOGY, FURNISHED_ONTOLOGY])


def replaced(index: int, **fields) -> Ontology:
    """Returns the paper's ontology with another concept in one place."""
    concepts = list(PAPER_ONTOLOGY.concepts)
    concepts[index] = dataclasses.replace(concepts[index], **fields)
    return dataclasses.replace(PAPER_ONTOLOGY, concepts=tuple(concepts))


def with_kinds(*kinds) -> Ontology:
    """Returns the paper's ontology with rooms of some kinds."""
    return replaced(ROOM, features=("kind",), kinds=kinds)


@BOTH
def test_rules_lead_from_lower_to_higher_concepts(ontology):
    parts, wholes = np.nonzero(ontology.may_be_part)
    assert len(parts) == len(ontology.rules)
    assert (parts < wholes).all()


def test_the_default_is_the_papers():
    assert PAPER_ONTOLOGY.names == ("plane", "wall", "room", "floor", "building", "city")
    assert [PAPER_ONTOLOGY.label_of(name) for name in PAPER_ONTOLOGY.names] == [
        *(PLANE, WALL, ROOM, FLOOR, BUILDING, CITY)
    ]
    wholes = {part: set(np.flatnonzero(row)) for part, row in enumerate(PAPER_ONTOLOGY.may_be_part)}
    assert wholes == {
        PLANE: {WALL, ROOM},
        WALL: set(),
        ROOM: {FLOOR},
        FLOOR: {BUILDING},
        BUILDING: {CITY},
        CITY: set(),
    }
    assert PAPER_ONTOLOGY.single_wholes == (
        *((PLANE, ROOM), (ROOM, FLOOR), (FLOOR, BUILDING), (BUILDING, CITY)),
    )
    npt.assert_array_equal(np.flatnonzero(PAPER_ONTOLOGY.is_observed), [PLANE])
    npt.assert_array_equal(np.flatnonzero(PAPER_ONTOLOGY.is_above), [BUILDING, CITY])
    npt.assert_array_equal(np.flatnonzero(PAPER_ONTOLOGY.hears_kin), [ROOM, FLOOR, BUILDING, CITY])
    for feature in FEATURES:
        planes = [] if feature == "kind" else [PLANE]
        npt.assert_array_equal(np.flatnonzero(PAPER_ONTOLOGY.has(feature)), planes)


def test_features_and_kinds_are_those_that_some_concept_has():
    assert PAPER_ONTOLOGY.features == ("normal", "width")
    assert with_kinds("hall", "flat").features == ("normal", "width", "kind")
    assert with_kinds("hall", "flat").num_kinds.tolist() == [0, 0, 2, 0, 0, 0]


def test_lists_make_the_same_ontology_as_tuples():
    with unchecked():
        lists = [{"features": [*each.features], "kinds": []} for each in PAPER_ONTOLOGY.concepts]
        each_concept = zip(PAPER_ONTOLOGY.concepts, lists, strict=True)
        concepts = [dataclasses.replace(concept, **fields) for concept, fields in each_concept]
        made = Ontology(concepts, [*PAPER_ONTOLOGY.rules])
    assert made == PAPER_ONTOLOGY
    assert hash(made) == hash(PAPER_ONTOLOGY)


@BOTH
def test_an_ontology_survives_json(ontology):
    again = ontology_from_dict(json.loads(json.dumps(ontology.to_dict())))
    assert again == ontology
    assert again.to_dict() == ontology.to_dict()  # also the colours
    assert hash(again) == hash(ontology)


def test_no_ontology_means_the_papers_and_it_is_one_object():
    assert ontology_from_dict(None) is PAPER_ONTOLOGY
    assert ontology_from_dict(PAPER_ONTOLOGY.to_dict()) is PAPER_ONTOLOGY


def test_ontologies_differ_by_any_field_but_colours_and_compile_apart():
    traced = []

    @jax.jit
    def count(ontology):
        traced.append(ontology)
        return ontology.num_concepts

    others = [replaced(WALL, hears_kin=True), replaced(ROOM, least_parts=2), own_world.ONTOLOGY]
    same = ontology_from_dict(PAPER_ONTOLOGY.to_dict()), replaced(WALL, colour="#123456")
    for ontology in (PAPER_ONTOLOGY, *others, *same):
        assert count(ontology) == 6
        assert not jax.tree.leaves(ontology)
    assert traced == [PAPER_ONTOLOGY, *others]
    assert len({PAPER_ONTOLOGY, *others}) == 4


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: replaced(WALL, name="room"), "name 'room' is there twice, expected once"),
        (lambda: replaced(WALL, letter="R"), "letter 'R' is there twice"),
        (lambda: replaced(WALL, layer="ROOMS"), "layer 'ROOMS' is there twice"),
        (lambda: replaced(WALL, letter="ww"), "letter of wall is 'ww', expected one"),
        (lambda: replaced(WALL, letter="ß"), "letter of wall is 'ß', expected one"),
        (lambda: replaced(WALL, colour="red"), "colour of wall is 'red', expected such as"),
        (lambda: replaced(WALL, colour="#12345g"), "colour of wall is '#12345g'"),
        (lambda: replaced(ROOM, features=("width", "height")), "feature of room is 'height', exp"),
        (
            lambda: replaced(ROOM, kinds=("hall",)),
            r"kinds of room are \['hall'\], its features none",
        ),
        (
            lambda: replaced(PLANE, features=("kind",)),
            r"kinds of plane are \[\], its features kind, e",
        ),
        (
            lambda: with_kinds("hall", "flat", "hall"),
            "kind 'hall' of room is there twice, expected",
        ),
        (lambda: with_kinds("hall", ""), "kind of room is '', expected one line"),
        (lambda: with_kinds("ha\nll"), r"kind of room is 'ha\\nll', expected one line"),
        (lambda: replaced(PLANE, observed=False), "expected concepts that are observed, and other"),
        (
            lambda: Ontology(PAPER_ONTOLOGY.concepts[:1], ()),
            "expected concepts that are observed, and others that grow",
        ),
        (
            lambda: dataclasses.replace(PAPER_ONTOLOGY, rules=(Rule("room", "plane"),)),
            "room is part of plane, expected a concept further up",
        ),
        (
            lambda: dataclasses.replace(PAPER_ONTOLOGY, rules=(Rule("room", "room"),)),
            "room is part of room, expected a concept further up",
        ),
        (
            lambda: dataclasses.replace(PAPER_ONTOLOGY, rules=(Rule("room", "flat"),)),
            "unknown concept 'flat', expected one of plane, wall, room",
        ),
    ],
)
def test_what_is_no_ontology_is_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


@pytest.mark.parametrize(
    "values",
    [
        {},
        [],
        "paper",
        {"concepts": [], "rules": []},
        {"concepts": [{"name": "plane"}], "rules": []},
        {"concepts": 3, "rules": []},
        {"concepts": [PAPER_ONTOLOGY.to_dict()["concepts"][0] | {"name": 3}], "rules": []},
        {"concepts": [PAPER_ONTOLOGY.to_dict()["concepts"][0] | {"least_parts": "2"}], "rules": []},
        {
            "concepts": [PAPER_ONTOLOGY.to_dict()["concepts"][0] | {"features": "width"}],
            "rules": [],
        },
        PAPER_ONTOLOGY.to_dict() | {"rules": [{"part": "plane", "hole": "room"}]},
        PAPER_ONTOLOGY.to_dict() | {"rules": [{"part": "room", "whole": "plane"}]},
    ],
)
def test_json_that_is_no_ontology_is_refused_with_the_place(values):
    with pytest.raises(ValueError, match=r"^scenes\.json: .*expected"):
        ontology_from_dict(values, "scenes.json")


@BOTH
def test_what_is_pickled_is_hashed_anew(ontology):
    """Hashes of strings differ from process to process: equal ontologies would not be found."""
    of_another_process = dataclasses.replace(ontology)
    vars(of_another_process)["_hash"] = hash(ontology) + 1
    again = pickle.loads(pickle.dumps(of_another_process))
    assert again == ontology
    assert hash(again) == hash(ontology)
