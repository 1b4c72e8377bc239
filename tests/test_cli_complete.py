"""`sg3d complete`: what is given, what is kept, and what is said of both."""

import io
import itertools
import json

import jax
import numpy as np
import pytest

from sg3d_jax import cli
from sg3d_jax.infer import complete as completing
from sg3d_jax.io.formats import read_graphs, write_graphs
from sg3d_jax.scene.graph import subgraph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF
from tests.command_line import (
    SCENES,
    as_csv,
    documents,
    observed,
    refusal,
    run,
    weights_at_random,
    write,
    write_lines,
)
from tests.tiny_run import small_floors, untrained_weights


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    with weights_at_random(tmp_path_factory.mktemp("weights")) as path:
        yield str(path)


@pytest.fixture(autouse=True)
def _workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with jax.debug_key_reuse(False):
        yield


def complete(name, weights, *options):
    arguments = "--weights", weights, "--candidates", 1, *options
    run("complete", name, "-o", "graph.json", *arguments)
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


def test_some_concepts_alone_are_as_they_are_in_the_whole(weights, capsys):
    write_graphs("known.json", [with_rooms()])
    options = "--keep", "--candidates", 2, "--lanes", 1
    whole = complete("known.json", weights, *options)
    chosen = "--until", "building", "--without", "wall", "floor"
    part = complete("known.json", weights, *options, *chosen)
    lists = ("nodes", "edges", "edge_confidence", "observed", "kept", "grown")
    assert {name: part[name] for name in part.keys() - {*lists}} == {
        name: whole[name] for name in whole.keys() - {*lists}
    }
    left = {"plane", "room", "building"}
    assert {*part["observed"], *part["kept"], *part["grown"]} == left
    nodes = [node for node in whole["nodes"] if node["label"] in left]
    assert [node | {"id": 0} for node in part["nodes"]] == [node | {"id": 0} for node in nodes]
    assert any(node["confidence"] < 1 for node in nodes)
    place = {node["id"]: row for row, node in enumerate(nodes)}
    edges = [
        ([place[end] for end in edge], sure)
        for edge, sure in zip(whole["edges"], whole["edge_confidence"], strict=True)
        if place.keys() >= {*edge}
    ]
    assert [*zip(part["edges"], part["edge_confidence"], strict=True)] == edges
    capsys.readouterr()
    line = refusal(capsys, "complete", "known.json", "-o", "a.json", "--until", "roof")
    assert line.startswith("unknown concept 'roof', expected one of plane, wall, room")


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


def planes_with(scene=SCENES[0], **changes):
    """Returns a scene of which some planes have other keys: plane_3={...}."""
    planes = [dict(plane) for plane in scene["planes"]]
    for name, held in changes.items():
        planes[int(name.removeprefix("plane_"))] |= held
    return {"planes": planes}


def remarks(capsys):
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith("sg3d: remark: planes.json") for line in lines)
    return [line.removeprefix("sg3d: remark: planes.json").removeprefix(": ") for line in lines]


def test_what_is_mended_is_said_and_right_planes_come_out_as_they_are(weights, capsys):
    x, y, _ = SCENES[0]["planes"][2]["normal"]
    scene = planes_with(plane_2={"normal": [x, y, 0.2]}, plane_4={"normal": [0.0, 0.1, 1.0]})
    scene["planes"].append(scene["planes"][0])
    document = complete(write("planes.json", scene), weights)
    expected = planes_with()["planes"]
    del expected[4]
    assert observed(document)["planes"] == expected
    mended = [
        "brought the normals of 1 plane to length 1",
        "levelled 1 plane (lean of up to 15 degrees)",
        "left out 1 plane (lean of more than 15 degrees)",
        "merged 1 plane (exactly repeated)",
    ]
    assert remarks(capsys)[:4] == mended
    assert document["remarks"][:4] == mended


