import functools
import itertools
import operator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.fill.constraints import (
    NEVER,
    Rules,
    constrained,
    draw_valid,
    is_whole,
    order_of,
    rules_of,
)
from sg3d_jax.scene.graph import SceneGraph, make_graph, parts_first, subgraph
from sg3d_jax.scene.ontology import (
    BUILDING,
    CITY,
    FLOOR,
    PAPER_ONTOLOGY,
    PLANE,
    ROOM,
    WALL,
    Concept,
    Ontology,
    Rule,
)
from sg3d_jax.scene.padding import Block, append_block, unpad
from tests.two_rooms import NUM_PLANES, on_device, two_rooms

pytestmark = pytest.mark.slow

SCENE = two_rooms()
NODES = {"planes": NUM_PLANES, "wall": 9, "one room": 10, "two rooms": 11, "all": 12}
CONCEPTS = range(PAPER_ONTOLOGY.num_concepts)
NUM_DRAWS = 20_000  # of one node
TOP_DOWN = ("city", "building", "floor", "room", "wall")
# Two kinds are observed, and a club holds any number of parts, at least two.
TOWN = Ontology(
    (
        Concept("door", "#112233", "d", "DOORS", observed=True),
        Concept("wall", "#112233", "w", "WALLS", observed=True),
        Concept("club", "#112233", "c", "CLUBS", least_parts=2),
        Concept("house", "#112233", "h", "HOUSES"),
        Concept("town", "#112233", "t", "TOWNS"),
    ),
    (
        Rule("door", "club", single=False),
        Rule("wall", "club", single=False),
        Rule("door", "house"),
        Rule("wall", "house"),
        Rule("house", "town"),
    ),
)


compiled_rules = jax.jit(rules_of, static_argnames=("num_block", "layers"))


whole_in = jax.jit(is_whole, static_argnames="layers")


def rules_for(graph, num_block=1, layers=(), closing=False):
    return jax.tree.map(np.asarray, compiled_rules(graph, num_block, layers, closing))


def made(labels, pairs, ontology=PAPER_ONTOLOGY):
    return make_graph(labels, np.zeros((len(labels), 3)), part_of=pairs, ontology=ontology)


def first(count: int) -> SceneGraph:
    return subgraph(SCENE, np.arange(count))


def said(rules: Rules) -> set[str]:
    return {rules.ontology.names[label] for label in np.flatnonzero(rules.label)}


@pytest.mark.parametrize(
    ("nodes", "closing", "expected"),
    [
        ("planes", False, {"wall", "room"}),
        ("planes", True, set()),
        ("wall", False, {"wall", "room"}),
        ("one room", False, {"wall", "room", "floor"}),
        ("two rooms", False, {"wall", "floor"}),  # every plane has its room
        ("two rooms", True, {"floor"}),
        ("all", False, {"wall", "building"}),
        ("all", True, {"building"}),
    ],
)
def test_a_concept__can_come_while_there_are_parts_for_it(nodes, closing, expected):
    graph = on_device(first(NODES[nodes]))
    assert said(rules_for(graph, closing=closing)) == expected


def test_old_nodes__are_open_to_what_the_ontology_allows_and_no_one_has_taken():
    graph = on_device(first(NODES["one room"]))  # of the first four planes
    rules, kinds = rules_for(graph), graph.nodes.label.tolist()
    for label, node in itertools.product(CONCEPTS, range(16)):
        kind = kinds[node]
        real = node < 10
        part = real and PAPER_ONTOLOGY.may_be_part[kind, label]
        part = part and not (label == ROOM and node < 4)
        assert rules.part[label, node] == part
        assert rules.whole[label, node] == (real and PAPER_ONTOLOGY.may_be_part[label, kind])


def test_of_what_holds_everything_there_is_one():
    labels = [PLANE, PLANE, ROOM, ROOM, FLOOR, FLOOR, BUILDING, BUILDING, CITY]
    pairs = [(0, 2), (1, 3), (2, 4), (3, 5), (4, 6), (5, 7)]
    without = on_device(made(labels[:8], pairs))
    rules = rules_for(without)
    assert said(rules) == {"wall", "city"}
    assert rules.must[BUILDING, CITY]  # it takes both
    assert not rules.must[ROOM, FLOOR]
    city = on_device(made(labels, [*pairs, (6, 8)]))
    assert "city" not in said(rules_for(city))


