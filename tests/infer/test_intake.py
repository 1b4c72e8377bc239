"""What is mended on the way in, and that what is right stays as it is."""

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.infer.intake import taken_in
from sg3d_jax.scene.graph import make_graph, observed_of, subgraph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PLANE, ROOM
from tests.own_world import NUM_OBSERVED, own_world
from tests.two_rooms import NUM_PLANES, moved, two_rooms


def observed(**fields):
    """Returns the planes of both rooms with other fields."""
    graph = observed_of(two_rooms())
    return graph._replace(nodes=graph.nodes._replace(**fields))


def normals(**rows):
    """Returns the planes of both rooms, some with another normal: row_3=[x, y, z]."""
    normal = np.array(two_rooms().nodes.normal[:NUM_PLANES])
    for name, value in rows.items():
        normal[int(name.removeprefix("row_"))] = value
    return observed(normal=normal)


def leaning(degrees, towards=(1.0, 0.0)):
    """Returns a unit normal that is so far from horizontal."""
    lean = np.radians(degrees)
    return [*np.cos(lean) * np.array(towards), np.sin(lean)]


def take(scene, **options):
    return taken_in(scene, "a.json", **options)


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("length", [1.0, 1 - 1e-16, 0.9995, 1.0005])
def test_what_is_right_stays_bit_for_bit(angle, length):
    scene = moved(observed_of(two_rooms()), angle, (5e6 + 0.1234567, -5e6, 100.0))
    scene = scene._replace(nodes=scene.nodes._replace(normal=scene.nodes.normal * length))
    graph, source, remarks = take(scene)
    for found, expected in zip(graph.nodes, scene.nodes, strict=True):
        npt.assert_array_equal(found, expected, strict=True)
    assert source.tolist() == list(range(NUM_PLANES))
    assert remarks == ()


@pytest.mark.parametrize("degrees", [0.1, -2.0, 14.9, -14.9])
def test_planes_that_lean_a_little_are_levelled(degrees):
    scene = normals(row_0=leaning(degrees), row_1=[-1.0, 0.0, 1e-4])
    graph, source, remarks = take(scene)
    npt.assert_allclose(graph.nodes.normal[0], [1, 0, 0], atol=1e-15)
    assert graph.nodes.normal[0, 2] == 0
    npt.assert_array_equal(graph.nodes.normal[1:], scene.nodes.normal[1:])
    npt.assert_array_equal(graph.nodes.position, scene.nodes.position)
    assert len(source) == NUM_PLANES
    assert remarks == ("levelled 1 plane (lean of up to 15 degrees)",)


@pytest.mark.parametrize("degrees", [15.1, -30.0, 90.0])
def test_planes_that_lean_more_are_left_out(degrees):
    scene = normals(row_0=leaning(degrees), row_5=leaning(-degrees))
    graph, source, remarks = take(scene)
    assert source.tolist() == [1, 2, 3, 4, 6, 7]
    npt.assert_array_equal(graph.nodes.normal, scene.nodes.normal[source])
    npt.assert_array_equal(graph.nodes.width, scene.nodes.width[source])
    assert remarks == ("left out 2 planes (lean of more than 15 degrees)",)


def test_what_is_left_out_is_not_mended_too():
    scene = subgraph(normals(row_0=[0, 0.1, 3.0]), [*range(NUM_PLANES), 0])
    _, source, remarks = take(scene)
    assert source.tolist() == list(range(1, NUM_PLANES))
    assert remarks == ("left out 2 planes (lean of more than 15 degrees)",)


@pytest.mark.parametrize("length", [1e-300, 0.01, 0.995, 3.0, 1e200])
def test_normals_are_brought_to_length_one(length):
    slanted = np.array([0.6, -0.8, 0.0])
    scene = normals(row_0=length * slanted, row_3=slanted)
    graph, _, remarks = take(scene)
    npt.assert_allclose(graph.nodes.normal[0], slanted, rtol=1e-15)
    npt.assert_array_equal(graph.nodes.normal[1:], scene.nodes.normal[1:])
    assert remarks == ("brought the normals of 1 plane to length 1",)


@pytest.mark.parametrize("shift", [0.0, 1e-9])
def test_repeats_are_merged_into_the_first(shift):
    scene = subgraph(observed_of(two_rooms()), [0, 1, 2, 1, 3, 0, 1])
    nodes = scene.nodes._replace(
        position=scene.nodes.position + shift * np.arange(7)[:, None],
        normal=np.array(scene.nodes.normal),
    )
    nodes.normal[3][nodes.normal[3] == 0] = -0.0  # a zero of the other sign is no other normal
    graph, source, remarks = take(scene._replace(nodes=nodes))
    assert source.tolist() == [0, 1, 2, 4]
    npt.assert_array_equal(graph.nodes.position, nodes.position[source])
    assert remarks == ("merged 3 planes (exactly repeated)",)


