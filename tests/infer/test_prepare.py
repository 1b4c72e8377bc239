import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.infer.prepare import in_place, prepare, whole_again
from sg3d_jax.io.planes import planes
from sg3d_jax.scene.graph import extended, observed_of, subgraph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PART_OF, PROXIMITY, ROOM
from sg3d_jax.scene.padding import Capacity, moved_by, pad
from tests.own_world import ONTOLOGY, own_world
from tests.two_rooms import NUM_PLANES, planes_of_room, two_rooms

FAR = np.array([5e5, 5e6, 300.0])  # metres, as of a map projection


def prepared(*scenes, keep=False, ontology=PAPER_ONTOLOGY):
    return prepare(list(scenes), ontology, keep)


def test_the_observed_nodes_are_given_and_the_others_counted():
    (scene,) = prepared(two_rooms())
    npt.assert_array_equal(scene.given.nodes.position, two_rooms().nodes.position[:NUM_PLANES])
    assert scene.num_missing == 4
    assert not len(scene.given.senders)


def test_everything_is_given_where_it_is_to_be_kept():
    (scene,) = prepared(two_rooms(), keep=True)
    for found, expected in zip(scene.given.nodes, two_rooms().nodes, strict=True):
        npt.assert_array_equal(found, expected)
    npt.assert_array_equal(
        undirected_edges(scene.given, PART_OF), undirected_edges(two_rooms(), PART_OF)
    )
    assert not len(undirected_edges(scene.given, PROXIMITY))  # made anew
    assert scene.num_missing == 0


def test_scenes_are_brought_to_the_origin_and_leave_as_they_came():
    far = moved_by(two_rooms(), FAR)
    for keep in (False, True):
        (scene,) = prepared(far, keep=keep)
        assert np.abs(scene.centred.nodes.position).max() < 20
        count = len(scene.given.nodes.label)
        grown = extended(scene.centred, [FLOOR], [[1.0, 2.0, 3.0]], [[0, count]])
        back = whole_again(scene, in_place(scene, grown))
        npt.assert_array_equal(back.nodes.position[:count], far.nodes.position[:count])
        npt.assert_array_equal(back.nodes.normal[:count], far.nodes.normal[:count])
        npt.assert_allclose(back.nodes.position[count], scene.centre + np.arange(1, 4), rtol=1e-12)
        assert [0, count] in undirected_edges(back, PART_OF).tolist()
        assert len(undirected_edges(back, PART_OF)) == 1 + 12 * keep


def changed(**fields):
    graph = observed_of(two_rooms())
    return graph._replace(nodes=graph.nodes._replace(**fields))


def with_entry(name, value):
    array = getattr(observed_of(two_rooms()).nodes, name).copy()
    array[(3, 0) if array.ndim == 2 else 3] = value
    return changed(**{name: array})


@pytest.mark.parametrize(
    ("scene", "sentence"),
    [
        (subgraph(two_rooms(), []), "scene 0: planes holds no planes"),
        (subgraph(two_rooms(), [8, 9]), "scene 0: planes holds no planes"),
        (subgraph(two_rooms(), [0]), "scene 0: planes holds one plane"),
        (with_entry("position", np.nan), r"scene 0: planes\[3\].centroid is .*nan.*finite"),
        (with_entry("normal", np.inf), r"scene 0: planes\[3\].normal is .*inf.*finite"),
        (with_entry("width", np.nan), r"scene 0: planes\[3\].width is nan.*finite"),
        (with_entry("width", -1.0), r"scene 0: planes\[3\].width is -1.*zero metres or more"),
        (
            changed(normal=np.zeros((8, 3))),
            r"scene 0: planes\[0\].normal is \[0, 0, 0\], .*length 1",
        ),
        (with_entry("label", 9), r"scene 0: nodes\[3\].label is 9, expected 0 to 5"),
        (changed(position=np.zeros((8, 2))), r"scene 0: position has shape \[8, 2\]"),
        (changed(width=np.ones(7)), r"scene 0: width has shape \[7\], expected \[8\]"),
        (changed(normal=np.ones((7, 3))), r"scene 0: normal has shape \[7, 3\]"),
        (pad(two_rooms(), Capacity(16, 128)), "scene 0: .*expected"),
        ([[0.0, 0.0, 1.0]], "scene 0: is a list, expected a host graph"),
        (own_world(), "scene 0: its concepts are plane, pillar, .* expected plane, wall, room"),
    ],
)
@pytest.mark.parametrize("keep", [False, True])
def test_what_no_model_can_complete_is_refused_in_one_sentence(scene, sentence, keep):
    with pytest.raises(ValueError, match=sentence) as caught:
        prepared(scene, keep=keep)
    assert "\n" not in str(caught.value)


def test_a_graph_alone_is_no_list_of_scenes():
    with pytest.raises(ValueError, match="expected a list of host graphs"):
        prepare(two_rooms(), PAPER_ONTOLOGY, False)


def test_refusals_call_scenes_by_their_names():
    with pytest.raises(ValueError, match=r"^b\.json: planes holds no planes"):
        prepare([two_rooms(), subgraph(two_rooms(), [])], PAPER_ONTOLOGY, False, ["a", "b.json"])