def test_in_the_order_of_another_graph__parts_find_their_wholes_and_wholes_wait():
    order = order_of(PAPER_ONTOLOGY, TOP_DOWN)
    assert order.least[FLOOR] == order.least[CITY] == 0
    assert order.least[ROOM] == 1  # planes are there before everything
    graph = on_device(made([PLANE, PLANE, CITY], []))
    rules = rules_for(graph, layers=TOP_DOWN)
    assert rules.must[BUILDING, CITY]
    assert rules.must[ROOM, FLOOR]
    assert said(rules_for(graph, layers=TOP_DOWN, closing=True)) == {"building"}
    assert not whole_in(graph, TOP_DOWN)


@pytest.mark.parametrize(
    ("nodes", "whole"),
    [("planes", True), ("wall", True), ("one room", True), ("two rooms", False), ("all", True)],
)
def test_a_graph__may_end_where_all_hangs_below_one_node(nodes, whole):
    assert bool(whole_in(on_device(first(NODES[nodes])))) == whole


def test_what_is_forbidden__has_probability_zero_and_all_else_that_of_its_labels():
    graph = on_device(first(NODES["one room"]))
    rules = rules_for(graph)
    rng = np.random.default_rng(0)
    logits = rng.normal(size=(2, 6)), rng.normal(size=(2, 18, 2))
    predicted = jax.jit(constrained)
    label, edge = map(np.asarray, predicted(rules, *logits))
    assert (label[:, [PLANE, BUILDING, CITY]] == 0).all()
    np.testing.assert_allclose(label.sum(axis=-1), 1, rtol=1e-6)
    free = np.exp(logits[1])[..., 1] / np.exp(logits[1]).sum(axis=-1)
    may = PAPER_ONTOLOGY.may_be_part | PAPER_ONTOLOGY.may_be_part.T
    for row, token in itertools.product(range(2), range(18)):
        if token < 2:
            both = np.outer(label[row], label[token])
            chance = (both * may).sum()
        else:
            open_to = rules.part[:, token - 2] | rules.whole[:, token - 2]
            chance = (label[row] * open_to).sum()
        np.testing.assert_allclose(edge[row, token, 1], free[row, token] * chance, rtol=1e-5)
    _, same = map(np.asarray, predicted(None, *logits))
    np.testing.assert_allclose(same[..., 1], free, rtol=1e-5)


@jax.jit
def draw_often(rules, logits_label, log_odds):
    """Draws a block of one node, often."""
    edge = jnp.stack([jnp.zeros_like(log_odds), log_odds], axis=-1)[None]
    edge = jnp.concatenate([jnp.zeros((1, 1, 2)), edge], axis=1)
    keys, one = jax.random.split(jax.random.key(0), NUM_DRAWS), jnp.ones(1, bool)
    return jax.vmap(lambda key: draw_valid(key, rules, logits_label[None], edge, one))(keys)


def drawn_often(rules, logits_label, log_odds):
    """Counts (label, old nodes that are joined) of a block of one node."""
    drawn = draw_often(rules, *(np.asarray(each, np.float32) for each in (logits_label, log_odds)))
    label, edges, mask = jax.tree.map(np.asarray, drawn)
    assert mask.all()
    assert not edges[:, 0, 0].any()
    found: dict = {}
    for kind, row in zip(label[:, 0].tolist(), edges[:, 0, 1:], strict=True):
        name = kind, *np.flatnonzero(row).tolist()
        found[name] = found.get(name, 0) + 1 / NUM_DRAWS
    return found


def only(label):
    """Returns logits of which one label alone is possible."""
    return [0.0 if other == label else NEVER for other in CONCEPTS]


def test_a_draw__is_one_of_the_prediction_given_the_rules():
    """Against all sets of edges, one by one: those that a label forbids have no chance."""
    graph = on_device(first(NODES["one room"]))
    rules = rules_for(graph)
    logits = [5.0, NEVER, 0.3, 0.0, 1.0, 1.0]  # of walls the least is two: not here
    log_odds = np.full(16, -30.0)
    log_odds[[3, 4, 5, 9]] = 1.0, 0.5, -0.4, 0.8
    found = drawn_often(rules, logits, log_odds)
    chance, expected = 1 / (1 + np.exp(-log_odds)), {}
    for label, open_to, closed in ((ROOM, (4, 5), (3, 9)), (FLOOR, (9,), (3, 4, 5))):
        absent = np.prod([1 - chance[node] for node in open_to])
        weight = np.exp(logits[label]) * (1 - absent) * np.prod(1 - chance[list(closed)])
        for joined in itertools.product([False, True], repeat=len(open_to)):
            nodes = [node for node, yes in zip(open_to, joined, strict=True) if yes]
            share = np.prod(
                [chance[node] if node in nodes else 1 - chance[node] for node in open_to]
            )
            best = nodes or [open_to[0]]  # in place of none
            expected[label, *best] = expected.get((label, *best), 0) + weight * share
    total = sum(expected.values())
    assert set(found) == set(expected)
    for name, share in expected.items():
        assert found[name] == pytest.approx(share / total, abs=0.012)


