"""A map that changes with what is observed, mostly over rooms that a stand-in draws by ids."""

import copy
import dataclasses
import json
import pickle
from typing import Any

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.flagg.grow import grow_lanes
from sg3d_jax.flagg.placement import Placement
from sg3d_jax.infer import placement
from sg3d_jax.infer import session as sessions
from sg3d_jax.infer.session import begin, graph_of, ids_of, nodes_of, update, warm_up
from sg3d_jax.scene.changes import MERGED, SHRUNK, SPLIT, Changes, Event
from sg3d_jax.scene.graph import (
    extended,
    make_graph,
    observed_of,
    ontology_of,
    parts_first,
    subgraph,
)
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, PLANE, ROOM, WALL
from sg3d_jax.scene.validate import validate_graph
from tests import own_world
from tests.growing_rooms import MODEL, NEVER, stop_at
from tests.two_rooms import moved, on_device, random_params, two_rooms
from tests.unchecked import unchecked

PLANES = observed_of(two_rooms())
IDS = ("a0", "a1", "a2", "a3", "b0", "b1", "b2", "b3")
TRUTH = {ROOM: [("a0", "a1", "a2", "a3"), ("b0", "b1", "b2", "b3")], WALL: [("a1", "b0")]}


class Draws:
    """Stands in for a model: draws wholes over observed nodes by their ids, and one of them all.

    Attributes:
      wholes: of each concept, the ids of their parts.
      top: the concept of the one above the second concept of `wholes`, such as rooms.
      regions: what was drawn so far.
      fails: whether it does not come to its end.
    """

    def __init__(self):
        self.wholes: dict[int, list[tuple[Any, ...]]] = TRUTH
        self.top = {ROOM: FLOOR}
        self.regions = []
        self.fails = False

    def __call__(self, model, params, session, region):
        self.regions.append(region)
        if self.fails:
            return None
        given = subgraph(session.known.graph, region.rows)
        label, placed = given.nodes.label.tolist(), parts_first(given).tolist()
        pieces = [
            (place, session.ids[session.pieces.owner[row]])
            for place, row in enumerate(region.rows.tolist())
            if row < len(session.pieces.owner)
        ]
        position, pairs = [], []
        for concept, wholes in self.wholes.items():
            held = {part for part, whole in placed if label[whole] == concept}
            for ids in wholes:
                if parts := [p for p, one in pieces if one in ids and p not in held]:
                    pairs += [(part, len(label)) for part in parts]
                    position.append(given.nodes.position[parts].mean(axis=0))
                    label.append(concept)
        for concept, above in self.top.items():
            if parts := [row for row, one in enumerate(label) if one == concept]:
                pairs += [(part, len(label)) for part in parts]
                position.append([1.0, 1.0, 1.0])
                label.append(above)
        return extended(given, label[len(region.rows) :], position, pairs)


@pytest.fixture(autouse=True)
def _no_check_of_key_reuse():
    """JAX takes a vmapped loop over keys for their reuse."""
    with jax.debug_key_reuse(False):
        yield


@pytest.fixture
def draws(monkeypatch):
    stand_in = Draws()
    monkeypatch.setattr(sessions, "_drawn", stand_in)
    return stand_in


def told(*ids: str, planes=PLANES) -> dict[str, Any]:
    """Returns the fields of changes that tell some of the planes."""
    return {"observed": subgraph(planes, [IDS.index(one) for one in ids]), "ids": ids}


THINK = Changes(think=True)


def go(session, **changes):
    """Returns the map after changes, and what they did to its graph, which must be all.

    Without any it is thought over.
    """
    changes = changes or {"think": True}
    after, done = update(MODEL, stop_at(13), session, Changes(**changes))
    nodes = {one: node for one, node in nodes_of(session).items() if one not in done.removed}
    nodes |= {node.id: node for node in (*done.added, *done.changed)}
    strip = lambda held: {one: node._replace(age=0) for one, node in held.items()}
    assert strip(nodes) == strip(nodes_of(after))
    assert not {node.id for node in done.added} & {*nodes_of(session)}
    graph = graph_of(after)
    if len(graph.nodes.label):
        validate_graph(graph, "map")
    assert len({*ids_of(after)}) == len(graph.nodes.label)
    return after, done


