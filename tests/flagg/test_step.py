import dataclasses
import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.fill.fd4 import FD4, FD4Config
from sg3d_jax.fill.midi import MiDi, MiDiConfig
from sg3d_jax.flagg import step
from sg3d_jax.flagg.corrupt import corrupt
from sg3d_jax.flagg.grow import RUNNING, grow
from sg3d_jax.flagg.halt import Halt, halt_loss
from sg3d_jax.flagg.insert import Insert, insert_loss
from sg3d_jax.flagg.step import Flagg, FlaggConfig, make_flagg
from sg3d_jax.nn.kin import kin_fit
from sg3d_jax.scene.graph import extended, observed_of
from sg3d_jax.scene.ontology import PLANE, ROOM, WALL
from tests.growing_rooms import NEVER, AddRooms, grows_rooms
from tests.own_world import ONTOLOGY
from tests.two_rooms import NUM_PLANES, STATISTICS, on_device, random_params, two_rooms

pytestmark = pytest.mark.slow

SCENE = two_rooms()
PAPER_LAYERS = ("room", "wall", "floor", "building", "city")
QUIET = step.CorruptionConfig(0.0, 0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class ConstantFill(AddRooms):
    """A Fill whose loss is its parameter."""

    def init(self, key, graph, block):
        return jnp.float32(3)

    def loss(self, params, key, graph, block):
        return 2 * params, {"constant": params}


@pytest.fixture(scope="module")
def simple():
    model = make_flagg(
        FlaggConfig(coins=(1, 2), width=4, depth=1, corruption=QUIET), ConstantFill()
    )
    params = random_params(functools.partial(model.init, graph=on_device(SCENE)))
    return model, params._replace(fill=jnp.float32(3))


def test_loss__is_the_sum_of_the_three_modules_on_one_cut(simple):
    model, params = simple
    graph = on_device(SCENE)

    @jax.jit
    def both(key, again):
        total, terms = model.loss(params, key, graph)
        cut = step.cut_graph(model.config, jax.random.split(again, 4)[0], graph)
        logits = model.insert.logits(params.insert, cut.survivors)
        logit = model.halt.logit(params.halt, cut.survivors)
        halt = halt_loss(logit, cut.complete, cut.inserted)
        return total, terms, insert_loss(logits, cut.insert_probs), halt

    for seed in range(6):
        total, terms, insert, halt = both(jax.random.key(seed), jax.random.key(seed))
        assert set(terms) == {"constant", "insert", "halt"}
        np.testing.assert_allclose(terms["insert"], insert, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(terms["halt"], halt, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(total, 6 + insert + halt, rtol=1e-5)


def test_loss__has_a_finite_gradient_that_reaches_every_module(simple):
    model, params = simple
    graphs, keys = on_device(SCENE), jax.random.split(jax.random.key(1), 8)

    @jax.jit
    def gradient(params):
        def mean(params):
            losses = jax.vmap(lambda key: model.loss(params, key, graphs)[0])(keys)
            return jnp.mean(losses)

        return jax.grad(mean)(params)

    found = gradient(params)
    chex.assert_tree_all_finite(found)
    assert found.kinds is None  # the paper's concepts have none
    for module in found[:-1]:
        assert any(np.any(leaf) for leaf in jax.tree.leaves(module))


@dataclasses.dataclass(frozen=True)
class TellingFill(AddRooms):
    """A Fill whose loss is the label of its block, and which tells a number of its key."""

    def loss(self, params, key, graph, block):
        label = block.label[0].astype(jnp.float32)
        return label, {"label": label, "noise": jax.random.uniform(key)}


@pytest.mark.parametrize("layers", [(), ("floor", "room", "wall", "building", "city")])
def test_loss__is_a_mean_over_what_may_come_next(layers):
    """Walls come first and rooms after them; a wall and two rooms cannot share a state."""
    sizes = {"width": 4, "depth": 1, "corruption": QUIET}
    config = FlaggConfig(coins=(1,), layers=layers, continuations=16, **sizes)
    model, graph = make_flagg(config, TellingFill()), on_device(SCENE)
    params = random_params(functools.partial(model.init, graph=graph))

    @jax.jit
    def both(key, again):
        cut = step.cut_graph(config, jax.random.split(again, 4)[0], graph)
        return model.loss(params, key, graph)[1], cut

    for seed in range(8):
        terms, cut = both(jax.random.key(seed), jax.random.key(seed))
        np.testing.assert_allclose(terms["label"], cut.block.label[0])
        assert 0.2 < terms["noise"] < 0.8  # of sixteen keys


def shown(graph):
    """Returns a number that tells any perturbation of a graph."""
    place = jnp.arange(len(graph.edges.mask)) % 7
    return jnp.sum(graph.nodes.position) + jnp.sum(graph.edges.mask * place).astype(jnp.float32)


class ShownInsert(Insert):
    def logits(self, params, graph):
        return jnp.stack([shown(graph), jnp.zeros(())])


class ShownHalt(Halt):
    def logit(self, params, graph):
        return shown(graph)


@dataclasses.dataclass(frozen=True)
class ShownFill(AddRooms):
    def loss(self, params, key, graph, block):
        return shown(graph), {"fill": shown(graph)}


def test_every_module__is_trained_on_the_perturbed_graph_and_the_clean_block():
    strong = step.CorruptionConfig(0.0, p_drop=0.5, p_add=0.05, sigma_position=0.1)
    config, graph = FlaggConfig(coins=(1, 2), corruption=strong), on_device(SCENE)
    model = Flagg(config, ShownInsert(1, 1, 2), ShownFill(), ShownHalt(1, 1))

    @jax.jit
    def both(key, again):
        key_cut, key_corrupt, *_ = jax.random.split(again, 4)
        cut = step.cut_graph(config, key_cut, graph)
        told = shown(corrupt(cut.survivors, key_corrupt, strong))
        halt = halt_loss(told, cut.complete, cut.inserted)
        insert = insert_loss(jnp.stack([told, jnp.zeros(())]), cut.insert_probs)
        expected = {"fill": told, "insert": insert, "halt": halt}
        return model.loss(NEVER, key, graph)[1], expected, told - shown(cut.survivors)

    for seed in range(6):
        terms, expected, change = both(jax.random.key(seed), jax.random.key(seed))
        assert change != 0
        chex.assert_trees_all_close(terms, expected, rtol=1e-5)


@pytest.mark.parametrize(("continuations", "ordering"), [(0, "H"), (2, "HP")])
def test_continuations__are_refused_where_there_are_none(continuations, ordering):
    with pytest.raises(ValueError, match=f"flagg.continuations is {continuations}, expected 1"):
        FlaggConfig(continuations=continuations, ordering=ordering)


def test_growing__with_an_untrained_model_leaves_the_planes_bit_for_bit():
    sizes = {"encoder_width": 8, "gates": 2, "node_width": 8, "pair_width": 8, "distance_width": 8}
    layers = {"encoder_layers": 1, "layers": 1, "heads": 2, "distance_layers": 1}
    diffusion = {"diffusion_steps": 3, "topology_steps": 2, "distance_steps": 2}
    fill = FD4(FD4Config(**sizes, **layers, **diffusion), STATISTICS)
    model = make_flagg(FlaggConfig(coins=(1, 2), width=4, depth=1), fill)
    planes = on_device(observed_of(SCENE))

    init = functools.partial(model.init, graph=on_device(SCENE))
    growing = jax.jit(functools.partial(grow, model, max_steps=3))

    for seed in range(4):
        grown = growing(random_params(init, seed=seed), jax.random.key(seed), planes)
        assert grown.halt_reason != RUNNING
        count = int(grown.graph.n_node[0])
        assert NUM_PLANES < count <= NUM_PLANES + 6
        chex.assert_tree_all_finite(grown)
        for found, given in zip(grown.graph.nodes, planes.nodes, strict=True):
            np.testing.assert_array_equal(found[:NUM_PLANES], given[:NUM_PLANES])
        assert (grown.graph.nodes.label[NUM_PLANES:count] != PLANE).all()
        np.testing.assert_array_equal(grown.graph.nodes.mask, np.arange(16) < count)


@pytest.mark.parametrize(("label", "fits"), [(ROOM, False), (WALL, True)])
def test_a_step__does_not_fit_where_kin_have_no_slot(label, fits):
    """Of 16 slots, a third is for nodes that hear of their kin: the floor and four rooms."""
    crowd = extended(SCENE, [ROOM, ROOM], np.zeros((2, 3)), [])
    graph = on_device(crowd)
    assert kin_fit(graph)
    model = grows_rooms(1, fill=AddRooms(label))
    grown = jax.jit(model.step)(NEVER, jax.random.key(0), graph)
    assert grown.fits == fits
    if fits:
        assert grown.graph.n_node[0] == graph.n_node[0] + 1
    else:
        chex.assert_trees_all_equal(grown.graph, graph)


@pytest.mark.parametrize("field", ["config", "statistics", "ontology"])
@pytest.mark.parametrize(
    ("fill", "config"),
    [(FD4, FD4Config(heads=2)), (MiDi, MiDiConfig(heads=2))],
    ids=["fd4", "midi"],
)
def test_models_that_are_built_alike__are_one(fill, config, field):
    def make(**changes):
        statistics = type(STATISTICS)(*STATISTICS)  # of equal numbers, not the same object
        parts = {"config": dataclasses.replace(config), "statistics": statistics}
        return make_flagg(FlaggConfig(coins=(1, 4)), fill(**{**parts, **changes}))

    changes = {
        "config": dataclasses.replace(config, heads=4),
        "statistics": STATISTICS._replace(distance_mean=2.5),
        "ontology": ONTOLOGY,
    }
    one, same, other = make(), make(), make(**{field: changes[field]})
    assert one is not same
    assert one == same
    assert hash(one) == hash(same)
    assert one != other

    chex.clear_trace_counter()  # which goes by names

    @functools.partial(jax.jit, static_argnums=0)
    @chex.assert_max_traces(n=2)
    def compiled(model, number):
        return model.config.width * number

    for model in (one, same, other, one):
        assert compiled(model, jnp.asarray(2)) == 64
    with pytest.raises(AssertionError, match="traced"):
        compiled(make_flagg(FlaggConfig(coins=(1,)), one.fill), jnp.asarray(2))


def test_an_order_of_other_concepts__is_refused():
    with pytest.raises(
        ValueError, match=r"flagg\.layers must name each of wall, room, flat, floor"
    ):
        make_flagg(FlaggConfig(layers=PAPER_LAYERS), AddRooms(ontology=ONTOLOGY))
    make_flagg(FlaggConfig(layers=PAPER_LAYERS), AddRooms())
