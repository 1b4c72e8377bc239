"""`sg3d complete`: what is given, what is kept, and what is said of both."""

import json

import jax
import numpy as np
import pytest

from sg3d_jax import cli
from sg3d_jax.io.formats import read_graphs, write_graphs
from sg3d_jax.scene.graph import subgraph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF
from tests.command_line import SCENES, refusal, run, write
from tests.tiny_run import small_floors, untrained_weights


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return str(untrained_weights(tmp_path_factory.mktemp("weights")))


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with jax.debug_key_reuse(False):
        yield


def complete(name, weights, *options):
    run("complete", name, "-o", "graph.json", "--weights", weights, *options)
    with open("graph.json") as file:
        return json.load(file)


def with_rooms():
    """Returns a floor as a user may know it: its planes and rooms, without walls."""
    floor = small_floors()[0]
    names = np.array(["plane", "wall", "room", "floor"])[floor.nodes.label]
    return subgraph(floor, np.isin(names, ["plane", "room"]))


def test_known_rooms_are_kept(weights):
    known = with_rooms()
    write_graphs("known.json", [known])
    document = complete("known.json", weights, "--keep", "--lanes", 1)
    (grown,) = read_graphs("graph.json")
    count = len(known.nodes.label)
    for found, expected in zip(grown.nodes, known.nodes, strict=True):
        np.testing.assert_array_equal(found[:count], expected)
    pairs = undirected_edges(grown, PART_OF)
    inside = pairs[(pairs < count).all(axis=1)]
    np.testing.assert_array_equal(inside, undirected_edges(known, PART_OF))
    assert document["kept"] == {"room": np.flatnonzero(known.nodes.label == 2).tolist()}
    assert sum(map(len, document["grown"].values())) == len(grown.nodes.label) - count


def test_without_it_planes_alone_are_taken(weights):
    write_graphs("known.json", [with_rooms()])
    document = complete("known.json", weights)
    num_planes = len(document["observed"]["plane"])
    assert document["observed"] == {"plane": list(range(num_planes))}
    assert document["kept"] == {}
    assert min(min(rows) for rows in document["grown"].values()) == num_planes
    for concept, rows in document["grown"].items():
        assert {document["nodes"][row]["label"] for row in rows} == {concept}


def test_a_method_that_does_not_grow_cannot_keep(tmp_path, capsys):
    write_graphs("known.json", [with_rooms()])
    path = untrained_weights(tmp_path, "ec-l")
    line = refusal(capsys, "complete", "known.json", "-o", "a.json", "--weights", path, "--keep")
    assert line.startswith("keep: this model completes planes alone")


def test_normals_of_two_decimals_are_completed_and_written(weights):
    angle = 0.5  # of which two decimals are a quarter of a percent off
    planes = [dict(plane) for plane in SCENES[0]["planes"]]
    for plane in planes:
        x, y, _ = plane["normal"]
        turned = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
        plane["normal"] = [round(turned[0], 2), round(turned[1], 2), 0.0]
        x, y, z = plane["centroid"]
        plane["centroid"] = [x * np.cos(angle) - y * np.sin(angle), 0.0, z]
        plane["centroid"][1] = x * np.sin(angle) + y * np.cos(angle)
    lengths = [np.linalg.norm(plane["normal"]) for plane in planes]
    assert max(abs(length - 1) for length in lengths) > 1e-3
    document = complete(write("planes.json", {"planes": planes}), weights)
    for node, plane in zip(document["nodes"], planes, strict=False):
        assert np.linalg.norm(node["normal"]) == pytest.approx(1, abs=1e-12)
        np.testing.assert_allclose(node["normal"], plane["normal"], atol=0.006)
        assert node["position"] == plane["centroid"]


def test_seeds_may_be_as_large_as_one_likes(weights):
    name = write("planes.json", SCENES[0])
    nodes = [complete(name, weights, "--seed", seed)["nodes"] for seed in (0, 2**32, 10**30)]
    assert nodes[0] != nodes[1] != nodes[2] != nodes[0]


def test_a_traceback_is_had_by_asking_for_it(monkeypatch, capsys):
    arguments = ["complete", "nothing.json", "-o", "a.json"]
    assert "nothing.json" in refusal(capsys, *arguments)
    monkeypatch.setenv("SG3D_DEBUG", "1")
    with pytest.raises(ValueError, match=r"nothing\.json: No such file"):
        cli.main(arguments)