def whole_map(draws):
    """Returns the map of both rooms; nothing is counted as drawn yet."""
    session, _ = go(begin(PAPER_ONTOLOGY), **told(*IDS))
    draws.regions.clear()
    return session


def ids_over(session, label, *observed):
    """Returns the ids of the grown nodes over observed ones."""
    nodes = nodes_of(session).values()
    return [node.id for node in nodes if (node.label, node.observed) == (label, observed)]


def room(session, name):
    """Returns the room of four planes, "a" or "b"."""
    [one] = ids_over(session, ROOM, *(f"{name}{number}" for number in range(4)))
    return nodes_of(session)[one]


def floor_of(session):
    [one] = [node for node in nodes_of(session).values() if node.label == FLOOR]
    return one


def assert_same(one, other):
    for mine, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        npt.assert_array_equal(mine, theirs, strict=True)


def test_what_is_observed__comes_back_bit_for_bit_in_the_order_first_told(draws):
    far = moved(PLANES, 0.3, (5e6 + 0.123456789, -5e6, 100.0))
    session, _ = go(begin(PAPER_ONTOLOGY), **told("b0", "b1", "a0", planes=far))
    session, _ = go(session, **told("a1", "b1", planes=moved(far, offset=(0, 1e-9, 0))))
    assert session.ids == ("b0", "b1", "a0", "a1")
    assert ids_of(session)[:4] == ["b0", "b1", "a0", "a1"]
    graph = graph_of(session)
    for name in ("position", "normal", "width", "label"):
        expected = np.array(getattr(far.nodes, name)[[4, 5, 0, 1]])
        if name == "position":
            expected[[1, 3], 1] += 1e-9
        npt.assert_array_equal(getattr(graph.nodes, name)[:4], expected)
    session, _ = go(session, removed=("b1",))
    assert ids_of(session)[:3] == ["b0", "a0", "a1"]


def test_what_grows__comes_with_ids_and_is_said(draws):
    session, done = go(begin(PAPER_ONTOLOGY), **told(*IDS))
    assert {node.label for node in done.added} == {ROOM, WALL, FLOOR}
    assert done.changed == done.removed == done.events == ()
    assert ids_of(session)[8:] == ["room-0", "room-1", "wall-2", "floor-3"]
    assert floor_of(session).parts == (room(session, "a").id, room(session, "b").id)
    npt.assert_array_equal(graph_of(session).nodes.position[8], room(session, "a").position)


def test_what_is_seen_again__changes_nothing_and_stands_in_when_the_first_is_gone(draws):
    session, seen = whole_map(draws), PLANES.nodes.position.copy()
    seen[0] += [0.01, 0.002, 0.1]
    again = subgraph(PLANES._replace(nodes=PLANES.nodes._replace(position=seen)), [0])
    before = nodes_of(session)
    session, done = go(session, observed=again, ids=("again",))
    assert done.added == done.changed == done.removed == ()
    assert nodes_of(session) == {one: node._replace(age=1) for one, node in before.items()}
    npt.assert_array_equal(graph_of(session).nodes.position[8], seen[0])
    gone, done = go(session, merged=(("again", "a0"),))
    assert (done.added, done.changed, done.removed) == ((), (), ())
    assert "again" not in ids_of(gone)
    draws.wholes = {ROOM: [("a1", "a2", "a3", "again"), TRUTH[ROOM][1]], WALL: TRUTH[WALL]}
    session, _ = go(session, removed=("a0",))
    assert ids_over(session, ROOM, "a1", "a2", "a3", "again") == [0]


