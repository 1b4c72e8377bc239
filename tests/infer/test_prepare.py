import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.infer.prepare import finished, prepare
from sg3d_jax.scene.graph import extended, observed_of, subgraph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PART_OF, PROXIMITY
from sg3d_jax.scene.padding import Capacity, moved_by, pad
from tests.own_world import ONTOLOGY, own_world
from tests.two_rooms import NUM_PLANES, two_rooms

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
        back = finished(scene, grown)
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
        (with_entry("width", -1.0), r"scene 0: planes\[3\].width is -1.*more than zero"),
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
