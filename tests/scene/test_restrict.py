import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.scene.graph import undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PROXIMITY
from sg3d_jax.scene.restrict import kept_concepts, restricted
from tests.two_rooms import NUM_PLANES, on_device, two_rooms


def left_of(**chosen):
    """Returns the rows of `two_rooms` that are left, and checks that they are as they were."""
    whole, part = two_rooms(), restricted(two_rooms(), **chosen)
    rows = [
        row for row in range(12) if (whole.nodes.position[row] == part.nodes.position).all(1).any()
    ]
    for before, after in zip(whole.nodes, part.nodes, strict=True):
        npt.assert_array_equal(before[rows], after)
    for relation in (PART_OF, PROXIMITY):
        pairs = undirected_edges(whole, relation)
        inside = pairs[np.isin(pairs, rows).all(axis=1)]
        npt.assert_array_equal(np.array(rows)[undirected_edges(part, relation)], inside)
    return rows[NUM_PLANES:]


def test_concepts_up_to_one_are_left_or_all_but_some():
    assert left_of() == [8, 9, 10, 11]
    assert left_of(until="room") == [8, 9, 10]
    assert left_of(until="plane") == []
    assert left_of(without="wall") == [9, 10, 11]
    assert left_of(without=["room", "wall"]) == [11]
    assert left_of(until="room", without=("wall",)) == [9, 10]


def test_graphs_on_the_device_are_read_without_their_padding():
    rooms = restricted(on_device(two_rooms()), "room")
    assert len(rooms.nodes.label) == 11


def test_what_is_observed_stays_wherever_it_is():
    kept = kept_concepts(FURNISHED_ONTOLOGY, "plane")
    npt.assert_array_equal(kept, FURNISHED_ONTOLOGY.is_observed)


@pytest.mark.parametrize(
    ("chosen", "sentence"),
    [
        ({"until": "roof"}, "unknown concept 'roof', expected one of plane, wall, room, floor, "),
        ({"without": "walls"}, "unknown concept 'walls', expected one of plane, wall, "),
        (
            {"without": ["wall", "plane"]},
            "plane is observed and cannot be left out, expected of wall",
        ),
    ],
)
def test_what_is_no_concept_or_observed_is_refused(chosen, sentence):
    with pytest.raises(ValueError, match=sentence):
        restricted(two_rooms(), **chosen)
