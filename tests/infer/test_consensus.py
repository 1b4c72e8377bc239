"""What most candidates have is kept, part by part; what was given stays as it is."""

import dataclasses

import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.infer.candidates import num_flaws
from sg3d_jax.infer.consensus import Version, adopted, consensus, elected, votes_of, votes_of_pairs
from sg3d_jax.metrics.calibration import identities
from sg3d_jax.metrics.structure import exact_structure
from sg3d_jax.scene.graph import make_graph, ontology_of, subgraph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PLANE, ROOM, WALL, Ontology, Rule
from tests.drawn_rooms import drawn, with_pairs
from tests.own_world import NUM_OBSERVED, ONTOLOGY, own_world
from tests.two_rooms import NUM_PLANES, two_rooms

A, B, C, D = (0, 1), (2, 3), (4, 5), (6, 7)
WALLS = [(1, 4), (3, 6)]


def in_turn(graphs):
    """Returns the graphs from each of them on, forwards and backwards: of three, every order."""
    ways = graphs, graphs[::-1]
    return [[*way[first:], *way[:first]] for way in ways for first in range(len(graphs))]


def room(*planes, row=-1):
    return Version(row, frozenset(planes))


def test_candidates_that_are_all_wrong_elsewhere_are_right_together():
    truth = drawn(A, B, C, D, walls=WALLS)
    wrong = [
        drawn(A + B, C, D, walls=WALLS),
        drawn(A, B, C + D, walls=WALLS),
        drawn(A, B, C, D, walls=[(1, 4, 6)]),
    ]
    assert not any(exact_structure(one, truth) for one in wrong)
    for order in in_turn(wrong):
        graph, _ = consensus(order, NUM_PLANES)
        assert exact_structure(graph, truth)


def test_what_most_have_is_added_and_what_few_have_is_dropped():
    few, most = drawn(A, B, walls=[(1, 2)]), drawn(A, B, walls=[(0, 3)])
    graph, start = consensus([few, most, most, few, drawn(A, B, walls=[(0, 3)])], NUM_PLANES)
    assert start == 1
    assert exact_structure(graph, most)
    bare = drawn(A, B)
    for graphs in ([bare, bare, most], [most, bare, bare]):
        assert exact_structure(consensus(graphs, NUM_PLANES)[0], bare)


def test_where_votes_are_equal_what_it_began_from_stays():
    one, other = drawn(A + B, C, D), drawn(A, B, C + D)
    for graphs in ([one, other], [other, one]):
        graph, start = consensus(graphs, NUM_PLANES)
        assert exact_structure(graph, graphs[start])


def test_a_plane_that_most_place_is_not_left_alone():
    """Each of three has the last plane of the west in another room, and none wins."""
    graphs = [
        drawn((0, 1, 2, 3), (4, 5, 6, 7)),
        drawn((0, 1, 2), (3, 4, 5, 6, 7)),
        drawn((0, 1, 2), (3,), (4, 5, 6, 7)),
        drawn((0, 1, 2), (4, 5, 6, 7)),
    ]
    for order in in_turn(graphs):
        graph, _ = consensus(order, NUM_PLANES)
        assert exact_structure(graph, graphs[0]) or exact_structure(graph, graphs[1])


def test_what_half_place_has_a_place_unless_much_belongs_to_nothing():
    """Two of four have the fourth plane in one room or another; the last two may be clutter."""
    for rest, joins in (((6, 7), True), ((), False)):
        east = 4, 5, *rest
        without, west = drawn((0, 1, 2), east), drawn((0, 1, 2, 3), east)
        half = [without, west, without, drawn((0, 1, 2), (3, *east))]
        graphs = [west, half[3]] if joins else [without]
        for order in in_turn(half):
            graph, _ = consensus(order, NUM_PLANES)
            assert any(exact_structure(graph, one) for one in graphs)
        most = [without, west, west, half[3]]
        graph, _ = consensus(most, NUM_PLANES)
        assert exact_structure(graph, west)


@pytest.mark.parametrize(
    ("num_places", "num_clutter", "joins"),
    [(1, 0, False), (2, 0, True), (3, 4, False), (4, 4, True), (4, 12, False), (5, 12, True)],
)
def test_the_fewer_parts_belong_to_nothing_the_fewer_votes_place_one(
    num_places, num_clutter, joins
):
    """Of eight candidates; 100 parts beside the one in question, in rooms of four."""
    number = 100 - num_clutter
    rooms = {room(*range(first, first + 4)) for first in range(0, number, 4)}
    first, last = room(0, 1, 2, 3), room(0, 1, 2, 3, 100)
    ballots = [rooms - {first} | {last}] * num_places + [rooms] * (8 - num_places)
    joined = adopted(rooms, ballots, {*range(101)})
    assert joined.pop(first) == ({100} if joins else set())
    assert not any(joined.values())
    assert not any(adopted(rooms, ballots, {*range(100)}).values())  # it may have any number


