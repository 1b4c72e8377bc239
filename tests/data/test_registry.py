"""Data sets by name, from a user's file, and by path."""

import json

import numpy as np
import pytest

from sg3d_jax.data import registry
from sg3d_jax.data.splits import split_of
from sg3d_jax.io import npz
from sg3d_jax.io.formats import write_graphs
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from sg3d_jax.scene.validate import validate_graph

GENERATED = [name for name, spec in registry.DATASETS.items() if spec.config is not None]
FROM_FILES = [name for name, spec in registry.DATASETS.items() if spec.config is None]
PAPER = ("s-f-square", "s-f", "s-c", "m-f", "m-b", "m-c", "r-f", "r-b", "r-c")


def test_the_nine_data_sets_of_the_paper_are_there():
    assert {name for name, spec in registry.DATASETS.items() if spec.paper is not None} == {*PAPER}


@pytest.mark.parametrize("name", GENERATED)
def test_every_generated_data_set_is_sound_and_has_its_levels(name):
    for graph in registry.make(name, num_graphs=3):
        validate_graph(graph, name)
        held = {PAPER_ONTOLOGY.names[label] for label in graph.nodes.label}
        assert held <= {*registry.get(name).levels}
        assert registry.get(name).levels[-1] in held


@pytest.mark.parametrize("name", PAPER[:3])
def test_a_generated_data_set_is_as_large_as_in_the_paper(name):
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


@pytest.mark.parametrize("name", FROM_FILES)
def test_a_set_that_is_made_from_a_file_says_how(name):
    with pytest.raises(ValueError, match=f"sg3d data import {name} FILE -o {name}.npz"):
        registry.load(name)
    with pytest.raises(ValueError, match=f"{name} is made from a file"):
        registry.header(name)


def test_a_path_is_read_from_its_file(tmp_path):
    graphs = registry.make("s-f", num_graphs=2, seed=7)
    npz.save(tmp_path / "scenes.npz", graphs, registry.header("s-f", seed=7))
    write_graphs(tmp_path / "scenes.jsonl", graphs)
    for name in ("scenes.npz", "scenes.jsonl"):
        loaded = registry.load(tmp_path / name).graphs
        np.testing.assert_array_equal(loaded[1].nodes.position, graphs[1].nodes.position)


def test_a_missing_file_is_refused_by_its_name(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.npz: no such file"):
        registry.load(tmp_path / "nowhere.npz")


def test_the_header_says_how_the_set_was_made():
    header = json.loads(json.dumps(registry.header("s-f", seed=3)))
    assert header["name"] == "s-f"
    assert header["seed"] == 3
    assert header["generator"]["merge_ratio"] == registry.get("s-f").config.merge_ratio


def test_a_set_for_test_only_is_split_so(tmp_path):
    write_graphs(tmp_path / "recorded.jsonl", registry.make("s-f", 4))
    graphs, header = registry.import_file("r-f", tmp_path / "recorded.jsonl")
    assert [len(part) for part in split_of(header, len(graphs))] == [0, 0, 4]
    assert (header["name"], header["file"]) == ("r-f", "recorded.jsonl")


def test_the_first_graphs_of_a_file_keep_their_parts(tmp_path):
    parts = ["test", "train", "validation"]
    npz.save(tmp_path / "a.npz", registry.make("s-f", 3), {"parts": parts, "origins": [*"abc"]})
    graphs, header = registry.load(tmp_path / "a.npz", num_graphs=2)
    assert len(graphs) == 2
    assert (header["parts"], header["origins"]) == (parts[:2], ["a", "b"])


@pytest.mark.parametrize("name", ["s-c", "m-b", "r-c"])
def test_a_file_of_another_level_is_refused(name, tmp_path):
    write_graphs(tmp_path / "floors.jsonl", registry.make("s-f", 2))
    with pytest.raises(ValueError, match="graph 0 reaches up to a floor, expected a"):
        registry.import_file(name, tmp_path / "floors.jsonl")


def test_graphs_that_break_the_hierarchy_are_no_data_set(tmp_path):
    graph = registry.make("s-f", 1)[0]
    label = graph.nodes.label.copy()
    label[label == 1] = 2  # walls become rooms: planes with several rooms are sound, so are these
    label[-1] = 1  # the floor becomes a wall over rooms
    broken = graph._replace(nodes=graph.nodes._replace(label=label))
    write_graphs(tmp_path / "broken.jsonl", [broken])
    with pytest.raises(ValueError, match=r"graph 0: edge .* joins wall and room as part_of"):
        registry.load(tmp_path / "broken.jsonl")
