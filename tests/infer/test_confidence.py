"""How sure a graph is: nothing is doubted of complete ones, and what is missing is counted."""

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.infer.confidence import PRIOR, SHARPNESS, Confidence, judged
from sg3d_jax.metrics.oddities import Odd, Oddity, oddities
from sg3d_jax.scene.graph import (
    SceneGraph,
    make_graph,
    parts_first,
    subgraph,
    undirected_edges,
)
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PART_OF, PLANE, ROOM, Ontology
from tests.drawn_rooms import drawn, with_pairs
from tests.own_world import own_world
from tests.two_rooms import NUM_PLANES, PART_OF_PAIRS, two_rooms

SURE = Confidence(0.0, 0.0, 0.0, None)
WEST, EAST, TOP = 9, 10, 11  # both rooms and the floor


def without(graph: SceneGraph, *lost: tuple[int, int]) -> SceneGraph:
    """Returns a graph without some of its part-of edges."""
    return with_pairs(graph, lost)


def of_all(graphs, num_given):
    """How sure each of some samples is, none of them being put together of others."""
    return [(one.confidence, one.remarks) for one in judged(graphs, graphs, num_given)]


def sure_of(graphs, drawn, num_given):
    return [(one.nodes, one.edges) for one in judged(graphs, drawn, num_given)]


def alone(graph):
    [judgement] = of_all([graph], NUM_PLANES)
    return judgement


@pytest.mark.parametrize("name", ["s-f", "s-b", "s-c"])
def test_complete_graphs_are_sure(name):
    for graph in registry.make(name, 5):
        num_given = int(graph.nodes.observed.sum())
        assert of_all([graph], num_given) == [(SURE, ())]
        assert (
            of_all([graph, subgraph(graph, range(len(graph.nodes.label)))], num_given)
            == [(SURE._replace(agreement=1.0), ())] * 2
        )


def test_complete_graphs_of_other_concepts_are_sure():
    assert alone(own_world()) == (SURE, ())


def test_what_was_not_grown_from_lacks_nothing():
    graph = without(two_rooms(), (0, WEST), (2, WEST))
    for set_aside, unplaced in (((), 0.25), ((0,), 0.125), ((0, 2), 0.0)):
        [one] = judged([graph], [graph], NUM_PLANES, set_aside)
        assert one.confidence.unplaced == unplaced
        assert any("without a room" in remark for remark in one.remarks) == (unplaced > 0)


@pytest.mark.parametrize(("num_lost", "holders"), [(0, 4), (1, 4), (2, 1)])
def test_a_floor_of_a_dozen_planes_is_the_same_without_one_of_them(num_lost, holders):
    """One of four draws is kept; the others leave planes of its first room alone."""
    graph = next(one for one in registry.make("s-f", 40) if one.nodes.observed.sum() == 12)
    num_given, label = 12, graph.nodes.label
    pairs = parts_first(graph)
    changed, other = np.flatnonzero(label == ROOM)[:2]
    (floor,) = np.flatnonzero(label == FLOOR)
    lost = [tuple(pair) for pair in pairs[pairs[:, 1] == changed].tolist()][:num_lost]
    [(nodes, edges)] = sure_of([graph], [graph, *[without(graph, *lost)] * 3], num_given)
    all_, some, one = likely(4, 4), likely(holders, 4), likely(1 if num_lost else 4, 4)
    npt.assert_allclose(nodes[[other, floor, changed]], [all_, some, one])
    place = {tuple(pair): row for row, pair in enumerate(pairs.tolist())}
    of_floor = edges[[place[other, floor], place[changed, floor]]]
    npt.assert_allclose(of_floor, [some, one])


def test_planes_without_a_room_are_counted():
    confidence, remarks = alone(without(two_rooms(), (0, WEST), (5, EAST), (7, EAST)))
    assert confidence == SURE._replace(unplaced=3 / 8)
    assert remarks == ("unsure: 3 of 8 planes without a room",)


def test_a_plane_with_a_wall_alone_has_no_room():
    confidence, _ = alone(without(two_rooms(), (1, WEST)))
    assert confidence == SURE._replace(unplaced=1 / 8)


