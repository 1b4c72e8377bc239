import json

import numpy as np
import pytest

from sg3d_jax.metrics.fgw import fgw_pairs
from sg3d_jax.metrics.mmd import mmd_scores
from sg3d_jax.metrics.paper import SCORES
from sg3d_jax.metrics.report import score, summary
from sg3d_jax.scene.graph import make_graph, subgraph
from sg3d_jax.scene.ontology import FLOOR, PLANE, ROOM, WALL
from sg3d_jax.scene.padding import Capacity, pad
from tests import own_world
from tests.two_rooms import LABELS, NUM_PLANES, PART_OF_PAIRS, two_rooms
from tests.unchecked import unchecked


def room_of_three_planes(floor: bool):
    label = [PLANE] * 3 + [ROOM] + [FLOOR] * floor
    count = len(label)
    position = np.array([[0.0, 0, 1], [2, 0, 1], [1, 2, 1], [1, 1, 1], [1, 1, 0]])[:count]
    part_of = [(0, 3), (1, 3), (2, 3), (3, 4)][: 3 + floor]
    return make_graph(label, position, np.zeros((count, 3)), np.zeros(count), part_of)


def test_report__sums_up_the_pairs_and_survives_json():
    truth = [room_of_three_planes(floor=True)] * 2
    generated = [room_of_three_planes(floor=False), *truth[1:]]
    report = score(generated, truth)
    assert json.loads(json.dumps(report)) == report
    assert report["graphs"] == 2
    assert report["exact_structure"] == 0.5
    assert report["node_count_error"]["signed"]["total"] == -0.5
    assert report["node_count_error"]["absolute"]["floor"] == 0.5
    assert report["node_count_error"]["absolute"]["room"] == 0
    assert report["failures"] == {
        "missing floor": {"count": 1, "share": 0.5},
        "room without floor": {"count": 1, "share": 0.5},
    }
    expected = fgw_pairs(generated, truth)
    np.testing.assert_allclose(report["fgw_per_graph"], expected.value)
    assert report["fgw"] == pytest.approx(expected.value[0] / 2)
    assert report["fgw"] == pytest.approx((report["gw"] + report["w"]) / 2)


def test_report__has_the_seven_scores_of_the_paper():
    truth = [two_rooms(), room_of_three_planes(floor=True)]
    generated = [two_rooms(), room_of_three_planes(floor=False)]
    report = score(generated, truth)
    assert {*SCORES} <= {*report}
    for name, value in mmd_scores(generated, truth).items():
        assert report[name] == pytest.approx(value)


def changed(label=tuple(LABELS), part_of=tuple(PART_OF_PAIRS)):
    """Returns the two rooms with further nodes or other edges; new nodes lie at the origin."""
    nodes, more = two_rooms().nodes, len(label) - len(LABELS)
    position, normal = (
        np.pad(field, [(0, more), (0, 0)]) for field in (nodes.position, nodes.normal)
    )
    return make_graph(label, position, normal, np.pad(nodes.width, (0, more)), part_of)


FLOOR_NODE = len(LABELS) - 1
CASES = {
    "sound": (changed(), set()),
    "two floors": (
        changed([*LABELS, FLOOR], [*PART_OF_PAIRS, (NUM_PLANES + 1, FLOOR_NODE + 1)]),
        {"one_parent"},
    ),
    "no room": (
        changed(part_of=PART_OF_PAIRS[:2] + PART_OF_PAIRS[3:]),
        {"one_parent", "connected"},
    ),
    "wall of a floor": (
        changed(part_of=[*PART_OF_PAIRS, (NUM_PLANES, FLOOR_NODE)]),
        {"layer_rule"},
    ),
    "second wall": (
        changed([*LABELS, WALL], [*PART_OF_PAIRS, (1, FLOOR_NODE + 1), (4, FLOOR_NODE + 1)]),
        {"no_duplicates"},
    ),
}


@pytest.mark.parametrize(("graph", "broken"), CASES.values(), ids=CASES.keys())
def test_rules__are_broken_one_by_one(graph, broken):
    report = score([graph], [two_rooms()])
    rules = ("one_parent", "layer_rule", "connected", "no_duplicates")
    assert {rule for rule in rules if report[rule] == 0} == broken
    assert all(report[rule] == 1 for rule in rules if rule not in broken)


