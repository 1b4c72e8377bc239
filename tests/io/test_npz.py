"""Files of scene graphs: exact round trips, and one clear sentence for everything else."""

import json
import os
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sg3d_jax.data import registry
from sg3d_jax.io import archive, npz
from sg3d_jax.scene.graph import SceneGraph, features_of, make_graph, undirected_edges
from sg3d_jax.scene.ontology import FEATURES, PART_OF, PROXIMITY

GRAPHS = registry.make("s-f", num_graphs=3)
HEADER = registry.header("s-f")


@pytest.fixture
def path(tmp_path):
    npz.save(tmp_path / "scenes.npz", GRAPHS, HEADER)
    return tmp_path / "scenes.npz"


def contents(path) -> dict[str, np.ndarray]:
    with np.load(path) as archive:
        return dict(archive)


def refusal(path) -> str:
    """Returns the sentence with which a file is refused."""
    with pytest.raises(ValueError, match=path.name) as caught:
        npz.load(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def assert_same(one: SceneGraph, other: SceneGraph) -> None:
    for mine, theirs in zip(one.nodes, other.nodes, strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert mine.dtype == theirs.dtype
    for relation in (PROXIMITY, PART_OF):
        pairs = [undirected_edges(graph, relation) for graph in (one, other)]
        np.testing.assert_array_equal(*pairs)


# --- what is written is read ---


def test_graphs_and_header_come_back_exactly(path):
    graphs, header = npz.load(path)
    assert len(graphs) == len(GRAPHS)
    for loaded, graph in zip(graphs, GRAPHS, strict=True):
        assert_same(loaded, graph)
    assert header == json.loads(json.dumps(HEADER)) | {"schema": 1, "units": "metres"}


def test_proximity_edges_come_back(tmp_path):
    graph = GRAPHS[0]
    nodes = graph.nodes.label, graph.nodes.position
    edges = {"part_of": undirected_edges(graph, PART_OF), "proximity": [(0, 1), (2, 0)]}
    linked = make_graph(*nodes, **features_of(graph), **edges)
    npz.save(tmp_path / "linked.npz", [linked], {})
    assert_same(npz.load(tmp_path / "linked.npz")[0][0], linked)


def test_no_graphs_are_a_sound_file(tmp_path):
    npz.save(tmp_path / "empty.npz", [], {})
    assert npz.load(tmp_path / "empty.npz")[0] == []


def test_the_same_graphs_give_the_same_bytes(path, tmp_path):
    graphs, header = npz.load(path)
    npz.save(tmp_path / "again.npz", graphs, header)
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


def test_arrays_are_plain_so_that_nothing_is_unpickled(path):
    assert all(array.dtype != object for array in contents(path).values())


# --- writing ---


def test_an_unsound_graph_is_not_written(path):
    before = path.read_bytes()
    nodes = GRAPHS[0].nodes
    broken = GRAPHS[0]._replace(nodes=nodes._replace(width=np.full_like(nodes.width, np.nan)))
    with pytest.raises(ValueError, match=r"scenes\.npz: graph 1: .*width"):
        npz.save(path, [GRAPHS[0], broken], HEADER)
    assert path.read_bytes() == before


def test_a_failed_write_leaves_the_old_file_and_no_draft(path):
    before = path.read_bytes()
    with pytest.raises(TypeError):
        npz.save(path, GRAPHS, {"seed": object()})
    assert os.listdir(path.parent) == [path.name]
    assert path.read_bytes() == before


# --- reading what is broken ---


def change(name, value):
    """Returns a function that puts a value into the second graph's part of an array."""

    def apply(arrays):
        offset = arrays["edge_offset" if name in npz.EDGE_FIELDS else "node_offset"]
        arrays[name][offset[1]] = value

    return apply


@pytest.mark.parametrize(
    ("damage", "field"),
    [
        (change("position", np.nan), "position"),
        (change("position", np.inf), "position"),
        (change("normal", 0.5), "normal"),
        (change("width", -1.0), "width"),
        (change("label", 6), "label"),
        (change("label", -1), "label"),
        (change("edges", (2, 2)), "edge"),
        (change("edges", (0, 10**6)), "edge"),
        (change("edges", (-1, 0)), "edge"),
        (change("relation", 2), "relation"),
        (change("relation", PROXIMITY), "edge"),
    ],
)
def test_a_wrong_value_is_refused_with_file_graph_and_field(path, damage, field):
    arrays = contents(path)
    damage(arrays)
    np.savez(path, **arrays)
    assert f"{path}: graph 1: " in refusal(path)
    assert field in refusal(path)


@pytest.mark.parametrize("name", sorted({"header", *npz.FIELDS} - {*FEATURES}))
def test_a_missing_array_is_refused_by_name(path, name):
    arrays = contents(path)
    del arrays[name]
    np.savez(path, **arrays)
    assert f"{name} is missing" in refusal(path)


def test_a_feature_that_a_file_lacks_is_zero(path):
    arrays = contents(path)
    del arrays["width"]
    np.savez(path, **arrays)
    for graph in npz.load(path).graphs:
        assert not graph.nodes.width.any()


def test_a_feature_that_a_file_must_not_lack_is_refused(path):
    arrays = contents(path)
    del arrays["normal"]
    np.savez(path, **arrays)
    assert "graph 0: nodes[0].normal is [0, 0, 0], expected length 1" in refusal(path)


@pytest.mark.parametrize("name", npz.FIELDS)
@pytest.mark.parametrize(
    "damage",
    [
        lambda array: array.astype("float32"),
        lambda array: array[None],
        lambda array: array[:-1],
        lambda array: array[:0],
    ],
    ids=["type", "rank", "short", "empty"],
)
def test_an_array_of_wrong_type_or_size_is_refused_by_name(path, name, damage):
    arrays = contents(path)
    arrays[name] = damage(arrays[name])
    np.savez(path, **arrays)
    assert name in refusal(path)


def test_offsets_that_fall_are_refused(path):
    arrays = contents(path)
    arrays["node_offset"][1] = arrays["node_offset"][2] + 1
    np.savez(path, **arrays)
    assert "node_offset does not rise" in refusal(path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("not json", "header is missing or unreadable"),
        ("[1]", "header is missing or unreadable"),
        ("{}", "header is missing or unreadable"),
        ('{"schema": 2, "units": "metres"}', "schema 2, expected 1"),
        ('{"schema": 1, "units": "mm"}', "units 'mm', expected 'metres'"),
    ],
)
def test_another_header_is_refused(path, header, message):
    np.savez(path, **(contents(path) | {"header": np.array(header)}))
    assert message in refusal(path)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("extra.npy", b"", "holds 'extra.npy', which is unknown, expected known arrays alone"),
        ("label", b"", "holds 'label', which is unknown, expected known arrays alone"),
        ("label.npy", b"hello", "not an npz file of plain arrays, or a damaged one"),
        ("label.npy", b"\x93NUMPY\x01\x00\x06\x00((((((", "not an npz file of plain arrays"),
    ],
)
def test_what_is_no_array_or_none_of_ours_is_refused(path, name, content, sentence):
    with zipfile.ZipFile(path) as file:
        members = {member: file.read(member) for member in file.namelist()}
    with zipfile.ZipFile(path, "w") as file:
        for member, data in (members | {name: content}).items():
            file.writestr(member, data)
    assert sentence in refusal(path)