def test_an_update_of_a_model__is_a_pure_function(monkeypatch):
    monkeypatch.setattr(sessions, "LEAST", 32)
    monkeypatch.setattr(sessions, "SPARE", 1)
    model = dataclasses.replace(MODEL, placement=Placement(4, 2, 1))
    places = random_params(model.placement.init, on_device(two_rooms()))
    params = stop_at(13)._replace(placement=places)
    warm_up(model, params, 0)
    compiled = grow_lanes._cache_size(), placement._positions._cache_size()

    def step(session, *changes):
        for one in changes:
            session, _ = update(model, params, session, one)
        return session

    first, *rest = Changes(**told(*IDS[:6])), Changes(**told(*IDS[6:])), THINK, THINK
    session = step(begin(PAPER_ONTOLOGY, 7), first)
    before = copy.deepcopy(jax.tree.leaves(session))
    after = step(session, *rest)
    assert_same(session, jax.tree.unflatten(jax.tree.structure(session), before))
    assert_same(after, step(pickle.loads(pickle.dumps(session)), *rest))
    assert_same(after, step(step(begin(PAPER_ONTOLOGY, 7), first), *rest))
    other = step(begin(PAPER_ONTOLOGY, 8), first)
    assert not np.array_equal(other.known.graph.nodes.position, session.known.graph.nodes.position)
    assert (session.known.graph.nodes.label == ROOM).any()
    assert (grow_lanes._cache_size(), placement._positions._cache_size()) == compiled
    drawn, _ = update(MODEL, stop_at(13), begin(PAPER_ONTOLOGY, 7), first)
    expected = placement.placed(model, params, drawn.known.graph, 6).nodes.position
    npt.assert_allclose(session.known.graph.nodes.position, expected, atol=1e-5)
    assert np.abs(expected - drawn.known.graph.nodes.position).max() > 0.01


def test_ids__stay_with_what_goes_on_and_are_never_given_twice(draws):
    session, _ = go(begin(PAPER_ONTOLOGY), **told("a0", "a1", "a2"))
    first = ids_over(session, ROOM, "a0", "a1", "a2")
    session, done = go(session, **told("a3", "b0", "b1", "b2", "b3"))
    assert [room(session, "a").id] == first
    assert room(session, "a") in done.changed
    assert room(session, "b") in done.added
    seen = {*nodes_of(session)}
    session, done = go(session, removed=IDS)
    assert {*done.removed} == seen
    assert nodes_of(session) == {}
    session, _ = go(session, **told(*IDS))
    assert not seen & {*nodes_of(session)}
    last, draws.top = floor_of(session).id, {}
    session, _ = go(session, forbidden=(last,))
    draws.wholes = {ROOM: [*TRUTH[ROOM], ("c",)]}
    other = told("a0", planes=moved(PLANES, offset=(0.2, 0.0, 0.0)))["observed"]
    session, done = go(session, observed=other, ids=("c",))
    assert done.added != ()
    assert all(node.id > last for node in done.added)


def test_what_does_not_change__is_kept_bit_for_bit(draws):
    session = whole_map(draws)
    after, done = go(session, **told("b1", planes=moved(PLANES, offset=(0.5, 0, 0))))
    assert room(after, "a").position == room(session, "a").position
    assert {node.id for node in done.changed} == {room(session, "b").id, floor_of(session).id}


def test_what_moves_as_one__takes_along_what_is_above_it(draws):
    draws.wholes = {ROOM: TRUTH[ROOM]}
    session, way = whole_map(draws), (0.4, (3.0, -2.0, 0.1))
    after, _ = go(session, **told(*IDS[4:], planes=moved(PLANES, *way)))
    assert draws.regions == []
    assert nodes_of(after).keys() == nodes_of(session).keys()
    assert room(after, "a").position == room(session, "a").position
    expected = moved(make_graph([ROOM], [room(session, "b").position]), *way).nodes.position[0]
    npt.assert_allclose(room(after, "b").position, expected, rtol=0, atol=1e-12)
    shift = (np.array(room(after, "b").position) - room(session, "b").position) / 2
    place = np.array(floor_of(session).position) + shift
    npt.assert_allclose(floor_of(after).position, place, rtol=0, atol=1e-12)


