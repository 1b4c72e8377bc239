import numpy as np
import pytest

from sg3d_jax.scene.graph import features_of, make_graph
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PLANE, ROOM, WALL
from sg3d_jax.scene.padding import Capacity, pad
from sg3d_jax.scene.validate import check_observed, validate_graph
from tests import own_world
from tests.furnished_rooms import BED, ROOMS, furnished_rooms, with_kind

WHERE = "scenes.npz: graph 3"


def two_rooms():
    """Two facing planes, their wall, a room each, and a floor."""
    return make_graph(
        label=[PLANE, PLANE, WALL, ROOM, ROOM, FLOOR],
        position=[[1, 0, 0], [1.1, 0, 0], [1.05, 0, 0], [0, 0, 0], [2, 0, 0], [1, 0, 0]],
        normal=[[-1, 0, 0], [1, 0, 0], *np.zeros((4, 3))],
        width=[2, 2, 0, 0, 0, 0],
        part_of=[[0, 2], [1, 2], [0, 3], [1, 4], [3, 5], [4, 5]],
        proximity=[[0, 1]],
    )


def with_node(graph, **fields):
    """Returns the graph with entries of node fields replaced: field=(index, value)."""
    changed = {}
    for name, (index, value) in fields.items():
        changed[name] = np.array(getattr(graph.nodes, name))
        changed[name][index] = value
    return graph._replace(nodes=graph.nodes._replace(**changed))


def with_pairs(*pairs):
    """Returns the graph with part-of edges appended."""
    part_of = [[0, 2], [1, 2], [0, 3], [1, 4], [3, 5], [4, 5], *pairs]
    return with_edges(two_rooms(), part_of=part_of)


def with_edges(graph, **edges):
    """Returns the nodes of a graph with other edges."""
    nodes = graph.nodes
    return make_graph(
        nodes.label, nodes.position, **features_of(graph), **edges, ontology=graph.globals
    )


def test_a_sound_graph_passes():
    validate_graph(two_rooms(), WHERE)


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"position": ((4, 1), np.nan)}, r"nodes\[4\].position is \[2, nan, 0\], expected finite"),
        ({"normal": (1, np.inf)}, r"nodes\[1\].normal is \[inf, inf, inf\], expected finite"),
        ({"width": (0, np.nan)}, r"nodes\[0\].width is nan, expected finite"),
        ({"label": (2, 6)}, r"nodes\[2\].label is 6, expected 0 to 5"),
        ({"label": (2, -1)}, r"nodes\[2\].label is -1, expected 0 to 5"),
        ({"normal": ((0, 0), -1.01)}, r"nodes\[0\].normal is \[-1.01, 0, 0\], expected length 1"),
        ({"width": (1, -2)}, r"nodes\[1\].width is -2, expected zero metres or more"),
        ({"width": (3, 1)}, r"nodes\[3\].width is 1, expected zero: only planes have one"),
        ({"normal": (5, 1)}, r"nodes\[5\].normal is \[1, 1, 1\], expected zero: only planes"),
    ],
)
def test_a_bad_node_is_named(fields, sentence):
    with pytest.raises(ValueError, match=rf"^{WHERE}: {sentence}"):
        validate_graph(with_node(two_rooms(), **fields), WHERE)


@pytest.mark.parametrize(
    ("pair", "sentence"),
    [
        ([3, 3], r"edge \[3, 3\] is a loop"),
        ([3, 6], r"edge \[3, 6\] joins a missing node, expected 0 to 5"),
        ([-1, 3], r"edge \[-1, 3\] joins a missing node"),
        ([0, 2], r"edge \[0, 2\] is there twice"),
        ([2, 0], r"edge \[0, 2\] is there twice"),
    ],
)
def test_a_bad_edge_is_named(pair, sentence):
    with pytest.raises(ValueError, match=rf"^{WHERE}: {sentence}"):
        validate_graph(with_pairs(pair), WHERE, rules=False)


@pytest.mark.parametrize("pair", [[0, 5], [2, 3], [3, 4], [2, 5], [0, 1]])
def test_edges_outside_the_hierarchy_are_refused_only_by_the_rules(pair):
    validate_graph(with_pairs(pair), WHERE, rules=False)
    with pytest.raises(ValueError, match=rf"edge \[{pair[0]}, {pair[1]}\] joins .* as part_of"):
        validate_graph(with_pairs(pair), WHERE)


def test_proximity_of_other_things_than_planes_is_refused():
    odd = with_edges(two_rooms(), proximity=[[0, 3]])
    sentence = "joins plane and room as proximity, expected two that are observed"
    with pytest.raises(ValueError, match=sentence):
        validate_graph(odd, WHERE)


def test_an_edge_in_one_direction_only_is_refused():
    graph = two_rooms()
    senders, receivers = np.array(graph.senders), np.array(graph.receivers)
    senders[-1], receivers[-1] = 0, 5
    with pytest.raises(ValueError, match="has no opposite, expected both directions"):
        validate_graph(graph._replace(senders=senders, receivers=receivers), WHERE)