def test_rooms_are_exchanged_together_so_that_no_plane_has_two_or_none():
    """Three cut the first six planes in three ways, and two of five leave them one room."""
    thirds = [drawn((0,), (1, 2, 3, 4, 5), D), drawn((0, 1), (2, 3, 4, 5), D)]
    thirds.append(drawn((0, 1, 2), (3, 4, 5), D))
    whole = drawn((0, 1, 2, 3, 4, 5), D)
    for order in in_turn([*thirds, whole, whole]):
        graph, _ = consensus(order, NUM_PLANES)
        assert exact_structure(graph, whole)


def test_a_candidate_with_another_room_there_still_says_which_floor_it_is_on():
    """No two have the same rooms on the first floor, but all have two rooms on the second."""
    rooms = [((0, 1, 2), (3,)), ((0,), (1, 2, 3)), ((0, 1), (2, 3))]
    graphs = [drawn(*pair, C, D, floors=[(0, 1), (2, 3)]) for pair in rooms]
    graphs.append(drawn(*rooms[0], C, D, floors=[(0, 1, 2, 3)]))
    for order in in_turn(graphs):
        graph, _ = consensus(order, NUM_PLANES)
        assert exact_structure(graph, graphs[0])


def test_nodes_stand_in_the_middle_of_those_that_have_them():
    graphs = [drawn(A, B, at=1.0), drawn(A, B, at=2.0), drawn(A, (2, 3, 4), at=6.0)]
    graph, _ = consensus(graphs, NUM_PLANES)
    npt.assert_allclose(graph.nodes.position[NUM_PLANES:, 0], [3.0, 1.5, 3.0])


@pytest.mark.parametrize("name", ["s-f", "s-c"])
def test_of_equal_candidates_it_is_one_of_them(name):
    for graph in registry.make(name, 3):
        observed = int(graph.nodes.observed.sum())
        made, start = consensus([graph] * 3, observed)
        assert start == 0
        assert exact_structure(made, graph)
        for field, given in zip(made.nodes, graph.nodes, strict=True):
            npt.assert_array_equal(field[:observed], given[:observed])
            assert field.dtype == given.dtype
        place = {one: row for row, one in enumerate(identities(graph))}
        rows = [place[one] for one in identities(made)]
        npt.assert_allclose(made.nodes.position, graph.nodes.position[rows])


def test_other_concepts_are_put_to_the_vote_too():
    world = own_world()
    observed, last = int(world.nodes.observed.sum()), len(world.nodes.label) - 1
    wrong = [with_pairs(world, lost=[(12, 15)]), with_pairs(world, lost=[(13, 16)])]
    for order in in_turn([*wrong, subgraph(world, range(last)), world]):
        graph, _ = consensus(order, observed)
        assert exact_structure(graph, world)
        assert ontology_of(graph) == ontology_of(world)


def test_what_stands_in_a_room_does_not_decide_which_planes_it_has():
    """Each of three has the pillars elsewhere, and two agree on pillars and on other rooms."""
    world = own_world()
    right = [world, with_pairs(world, lost=[(12, 15)], new=[(12, 16)])]
    right.append(with_pairs(world, lost=[(13, 16)], new=[(13, 17)]))
    wrong = with_pairs(world, lost=[(4, 16)], new=[(4, 15)])
    candidates = [*right, wrong, wrong]
    for first in range(5):
        graph, _ = consensus([*candidates[first:], *candidates[:first]], NUM_OBSERVED)
        assert exact_structure(graph, world)


def test_what_may_stand_in_several_rooms_is_in_those_that_most_have_it_in():
    """Two of three have the first pillar in both rooms, and place the second, in one or another."""
    rules = [dataclasses.replace(rule, single=rule.part != "pillar") for rule in ONTOLOGY.rules]
    joining = Ontology(ONTOLOGY.concepts, tuple(rules))

    def stands(*rooms):
        new = [*((12, room) for room in rooms[0]), *((13, room) for room in rooms[1])]
        graph = with_pairs(own_world(), lost=[(12, 15), (13, 16)], new=new)
        return graph._replace(globals=make_graph([], [], ontology=joining).globals)

    graphs = [stands([15, 16], [15]), stands([15, 16], [16]), stands([17], [])]
    graph, _ = consensus(graphs, NUM_OBSERVED)
    assert exact_structure(graph, stands([15, 16], [16]))


