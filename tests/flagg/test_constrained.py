"""What is grown is sound, whatever a model has learnt: here, nothing."""

import functools

import chex
import jax
import numpy as np
import pytest

from sg3d_jax.fill.fd4 import FD4Config
from sg3d_jax.fill.midi import MiDi, MiDiConfig
from sg3d_jax.fill.protocol import Fill
from sg3d_jax.flagg.grow import HALTED, RUNNING, Grown, grow
from sg3d_jax.flagg.step import Flagg, FlaggConfig, make_flagg, with_upper
from sg3d_jax.metrics.oddities import Oddity, oddities
from sg3d_jax.metrics.structure import num_forbidden_edges
from sg3d_jax.scene.graph import SceneGraph, observed_of, ontology_of, parts_first, subgraph
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.padding import Capacity, unpad
from tests.growing_rooms import Counting, Even, stop_at
from tests.opinions import OpinionatedFD4, OpinionatedMiDi
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
MIDI_CONFIG = MiDiConfig(8, 1, 2, 8, 8, 1, 2, diffusion_steps=3, sampling_steps=2)
FD4_CONFIG = FD4Config(8, 1, 2, 8, 8, 1, 2, 8, 1, 3, topology_steps=2, distance_steps=1)
BROKEN = {Oddity.WITHOUT_WHOLE, Oddity.SEVERAL_WHOLES, Oddity.TOO_FEW_PARTS}
UNTRAINED = make_flagg(
    FlaggConfig(coins=(1, 2), width=4, depth=1, constrained=False), MiDi(MIDI_CONFIG, STATISTICS)
)
grow_one = jax.jit(grow, static_argnames=("model", "max_steps"))


FILLS = {
    "midi": OpinionatedMiDi(MIDI_CONFIG, STATISTICS),
    "fd4": OpinionatedFD4(FD4_CONFIG, STATISTICS),
}


def growing(fill: Fill, config: FlaggConfig, given: SceneGraph, stop: int = 14) -> list[Grown]:
    """Grows many graphs by drawn parameters; Halt would end from so many nodes on."""
    model = Flagg(config, Even(1, 1, len(config.coins)), fill, Counting(1, 1))
    fill_params = random_params(fill.init, observed(SCENE), jax.jit(all_at_once)())
    params = with_upper(stop_at(stop)._replace(fill=fill_params), config)
    start = on_device(given, ROOM_FOR)
    grown = [grow_one(model, params, jax.random.key(seed), start) for seed in range(NUMBER)]
    return jax.tree.map(np.asarray, grown)


def halted(grown: list[Grown]) -> list[SceneGraph]:
    return [unpad(one.graph) for one in grown if one.halt_reason == HALTED]


def assert_begins_with(grown: Grown, given: SceneGraph) -> None:
    """Asserts that what was given is there, bit for bit."""
    count = int(given.n_node[0])
    for found, expected in zip(grown.graph.nodes, given.nodes, strict=True):
        np.testing.assert_array_equal(found[:count], np.asarray(expected)[:count])


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
@pytest.mark.parametrize(("fill", "coins", "upper"), [("midi", (1,), "floor"), ("fd4", (1, 4), "")])
def test_what_halts__obeys_every_rule_whatever_the_parameters(fill, coins, upper, given):
    start = subgraph(SCENE, np.arange(given))
    grown = growing(FILLS[fill], FlaggConfig(coins=coins, upper=upper), start)
    graphs = halted(grown)
    assert len(graphs) > 0.8 * NUMBER
    for graph in graphs:
        assert_sound(graph)
    for one in grown:
        assert_begins_with(one, on_device(start, ROOM_FOR))


def test_growing_from_the_top__is_sound_too():
    layers = ("floor", "room", "wall", "building", "city")
    config = FlaggConfig(coins=(1,), layers=layers)
    graphs = halted(growing(FILLS["midi"], config, observed_of(SCENE)))
    assert graphs
    for graph in graphs:
        assert_sound(graph)


@pytest.fixture(scope="module")
def unconstrained() -> list[Grown]:
    """What grows without constraints in three steps, by untrained networks of Insert and Halt."""
    planes = on_device(observed_of(SCENE), ROOM_FOR)
    init = functools.partial(UNTRAINED.init, graph=on_device(SCENE))
    grown = [
        grow_one(UNTRAINED, random_params(init, seed=seed), jax.random.key(seed), planes, 3)
        for seed in range(NUMBER)
    ]
    return jax.tree.map(np.asarray, grown)


def test_without_constraints__rules_are_broken(unconstrained):
    kinds = {odd.kind for grown in unconstrained for odd in oddities(unpad(grown.graph))}
    assert kinds >= {Oddity.WITHOUT_WHOLE, Oddity.SEVERAL_WHOLES}


def test_growing__with_an_untrained_model_leaves_the_planes_bit_for_bit(unconstrained):
    for grown in unconstrained:
        assert grown.halt_reason != RUNNING
        count = int(grown.graph.n_node[0])
        assert NUM_PLANES < count <= NUM_PLANES + 6
        chex.assert_tree_all_finite(grown)
        assert_begins_with(grown, on_device(observed_of(SCENE), ROOM_FOR))
        assert (grown.graph.nodes.label[NUM_PLANES:count] != PLANE).all()
        np.testing.assert_array_equal(grown.graph.nodes.mask, np.arange(ROOM_FOR.nodes) < count)


def test_a_graph_to_which_nothing_can_be_added__ends():
    """Of one plane that has its room there is no wall; and Halt alone would never end."""
    scene = subgraph(SCENE, np.array([0, 9, 11]))
    graphs = halted(growing(FILLS["midi"], FlaggConfig(coins=(1,)), scene, stop=10**6))
    assert len(graphs) == NUMBER
    names = ontology_of(scene).names
    labels = [names[label] for label in graphs[0].nodes.label]
    assert labels == ["plane", "room", "floor", "building", "city"]
