"""Data sets by name and by path."""

import json

import numpy as np
import pytest

from sg3d_jax.data import registry, schema
from sg3d_jax.scene.concepts import FLOOR
from sg3d_jax.scene.validate import validate_graph


@pytest.mark.parametrize("name", registry.DATASETS)
def test_every_named_data_set_can_be_made_and_is_sound(name):
    for graph in registry.make(name, num_graphs=3):
        validate_graph(graph, name)
        assert graph.nodes.label.max() == FLOOR


@pytest.mark.parametrize("name", registry.DATASETS)
def test_a_named_data_set_is_as_large_as_in_the_paper(name):
    spec = registry.get(name)
    assert spec.num_graphs == spec.paper.samples


def test_a_graph_depends_on_its_index_and_seed_but_not_on_how_many_are_made():
    two, three, other = (
        registry.make("s-f", num_graphs, seed) for num_graphs, seed in ((2, 0), (3, 0), (2, 1))
    )
    np.testing.assert_array_equal(two[1].nodes.position, three[1].nodes.position)
    assert not np.array_equal(two[1].nodes.position, other[1].nodes.position)


@pytest.mark.parametrize("name", ["S-F", "s_f", "s-f-sqare", "nothing"])
def test_an_unknown_name_is_refused_with_the_names_there_are(name):
    with pytest.raises(ValueError, match="expected one of s-f-square, s-f"):
        registry.load(name)


def test_a_misspelt_name_is_refused_with_the_closest_one():
    with pytest.raises(ValueError, match="did you mean 's-f-square'"):
        registry.make("S-F-sqare")


def test_a_path_is_read_from_its_file(tmp_path):
    graphs = registry.make("s-f", num_graphs=2, seed=7)
    schema.save(tmp_path / "scenes.npz", graphs, registry.header("s-f", seed=7))
    loaded = registry.load(tmp_path / "scenes.npz")
    np.testing.assert_array_equal(loaded[1].nodes.position, graphs[1].nodes.position)


def test_a_missing_file_is_refused_by_its_name(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.npz: no such file"):
        registry.load(tmp_path / "nowhere.npz")


def test_the_header_says_how_the_set_was_made():
    header = json.loads(json.dumps(registry.header("s-f", seed=3)))
    assert header["name"] == "s-f"
    assert header["seed"] == 3
    assert header["generator"]["merge_ratio"] == registry.get("s-f").config.merge_ratio