def test_a_candidate_with_other_planes_there_still_says_what_stands_in_a_room():
    """And what one of three places alone is left alone."""
    world = own_world()
    expected = with_pairs(world, lost=[(13, 16)])
    graphs = [with_pairs(world, lost=[(12, 15)]), expected]
    graphs.append(with_pairs(expected, lost=[(0, 15)], new=[(0, 16)]))
    for order in in_turn(graphs):
        graph, _ = consensus(order, NUM_OBSERVED)
        assert exact_structure(graph, expected)


def test_repeated_nodes_are_kept_if_most_repeat_them():
    once, twice = drawn(A, B, walls=[(1, 2)]), drawn(A, B, walls=[(1, 2), (1, 2)])
    assert exact_structure(consensus([once, twice, twice], NUM_PLANES)[0], twice)
    assert exact_structure(consensus([twice, once, once], NUM_PLANES)[0], once)


def test_nodes_that_were_given_stay_and_get_the_parts_that_most_give_them():
    """The floor and the first room are given; others are grown below the floor."""
    label = [PLANE] * NUM_PLANES + [ROOM, FLOOR]
    given = [(0, 8), (1, 8), (8, 9)]

    def grown(*rooms, walls=()):
        wholes = [*rooms, *walls]
        pairs = [*given, *((plane, 10 + i) for i, of in enumerate(wholes) for plane in of)]
        pairs += [(10 + i, 9) for i in range(len(rooms))]
        labels = [*label, *[ROOM] * len(rooms), *[WALL] * len(walls)]
        return make_graph(labels, np.zeros((len(labels), 3)), part_of=pairs)

    right = grown(B, C, D)
    wrong = [grown(B + C, D), grown(B, C + D), grown(B, C, D, walls=[(1, 4)])]
    for order in in_turn(wrong):
        graph, _ = consensus(order, 10)
        assert graph.nodes.label.tolist() == [*label, ROOM, ROOM, ROOM]
        assert exact_structure(graph, right)
        pairs = [*map(tuple, undirected_edges(graph, PART_OF).tolist())]
        assert len(pairs) == len({*pairs})


