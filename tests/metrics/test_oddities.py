"""What is unusual about graphs, on scenes that were spoilt in one way each."""

import dataclasses

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.data import registry
from sg3d_jax.metrics.oddities import Odd, Oddity, Remark, check, oddities
from sg3d_jax.scene.graph import features_of, make_graph
from sg3d_jax.scene.ontology import BUILDING, FLOOR, PAPER_ONTOLOGY, PLANE, ROOM, WALL
from sg3d_jax.scene.padding import Capacity, pad
from tests import own_world
from tests.two_rooms import LABELS, NUM_PLANES, PART_OF_PAIRS, two_rooms

WALL_NODE, ROOM_NODE, FLOOR_NODE = NUM_PLANES, NUM_PLANES + 1, NUM_PLANES + 3


def scene(label=tuple(LABELS), part_of=tuple(PART_OF_PAIRS), position=None):
    label = np.array(label)
    if position is None:
        position = np.arange(3.0 * len(label)).reshape(-1, 3)
    planes = label == PLANE
    return make_graph(label, position, planes[:, None] * [1.0, 0.0, 0.0], planes * 1.0, part_of)


def without(*pairs):
    return [pair for pair in PART_OF_PAIRS if tuple(pair) not in pairs]


@pytest.mark.parametrize("name", ["s-f-square", "s-f"])
def test_synthetic_floors_are_as_they_should_be(name):
    assert check(registry.make(name, 50)) == []


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        (scene(), {}),
        (
            scene(part_of=without((0, ROOM_NODE))),
            {"plane without a room": 1, "node apart from the rest": 1},
        ),
        (scene(part_of=[*PART_OF_PAIRS, (0, ROOM_NODE + 1)]), {"plane with more than one room": 1}),
        (scene(part_of=without((1, WALL_NODE))), {"wall with fewer than two planes": 1}),
        (
            scene([*LABELS, WALL]),
            {"wall with fewer than two planes": 1, "node apart from the rest": 1},
        ),
        (
            scene([*LABELS, ROOM], [*PART_OF_PAIRS, (NUM_PLANES + 4, FLOOR_NODE)]),
            {"empty room": 1},
        ),
        (
            scene([*LABELS, BUILDING]),
            {"floor without a building": 1, "empty building": 1} | {"node apart from the rest": 1},
        ),
        (
            scene([*LABELS, FLOOR], [*PART_OF_PAIRS, (ROOM_NODE, NUM_PLANES + 4)]),
            {"room with more than one floor": 1},
        ),
        (scene(position=np.zeros((len(LABELS), 3))), {"repeated plane": NUM_PLANES - 1}),
        (
            scene([PLANE] * 3, np.zeros((0, 2), int)),
            {"node apart from the rest": 2},
        ),
    ],
)
def test_what_is_unusual_is_named_and_counted(graph, expected):
    found = oddities(graph)
    assert {odd.text(PAPER_ONTOLOGY): count for odd, count in found.items()} == expected


def test_oddities_name_the_concepts_that_they_are_about():
    found = oddities(scene(part_of=without((0, ROOM_NODE), (1, WALL_NODE))))
    assert found == {
        Odd(Oddity.WITHOUT_WHOLE, "plane", "room"): 1,
        Odd(Oddity.TOO_FEW_PARTS, "wall"): 1,
        Odd(Oddity.APART): 1,
    }


def test_planes_in_one_place_are_repeated_only_with_all_their_features():
    position, normal = np.zeros((5, 3)), np.eye(3)[[0, 1, 0, 0, 1]]
    graph = make_graph([PLANE] * 5, position, normal, [1, 1, 2, 1, 2], [])
    assert oddities(graph)[Odd(Oddity.REPEATED, "plane")] == 1


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([0.05, 0.15, 0.4]))
@settings(deadline=None, max_examples=50)
def test_nodes_apart_are_those_outside_the_largest_component_of_networkx(seed, num_nodes, share):
    edges = nx.gnp_random_graph(num_nodes, share, seed=seed)
    graph = make_graph([ROOM] * num_nodes, np.zeros((num_nodes, 3)), part_of=[*edges.edges])
    largest = max(map(len, nx.connected_components(edges)))
    assert oddities(graph)[Odd(Oddity.APART)] == num_nodes - largest


def test_a_graph_without_nodes_has_no_oddities():
    assert oddities(make_graph([], [])) == {}


def own_oddities(label=(), without=(), more=(), position=None):
    """Returns what is odd about the made-up world with further nodes and other edges."""
    world = own_world.own_world()
    label = [*world.nodes.label, *label]
    fields = {
        name: np.concatenate([array, np.zeros((len(label) - len(array), *array.shape[1:]))])
        for name, array in {"position": world.nodes.position, **features_of(world)}.items()
    }
    if position:
        fields["position"][position[0]] = fields["position"][position[1]]
    pairs = [pair for pair in own_world.PART_OF_PAIRS if pair not in without]
    graph = make_graph(label, **fields, part_of=[*pairs, *more], ontology=own_world.ONTOLOGY)
    return {odd.text(own_world.ONTOLOGY): count for odd, count in oddities(graph).items()}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, {}),
        ({"position": (12, 13)}, {"repeated pillar": 1}),
        ({"position": (12, 0)}, {}),
        ({"without": [(12, 15)]}, {"pillar without a room": 1, "node apart from the rest": 1}),
        ({"more": [(12, 16)]}, {"pillar with more than one room": 1}),
        ({"without": [(1, 14)]}, {"wall with fewer than two planes": 1}),
        (
            {"label": [own_world.FLAT], "more": [(21, 20)]},
            {"empty flat": 1},
        ),
        (
            {"label": [own_world.FLOOR]},
            {"empty floor": 1, "node apart from the rest": 1},
        ),
        ({"without": [(18, 20)]}, {"flat without a floor": 1, "node apart from the rest": 7}),
    ],
)
def test_oddities__of_a_made_up_ontology_are_named_and_counted(changes, expected):
    assert own_oddities(**changes) == expected


def test_what_is_too_few_is_said_in_the_words_of_the_ontology():
    concepts = [
        dataclasses.replace(concept, least_parts={"room": 3, "flat": 12}.get(concept.name, 1))
        for concept in own_world.ONTOLOGY.concepts
    ]
    ontology = dataclasses.replace(own_world.ONTOLOGY, concepts=tuple(concepts))
    texts = [Odd(Oddity.TOO_FEW_PARTS, name).text(ontology) for name in ("room", "flat", "floor")]
    assert texts == [
        "room with fewer than three planes or pillars",
        "flat with fewer than 12 rooms",
        "empty floor",
    ]


def test_remarks_say_how_often_and_where_first():
    fewer = scene(part_of=without((1, WALL_NODE)))
    assert check([scene(), fewer, scene(), fewer]) == [
        Remark("wall with fewer than two planes", 2, 2, 1)
    ]


def test_a_graph_in_millimetres_is_odd():
    graph = two_rooms()
    nodes = graph.nodes._replace(
        position=1000 * graph.nodes.position, width=1000 * graph.nodes.width
    )
    (remark,) = check([graph, graph._replace(nodes=nodes)])
    assert remark.what == "node of a graph too large to be in metres"
    assert (remark.nodes, remark.graphs, remark.first) == (len(nodes.label), 1, 1)


def test_padding_is_nothing_unusual():
    assert check([pad(two_rooms(), Capacity(16, 192))]) == check([two_rooms()])
