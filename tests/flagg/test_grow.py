from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.fill.protocol import Fill
from sg3d_jax.flagg import sample
from sg3d_jax.flagg.halt import Halt
from sg3d_jax.flagg.insert import Insert
from sg3d_jax.flagg.grow import complete, grow_batch, grow_from_planes, growth_capacity
from sg3d_jax.flagg.step import Flagg, FlaggConfig, Params
from sg3d_jax.scene.ontology import PART_OF, PLANE, PROXIMITY, ROOM
from sg3d_jax.scene.graph import SceneGraph, observed_of, undirected_edges
from sg3d_jax.scene.padding import Block, stack
from sg3d_jax.scene.validate import validate_graph
from tests.two_rooms import NUM_PLANES, moved, two_rooms

SCENE = two_rooms()
ROOM_FOR = growth_capacity(NUM_PLANES)


def add_rooms(params: Any, key: jax.Array, graph: SceneGraph, mask: jax.Array) -> Block:
    """Fills a block with rooms of the first two planes, anywhere within a metre of the origin."""
    num_block, num_old = mask.shape[0], graph.nodes.mask.shape[0]
    edges = jnp.zeros((num_block, num_block + num_old), bool)
    edges = edges.at[:, num_block : num_block + 2].set(mask[:, None])
    position = jax.random.uniform(key, (num_block, 3), minval=-1.0) * mask[:, None]
    return Block(jnp.where(mask, ROOM, 0), position, edges, mask)


# The parameter of Halt is the number of nodes at which a graph is complete.
MODEL = Flagg(
    insert=Insert(init=lambda key, graph: None, logits=lambda params, graph: jnp.zeros(2)),
    fill=Fill(init=lambda *_: None, loss=lambda *_: (jnp.float32(0), {}), sample=add_rooms),
    halt=Halt(
        init=lambda key, graph: None,
        logit=lambda params, graph: (graph.n_node[0] - params + 0.5).astype(jnp.float32),
    ),
    config=FlaggConfig(coins=(1, 2)),
)


def stop_at(num_nodes: int) -> Params:
    return Params(None, None, jnp.float32(num_nodes))


NEVER = stop_at(10**6)


def first_planes(count: int) -> SceneGraph:
    planes = observed_of(SCENE)
    nodes = jax.tree.map(lambda field: field[:count], planes.nodes)
    return planes._replace(nodes=nodes, n_node=np.array([count], np.int32))


def same(one: sample.Completion, other: sample.Completion) -> bool:
    equal = jax.tree.map(np.array_equal, one, other)
    return all(jax.tree.leaves(equal))


@pytest.mark.parametrize(
    ("params", "max_steps", "reason"),
    [(stop_at(13), 50, "HALTED"), (NEVER, 50, "CAPACITY"), (NEVER, 3, "MAX_STEPS")],
)
def test_growing__ends_for_each_of_its_reasons(params, max_steps, reason):
    [[grown]] = complete(MODEL, params, [SCENE], max_steps=max_steps)
    num_new = len(grown.graph.nodes.label) - NUM_PLANES
    assert grown.halt_reason == reason
    assert grown.steps <= num_new <= 2 * grown.steps
    if reason == "HALTED":
        assert num_new in (5, 6)
    elif reason == "CAPACITY":
        assert num_new + NUM_PLANES in (ROOM_FOR.nodes - 1, ROOM_FOR.nodes)
    else:
        assert grown.steps == max_steps


def test_halting__goes_before_the_limit_on_steps():
    [[grown]] = complete(MODEL, stop_at(9), [SCENE], max_steps=1)
    assert grown.halt_reason == "HALTED"


def test_grown_graphs__have_their_planes_and_part_of_edges_and_nothing_else():
    [[grown]] = complete(MODEL, stop_at(13), [SCENE], max_steps=50)
    graph, num_nodes = grown.graph, len(grown.graph.nodes.label)
    validate_graph(graph, "grown")
    assert (graph.nodes.label[NUM_PLANES:] == ROOM).all()
    assert len(undirected_edges(graph, PROXIMITY)) == 0
    expected = [(plane, room) for plane in (0, 1) for room in range(NUM_PLANES, num_nodes)]
    np.testing.assert_array_equal(undirected_edges(graph, PART_OF), expected)