def test_rules__leave_alone_what_truth_leaves_alone_and_pieces_their_own_wholes():
    """A plane in two rooms, and one in none: sound where truth or its pieces have it so."""
    shared = changed(part_of=[*PART_OF_PAIRS, (0, NUM_PLANES + 2)])
    alone = changed(part_of=PART_OF_PAIRS[:2] + PART_OF_PAIRS[3:])
    one, two = np.ones(NUM_PLANES, int), np.r_[2, np.ones(NUM_PLANES - 1, int)]
    sound = two_rooms()
    for made, truth, pieces, expected in (
        (shared, sound, None, 0),
        (shared, sound, [one], 0),
        (shared, sound, [two], 1),
        (shared, shared, None, 1),
        (sound, shared, None, 1),
        (alone, alone, None, 1),
        (sound, alone, None, 1),
        (alone, sound, [two], 0),
    ):
        assert score([made], [truth], pieces=pieces)["one_parent"] == expected
    assert score([alone], [alone])["connected"] == 1
    assert score([alone], [sound])["connected"] == 0


def test_levels__a_missing_node_costs_recall_and_a_second_one_precision():
    fewer = score([room_of_three_planes(floor=False)], [room_of_three_planes(floor=True)])
    assert fewer["precision"] == {"room": pytest.approx(1)}
    assert fewer["recall"] == {"room": pytest.approx(1), "floor": pytest.approx(0)}
    more = score([CASES["second wall"][0]], [two_rooms()])
    assert more["precision"]["wall"] == pytest.approx(0.5)
    assert more["recall"]["wall"] == pytest.approx(1)
    assert more["precision"]["room"] == pytest.approx(1)


def test_report__of_a_made_up_ontology_tells_its_concepts():
    truth = own_world.own_world()
    fewer = subgraph(truth, np.arange(20))  # without the floor
    report = score([truth, fewer], [truth, truth])
    assert json.loads(json.dumps(report)) == report
    grown = {"wall": 1.0, "room": 1.0, "flat": 1.0}
    assert report["precision"] == pytest.approx(grown | {"floor": 1.0})
    assert report["recall"] == pytest.approx(grown | {"floor": 0.5})
    assert report["node_count_error"]["signed"] == {"total": -0.5, "floor": -0.5} | dict.fromkeys(
        ("plane", "pillar", "wall", "room", "flat"), 0.0
    )
    assert report["failures"] == {
        "flat without floor": {"count": 2, "share": 0.5},
        "missing floor": {"count": 1, "share": 0.5},
    }
    assert report["exact_structure"] == 0.5
    assert {report[rule] for rule in ("one_parent", "layer_rule", "no_duplicates")} == {1.0}
    assert report["connected"] == 0.5
    twice = make_graph(
        truth.nodes.label,
        truth.nodes.position,
        part_of=[*own_world.PART_OF_PAIRS, (12, 16), (14, 20)],
        ontology=own_world.ONTOLOGY,
    )
    broken = score([twice], [truth])
    assert broken["one_parent"] == broken["layer_rule"] == 0


def test_graphs_of_different_ontologies_are_refused():
    with pytest.raises(ValueError, match="different ontologies"):
        score([two_rooms()], [own_world.own_world()])


def test_summary__has_mean_and_deviation_of_every_number():
    truth = [two_rooms()] * 2
    runs = [score([two_rooms(), graph], truth) for graph in (two_rooms(), CASES["second wall"][0])]
    summed = summary([run | {"halted": None} for run in runs])
    assert summed["exact structure"] == {"mean": 0.75, "sd": pytest.approx(0.5**0.5 / 2)}
    assert summed["node count error, wall"]["mean"] == 0.25
    assert summed["precision, wall"]["mean"] == pytest.approx((1 + 2 / 3) / 2)
    assert "halted" not in summed
    assert summary(runs[:1])["fgw"] == {"mean": runs[0]["fgw"], "sd": None}


def test_padding_does_not_count_and_a_list_may_be_a_generator():
    truth = [room_of_three_planes(floor=True)] * 2
    generated = [room_of_three_planes(floor=False), *truth[1:]]
    padded = [[pad(graph, Capacity(16, 192)) for graph in graphs] for graphs in (generated, truth)]
    assert score(*padded) == score((graph for graph in generated), truth)


def test_one_graph_or_a_weight_that_there_is_not_is_refused():
    with unchecked(), pytest.raises(ValueError, match="got one scene graph, expected a list"):
        score(two_rooms(), two_rooms())
    with unchecked(), pytest.raises(ValueError, match="alpha is 2, expected a number from 0 to 1"):
        score([two_rooms()], [two_rooms()], alpha=2)


def test_a_set_without_nodes_has_no_mmd_but_all_other_scores():
    nothing, truth = make_graph([], np.zeros((0, 3))), room_of_three_planes(floor=True)
    report = score([nothing], [truth])
    assert json.loads(json.dumps(report)) == report
    assert {report[name] for name in ("degree", "spectrum", "clustering", "gin")} == {None}
    assert report["fgw"] == pytest.approx(fgw_pairs([nothing], [truth]).value[0])
    assert report["exact_structure"] == 0
    assert "gin" not in summary([report, score([truth], [truth])])