def test_what_is_torn_apart__is_all_that_is_drawn_again(draws):
    session = whole_map(draws)
    wall = ids_over(session, WALL, "a1", "b0")
    go(session, **told(*IDS[4:], planes=moved(PLANES, offset=(0.0, 5.0, 0.0))))
    [region] = draws.regions
    opened = session.known.tracks.id[region.open].tolist()
    assert opened == [*wall, floor_of(session).id]


def test_what_jitters__is_not_drawn_again(draws):
    session, rng = whole_map(draws), np.random.default_rng(0)
    nodes = PLANES.nodes
    for _ in range(5):
        noisy = PLANES._replace(
            nodes=nodes._replace(
                position=nodes.position + rng.normal(0, 0.01, (8, 3)),
                width=nodes.width + rng.uniform(-0.04, 0.04, 8),
            )
        )
        session, done = go(session, **told(*IDS, planes=noisy))
        assert done.added == done.removed == done.events == ()
    assert draws.regions == []


@pytest.mark.parametrize("each", [0.04, 0.25])
def test_what_grows_little_by_little__is_drawn_again_at_last(draws, each):
    session, nodes, grown = whole_map(draws), PLANES.nodes, 0.0
    while not draws.regions:
        grown += each
        position = nodes.position + grown / 2 * np.array([0, 1, 0]) * (nodes.normal[:, :1] != 0)
        longer = PLANES._replace(nodes=nodes._replace(position=position, width=nodes.width + grown))
        session, _ = go(session, **told("a1", planes=longer))
        assert grown < 1.0
    assert grown > 0.3


def test_parts_that_move_apart__are_drawn_again(draws):
    session = whole_map(draws)
    go(session, **told("a0", planes=moved(PLANES, offset=(-0.1, 0, 0))))
    assert draws.regions == []
    go(session, **told("a0", planes=moved(PLANES, offset=(-1.0, 0, 0))))
    assert len(draws.regions) == 1


def test_a_plane_without_a_room__is_drawn_again_if_it_moves(draws):
    draws.wholes = {ROOM: [IDS[:4]]}
    session = whole_map(draws)
    go(session, **told("b2", planes=moved(PLANES, offset=(0, 0, 0.05))))
    assert draws.regions == []
    go(session, **told("b2", planes=moved(PLANES, offset=(0, 0, 0.5))))
    assert len(draws.regions) == 1


def test_a_room_that_loses_a_plane__is_drawn_again_and_says_so(draws):
    session = whole_map(draws)
    one = room(session, "a").id
    after, done = go(session, removed=("a2",))
    assert len(draws.regions) == 1
    assert done.events == (Event(SHRUNK, one, ()),)
    assert nodes_of(after)[one].observed == ("a0", "a1", "a3")


def test_a_room_without_planes__is_gone_even_if_nothing_is_drawn(draws):
    session = whole_map(draws)
    one, draws.fails = room(session, "a").id, True
    after, done = go(session, removed=IDS[:4])
    assert one in done.removed
    after, done = go(after, removed=IDS[4:])
    assert nodes_of(after) == {}


def test_a_plane_that_is_merged__is_gone_and_no_loss(draws):
    session = whole_map(draws)
    one = room(session, "a").id
    after, done = go(session, merged=(("a2", "a0"),))
    assert "a2" not in after.ids
    assert nodes_of(after)[one].observed == ("a0", "a1", "a3")
    assert done.events == ()


def test_rooms_that_split_and_merge__say_so(draws):
    session = whole_map(draws)
    first, second = room(session, "a").id, room(session, "b").id
    draws.wholes = {ROOM: [IDS]}
    shifted = told("a1", "b0", planes=moved(PLANES, offset=(1.0, 0, 0)))
    session, done = go(session, **shifted)
    assert Event(MERGED, first, (second,)) in done.events
    draws.wholes = {ROOM: [("a0", "a1", "a2", "a3"), IDS[4:]]}
    session, done = go(session, **told("a1", "b0"))
    [new] = done.added
    assert done.events[0] == Event(SPLIT, first, (new.id,))