def test_flipped_normals_are_turned_or_kept(weights, capsys):
    flipped = planes_with()
    for plane in flipped["planes"]:
        plane["normal"] = [0.0 - part for part in plane["normal"]]
    write("planes.json", flipped)
    for options, expected, said in (
        ((), planes_with(), "turned all normals, since "),
        (("--normals", "as-given"), flipped, "kept all normals as given, though "),
    ):
        document = complete("planes.json", weights, *options)
        assert observed(document) == expected
        assert remarks(capsys)[0].startswith(said)


def test_shared_planes_are_cut_unless_they_are_not_to_be(weights, capsys):
    """Two rooms along one plane: a wall between them abuts on it. A third stands elsewhere."""
    sides = [
        *[([0.0, 1.5], [1, 0], 3.0), ([4.0, 1.5], [-1, 0], 3.0), ([2.0, 0.0], [0, 1], 4.0)],
        *[([4.2, 1.5], [1, 0], 3.0), ([8.2, 1.5], [-1, 0], 3.0), ([6.2, 0.0], [0, 1], 4.0)],
        ([4.1, 3.0], [0, -1], 8.2),
        *[([20.0, 1.5], [1, 0], 3.0), ([24.0, 1.5], [-1, 0], 3.0)],
        *[([22.0, 0.0], [0, 1], 4.0), ([22.0, 3.0], [0, -1], 4.0)],
    ]
    scene = {
        "planes": [
            {"centroid": [*place, 0.0], "normal": [*map(float, facing), 0.0], "width": width}
            for place, facing, width in sides
        ]
    }
    write("planes.json", scene)
    cut = "cut 1 of 11 planes where others abut on them, and joined them again"
    for options, expected in (((), True), (("--cut", "never"), False)):
        document = complete("planes.json", weights, *options)
        assert observed(document) == scene
        assert (cut in document["remarks"]) == expected
        assert (cut in remarks(capsys)) == expected


def test_ids_and_further_keys_are_carried(weights):
    """Also if a plane before them is left out; edges and lists name what was grown by new ids."""
    scene = planes_with(
        plane_0={"id": "ceiling", "normal": [0, 0, 1]},
        plane_1={"id": 70, "robot": {"name": "r2"}},
        plane_3={"colour": [0, 0.5, 1]},
    )
    document = complete(write("planes.json", scene), weights)
    nodes, count = document["nodes"], len(scene["planes"]) - 1
    assert nodes[0]["id"] == 70
    assert nodes[0]["robot"] == {"name": "r2"}
    assert nodes[2]["colour"] == [0, 0.5, 1]
    known = {"id", "label", "position", "normal", "width"}
    assert [set(node) - known for node in nodes[3:]] == [set()] * (len(nodes) - 3)
    ids = [node["id"] for node in nodes]
    assert len(set(ids)) == len(ids)
    assert document["observed"] == {"plane": ids[:count]}
    assert sorted(name for rows in document["grown"].values() for name in rows) == ids[count:]
    assert {end for edge in document["edges"] for end in edge} <= set(ids)
    (read,) = read_graphs("graph.json")
    assert len(undirected_edges(read, PART_OF)) == len(document["edges"])


def test_tables_and_graphs_carry_theirs_too(weights):
    rows = as_csv(SCENES[0]).splitlines()
    wide = [f"{row},{cell}" for row, cell in zip(rows, ["id", *range(50, 99)], strict=False)]
    nodes = complete(write("planes.csv", "\n".join(wide)), weights)["nodes"]
    count = len(SCENES[0]["planes"])
    assert [node["id"] for node in nodes[:count]] == list(range(50, 50 + count))
    known = with_rooms()
    names = [{"id": f"n{row}", "seen": row} for row in range(len(known.nodes.label))]
    write_graphs("known.json", [known], attributes=[names])
    document = complete("known.json", weights, "--keep")
    kept = [{key: node.get(key) for key in ("id", "seen")} for node in document["nodes"]]
    assert kept[: len(names)] == names
    rooms = np.flatnonzero(known.nodes.label == 2)
    assert document["kept"] == {"room": [f"n{row}" for row in rooms]}