def test_an_array_that_is_there_twice_is_refused(path):
    with zipfile.ZipFile(path, "a") as file, pytest.warns(UserWarning, match="Duplicate name"):
        file.writestr("label.npy", file.read("label.npy"))
    assert "array label is there twice, expected once" in refusal(path)


def test_arrays_are_refused_by_their_size_before_they_are_read(path, monkeypatch):
    np.savez_compressed(path, **(contents(path) | {"label": np.zeros(10**6)}))
    assert path.stat().st_size < 50_000
    monkeypatch.setattr(archive, "MAX_BYTES", 1_000_000)
    monkeypatch.setattr(archive, "_array", None)
    assert "bytes, expected 1000000 at most" in refusal(path)


def test_a_file_of_too_many_graphs_is_neither_written_nor_read(path, monkeypatch):
    monkeypatch.setattr(npz, "MAX_GRAPHS", 2)
    assert "there are 3 graphs, expected 2 at most" in refusal(path)
    with pytest.raises(ValueError, match="there are 3 graphs, expected 2 at most"):
        npz.save(path, GRAPHS, HEADER)


def test_pickled_arrays_are_refused(path):
    np.savez(path, **(contents(path) | {"label": np.array([{}], dtype=object)}))
    assert "plain arrays" in refusal(path)


def test_generated_graphs_may_break_the_hierarchy_if_asked(tmp_path):
    nodes = GRAPHS[0].nodes
    odd = make_graph(nodes.label, nodes.position, **features_of(GRAPHS[0]), part_of=[(0, 1)])
    with pytest.raises(ValueError, match="graph 0"):
        npz.save(tmp_path / "odd.npz", [odd], {})
    npz.save(tmp_path / "odd.npz", [odd], {}, rules=False)
    assert_same(npz.load(tmp_path / "odd.npz", rules=False)[0][0], odd)


files = settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@given(st.data())
@files
def test_a_flipped_byte_is_refused_or_harmless(path, data):
    whole = bytearray(path.read_bytes())
    whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    path.with_name("flipped.npz").write_bytes(whole)
    try:
        graphs, _ = npz.load(path.with_name("flipped.npz"))
    except ValueError as error:
        assert str(error).startswith(str(path.with_name("flipped.npz")))  # noqa: PT017
    else:
        for loaded, graph in zip(graphs, GRAPHS, strict=True):
            assert_same(loaded, graph)
