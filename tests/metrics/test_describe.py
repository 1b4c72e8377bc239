"""Statistics of data sets, against networkx and scipy."""

import json

import networkx as nx
import numpy as np
import pytest
from scipy.spatial import cKDTree

from sg3d_jax.data import registry
from sg3d_jax.metrics.describe import count_proximity_edges, describe
from sg3d_jax.scene.graph import SceneGraph, make_graph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.padding import Capacity, pad
from tests import own_world


def one_room() -> SceneGraph:
    normal = [[-1, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0]]
    return make_graph(
        label=[PLANE] * 4 + [ROOM, FLOOR],
        position=-2.0 * np.array(normal),
        normal=normal,
        width=[4.0, 4.0, 4.0, 4.0, 0.0, 0.0],
        part_of=[(0, 4), (1, 4), (2, 4), (3, 4), (4, 5)],
    )


def with_proximity(graph: SceneGraph) -> nx.Graph:
    """Returns the undirected graph with the 10 nearest planes of each plane, by a KD-tree."""
    planes = graph.nodes.position[graph.nodes.label == PLANE]
    _, nearest = cKDTree(planes).query(planes, k=min(11, len(planes)))
    result = nx.Graph(zip(graph.senders.tolist(), graph.receivers.tolist(), strict=True))
    result.add_edges_from((i, int(j)) for i, row in enumerate(nearest) for j in row if i != j)
    return result


def test_one_room_counts_its_six_plane_pairs():
    summary = describe([one_room()])
    assert summary["num_graphs"] == 1
    assert summary["nodes"] == {"mean": 6.0, "sd": 0.0, "min": 6.0, "max": 6.0}
    assert summary["hierarchy_edges"]["mean"] == 5
    assert summary["proximity_edges"]["mean"] == 6
    assert summary["edges"]["mean"] == 11
    assert summary["degree"]["mean"] == pytest.approx(22 / 6)
    assert summary["children"] == {"plane-room": {"4": 1.0}, "room-floor": {"1": 1.0}}
    assert set(summary["concepts"]) == {"plane", "room", "floor"}
    ranges = {"x": [-2.0, 2.0], "y": [-2.0, 2.0], "z": [0.0, 0.0], "width": [4.0, 4.0]}
    assert summary["ranges"] == ranges


def test_edges_and_degree_are_those_of_networkx_with_a_kd_tree():
    graphs = registry.make("s-f-square", num_graphs=20)
    others = [with_proximity(graph) for graph in graphs]
    summary = describe(graphs)
    num_edges = [other.number_of_edges() for other in others]
    degrees = [np.mean([degree for _, degree in other.degree]) for other in others]
    # Planes on a grid are often equally far from a third one: float32 and a KD-tree choose freely.
    assert summary["edges"]["mean"] == pytest.approx(np.mean(num_edges), rel=0.005)
    assert summary["degree"]["mean"] == pytest.approx(np.mean(degrees), rel=0.005)
    assert summary["degree"]["sd"] == pytest.approx(np.std(degrees), rel=0.02)


def test_proximity_counts_keep_the_order_of_graphs_of_different_sizes():
    large = next(graph for graph in registry.make("s-f", 20) if len(graph.nodes.label) > 32)
    few, many, again = count_proximity_edges([one_room(), large, one_room()])
    assert few == again == 6
    assert many > 6


def test_a_made_up_ontology_is_described_in_its_own_words():
    world = own_world.own_world()
    summary = describe([world, world])
    assert {name: each["mean"] for name, each in summary["concepts"].items()} == {
        "plane": 12,
        "pillar": 2,
        "wall": 1,
        "room": 3,
        "flat": 2,
        "floor": 1,
    }
    assert summary["children"] == {
        "plane-wall": {"2": 1.0},
        "plane-room": {"4": 1.0},
        "pillar-room": {"1": 1.0},
        "room-flat": {"1": 0.5, "2": 0.5},
        "flat-floor": {"2": 1.0},
    }
    assert summary["ranges"]["width"] == [world.nodes.width[:12].min(), 4.8]


def test_all_that_is_observed_is_counted_as_joined():
    world = own_world.own_world()
    without = make_graph(
        world.nodes.label,
        world.nodes.position,
        part_of=own_world.PART_OF_PAIRS,
        ontology=own_world.ONTOLOGY,
    )
    position, first = world.nodes.position[: own_world.NUM_OBSERVED], own_world.NUM_PLANES
    pairs = set()
    for node, place in enumerate(position):  # 10 nearest of its own concept, 3 of the other
        distance = np.linalg.norm(position - place, axis=1)
        nearest = np.argsort(distance, kind="stable").tolist()
        alike = [other for other in nearest if (other < first) == (node < first) and other != node]
        others = [other for other in nearest if (other < first) != (node < first)]
        pairs |= {frozenset((node, other)) for other in (*alike[:10], *others[:3])}
    assert count_proximity_edges([without, world]).tolist() == [
        len(pairs),
        len(undirected_edges(world, PROXIMITY)),
    ]


def test_statistics_are_json():
    summary = describe([one_room()])
    assert json.loads(json.dumps(summary)) == summary


def test_no_graphs_are_refused():
    with pytest.raises(ValueError, match="no graphs"):
        describe([])


def test_padding_does_not_count():
    assert describe([pad(one_room(), Capacity(16, 192))]) == describe([one_room()])