def test_how_sure_it_is_stands_in_the_result_and_doubts_are_said(weights, capsys):
    """Untrained weights grow nodes that belong to nothing, and other ones every time."""
    write("planes.json", SCENES[0])
    run("complete", "planes.json", "-o", "graphs.jsonl", "--weights", weights, "--samples", 2)
    one, other = documents("graphs.jsonl")
    said = remarks(capsys)
    for index, document in enumerate((one, other)):
        shares = document["confidence"]
        assert list(shares) == ["unplaced", "loose", "thin", "agreement"]
        assert all(0 <= share <= 1 for share in shares.values())
        doubts = [remark for remark in document["remarks"] if remark.startswith("unsure: ")]
        assert doubts
        shared = set(one["remarks"]) & set(other["remarks"])
        for doubt in doubts:
            assert (doubt if doubt in shared else f"sample {index}: {doubt}") in said
    assert len(said) == len(set(said))
    assert complete("planes.json", weights)["confidence"]["agreement"] is None


@pytest.mark.parametrize("scenes", [SCENES[:1], SCENES[:2]], ids=["one", "several"])
def test_standard_input_and_output_hold_what_files_hold(weights, capsys, monkeypatch, scenes):
    text = "\n".join(map(json.dumps, scenes)) if len(scenes) > 1 else json.dumps(*scenes, indent=1)
    name = write("planes.jsonl" if len(scenes) > 1 else "planes.json", text)
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    run("complete", name, "-o", "graphs.jsonl", "--weights", weights)
    capsys.readouterr()
    run("complete", "-", "-o", "-", "--weights", weights)
    captured = capsys.readouterr()
    lines = captured.out.splitlines() if len(scenes) > 1 else [captured.out]
    assert [json.loads(line) for line in lines] == documents("graphs.jsonl")
    assert "-: scene 0 sample 0: " in captured.err


def test_what_is_wrong_with_standard_input_is_said_of_it(weights, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b'{"planes": []}')))
    line = refusal(capsys, "complete", "-", "-o", "-", "--weights", weights)
    assert line.startswith("standard input: line 1: planes holds no planes")


def test_remarks_name_the_graph_of_a_file_of_several(weights, capsys):
    lines = [json.dumps(planes_with()), json.dumps(planes_with(plane_0={"normal": [0, 0, 1]}))]
    write("planes.jsonl", "\n".join(lines))
    run("complete", "planes.jsonl", "-o", "graphs.jsonl", "--weights", weights)
    said = "sg3d: remark: planes.jsonl: graph 1: left out 1 plane (lean of more than 15 degrees)"
    assert said in capsys.readouterr().err.splitlines()


def stopped_after(monkeypatch, module, name, count, error):
    """Lets completing scene by scene end like that after so many."""
    each = getattr(module, name)

    def stopped(*arguments, **options):
        yield from itertools.islice(each(*arguments, **options), count)
        raise error

    monkeypatch.setattr(module, name, stopped)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), MemoryError("no room")])
def test_what_is_done_is_kept_however_it_ends(weights, capsys, monkeypatch, error):
    write_lines("planes.jsonl", SCENES)
    arguments = "complete", "planes.jsonl", "--weights", weights, "--candidates", 1, "-o"
    run(*arguments, "whole.jsonl")
    capsys.readouterr()
    stopped_after(monkeypatch, completing, "complete_each", 2, error)
    with pytest.raises(SystemExit):
        run(*arguments, "graphs.jsonl")
    assert documents("graphs.jsonl") == documents("whole.jsonl")[:2]
    said = "sg3d: graphs.jsonl: has 2 of 3 graphs, all that were done"
    assert capsys.readouterr().err.splitlines()[-2] == said


def test_graphs_are_written_one_by_one(weights, monkeypatch):
    seen = []
    each = completing.complete_each

    def watched(*arguments, **options):
        for one in each(*arguments, **options):
            seen.append(len(documents("graphs.jsonl")))
            yield one

    write_lines("planes.jsonl", SCENES)
    monkeypatch.setattr(completing, "complete_each", watched)
    run("complete", "planes.jsonl", "--weights", weights, "--samples", 2, "-o", "graphs.jsonl")
    assert seen == [0, 2, 4]
