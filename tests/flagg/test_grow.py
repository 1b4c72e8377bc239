import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.flagg.grow import (
    CAPACITY,
    HALTED,
    MAX_STEPS,
    REPEATED,
    TWINS,
    grow,
    grow_lanes,
    num_twins,
)
from sg3d_jax.flagg.step import Flagg, FlaggConfig
from sg3d_jax.scene.graph import SceneGraph, make_graph, observed_of, subgraph, undirected_edges
from sg3d_jax.scene.ontology import FLOOR, PART_OF, PROXIMITY, ROOM, WALL
from sg3d_jax.scene.padding import Block, Capacity, masked, stack, unpad
from sg3d_jax.scene.proximity import connect_observed
from sg3d_jax.scene.validate import validate_graph
from tests.growing_rooms import (
    MODEL,
    NEVER,
    ONE_BY_ONE,
    AddRooms,
    AddWalls,
    Counting,
    Even,
    grows_rooms,
    stop_at,
)
from tests.two_rooms import NUM_PLANES, on_device, two_rooms
from tests.unchecked import unchecked

SCENE = two_rooms()
ROOM_FOR = Capacity(24, 288)
KNOWN = subgraph(SCENE, np.arange(11))  # both rooms and the wall between them, but no floor
WALLS = grows_rooms(1, 2, fill=AddWalls())
LARGER, LARGE = Capacity(32, 384), Capacity(48, 576)
LIMIT = 50  # steps
compiled = jax.jit(grow, static_argnames=("model", "max_steps", "ask_first"))
twins = jax.jit(num_twins)


def growing(model, params, key, scene, ask_first=False, steps=0):
    return compiled(model, params, key, scene, LIMIT, ask_first, np.int32(steps))


def first_planes(count: int) -> SceneGraph:
    return subgraph(observed_of(SCENE), np.arange(count))


def given(scene: SceneGraph, capacity: Capacity = ROOM_FOR):
    return on_device(scene, capacity)


def assert_begins_with(graph, start):
    """Asserts that a graph begins with another one, bit for bit."""
    count = int(start.n_node[0])
    for found, expected in zip(graph.nodes, start.nodes, strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found[:count], expected[:count])
    pairs = undirected_edges(graph, PART_OF)
    inside = pairs[(pairs < count).all(axis=1)]
    np.testing.assert_array_equal(inside, undirected_edges(start, PART_OF))