def test_two_faces_of_a_wall_without_thickness_are_no_repeats():
    scene = make_graph([PLANE] * 2, np.zeros((2, 3)), [[1, 0, 0], [-1, 0, 0.0]], [2, 2])
    assert take(scene).remarks == ()


def test_repeats_of_what_is_kept_leave_their_rooms_to_the_first():
    nodes = subgraph(two_rooms(), [0, 1, 1, 9, 10]).nodes
    pairs = [[0, 3], [1, 3], [2, 3], [2, 4]]
    scene = make_graph(*(nodes.label, nodes.position, nodes.normal, nodes.width), pairs)
    graph, source, _ = take(scene)
    assert source.tolist() == [0, 1, 3, 4]
    npt.assert_array_equal(undirected_edges(graph, PART_OF), [[0, 2], [1, 2], [1, 3]])


def test_what_is_left_out_leaves_with_its_edges():
    scene = two_rooms()
    normal = np.array(scene.nodes.normal)
    normal[0] = [0, 0, 1]
    graph, source, _ = take(scene._replace(nodes=scene.nodes._replace(normal=normal)))
    assert source.tolist() == list(range(1, 12))
    expected = undirected_edges(scene, PART_OF)
    npt.assert_array_equal(undirected_edges(graph, PART_OF), expected[expected[:, 0] > 0] - 1)


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ([0, 0, 0], r"holds one plane, having merged 2 planes \(exactly repeated\), expected at"),
    ],
)
def test_two_planes_must_be_left(rows, sentence):
    with pytest.raises(ValueError, match=rf"^a\.json: planes {sentence}"):
        take(subgraph(observed_of(two_rooms()), rows))
    flat = {f"row_{row}": [0, 0, 1] for row in range(NUM_PLANES)}
    with pytest.raises(ValueError, match=r"planes holds no planes, having left out 8 planes \("):
        take(normals(**flat))


@pytest.mark.parametrize("choice", ["check", "as-given"])
def test_normals_that_are_flipped_all_over_are_turned_unless_they_are_to_be_kept(choice):
    right = registry.make("s-f", 1)[0]
    flipped = right._replace(nodes=right.nodes._replace(normal=0.0 - right.nodes.normal))
    graph, _, remarks = take(flipped, normals=choice)
    (remark,) = remarks
    expected = right if choice == "check" else flipped
    npt.assert_array_equal(graph.nodes.normal, expected.nodes.normal)
    done = "turned all normals, since" if choice == "check" else "kept all normals as given, though"
    assert remark.startswith(f"{done} ")
    assert "have others behind them and none in front, 1 the reverse" in remark
    assert take(right, normals=choice).remarks == ()


@pytest.mark.parametrize("choice", ["check", "as-given"])
def test_a_normal_that_is_flipped_among_right_ones_is_turned_unless_all_are_to_be_kept(choice):
    right = registry.make("s-f", 1)[0]
    chosen = np.isin(np.arange(len(right.nodes.label)), [2, 12])[:, None]
    normal = np.where(chosen, 0.0 - right.nodes.normal, right.nodes.normal)
    flipped = right._replace(nodes=right.nodes._replace(normal=normal))
    graph, _, remarks = take(flipped, normals=choice)
    expected = right if choice == "check" else flipped
    npt.assert_array_equal(graph.nodes.normal, expected.nodes.normal)
    done = "turned" if choice == "check" else "kept"
    (remark,) = remarks
    assert remark.startswith(f"{done} the normals of 2 planes")


def test_sizes_that_are_not_plausible_are_said_and_nothing_else_is_judged_by_them():
    right = registry.make("s-f", 1)[0].nodes
    small = make_graph(*(right.label, right.position / 1e3, -right.normal, right.width / 1e3))
    (remark,) = take(small).remarks
    assert remark.startswith("the planes have the size of a doll's house, with widths of about 0.0")


def test_what_has_no_normal_is_merged_and_neither_levelled_nor_judged():
    world = own_world()
    world = subgraph(world, [*range(NUM_OBSERVED), NUM_OBSERVED - 1], edges=False)
    graph, source, remarks = take(world)
    assert source.tolist() == list(range(NUM_OBSERVED))
    npt.assert_array_equal(graph.nodes.position, world.nodes.position[:NUM_OBSERVED])
    assert remarks == ("merged 1 plane or pillar (exactly repeated)",)


@pytest.mark.parametrize("name", ["s-f-square", "s-f", "s-c"])
def test_nothing_is_said_of_data_sets(name):
    for graph in registry.make(name, 20):
        assert take(graph).remarks == ()


def test_rooms_stay_as_they_are():
    scene = two_rooms()
    graph, source, _ = take(scene)
    assert source.tolist() == list(range(12))
    assert graph.nodes.label.tolist().count(ROOM) == 2
    npt.assert_array_equal(undirected_edges(graph, PART_OF), undirected_edges(scene, PART_OF))
