"""What is grown is sound, whatever a model has learnt: here, nothing."""

import functools

import jax
import numpy as np
import pytest

from sg3d_jax.fill.fd4 import FD4, FD4Config
from sg3d_jax.fill.midi import MiDi, MiDiConfig
from sg3d_jax.flagg.grow import HALTED, Grown, grow
from sg3d_jax.flagg.step import Flagg, FlaggConfig, Params
from sg3d_jax.metrics.oddities import Oddity, oddities
from sg3d_jax.metrics.structure import num_forbidden_edges
from sg3d_jax.scene.graph import (
    PackedGraph,
    SceneGraph,
    observed_of,
    ontology_of,
    parts_first,
    subgraph,
)
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.padding import Capacity, unpad
from tests.growing_rooms import Counting, Even, stop_at
from tests.two_rooms import (
    NUM_PLANES,
    STATISTICS,
    all_at_once,
    observed,
    on_device,
    random_params,
    two_rooms,
)

pytestmark = pytest.mark.slow

SCENE = two_rooms()
ROOM_FOR = Capacity(48, 800)
NUMBER = 12
FILLS = {
    "midi": MiDi(MiDiConfig(8, 1, 2, 8, 8, 1, 2, diffusion_steps=3, sampling_steps=2), STATISTICS),
    "fd4": FD4(
        FD4Config(8, 1, 2, 8, 8, 1, 2, 8, 1, 3, topology_steps=2, distance_steps=1), STATISTICS
    ),
}
BROKEN = {Oddity.WITHOUT_WHOLE, Oddity.SEVERAL_WHOLES, Oddity.TOO_FEW_PARTS}


@functools.partial(jax.jit, static_argnames="model")
def grow_many(model: Flagg, params: Params, keys: jax.Array, given: PackedGraph) -> Grown:
    return jax.vmap(lambda key: grow(model, params, key, given))(keys)


@jax.debug_key_reuse(False)  # JAX takes a vmapped scan over keys for their reuse
def growing(fill: str, config: FlaggConfig, given: SceneGraph, stop: int = 14) -> Grown:
    """Grows many graphs by drawn parameters; Halt would end from so many nodes on."""
    model = Flagg(config, Even(1, 1, len(config.coins)), FILLS[fill], Counting(1, 1))
    params = random_params(FILLS[fill].init, observed(SCENE), all_at_once())
    keys = jax.random.split(jax.random.key(0), NUMBER)
    start = on_device(given, ROOM_FOR)
    return jax.tree.map(
        np.asarray, grow_many(model, stop_at(stop)._replace(fill=params), keys, start)
    )


def of(grown, number):
    return unpad(jax.tree.map(lambda leaf: leaf[number], grown.graph))


def assert_sound(graph: SceneGraph) -> None:
    """Asserts every rule; a plane alone may have no room, which says that it belongs to nothing."""
    assert num_forbidden_edges(graph) == 0
    for odd, count in oddities(graph).items():
        unplaced = odd.kind is Oddity.WITHOUT_WHOLE and odd.concept == "plane"
        assert odd.kind not in BROKEN or unplaced, (odd, count)
    label, names = np.asarray(graph.nodes.label), ontology_of(graph).names
    wholes = {part for part, whole in parts_first(graph).tolist() if names[label[whole]] != "wall"}
    grown = [row for row in np.flatnonzero(label != PLANE) if names[label[row]] != "wall"]
    assert sum(row not in wholes for row in grown) <= 1


@pytest.mark.parametrize("given", [NUM_PLANES, 10], ids=["planes", "a room"])
@pytest.mark.parametrize(("fill", "coins"), [("midi", (1,)), ("fd4", (1, 4))])
def test_what_halts__obeys_every_rule_whatever_the_parameters(fill, coins, given):
    grown = growing(fill, FlaggConfig(coins=coins), subgraph(SCENE, np.arange(given)))
    assert (grown.halt_reason == HALTED).mean() > 0.8
    for number in np.flatnonzero(grown.halt_reason == HALTED):
        assert_sound(of(grown, number))


def test_without_constraints__rules_are_broken():
    grown = growing("midi", FlaggConfig(coins=(1,), constrained=False), observed_of(SCENE))
    kinds = {odd.kind for number in range(NUMBER) for odd in oddities(of(grown, number))}
    assert kinds >= {Oddity.WITHOUT_WHOLE, Oddity.SEVERAL_WHOLES}


def test_growing_from_the_top__is_sound_too():
    layers = ("floor", "room", "wall", "building", "city")
    grown = growing("midi", FlaggConfig(coins=(1,), layers=layers), observed_of(SCENE))
    assert (grown.halt_reason == HALTED).any()
    for number in np.flatnonzero(grown.halt_reason == HALTED):
        assert_sound(of(grown, number))


def test_a_graph_to_which_nothing_can_be_added__ends():
    """Of one plane that has its room there is no wall; and Halt alone would never end."""
    scene = subgraph(SCENE, np.array([0, 9, 11]))
    grown = growing("midi", FlaggConfig(coins=(1,)), scene, stop=10**6)
    assert (grown.halt_reason == HALTED).all()
    names = ontology_of(scene).names
    labels = [names[label] for label in of(grown, 0).nodes.label]
    assert labels == ["plane", "room", "floor", "building", "city"]