def test_where_no_whole_is_single_any_will_do():
    plane, wall = PAPER_ONTOLOGY.concepts[:2]
    walls = Ontology((plane, wall), PAPER_ONTOLOGY.rules[:1])
    nodes = subgraph(two_rooms(), range(9), edges=False).nodes
    fields = (nodes.label, nodes.position, nodes.normal, nodes.width)
    confidence, remarks = alone(make_graph(*fields, [[1, 8], [4, 8]], ontology=walls))
    assert confidence == SURE._replace(unplaced=6 / 8)
    assert remarks == ("unsure: 6 of 8 planes without a wall",)


def test_rooms_without_a_floor_are_counted():
    confidence, remarks = alone(without(two_rooms(), (EAST, TOP)))
    assert confidence == SURE._replace(loose=1 / 3)
    assert remarks == ("unsure: 1 of 2 rooms without a floor",)


def test_without_any_floor_all_rooms_but_one_are_without():
    confidence, remarks = alone(subgraph(two_rooms(), range(TOP)))
    assert confidence == SURE._replace(loose=1 / 2)
    assert remarks == ("unsure: 1 of 2 rooms without a floor",)


def test_two_tops_are_one_too_many():
    cities = registry.make("s-c", 2)
    counts = [len(city.nodes.label) for city in cities]
    columns = [
        np.concatenate([getattr(city.nodes, field) for city in cities])
        for field in ("label", "position", "normal", "width")
    ]
    pairs = [undirected_edges(city, PART_OF) for city in cities]
    both = make_graph(*columns, part_of=np.concatenate([pairs[0], pairs[1] + counts[0]]))
    [(confidence, remarks)] = of_all([both], 0)
    assert 0 < confidence.loose < 0.2
    assert remarks == ("unsure: 1 of 2 cities too many",)


def test_rooms_and_walls_of_one_plane_are_counted():
    lost = [(plane, EAST) for plane in (5, 6, 7)]
    confidence, remarks = alone(without(two_rooms(), *lost, (1, 8)))
    assert confidence.thin == 2 / 3
    assert set(remarks) == {
        "unsure: 1 of 1 walls with fewer than 2 planes",
        "unsure: 1 of 2 rooms with fewer than 2 planes",
        "unsure: 3 of 8 planes without a room",
    }


def test_a_graph_of_planes_alone_is_sure_of_nothing():
    confidence, _ = alone(subgraph(two_rooms(), range(NUM_PLANES)))
    assert confidence == SURE._replace(unplaced=1.0)


@pytest.mark.parametrize("index", range(10))
def test_shares_are_those_of_oddities(index):
    """Where a graph has its floor, what lacks a whole is what `sg3d data check` finds odd."""
    graph, rng = registry.make("s-f", 10)[index], np.random.default_rng(index)
    label = graph.nodes.label
    pairs = undirected_edges(graph, PART_OF)
    torn = without(graph, *map(tuple, pairs[rng.random(len(pairs)) < 0.2].tolist()))
    found = oddities(torn)
    [(confidence, _)] = of_all([torn], 0)
    odd_planes = found[Odd(Oddity.WITHOUT_WHOLE, "plane", "room")]
    odd_rooms = found[Odd(Oddity.WITHOUT_WHOLE, "room", "floor")]
    npt.assert_allclose(confidence.unplaced, odd_planes / np.sum(label == PLANE))
    above = np.sum((label == ROOM) | (label == FLOOR))
    npt.assert_allclose(confidence.loose, odd_rooms / above)


def test_agreement_is_what_samples_share():
    west, east = (0, 1, 2, 3), (4, 5, 6, 7)
    right, wrong, one = drawn(west, east), drawn(west, (4, 5), (6, 7)), drawn(west + east)
    agreements = [confidence.agreement for confidence, _ in of_all([right, wrong, one], NUM_PLANES)]
    # Right and wrong share a room and the floor, of three and four nodes; the floor alone is shared
    # with the third, of two.
    between = {"right wrong": 4 / 7, "right one": 2 / 5, "wrong one": 2 / 6}
    npt.assert_allclose(
        agreements,
        [
            (between["right wrong"] + between["right one"]) / 2,
            (between["right wrong"] + between["wrong one"]) / 2,
            (between["right one"] + between["wrong one"]) / 2,
        ],
    )


def test_agreement_does_not_depend_on_the_order_of_what_was_grown_nor_count_what_was_given():
    east, west = drawn((4, 5, 6, 7), (0, 1, 2, 3)), drawn((0, 1, 2, 3), (4, 5, 6, 7))
    assert [c.agreement for c, _ in of_all([east, west], NUM_PLANES)] == [1.0, 1.0]
    other = drawn((0, 1, 2, 3), (4, 5), (6, 7))
    kept = NUM_PLANES + 1  # the west room was given
    npt.assert_allclose([c.agreement for c, _ in of_all([west, other], kept)], [2 / 5] * 2)


