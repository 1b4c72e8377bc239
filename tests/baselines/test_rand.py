"""Rand draws what it counted, and nothing of it depends on anything else."""

import numpy as np
import pytest

from sg3d_jax.baselines.rand import FITTED_EDGE_PROBABILITY, complete, fit, fit_sized
from sg3d_jax.data import registry
from sg3d_jax.scene.graph import observed_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, PLANE, PROXIMITY, WALL
from sg3d_jax.scene.validate import validate_graph
from tests.two_rooms import two_rooms

FLOORS = registry.make("s-f", 60)


def test_the_counts_of_one_scene_are_those_made_by_hand():
    model = fit([two_rooms()])  # 8 planes; a wall, two rooms, a floor; 12 part-of edges
    assert model.num_nodes.tolist() == [4]
    np.testing.assert_allclose(model.label_share, [0, 1 / 4, 2 / 4, 1 / 4, 0, 0])
    assert model.edge_probability == pytest.approx(12 / (4 * 8 + 6))


def test_the_sized_variant_has_as_many_new_nodes_as_a_graph_has_in_all():
    model = fit_sized([two_rooms()])
    assert model.num_nodes.tolist() == [12]
    assert model.edge_probability == pytest.approx(2 * 12 / (4 * 8 + 6))
    assert fit_sized(FLOORS, "s-f").edge_probability == FITTED_EDGE_PROBABILITY["s-f"]


@pytest.mark.parametrize("fitted", [fit(FLOORS), fit_sized(FLOORS, "s-f")])
def test_graphs_follow_the_counts(fitted):
    scenes = FLOORS * 20
    drawn = complete(fitted, scenes, seed=1)
    num_planes = np.array([len(observed_of(scene).nodes.label) for scene in scenes])
    num_new = np.array([len(graph.nodes.label) for graph in drawn]) - num_planes
    error = fitted.num_nodes.std() / len(scenes) ** 0.5
    assert num_new.mean() == pytest.approx(fitted.num_nodes.mean(), abs=4 * error)
    labels = np.concatenate([graph.nodes.label[graph.nodes.label != PLANE] for graph in drawn])
    assert (labels == WALL).mean() == pytest.approx(fitted.label_share[WALL], abs=0.02)
    num_edges = sum(len(undirected_edges(graph, PART_OF)) for graph in drawn)
    num_pairs = (num_new * num_planes + num_new * (num_new - 1) // 2).sum()
    assert num_edges / num_pairs == pytest.approx(fitted.edge_probability, rel=0.02)


def test_no_edge_joins_two_planes_and_planes_are_as_they_came():
    for scene, graph in zip(FLOORS, complete(fit_sized(FLOORS), FLOORS), strict=True):
        validate_graph(graph, "drawn", rules=False)
        pairs = undirected_edges(graph, PART_OF)
        assert not (graph.nodes.label[pairs] == PLANE).all(axis=1).any()
        assert len(undirected_edges(graph, PROXIMITY)) == 0
        for one, other in zip(observed_of(graph).nodes, observed_of(scene).nodes, strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_graph_depends_on_its_seed_and_its_place_only():
    model = fit(FLOORS)
    few, many, other = (complete(model, FLOORS[:n], s) for n, s in ((2, 0), (5, 0), (2, 1)))
    np.testing.assert_array_equal(few[1].nodes.position, many[1].nodes.position)
    assert not np.array_equal(few[1].nodes.position, other[1].nodes.position)


def test_planes_alone_teach_nothing():
    with pytest.raises(ValueError, match="no training graph has a node beside its planes"):
        fit([observed_of(FLOORS[0])])