def test_rows_of_the_scene_are_named_whatever_was_left_out():
    given = two_rooms()
    mixed = subgraph(given, [8, 3, 9, 0, 10, 1, 2, 11])  # planes among others
    lying = np.array(mixed.nodes.normal)
    lying[3] = [0, 0, 1]
    mixed = mixed._replace(nodes=mixed.nodes._replace(normal=lying))
    for keep, source in ((False, [1, 5, 6]), (True, [0, 1, 2, 4, 5, 6, 7])):
        (scene,) = prepared(mixed, keep=keep)
        assert scene.source.tolist() == source
        npt.assert_array_equal(scene.given.nodes.position, mixed.nodes.position[source])
        assert scene.num_missing == (0 if keep else 4)  # what lies is no part of what is missing
        assert "left out 1 plane (lean of more than 15 degrees)" in scene.remarks


def shared_wall():
    """Two rooms along one plane, of which a robot has made one; the other sides are of one room."""
    west, east = planes_of_room(0, 4, 0, 3), planes_of_room(4.2, 8.2, 0, 3)
    centroid, normal, width = (
        np.array([*one[:3], *other[:3]]) for one, other in zip(west, east, strict=True)
    )
    long = np.array([4.1, 3.0]), np.array([0.0, -1.0]), 8.2
    position, normal = (
        np.pad(np.vstack([values, more]), [(0, 0), (0, 1)])
        for values, more in ((centroid, long[0]), (normal, long[1]))
    )
    return planes(position, normal, [*width, long[2]])


def test_a_plane_that_rooms_share_is_cut_and_comes_back_whole():
    given = shared_wall()
    (scene,) = prepared(given)
    assert scene.remarks == ("cut 1 of 7 planes where others abut on them, and joined them again",)
    assert len(scene.centred.nodes.label) == 8
    rooms = [[8.0, 0, 0], [9.0, 0, 0]]  # of the first piece, and of the second
    grown = extended(scene.centred, [ROOM, ROOM], rooms, [[6, 8], [7, 9], [0, 8]])
    back = whole_again(scene, in_place(scene, grown))
    for found, expected in zip(observed_of(back).nodes, given.nodes, strict=True):
        npt.assert_array_equal(found, expected)
    npt.assert_array_equal(undirected_edges(back, PART_OF), [[0, 7], [6, 7], [6, 8]])
    npt.assert_allclose(back.nodes.position[7:], scene.centre + rooms)
    npt.assert_array_equal(scene.num_pieces, [1, 1, 1, 1, 1, 1, 2])
    (scene,) = prepare([given], PAPER_ONTOLOGY, False, cut="never")
    npt.assert_array_equal(scene.num_pieces, np.ones(7))
    assert scene.remarks == ()
    assert len(scene.centred.nodes.label) == 7


def test_a_plane_that_was_seen_twice_is_grown_from_once_and_comes_back_alone():
    given = shared_wall()
    rows = [*range(7), 6]
    position = given.nodes.position[rows]
    position[7] += [0.0, 0.01, 0.2]
    twice = planes(position, given.nodes.normal[rows], given.nodes.width[rows])
    (scene,), (once,) = prepared(twice), prepared(given)
    assert scene.remarks == (
        "left 1 of 8 planes alone, which show again what one before them does",
        "cut 1 of 8 planes where others abut on them, and joined them again",
    )
    npt.assert_array_equal(scene.num_pieces, [1, 1, 1, 1, 1, 1, 2, 0])
    assert (scene.set_aside.tolist(), once.set_aside.tolist()) == ([7], [])
    for found, expected in zip(scene.centred.nodes, once.centred.nodes, strict=True):
        npt.assert_array_equal(found, expected)
    back = whole_again(
        scene, in_place(scene, extended(scene.centred, [ROOM], [[8, 0, 0]], [[6, 8]]))
    )
    npt.assert_array_equal(back.nodes.position[:8], twice.nodes.position)
    npt.assert_array_equal(undirected_edges(back, PART_OF), [[6, 8]])
    uncut = subgraph(twice, [0, 6, 7])
    (scene,) = prepared(uncut)
    assert scene.remarks == (
        "left 1 of 3 planes alone, which show again what one before them does",
    )
    assert scene.num_in_pieces == 2


def test_a_plane_whose_room_is_known_is_not_cut():
    known = extended(shared_wall(), [ROOM], [[2.0, 1.5, 0.0]], [[6, 7]])
    (scene,) = prepared(known, keep=True)
    assert scene.remarks == ()
    assert scene.pieces is None


@pytest.mark.parametrize("option", ["normals", "cut"])
def test_unknown_choices_are_refused(option):
    with pytest.raises(ValueError, match=rf"{option} is 'yes', expected \w+ or [\w-]+$"):
        prepare([two_rooms()], PAPER_ONTOLOGY, False, **{option: "yes"})


def test_normals_of_two_decimals_are_brought_to_unit_length_and_others_left_alone():
    rounded = changed(normal=np.round(observed_of(two_rooms()).nodes.normal * 0.993, 3))
    (scene,) = prepared(rounded)
    npt.assert_allclose(np.linalg.norm(scene.given.nodes.normal, axis=1), 1, rtol=1e-12)
    (scene,) = prepared(two_rooms())
    npt.assert_array_equal(scene.given.nodes.normal, two_rooms().nodes.normal[:NUM_PLANES])


def test_other_concepts_are_taken_as_the_model_knows_them():
    (scene,) = prepared(own_world(), ontology=ONTOLOGY)
    assert scene.given.nodes.observed.all()
    assert sorted(set(scene.given.nodes.label.tolist())) == [0, 1]
    assert scene.num_missing == 7