def test_nothing_new__has_the_whole_map_drawn_again(draws):
    _, done = go(whole_map(draws))
    [region] = draws.regions
    assert region.rows.tolist() == [*range(8)]
    assert region.open.tolist() == [False] * 8 + [True] * 4
    assert done.added == done.removed == done.events == ()


def test_what_is_drawn_otherwise__is_taken_over_the_second_time(draws):
    session = whole_map(draws)
    draws.wholes = {ROOM: [(*IDS[:4], "b0"), IDS[5:]]}
    once, _ = go(session)
    assert room(once, "b").id == room(session, "b").id
    draws.wholes = TRUTH
    back, _ = go(once)
    draws.wholes = {ROOM: [(*IDS[:4], "b0"), IDS[5:]]}
    again, _ = go(back)
    assert room(again, "b").id == room(session, "b").id
    twice, done = go(again)
    assert ids_over(twice, ROOM, *IDS[5:]) == [room(session, "b").id]
    assert nodes_of(twice)[room(session, "a").id].observed == IDS[:5]
    assert (SHRUNK, room(session, "b").id) in {(event.kind, event.id) for event in done.events}


def test_confidence__comes_with_agreement(draws):
    session = whole_map(draws)
    first = room(session, "a").confidence
    surer, done = go(session)
    assert room(surer, "a").confidence > first
    assert room(surer, "a") in done.changed
    draws.wholes = {ROOM: [IDS]}
    assert room(go(surer)[0], "a").confidence < room(surer, "a").confidence


def test_what_is_confirmed__stays_whatever_is_drawn(draws):
    session = whole_map(draws)
    one, floor = room(session, "a"), floor_of(session)
    session, done = go(session, confirmed=(one.id, floor.id))
    assert draws.regions == []
    assert {node.id for node in done.changed} == {one.id, floor.id}
    assert nodes_of(session)[one.id].confidence == 1.0
    draws.wholes = {ROOM: [IDS]}
    for _ in range(3):
        session, _ = go(session)
        assert nodes_of(session)[one.id]._replace(age=0, confidence=0) == one._replace(
            age=0, confidence=0
        )
    assert floor_of(session).id == floor.id
    session, _ = go(session, removed=IDS)
    assert {*nodes_of(session)} == {one.id, floor.id}


def test_a_floor_that_is_confirmed__takes_further_rooms(draws):
    session, _ = go(begin(PAPER_ONTOLOGY), **told(*IDS[:4]))
    session, _ = go(session, confirmed=(floor_of(session).id,))
    session, _ = go(session, **told(*IDS[4:]))
    session, _ = go(session)
    session, _ = go(session)
    assert floor_of(session).parts == (room(session, "a").id, room(session, "b").id)


def test_an_update_that_tells_of_nothing__changes_nothing(draws):
    session = whole_map(draws)
    after, done = go(session, removed=())
    assert not any(done)
    assert draws.regions == []
    assert_same(after.known, session.known)


def test_what_is_forbidden__goes_and_does_not_come_again(draws):
    session = whole_map(draws)
    one = room(session, "a").id
    session, done = go(session, forbidden=(one,))
    assert one in done.removed
    assert {*range(4)} <= {*draws.regions[0].rows.tolist()}
    for changes in ({}, {}, told("a0", planes=moved(PLANES, offset=(-1, 0, 0))), {}):
        session, _ = go(session, **changes)
        assert ids_over(session, ROOM, *IDS[:4]) == []
        assert ids_over(session, ROOM, *IDS[4:]) != []
    draws.wholes = {ROOM: [IDS[:3], IDS[4:]]}
    session, _ = go(session)
    assert ids_over(session, ROOM, *IDS[:3]) != []


def test_what_is_forbidden__does_not_come_again_over_what_is_left_of_its_planes(draws):
    session = whole_map(draws)
    session, _ = go(session, forbidden=(room(session, "a").id,))
    beside = told("a0", planes=moved(PLANES, offset=(0.1, 0, 0)))["observed"]
    draws.wholes = {ROOM: [("other", *IDS[1:4]), IDS[4:]]}
    session, _ = go(session, observed=beside, ids=("other",), merged=(("a0", "other"),))
    session, _ = go(session)
    assert "other" in session.ids
    assert {node.label for node in nodes_of(session).values()} == {WALL, ROOM, FLOOR}
    assert [node.observed for node in nodes_of(session).values() if node.label == ROOM] == [IDS[4:]]
    session, _ = go(session, removed=("a3",))
    session, _ = go(session)
    assert [node.observed for node in nodes_of(session).values() if node.label == ROOM] == [IDS[4:]]