def test_repeated_nodes_are_no_agreement():
    room = (0, 1, 2, 3)
    once, twice = drawn(room, (4, 5, 6, 7)), drawn(room, room)
    npt.assert_allclose([c.agreement for c, _ in of_all([once, twice], NUM_PLANES)], [2 / 6] * 2)


def test_what_is_put_together_agrees_with_all_that_was_drawn():
    right, wrong = drawn((0, 1, 2, 3), (4, 5, 6, 7)), drawn((0, 1, 2), (3, 4, 5, 6, 7))
    copy = subgraph(right, range(len(right.nodes.label)))
    drawn_one, made = judged([right, copy], [right, wrong], NUM_PLANES)
    npt.assert_allclose(drawn_one.confidence.agreement, 1 / 3)
    npt.assert_allclose(made.confidence.agreement, (1 + 1 / 3) / 2)


def test_one_draw_alone_tells_nothing_of_its_nodes_and_edges():
    [one] = judged([two_rooms()], [two_rooms()], NUM_PLANES)
    assert one.nodes is one.edges is one.confidence.agreement is None


def likely(count, of_all):
    return 1 / (1 + ((of_all - count + PRIOR) / (count + PRIOR)) ** SHARPNESS)


def test_nodes_and_edges_are_as_sure_as_many_draws_have_them():
    west, east = (0, 1, 2, 3), (4, 5, 6, 7)
    draws = [drawn(west, east), drawn(east, west), drawn(west, (4, 5), (6, 7)), drawn(west + east)]
    [(nodes, edges), *_] = sure_of(draws[:1], draws, NUM_PLANES)
    npt.assert_array_equal(nodes[:NUM_PLANES], 1.0)
    # The west room is in three, the east room in two; all are of a floor over all planes.
    npt.assert_allclose(nodes[NUM_PLANES:], [likely(3, 4), likely(2, 4), likely(4, 4)])
    top = NUM_PLANES + 2
    expected = {
        **{(plane, NUM_PLANES): likely(3, 4) for plane in west},
        **{(plane, NUM_PLANES + 1): likely(2, 4) for plane in east},
        **{(NUM_PLANES, top): likely(3, 4), (NUM_PLANES + 1, top): likely(2, 4)},
    }
    found = dict(zip(map(tuple, parts_first(draws[0]).tolist()), edges, strict=True))
    assert found == pytest.approx(expected)


def test_what_was_given_is_sure_and_so_are_edges_between_it():
    draws = [drawn((0, 1, 2, 3), (4, 5, 6, 7)), drawn((0, 1, 2, 3), (4, 5, 6))]
    west, east, top = NUM_PLANES, NUM_PLANES + 1, NUM_PLANES + 2
    [(nodes, edges), _] = sure_of(draws, draws, NUM_PLANES + 1)
    assert nodes[west] == 1.0
    npt.assert_allclose(nodes[[east, top]], likely(1, 2))
    sure = [tuple(pair) for pair in parts_first(draws[0])[edges == 1.0].tolist()]
    assert sure == [(plane, west) for plane in range(4)]


def test_what_more_draws_have_is_surer_and_never_certain():
    room = (0, 1, 2, 3)
    for total in (2, 4, 8):
        sure = []
        for count in range(1, total + 1):
            draws = [drawn(room)] * count + [drawn((4, 5, 6, 7))] * (total - count)
            [(nodes, _)] = sure_of(draws[:1], draws, NUM_PLANES)
            sure.append(nodes[NUM_PLANES])
        assert (np.diff(sure) > 0).all()
        assert 0 < sure[0] <= 0.5 < sure[-1] < 1


def test_samples_that_differ_much_are_said():
    right, wrong = drawn((0, 1, 2, 3), (4, 5, 6, 7)), drawn((0, 1, 2), (3, 4, 5), (6, 7))
    (_, remarks), _ = of_all([right, wrong], NUM_PLANES)
    assert remarks == ("unsure: other samples have 29% of what was grown",)


def test_the_pairs_of_the_scene_are_those_it_is_made_of():
    npt.assert_array_equal(undirected_edges(two_rooms(), PART_OF), sorted(PART_OF_PAIRS))