def test_an_unknown_relation_is_refused():
    graph = two_rooms()
    relation = np.where(graph.edges.relation == PART_OF, 2, graph.edges.relation)
    with pytest.raises(ValueError, match="unknown relation"):
        validate_graph(graph._replace(edges=graph.edges._replace(relation=relation)), WHERE)


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("position", np.zeros((6, 2)), r"position has shape \[6, 2\], expected \[6, 3\]"),
        ("normal", np.zeros((5, 3)), r"normal has shape \[5, 3\], expected \[6, 3\]"),
        ("width", np.zeros((6, 1)), r"width has shape \[6, 1\], expected \[6\]"),
        ("mask", np.ones(7, bool), r"mask has shape \[7\], expected \[6\]"),
        ("label", np.zeros(6), r"label is float64, expected integers"),
    ],
)
def test_a_wrong_shape_or_type_is_named(name, value, sentence):
    graph = two_rooms()
    broken = graph._replace(nodes=graph.nodes._replace(**{name: value}))
    with pytest.raises(ValueError, match=rf"^{WHERE}: {sentence}"):
        validate_graph(broken, WHERE)


def test_counts_must_agree():
    with pytest.raises(ValueError, match=r"n_edge is \[4\], expected \[14\]"):
        validate_graph(two_rooms()._replace(n_edge=np.array([4])), WHERE)


def test_a_padded_graph_is_refused():
    with pytest.raises(ValueError, match=r"n_node is \[6, 2\], expected \[8\]"):
        validate_graph(pad(two_rooms(), Capacity(8, 32)), WHERE)


def test_an_empty_graph_is_refused():
    empty = make_graph([], [], [], [], part_of=[])
    with pytest.raises(ValueError, match="nodes is empty"):
        validate_graph(empty, WHERE)


def corridor():
    """Centroid, normal and width of three planes, metres."""
    position = np.array([[0, 1, 0], [0, -1, 0], [4, 0, 0.0]])
    normal = np.array([[0, -1, 0], [0, 1, 0], [-1, 0, 0.0]])
    return position, normal, np.array([8, 8, 2.0])


def planes(position, normal, width):
    return make_graph([PLANE] * len(position), position, normal, width)


def refusal(position, normal, width):
    return refusal_of(planes(position, normal, width))


def refusal_of(graph):
    with pytest.raises(ValueError, match=r"^planes\.json: ") as caught:
        check_observed(graph, "planes.json")
    message = str(caught.value)
    assert "\n" not in message
    assert "expected" in message
    return message


def test_sound_planes_pass():
    check_observed(planes(*corridor()), "planes.json")


def test_what_is_not_observed_is_not_looked_at():
    check_observed(with_node(two_rooms(), position=(3, np.nan), normal=((5, 0), 0.995)), WHERE)


def test_two_sides_of_one_thin_wall_pass():
    _, normal, _ = corridor()
    check_observed(planes(np.zeros((2, 3)), normal[:2], np.ones(2)), "planes.json")


@pytest.mark.parametrize(("count", "held"), [(0, "no planes"), (1, "one plane")])
def test_too_few_planes_are_refused(count, held):
    message = refusal(*(field[:count] for field in corridor()))
    assert f"planes holds {held}, expected at least two" in message


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(("field", "name"), [(0, "centroid"), (1, "normal"), (2, "width")])
def test_non_finite_numbers_are_named(field, name, value):
    fields = [np.array(array) for array in corridor()]
    fields[field][2] = value
    assert f"planes[2].{name} is " in refusal(*fields)


def test_normals_that_point_nowhere_are_refused():
    position, normal, width = corridor()
    normal[1] = 0
    message = refusal(position, normal, width)
    assert "planes[1].normal is [0, 0, 0], expected length 1" in message


def test_widths_must_not_be_negative():
    position, normal, width = corridor()
    width[1] = -1
    assert "planes[1].width is -1, expected zero metres or more" in refusal(position, normal, width)


@pytest.mark.parametrize("scale", [1e-300, 0.9, 1.1, 1e200])
@pytest.mark.parametrize("normal", [[0, 0, 1], [0.6, 0, 0.8], [0.995, 0, 0.1], [0, -1, 0]])
def test_what_can_be_mended_passes(scale, normal):
    """Normals of any length and lean, widths of zero and repeats: the way in mends them."""
    position, normals, width = (np.concatenate([field, field[1:2]]) for field in corridor())
    normals[2] = scale * np.array(normal)
    width[2] = 0
    check_observed(planes(position, normals, width), "planes.json")


def test_a_graph_may_have_normals_of_any_length_unless_rules_are_asked_for():
    long = with_node(two_rooms(), normal=((0, 0), -3.0))
    validate_graph(long, WHERE, rules=False)
    with pytest.raises(ValueError, match=r"nodes\[0\].normal is \[-3, 0, 0\], expected length 1"):
        validate_graph(long, WHERE)
    nowhere = with_node(two_rooms(), normal=(0, 0.0))
    with pytest.raises(ValueError, match=r"nodes\[0\].normal is \[0, 0, 0\], expected length 1"):
        validate_graph(nowhere, WHERE, rules=False)