def test_what_was_not_drawn_to_its_end__is_drawn_with_the_next_change(draws):
    draws.fails = True
    session, done = go(begin(PAPER_ONTOLOGY), **told(*IDS))
    assert done.remarks == ("update 1: what was drawn did not come to its end, and was left",)
    draws.fails = False
    session, done = go(session, **told("a0"))
    assert len(done.added) == 4


def test_what_is_too_large__is_left_with_a_remark(monkeypatch):
    monkeypatch.setattr(sessions, "LEAST", 10**4)
    session, done = go(begin(PAPER_ONTOLOGY), **told(*IDS))
    assert nodes_of(session) == {}
    assert done.remarks == ("update 1: what was drawn did not come to its end, and was left",)


def test_ids_of_numpy__leave_as_those_of_python():
    one = {"observed": subgraph(PLANES, [0]), "ids": np.arange(7, 8)}
    with unchecked():
        session, _ = update(MODEL, stop_at(13), begin(PAPER_ONTOLOGY), Changes(**one))
    assert json.dumps(ids_of(session)) == "[7]"
    session, _ = update(MODEL, stop_at(13), session, Changes(removed=(np.int64(7),)))
    assert ids_of(session) == []


def test_what_does_not_grow_and_what_are_no_changes__are_refused():
    session, halt = begin(PAPER_ONTOLOGY, np.int64(3)), MODEL.halt
    for call in (lambda: update(halt, NEVER, session, THINK), lambda: warm_up(halt, NEVER, 8)):
        with unchecked(), pytest.raises(ValueError, match=r"^the model is a Counting, expected"):
            call()
    with pytest.raises(ValueError, match=r"^the parameters halt are not all finite, expected"):
        warm_up(MODEL, stop_at(np.nan), 8)
    with unchecked(), pytest.raises(ValueError, match=r"^update 1: the changes are a dict, "):
        update(MODEL, stop_at(13), session, {"planes": []})


def test_few_planes_and_none__are_no_harm(draws):
    session, done = go(begin(PAPER_ONTOLOGY))
    assert not any(done)
    session, _ = go(session, **told("a0"))
    session, _ = go(session)
    assert draws.regions == []
    session, _ = go(session, **told("a1"))
    assert ids_over(session, ROOM, "a0", "a1") != []
    session, _ = go(session, removed=("a0", "a1"))
    assert len(graph_of(session).nodes.label) == 0