@pytest.mark.parametrize(
    ("model", "params", "before", "reason"),
    [
        (MODEL, stop_at(13), 0, HALTED),
        (MODEL, NEVER, 0, CAPACITY),
        (WALLS, NEVER, 0, CAPACITY),
        (MODEL, NEVER, LIMIT - 3, MAX_STEPS),
    ],
    ids=["halted", "full of kin", "full", "stopped"],
)
def test_growing__ends_for_each_of_its_reasons(model, params, before, reason):
    planes = given(observed_of(SCENE))
    for seed in range(3):
        grown = growing(model, params, jax.random.key(seed), planes, steps=before)
        num_new, num_blocks = int(grown.graph.n_node[0]) - NUM_PLANES, int(grown.steps) - before
        assert grown.halt_reason == reason
        assert num_blocks <= num_new <= 2 * num_blocks
        if reason == HALTED:
            assert num_new in (5, 6)
        elif reason == MAX_STEPS:
            assert grown.steps == LIMIT
        elif model == WALLS:
            assert num_new + NUM_PLANES in (ROOM_FOR.nodes - 1, ROOM_FOR.nodes)
        else:  # a third of the slots is for nodes that hear of their kin
            assert num_new in (ROOM_FOR.nodes // 3 - 1, ROOM_FOR.nodes // 3)


def test_growing__ends_where_one_thing_is_drawn_again_and_again():
    scene = given(observed_of(SCENE), LARGE)
    for stop, reason in ((NEVER, REPEATED), (stop_at(NUM_PLANES + TWINS + 2), HALTED)):
        grown = growing(ONE_BY_ONE, stop, jax.random.key(0), scene)
        assert grown.halt_reason == reason
        assert grown.steps == TWINS + 2


def test_twins__have_the_concept_and_the_parts_of_the_last_node():
    rng, labels = np.random.default_rng(0), [0] * 5 + [1, 2, 1, 1, 2, 1, 3, 1]
    counts = []
    for _ in range(40):
        parts = rng.random((len(labels), 5)) < 0.5
        parts[rng.integers(5, len(labels), 4)] = parts[-1]
        sets = [(label, set(np.flatnonzero(row))) for label, row in zip(labels, parts, strict=True)]
        edges = [(p, whole) for whole in range(5, 13) if labels[whole] < 3 for p in sets[whole][1]]
        graph = make_graph(labels, rng.normal(size=(13, 3)), part_of=edges)
        expected = sets[5:-1].count(sets[-1]) if sets[-1][1] else 0
        assert twins(given(graph)) == expected
        counts.append(expected)
    assert min(counts) == 0
    assert max(counts) >= 3


SCENES = [observed_of(SCENE), first_planes(5), KNOWN, first_planes(5)]
BEFORE = np.asarray([0, 1, 0, LIMIT], np.int32)  # steps


def grow_batch(model, keys, lanes):
    return grow_lanes(model, stop_at(12), keys, stack(SCENES, ROOM_FOR), BEFORE, LIMIT, True, lanes)


@pytest.mark.parametrize("lanes", [None, 2])
def test_a_batch__is_a_loop_over_its_scenes(lanes):
    """However many there are side by side; what has had all its steps only fills the batch."""
    keys = jax.random.split(jax.random.key(3), 4)
    batch = jax.tree.map(np.asarray, grow_batch(MODEL, keys, lanes))
    for index, (scene, before) in enumerate(zip(SCENES, BEFORE.tolist(), strict=True)):
        found = jax.tree.map(lambda leaf, i=index: leaf[i], batch)
        if before == LIMIT:
            assert (found.halt_reason, found.steps) == (MAX_STEPS, LIMIT)
            assert_begins_with(found.graph, given(scene))
            assert int(found.graph.n_node[0]) == 5
        else:
            one = growing(MODEL, stop_at(12), keys[index], given(scene), True, before)
            chex.assert_trees_all_equal(found, jax.tree.map(np.asarray, one))


def test_every_step__has_randomness_of_its_own():
    scene = given(observed_of(SCENE), LARGE)
    grown = growing(ONE_BY_ONE, stop_at(NUM_PLANES + 6), jax.random.key(0), scene)
    places = np.asarray(grown.graph.nodes.position)[NUM_PLANES : NUM_PLANES + 6]
    assert len(np.unique(places, axis=0)) == 6


def test_a_partial_graph__is_kept_bit_for_bit_and_comes_first():
    scene = given(KNOWN)
    grown = growing(MODEL, stop_at(14), jax.random.key(1), scene)
    assert_begins_with(grown.graph, scene)
    graph = unpad(grown.graph)
    validate_graph(graph, "grown")
    assert (graph.nodes.label[11:] == ROOM).all()
    assert len(graph.nodes.label) in (14, 15)
    assert len(undirected_edges(graph, PROXIMITY)) == 0


@dataclasses.dataclass(frozen=True)
class Telling(AddRooms):
    """A Fill that puts what it was shown where its nodes stand."""

    def sample(self, params, key, graph, mask, rules=None):
        block: Block = super().sample(params, key, graph, mask, rules)
        is_near = graph.edges.mask & (graph.edges.relation == PROXIMITY)
        is_part = graph.edges.mask & (graph.edges.relation == PART_OF)
        counts = jnp.stack([jnp.sum(is_near), jnp.sum(is_part), graph.n_node[0]])
        return block._replace(position=mask[:, None] * counts[None].astype(jnp.float32))


def test_a_model__is_shown_new_proximity_edges_and_the_part_of_edges_that_are_known():
    bare = subgraph(KNOWN, np.arange(11))
    one = grows_rooms(1, fill=Telling())
    near = 8 * 7  # eight planes are all near each other, in both directions
    for scene, known in ((bare, 2 * len(undirected_edges(KNOWN, PART_OF))), (first_planes(8), 0)):
        count = len(scene.nodes.label)
        grown = growing(one, stop_at(count + 2), jax.random.key(2), given(scene))
        told = np.asarray(grown.graph.nodes.position)[count : count + 2]
        np.testing.assert_array_equal(told, [[near, known, count], [near, known + 4, count + 1]])


@dataclasses.dataclass(frozen=True)
class InLayers(AddRooms):
    """A Fill that draws two rooms and then floors, where its parameter says."""

    kin: int = 0

    def sample(self, params, key, graph, mask, rules=None):
        block: Block = super().sample(params, key, graph, mask, rules)
        rooms = jnp.sum(graph.nodes.mask & (graph.nodes.label == ROOM))
        label = jnp.where(mask & (rooms < 2), ROOM, jnp.where(mask, FLOOR, 0))
        edges = jnp.zeros_like(block.edges)  # so that none repeats another
        return block._replace(label=label, edges=edges, position=jnp.full((len(mask), 3), params))


def in_layers(upper):
    config = FlaggConfig(coins=(1,), constrained=False, upper=upper)
    return Flagg(config, Even(1, 1, 1), InLayers(), Counting(1, 1))


def drawn_by(graph, before):
    """Returns which parameters drew the new nodes of a graph."""
    return np.asarray(unpad(graph).nodes.position)[before:, 0].tolist()


OF_BOTH = {"fill": np.float32(1), "upper": np.float32(2)}


@pytest.mark.parametrize(
    ("upper", "expected"), [("", [1, 1, 1, 1]), ("floor", [1, 1, 2, 2]), ("room", [2, 2, 2, 2])]
)
def test_upper_layers__are_drawn_by_parameters_of_their_own(upper, expected):
    planes, key = given(observed_of(SCENE)), jax.random.key(0)
    params = stop_at(NUM_PLANES + 4)._replace(**OF_BOTH)
    model = in_layers(upper)
    grown = growing(model, params, key, planes)
    assert (grown.halt_reason, grown.steps) == (HALTED, 4)
    assert unpad(grown.graph).nodes.label[NUM_PLANES:].tolist() == [ROOM, ROOM, FLOOR, FLOOR]
    assert drawn_by(grown.graph, NUM_PLANES) == expected
    stopped = growing(model, NEVER._replace(**OF_BOTH), key, planes, steps=LIMIT - 3)
    assert (stopped.halt_reason, stopped.steps) == (MAX_STEPS, LIMIT)
    assert drawn_by(stopped.graph, NUM_PLANES) == expected[:3]
    side_by_side = grow_lanes(
        model,
        params,
        jax.random.split(key, 3),
        stack([observed_of(SCENE), first_planes(5), observed_of(SCENE)], ROOM_FOR),
        np.zeros(3, np.int32),
        LIMIT,
        False,
        2,
    )
    for index, count in ((0, 4), (1, NUM_PLANES - 1), (2, 4)):
        one = jax.tree.map(lambda leaf, i=index: np.asarray(leaf)[i], side_by_side)
        assert one.steps == count
        more = expected[-1:] * (count - 4)
        assert drawn_by(one.graph, NUM_PLANES + 4 - count) == expected + more


def arrays_in(jaxpr):
    """Yields the shape and type of every array in a traced program, and in what it consists of."""
    for equation in jaxpr.eqns:
        for one in (*equation.invars, *equation.outvars):
            yield one.aval.shape, one.aval.dtype
        for inner in jax.tree.leaves(equation.params, is_leaf=lambda one: hasattr(one, "eqns")):
            if hasattr(inner, "eqns"):
                yield from arrays_in(inner)


def test_graphs_side_by_side__share_the_parameters_of_all_layers():
    """Which `vmap` would make a batch of, to be read by every product, if they chose for each."""
    params = stop_at(NUM_PLANES + 4)
    params = params._replace(fill=np.ones(3, np.float16), upper=np.full(3, 2, np.float16))
    model, scenes = in_layers("floor"), stack([observed_of(SCENE)] * 5, ROOM_FOR)
    keys = jax.random.split(jax.random.key(0), 5)

    def all_of(keys, scenes):
        return jax.vmap(lambda key, scene: grow(model, params, key, scene, LIMIT))(keys, scenes)

    batch = model, params, keys, scenes, np.zeros(5, np.int32), LIMIT, False, 2
    for traced in (jax.make_jaxpr(all_of)(keys, scenes), grow_lanes.trace(*batch).jaxpr):
        found = {shape for shape, dtype in arrays_in(traced) if dtype == np.float16}
        assert (3,) in found  # the parameters; what a block has of them is
        assert found <= {(), (3,), (1, 3)}


def test_a_graph_does_not_end__where_the_upper_layers_begin():
    """Which is no step: Halt, which would end at once, is asked after the first floor."""
    rooms = subgraph(SCENE, np.arange(NUM_PLANES + 3))
    num_rooms = int((rooms.nodes.label == ROOM).sum())
    assert num_rooms == 2
    params = stop_at(1)._replace(**OF_BOTH)
    grown = growing(in_layers("floor"), params, jax.random.key(0), given(rooms))
    assert (grown.halt_reason, grown.steps) == (HALTED, 1)
    assert drawn_by(grown.graph, NUM_PLANES + 3) == [2]


@pytest.mark.parametrize(
    ("scene", "fill", "rules", "expected"),
    [
        (observed_of(SCENE), AddRooms(planes=NUM_PLANES), {}, True),
        (observed_of(SCENE), AddRooms(planes=NUM_PLANES - 1), {}, False),
        (KNOWN, AddRooms(WALL), {}, False),
        (observed_of(SCENE), AddRooms(planes=NUM_PLANES), {"constrained": False}, False),
        (observed_of(SCENE), AddRooms(planes=NUM_PLANES), {"upper": ""}, False),
    ],
    ids=["room", "another room", "wall", "any rooms", "no upper layers"],
)
def test_upper_layers__begin_where_no_room_can_follow_the_last(scene, fill, rules, expected):
    """So that no block is drawn only to find that out."""
    config = FlaggConfig(coins=(1,), **({"upper": "floor"} | rules))
    model, key = Flagg(config, Even(1, 1, 1), fill, Counting(1, 1)), jax.random.key(0)
    grown = jax.jit(model.step)(NEVER, key, connect_observed(given(scene)))
    assert (bool(grown.inserted), bool(grown.fits), bool(grown.upper)) == (True, True, expected)


def test_upper_layers__go_on_in_a_larger_graph():
    planes, key, model = observed_of(SCENE), jax.random.key(0), in_layers("floor")
    params = stop_at(30)._replace(**OF_BOTH)
    whole = growing(model, params, key, given(planes, LARGER))
    part = growing(model, params, key, given(planes))
    rest = growing(model, params, key, given(unpad(part.graph), LARGER), steps=part.steps)
    assert (part.halt_reason, rest.halt_reason, rest.steps) == (CAPACITY, HALTED, whole.steps)
    chex.assert_trees_all_equal(rest.graph.nodes, whole.graph.nodes)


def test_a_graph_that_is_found_complete__is_returned_as_it_came_if_that_is_asked():
    scene, key = given(KNOWN), jax.random.key(3)
    asked, unasked = (growing(MODEL, stop_at(11), key, scene, ask) for ask in (True, False))
    assert (asked.halt_reason, asked.steps) == (HALTED, 0)
    assert asked.graph.n_node[0] == 11
    assert_begins_with(asked.graph, scene)
    assert (unasked.halt_reason, unasked.steps) == (HALTED, 1)
    incomplete = growing(MODEL, stop_at(13), key, scene, True)
    assert incomplete.steps > 0
    assert incomplete.graph.n_node[0] >= 13


def test_halt__is_never_asked_about_planes_alone_nor_where_growing_goes_on():
    for scene, before in ((observed_of(SCENE), 0), (KNOWN, 2)):
        grown = growing(MODEL, stop_at(1), jax.random.key(4), given(scene), True, before)
        assert (grown.halt_reason, grown.steps) == (HALTED, before + 1)


def test_growing_that_goes_on_in_a_larger_graph__is_growing_at_once():
    model, stop, key, planes = WALLS, stop_at(28), jax.random.key(5), observed_of(SCENE)
    whole = growing(model, stop, key, given(planes, LARGER))
    part = growing(model, stop, key, given(planes))
    assert 3 < part.steps < whole.steps
    rest = growing(model, stop, key, given(unpad(part.graph), LARGER), steps=part.steps)
    assert (part.halt_reason, rest.halt_reason, rest.steps) == (CAPACITY, HALTED, whole.steps)
    for one, other in zip(unpad(rest.graph).nodes, unpad(whole.graph).nodes, strict=True):
        np.testing.assert_array_equal(one, other)
    pairs = (undirected_edges(grown.graph, PART_OF) for grown in (rest, whole))
    np.testing.assert_array_equal(*pairs)


def test_what_grows__is_the_same_whatever_jax_is_told_of_types():
    planes, key = given(observed_of(SCENE)), jax.random.key(0)
    expected = growing(MODEL, stop_at(13), key, planes)
    assert expected.halt_reason.dtype == np.int32
    assert not expected.halt_reason.weak_type
    with jax.enable_x64(True), jax.numpy_dtype_promotion("strict"):
        chex.assert_trees_all_equal(growing(MODEL, stop_at(13), key, planes), expected)
        wide = jax.tree.map(lambda leaf: np.asarray(leaf, leaf.dtype.str.replace("4", "8")), planes)
        assert (wide.nodes.position.dtype, wide.senders.dtype) == (np.float64, np.int64)
        traced = jax.eval_shape(lambda graph: grow(MODEL, NEVER, key, graph, LIMIT), wide)
    chex.assert_trees_all_equal_dtypes(traced, expected)


def test_what_does_not_grow_and_what_are_no_parameters__are_refused():
    planes, key = given(observed_of(SCENE)), jax.random.key(0)
    with unchecked(), pytest.raises(ValueError, match=r"^the model is a Counting, expected"):
        grow(MODEL.halt, NEVER, key, planes)
    with unchecked(), pytest.raises(ValueError, match=r"^the parameters are a dict, "):
        grow(MODEL, {"halt": 1.0}, key, planes)


def test_a_graph_with_holes__cannot_grow():
    scene = given(KNOWN)
    holes = jax.jit(masked)(scene, scene.nodes.mask & (np.arange(24) != 9), scene.edges.mask)
    with pytest.raises(TypeError):
        grow(MODEL, NEVER, jax.random.key(6), holes, 3)


def test_models_that_are_built_alike__are_compiled_once():
    @jax.jit
    def start(keys):
        return keys

    sizes = set()
    for seed in range(2):
        keys = start(jax.random.split(jax.random.key(seed), 4))
        grow_batch(grows_rooms(1, 2), keys, 2)
        sizes.add(grow_lanes._cache_size())
    assert len(sizes) == 1