def test_a_part__takes_one_whole_at_most_by_odds():
    labels = [PLANE, PLANE, FLOOR, FLOOR, FLOOR]
    rules = rules_for(on_device(made(labels, [])))
    log_odds = np.r_[30.0, np.log([0.5, 2.0, 1.0, 0.25]), [-30.0] * 11]
    found = drawn_often(rules, only(ROOM), log_odds)
    for plane, share in (((), 2 / 3), ((1,), 1 / 3)):
        for floor, weight in (((), 1.0), ((2,), 2.0), ((3,), 1.0), ((4,), 0.25)):
            expected = share * weight / 4.25
            assert found.pop((ROOM, 0, *plane, *floor)) == pytest.approx(expected, abs=0.012)
    assert not found


def test_what_has_too_few_parts__takes_those_of_the_best_odds():
    graph = on_device(made([PLANE] * 5, []))
    log_odds = [-60.0, -20.0, -60.0, -25.0, -60.0, *[NEVER] * 11]
    found = drawn_often(rules_for(graph), only(WALL), log_odds)
    assert found == {(WALL, 1, 3): pytest.approx(1.0)}


def random_draw(key, rules, num_block):
    keys = jax.random.split(key, 2)
    num_tokens = num_block + rules.old_label.shape[0]
    label = 2 * jax.random.normal(keys[0], (num_block, rules.ontology.num_concepts))
    edge = 2 * jax.random.normal(keys[1], (num_block, num_tokens, 2))
    return draw_valid(jax.random.fold_in(key, 2), rules, label, edge, jnp.ones(num_block, bool))


STARTS = {
    **{name: first(count) for name, count in NODES.items()},
    "town": made([0, 0, 0, 1, 1, 1, 3], [(0, 6), (3, 6)], TOWN),
}


@functools.partial(jax.jit, static_argnames="num_block")
@functools.partial(jax.vmap, in_axes=(0, None, None))
def grow(key, graph, num_block):
    label, edges, mask = random_draw(key, rules_of(graph, num_block), num_block)
    return append_block(graph, Block(label, jnp.zeros((num_block, 3)), edges, mask))


@pytest.mark.parametrize("num_block", [1, 4])
@pytest.mark.parametrize("start", STARTS)
def test_whatever_is_predicted__a_block_obeys_the_rules(start, num_block):
    """By loops over its edges: allowed pairs, one whole a part, enough parts, one that is top."""
    graph = on_device(STARTS[start])
    ontology = graph.globals
    wholes = dict(ontology.single_wholes)

    grown, fits = grow(jax.random.split(jax.random.key(1), 40), graph, num_block)
    before, counts = int(graph.n_node[0]), set()
    grown = jax.tree.map(np.asarray, grown)
    for number in range(40):
        after = unpad(jax.tree.map(operator.itemgetter(number), grown))
        label = np.asarray(after.nodes.label)
        counts.add(len(label) - before)
        assert fits[number]
        parts: dict = {}
        taken: dict = {}
        for part, whole in parts_first(after).tolist():
            assert ontology.may_be_part[label[part], label[whole]]
            parts.setdefault(whole, []).append(part)
            taken.setdefault((part, label[whole]), []).append(whole)
        for (part, kind), of_kind in taken.items():
            if wholes.get(label[part]) == kind:
                assert len(of_kind) == 1
        for node in range(before, len(label)):
            assert not ontology.is_observed[label[node]]
            assert len(parts.get(node, [])) >= ontology.concepts[label[node]].least_parts
        assert (label == ontology.num_concepts - 1).sum() <= 1
    assert max(counts) >= 1
    if num_block == 1:
        assert counts == {1}