def test_planes_that_lean_and_repeats__stay_without_a_room(draws):
    position, normal = [[1, 1, 0], PLANES.nodes.position[0]], [[0, 0, 1], [1, 0, 0]]
    odd = make_graph([PLANE] * 2, position, normal, [3, 3])
    session, done = go(begin(PAPER_ONTOLOGY), **told(*IDS))
    session, done = go(session, observed=odd, ids=("ceiling", "again"))
    assert done.remarks == (
        "left out 1 plane (lean of more than 15 degrees)",
        "merged 1 plane (exactly repeated)",
    )
    assert ids_of(session)[8:10] == ["ceiling", "again"]
    assert not (parts_first(graph_of(session))[:, 0] // 2 == 4).any()
    assert room(session, "a").observed == IDS[:4]
    assert go(session)[1].remarks == ()


def test_a_plane_that_rooms_share__is_cut_and_is_part_of_both(draws):
    position, width = np.array(PLANES.nodes.position), np.array(PLANES.nodes.width)
    position[[4, 5], 1], position[2, 0], width[2] = 1.5, 4.5, 9.0  # the third reaches along both
    planes = PLANES._replace(nodes=PLANES.nodes._replace(position=position, width=width))
    rows = [0, 1, 2, 3, 4, 5, 7]
    session, _ = go(begin(PAPER_ONTOLOGY), **told(*(IDS[row] for row in rows), planes=planes))
    assert len(session.pieces.owner) == len(rows) + 1
    npt.assert_array_equal(graph_of(session).nodes.width[: len(rows)], width[rows])
    # What is forbidden is so over planes, whatever these are cut into.
    [one] = ids_over(session, ROOM, *IDS[:4])
    session, _ = go(go(session, forbidden=(one,))[0])
    assert ids_over(session, ROOM, *IDS[:4]) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (told("a0") | {"ids": ()}, "1 planes with 0 ids, expected as many"),
        (told("a0", "a0"), "'a0' is told twice, expected once"),
        ({"removed": ("c",)}, "'c' is gone, but was not there, expected a known id"),
        ({"removed": ("a1", "a1")}, "'a1' is gone twice, expected once"),
        ({"removed": ("a1",), "merged": (("a1", "a2"),)}, "'a1' is gone twice, expected once"),
        (told("a1") | {"removed": ("a1",)}, "'a1' is both told and gone, expected one of it"),
        ({"merged": (("a1", "c"),)}, "'a1' is merged into 'c', expected an id that stays"),
        ({"merged": (("a1", "a1"),)}, "'a1' is merged into 'a1', expected an id that stays"),
        ({"confirmed": (77,)}, "there is no grown node 77, expected one of the map"),
        ({"forbidden": (77,)}, "there is no grown node 77, expected one of the map"),
        (
            {"observed": two_rooms(), "ids": tuple(range(12))},
            "expected planes alone, of the concepts of the map",
        ),
        (
            told("a0", planes=moved(PLANES, offset=(np.nan, 0, 0))),
            r"nodes\[0\].position is \[nan, 1.5, 1.2\], expected finite numbers",
        ),
        (told("a0", planes=moved(PLANES, offset=(9e3, 0, 0))), "planes spans 8998 with .*"),
    ],
)
def test_changes_that_are_none__are_refused(draws, changes, message):
    session = whole_map(draws)
    before = copy.deepcopy(jax.tree.leaves(session))
    with pytest.raises(ValueError, match=f"^update 2: {message}"):
        go(session, **changes)
    assert_same(session, jax.tree.unflatten(jax.tree.structure(session), before))


def test_a_first_plane_that_is_none__is_refused():
    with pytest.raises(ValueError, match=r"^update 1: nodes\[0\].position is \[nan"):
        go(begin(PAPER_ONTOLOGY), **told("a0", planes=moved(PLANES, offset=(np.nan, 0, 0))))


def test_other_concepts__are_followed_too(draws):
    world = own_world.own_world()
    observed, ids = observed_of(world), tuple(range(own_world.NUM_OBSERVED))
    pillars = ids[own_world.NUM_PLANES :]
    rooms = [(*ids[4 * i : 4 * i + 4], *pillars[i : i + 1]) for i in range(3)]
    draws.wholes = {own_world.WALL: [(1, 4)], own_world.ROOM: rooms}
    draws.top = {own_world.ROOM: own_world.FLAT, own_world.FLAT: own_world.FLOOR}
    session, _ = go(begin(own_world.ONTOLOGY), observed=observed, ids=ids)
    assert ontology_of(graph_of(session)) == own_world.ONTOLOGY
    assert "pillar" not in " ".join(map(str, ids_of(session)))
    before = nodes_of(session)
    [one] = ids_over(session, own_world.ROOM, 0, 1, 2, 3, 12)
    bent = moved(observed, 0.0, (2.0, 1.0, 0.0))
    draws.regions.clear()
    session, _ = go(session, observed=bent, ids=ids)
    assert draws.regions == []
    for number, node in nodes_of(session).items():
        npt.assert_allclose(node.position, np.add(before[number].position, (2, 1, 0)), atol=1e-12)
    session, done = go(session, removed=pillars[:1])
    assert Event(SHRUNK, one, ()) in done.events