@pytest.mark.parametrize("offset", [(0, 0, 0), (5e6 + 0.123456789, -5e6, 100.0)])
def test_planes__come_back_bit_for_bit_wherever_the_building_stands(offset):
    scene = moved(SCENE, 0.3, offset)
    [[grown]] = complete(MODEL, stop_at(11), [scene], max_steps=50)
    observed = observed_of(scene).nodes
    for found, given in zip(grown.graph.nodes, observed, strict=True):
        assert found.dtype == given.dtype
        np.testing.assert_array_equal(found[:NUM_PLANES], given)
    away = grown.graph.nodes.position[NUM_PLANES:] - observed.position.mean(axis=0)
    assert 1e-3 < np.abs(away).max() <= 1


def test_only_the_planes_of_a_scene__are_looked_at():
    [[whole]] = complete(MODEL, stop_at(13), [SCENE], max_steps=50)
    [[planes]] = complete(MODEL, stop_at(13), [observed_of(SCENE)], max_steps=50)
    assert same(whole, planes)


def test_results__come_in_the_order_of_the_scenes_with_as_many_samples_as_asked():
    counts = [8, 3, 6, 2, 8]
    scenes = [first_planes(count) for count in counts]
    grown = complete(MODEL, stop_at(10), scenes, samples=3, max_steps=50)
    assert [len(samples) for samples in grown] == [3] * 5
    for count, samples in zip(counts, grown, strict=True):
        for one in samples:
            assert (one.graph.nodes.label == PLANE).sum() == count
        places = [one.graph.nodes.position[count] for one in samples]
        assert len(np.unique(places, axis=0)) == 3


def test_a_sample__does_not_depend_on_the_batch_it_is_grown_in(monkeypatch):
    scenes = [first_planes(count) for count in (8, 3, 6, 2, 7)]
    expected = complete(MODEL, stop_at(12), scenes, seed=7, max_steps=50)
    alone = complete(MODEL, stop_at(12), scenes[:1], seed=7, max_steps=50)
    assert same(alone[0][0], expected[0][0])
    monkeypatch.setattr(sample, "BATCH", 2)
    for one, other in zip(
        complete(MODEL, stop_at(12), scenes, seed=7, max_steps=50), expected, strict=True
    ):
        assert same(one[0], other[0])


def test_seeds__give_other_graphs():
    one, other = (complete(MODEL, stop_at(12), [SCENE], seed, max_steps=50) for seed in (0, 1))
    assert not same(one[0][0], other[0][0])


def test_a_batch__is_a_loop_over_its_scenes():
    scenes = [observed_of(SCENE), first_planes(5), first_planes(7)]
    keys, planes = sample.sample_keys(3, jnp.arange(3), jnp.zeros(3, int)), stack(scenes, ROOM_FOR)
    batch = grow_batch(MODEL, stop_at(12), keys, planes, 50)
    alone = jax.jit(lambda key, planes: grow_from_planes(MODEL, stop_at(12), key, planes, 50))
    for index in range(3):
        one = alone(*jax.tree.map(lambda leaf, i=index: leaf[i], (keys, planes)))
        jax.tree.map(
            lambda left, right, i=index: np.testing.assert_array_equal(left[i], right), batch, one
        )


def test_scenes_of_one_bucket__are_compiled_once():
    grow_batch.clear_cache()
    counts = (8, 7, 6)  # the bucket of 24 nodes, and twice that of 16 below
    for scenes in ([first_planes(count) for count in counts], [first_planes(8)] * 40):
        complete(MODEL, stop_at(12), scenes, max_steps=50)
    assert grow_batch._cache_size() == 1
    complete(MODEL, stop_at(12), [first_planes(3), first_planes(8), first_planes(2)], max_steps=50)
    assert grow_batch._cache_size() == 2


@pytest.mark.parametrize("num_planes", [2, 40, 200])
def test_capacity__has_room_for_eight_new_nodes_and_four_for_every_five_planes(num_planes):
    capacity = growth_capacity(num_planes)
    assert capacity.nodes >= 1.8 * num_planes + 7
    assert capacity.edges >= 20 * num_planes