def test_what_is_given_is_part_of_what_it_has_an_edge_to_and_not_of_all_above():
    ontology = ontology_of(two_rooms())
    rules = (*ontology.rules, Rule("plane", "floor", single=False))
    nodes = drawn(A, B).nodes
    graph = make_graph(
        nodes.label,
        nodes.position,
        part_of=[*((plane, 8 + plane // 2) for plane in range(4)), (8, 10), (9, 10), (7, 10)],
        ontology=Ontology(ontology.concepts, rules),
    )
    made, _ = consensus([graph] * 3, NUM_PLANES)
    assert exact_structure(made, graph)


def test_edges_against_the_rules_are_not_kept():
    forbidden = with_pairs(drawn(A, B), new=[(0, NUM_PLANES + 2)])  # a plane of a floor
    graph, _ = consensus([forbidden] * 3, NUM_PLANES)
    assert exact_structure(graph, drawn(A, B))


def test_what_breaks_more_rules_than_the_best_candidate_is_not_kept():
    """Most leave a room without a floor, and one does not."""
    valid = drawn(A, B)
    loose = with_pairs(drawn(A, B), lost=[(NUM_PLANES + 1, NUM_PLANES + 2)])
    graph, start = consensus([loose, valid, loose], NUM_PLANES)
    assert start == 1
    assert graph is valid
    assert num_flaws(consensus([loose] * 3, NUM_PLANES)[0]) == 1


def test_one_candidate_is_kept_as_it_is():
    loose = with_pairs(drawn(A, B), new=[(0, NUM_PLANES + 2)])
    assert consensus([loose], NUM_PLANES) == (loose, 0)
    with pytest.raises(ValueError, match="no candidates"):
        consensus([], NUM_PLANES)


def test_concepts_that_grow_without_parts_cannot_be_put_to_the_vote():
    ontology = ontology_of(two_rooms())
    roofless = Ontology(ontology.concepts, tuple(r for r in ontology.rules if r.whole != "wall"))
    graph = make_graph([PLANE] * 2 + [WALL], np.zeros((3, 3)), ontology=roofless)
    assert consensus([graph] * 3, 2) == (graph, 0)


def chosen_of(ballots, start, by):
    return elected(ballots, start, by(ballots))


@pytest.mark.parametrize("by", [votes_of, votes_of_pairs])
def test_a_draw_of_votes_leaves_what_it_began_from(by):
    one, other = {room(0, 1), room(2)}, {room(0), room(1, 2)}
    assert chosen_of([one, other], 0, by) == one
    assert chosen_of([one, other], 1, by) == other
    assert chosen_of([one, other, other], 0, by) == other


def test_two_small_rooms_count_as_much_as_a_large_one():
    large, halves = {room(0, 1, 2, 3)}, {room(0, 1), room(2, 3)}
    ballots = [large, halves, large, halves, {room(0), room(1), room(2), room(3)}]
    assert chosen_of(ballots, 0, votes_of) == large
    assert chosen_of(ballots, 1, votes_of) == halves


@pytest.mark.parametrize("by", [votes_of, votes_of_pairs])
@pytest.mark.parametrize("seed", range(20))
def test_wholes_that_are_elected_have_no_part_in_common_and_all_parts_a_whole(seed, by):
    rng = np.random.default_rng(seed)
    base = rng.integers(4, size=12)
    ballots = []
    for _ in range(5):
        of_part = np.where(rng.random(12) < 0.2, rng.integers(4, size=12), base)
        ballots.append({room(*np.flatnonzero(of_part == k).tolist()) for k in {*of_part.tolist()}})
    for start in range(5):
        chosen = chosen_of(ballots, start, by)
        parts = [part for version in chosen for part in version.parts]
        assert sorted(parts) == [*range(12)]


@pytest.mark.parametrize("seed", range(10))
def test_pairs_vote_for_what_agrees_with_most_candidates_on_most_of_them(seed):
    """A brute-force count; 20 and 21 are given wholes, one of which may hold nothing."""
    rng = np.random.default_rng(seed)
    ballots = []
    for _ in range(5):
        of_part = rng.integers(5, size=8)
        held = [np.flatnonzero(of_part == k).tolist() for k in range(4)]  # what has 4 has no whole
        ballots.append({room(*held[0], row=20), room(*held[1], row=21)})
        ballots[-1] |= {room(*parts) for parts in held[2:] if parts}
    for version, votes in votes_of_pairs(ballots).items():
        parts = sorted(version.parts)
        wanted = [{one, other} for one in parts for other in parts if one <= other]
        said = sum(
            2 * sum(any(pair <= one.parts for one in ballot) for ballot in ballots) - 5
            for pair in wanted
        )
        if version.row >= 0:
            at_row = [one.parts for ballot in ballots for one in ballot if one.row == version.row]
            said += sum(2 * sum(part in other for other in at_row) - 5 for part in parts)
        assert votes == said


def test_rooms_that_most_have_on_different_floors_are_not_on_one():
    """Two of eight join both floors; five each have another room on the wrong one."""
    west, east = (0, 1, 2, 3, 4), (5, 6, 7)
    joined, right = {room(*west, *east)}, {room(*west), room(*east)}
    wrong = [{room(*({*west} - {lost})), room(*east, lost)} for lost in west]
    ballots = [joined, joined, *wrong, right]
    assert chosen_of(ballots, 0, votes_of_pairs) == right
    assert chosen_of(ballots, 0, votes_of) == joined


def test_a_room_with_more_doors_than_planes_is_in_one_unit():
    """Two units, each of a room of one plane, and three doors between the rooms."""
    names = "plane", "door", "room", "unit", "floor"
    plane, door, a_room, unit, floor = map(FURNISHED_ONTOLOGY.label_of, names)
    labels = [plane] * 2 + [door] * 3 + [a_room] * 2 + [unit] * 2 + [floor]
    pairs = [(0, 5), (1, 6), *((one, other) for one in (2, 3, 4) for other in (5, 6))]
    pairs += [(5, 7), (6, 8), (7, 9), (8, 9)]
    graph = make_graph(labels, np.zeros((10, 3)), part_of=pairs, ontology=FURNISHED_ONTOLOGY)
    made, _ = consensus([graph] * 3, 5)
    assert made is not graph  # which is kept where the votes break a rule
    assert exact_structure(made, graph)


def test_what_half_place_has_a_place_among_objects_that_have_one():
    """Of two rooms with nine objects each; two of four leave one of the planes alone."""
    plane, thing, a_room = map(FURNISHED_ONTOLOGY.label_of, ("plane", "object", "room"))
    labels = [plane] * 8 + [thing] * 18 + [a_room] * 2
    pairs = [(one, 26 + (one >= 4)) for one in range(8)]
    pairs += [(8 + one, 26 + one % 2) for one in range(18)]

    def with_fourth(*fourth):
        held = [pair for pair in pairs if pair[0] != 3] + [(3, one) for one in fourth]
        position = np.zeros((len(labels), 3))
        return make_graph(labels, position, part_of=held, ontology=FURNISHED_ONTOLOGY)

    without, west, east = with_fourth(), with_fourth(26), with_fourth(27)
    for order in in_turn([without, west, without, east]):
        made, _ = consensus(order, 26)
        assert exact_structure(made, west) or exact_structure(made, east)