@pytest.mark.parametrize(("of_position", "of_width"), [(1000, 1000), (1000, 1), (1, 1000)])
def test_millimetres_are_recognised(of_position, of_width):
    position, normal, width = corridor()
    assert "looks like millimetres" in refusal(position * of_position, normal, width * of_width)


def test_a_building_far_from_the_origin_passes():
    position, normal, width = corridor()
    far = planes(position + np.array([5e5, 4.6e6, 100.0]), normal, width)
    check_observed(far, "planes.json")


@pytest.mark.parametrize("field", [0, 1, 2])
def test_a_field_of_another_length_is_refused(field):
    fields = list(corridor())
    fields[field] = fields[field][:2]
    assert "has shape" in refusal_of(make_graph([PLANE] * 3, *fields))


@pytest.mark.parametrize(
    ("name", "shape"), [("position", (3, 2)), ("normal", (3, 2)), ("width", (3, 1))]
)
def test_a_field_of_another_width_is_refused(name, shape):
    position, normal, width = corridor()
    fields = {"position": position, "normal": normal, "width": width} | {name: np.ones(shape)}
    message = refusal_of(make_graph([PLANE] * 3, **fields))
    assert f"{name} has shape {list(shape)}, expected " in message


@pytest.mark.parametrize("label", [-1, 6])
def test_an_unknown_label_is_refused(label):
    message = refusal_of(make_graph([PLANE, PLANE, label], *corridor()))
    assert f"nodes[2].label is {label}, expected 0 to 5" in message


@pytest.mark.parametrize(
    ("row", "kind", "sentence"),
    [
        (7, 4, r"nodes\[7\].kind is 4, expected 0 to 3"),  # a unit
        (5, 1.5, r"nodes\[5\].kind is 1.5, expected 0 to 12"),
        (5, -1, r"nodes\[5\].kind is -1, expected 0 to 12"),
        (4, np.nan, r"nodes\[4\].kind is nan, expected finite numbers"),
        (8, 1, r"nodes\[8\].kind is 1, expected zero: only objects and rooms and units have one"),
    ],
)
def test_a_kind_that_a_concept_has_not_is_refused(row, kind, sentence):
    validate_graph(furnished_rooms(), WHERE)
    with pytest.raises(ValueError, match=rf"^{WHERE}: {sentence}"):
        validate_graph(with_kind(furnished_rooms(), row, kind), WHERE)


def test_kinds_of_what_is_observed_are_looked_at_before_growing():
    with pytest.raises(ValueError, match=rf"^{WHERE}: .*kind is 15, expected 0 to 14"):
        check_observed(with_kind(furnished_rooms(), BED, 15), WHERE)
    check_observed(with_kind(furnished_rooms(), ROOMS[0], 15), WHERE)


def test_a_made_up_world_is_sound():
    world = own_world.own_world()
    validate_graph(world, WHERE)
    check_observed(world, WHERE)


def test_nodes_of_a_made_up_world_are_counted_within_their_concept():
    world, (pillar, other) = own_world.own_world(), (own_world.NUM_PLANES, own_world.NUM_PLANES + 1)
    nowhere = with_node(world, position=((other, 1), np.nan))
    assert "pillars[1].centroid is [6, nan, 1.2], expected finite numbers" in refusal_of(nowhere)
    # A pillar has neither normal nor width: none is asked of it, and none may be there.
    wide = with_node(world, width=(pillar, 1.0))
    assert f"nodes[{pillar}].width is 1, expected zero: only planes have one" in refusal_of(wide)
    turned = with_node(world, normal=((pillar, 0), 1.0))
    assert f"nodes[{pillar}].normal is [1, 0, 0], expected zero" in refusal_of(turned)
    millimetres = world._replace(nodes=world.nodes._replace(position=1000 * world.nodes.position))
    assert "planes or pillars spans 12000" in refusal_of(millimetres)


@pytest.mark.parametrize(
    ("label", "held"), [([3], "no planes or pillars"), ([3, 1], "one pillar"), ([0], "one plane")]
)
def test_too_little_that_is_observed_is_refused(label, held):
    facing = [[label == own_world.PLANE, 0, 0] for label in label]
    width = [float(label == own_world.PLANE) for label in label]
    position = np.arange(3.0 * len(label)).reshape(-1, 3)
    few = make_graph(label, position, facing, width, ontology=own_world.ONTOLOGY)
    assert f"planes or pillars holds {held}, expected at least two to group" in refusal_of(few)


def test_pillars_alone_are_enough_to_grow_from():
    position = np.array([[0.0, 0, 1], [4, 0, 1]])
    pillars = make_graph([own_world.PILLAR] * 2, position, ontology=own_world.ONTOLOGY)
    check_observed(pillars, WHERE)


@pytest.mark.parametrize("field", ["position", "width"])
def test_numbers_of_which_the_squares_overflow_are_refused(field):
    graph = two_rooms()
    values = getattr(graph.nodes, field).copy()
    values[1] = 1e308
    nodes = graph.nodes._replace(**{field: values})
    with pytest.raises(
        ValueError, match=rf"^a: nodes\[1\]\.{field} is .*, expected numbers within"
    ):
        validate_graph(graph._replace(nodes=nodes), "a")
