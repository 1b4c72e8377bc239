"""Labels of real floor plans as kinds of rooms."""

import numpy as np
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY, ROOM_KINDS
from sg3d_jax.data.room_labels import _FLAT, _WORKPLACE, kind_of, labelled
from sg3d_jax.scene.ontology import ROOM
from sg3d_jax.scene.validate import validate_graph
from tests.seen_rooms import row_of_planes


def test_every_label_means_a_kind_that_there_is():
    assert {*_FLAT.values(), *_WORKPLACE.values()} == {*ROOM_KINDS}


@pytest.mark.parametrize(
    ("label", "kind"),
    [
        ("bedroom", "bedroom"),
        ("restroom", "bathroom"),
        ("PS", "storage"),
        ("corridor+entrance+stairs", "corridor"),
        ("entrance+kitchen", "kitchen"),
        ("kitchen+living_room", "living room"),
        ("bedroom+entrance+kitchen", "living room"),
        ("bedroom+closet", "bedroom"),
        ("SHARED OFFICE", "office"),
        ("STAIRS", "stairwell"),
        ("ELEVATOR", ""),
        ("MEDIUM", ""),
        ("", ""),
    ],
)
def test_a_label_is_of_a_kind(label, kind):
    assert kind_of(label) == kind


def test_a_real_floor_has_kinds_of_rooms_and_is_one_flat_or_unknown_units():
    graph = row_of_planes(3.0, 4.0, 5.0)
    rooms = np.flatnonzero(graph.nodes.label == ROOM).tolist()
    for names, flat in ((("bedroom", "PS", "nothing"), 1), (("CLASSROOM", "STAIRS", ""), 0)):
        made = labelled(graph, dict(zip(rooms, names, strict=True)))
        validate_graph(made, "real")
        is_room = made.nodes.label == FURNISHED_ONTOLOGY.label_of("room")
        kinds = [("", *ROOM_KINDS)[int(kind)] for kind in made.nodes.kind[is_room]]
        assert kinds == [kind_of(name) for name in names]
        np.testing.assert_array_equal(made.nodes.position[is_room], graph.nodes.position[rooms])
        is_unit = made.nodes.label == FURNISHED_ONTOLOGY.label_of("unit")
        assert made.nodes.kind[is_unit].tolist() == [flat]
