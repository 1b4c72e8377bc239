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
from sg3d_jax.flagg.halt import Halt, halt_loss
from sg3d_jax.flagg.insert import Insert, insert_loss
from sg3d_jax.flagg.step import Flagg, FlaggConfig, make_flagg
from sg3d_jax.nn.kin import kin_fit
from sg3d_jax.scene.graph import extended
from sg3d_jax.scene.ontology import ROOM, WALL
from sg3d_jax.scene.padding import Block
from tests.growing_rooms import NEVER, AddRooms, Counting, Even, grows_rooms
from tests.own_world import ONTOLOGY
from tests.two_rooms import STATISTICS, on_device, random_params, two_rooms

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
        return params, {"constant": params}


@dataclasses.dataclass(frozen=True)
class TimesLabel(AddRooms):
    """A Fill whose loss is the label of its block, times its parameter."""

    def loss(self, params, key, graph, block):
        label = params * block.label[0]
        return label, {"label": label}


def test_loss__has_a_finite_gradient_that_reaches_every_module():
    fill, graph = ConstantFill(), on_device(SCENE)
    model = make_flagg(FlaggConfig(coins=(1, 2), width=4, depth=1, corruption=QUIET), fill)
    params = random_params(functools.partial(model.init, graph=graph))
    keys = jax.random.split(jax.random.key(1), 8)

    @jax.jit
    @jax.grad
    def gradient(params):
        losses = jax.vmap(lambda key: model.loss(params, key, graph)[0])(keys)
        return jnp.mean(losses)

    found = gradient(params)
    chex.assert_tree_all_finite(found)
    assert found.kinds is None  # the paper's concepts have none
    assert found.upper is None  # nor are there upper layers
    for module in (found.insert, found.fill, found.halt):
        assert any(np.any(leaf) for leaf in jax.tree.leaves(module))


def test_the_upper_layers__have_a_loss_of_their_own_on_cuts_of_their_own():
    """Which is the label of the block, times the parameter."""
    config = FlaggConfig(coins=(1,), continuations=2, corruption=QUIET, upper="room")
    model = Flagg(config, Even(1, 1, 1), TimesLabel(), Counting(1, 1))
    graph, keys = on_device(SCENE), jax.random.split(jax.random.key(2), 40)
    params = NEVER._replace(fill=jnp.float32(1), upper=jnp.float32(100))

    @functools.partial(jax.jit, static_argnums=0)
    def terms_of(loss, params):
        return jax.vmap(lambda key: loss(params, key, graph))(keys)

    total, terms = jax.tree.map(np.asarray, terms_of(model.loss, params))
    assert terms["upper_label"].min() == 100 * ROOM
    assert WALL in terms["label"]
    np.testing.assert_allclose(total, terms["label"] + terms["upper_label"] + terms["halt"])
    alone, of_alone = terms_of(model.upper_loss, params)
    np.testing.assert_array_equal(alone, of_alone["upper_label"])
    gradient = jax.grad(lambda params: jnp.sum(terms_of(model.upper_loss, params)[0]))(params)
    assert gradient.upper > 0
    assert (gradient.fill, gradient.halt) == (0, 0)


def test_upper_layers__begin_with_what_fill_knows():
    graph = on_device(SCENE)
    model = make_flagg(FlaggConfig(coins=(1,), upper="floor"), ConstantFill())
    params = model.init(jax.random.key(0), graph)
    assert params.upper == 3
    learnt = params._replace(upper=jnp.float32(4))
    assert step.with_upper(learnt, model.config).upper == 4
    without = step.with_upper(learnt, FlaggConfig())
    assert without == learnt._replace(upper=None)
    assert step.with_upper(without, model.config).upper is without.fill
    step.check_grows(model, learnt)
    expected = (
        r"^the parameters have none of upper layers, expected those from floor on, too \(with_"
    )
    with pytest.raises(ValueError, match=expected):
        step.check_grows(model, without)


@dataclasses.dataclass(frozen=True)
class TellingFill(AddRooms):
    """A Fill whose loss is the label of its block, and which tells a number of its key."""

    def loss(self, params, key, graph, block):
        label = block.label[0].astype(jnp.float32)
        return label, {"label": label, "noise": jax.random.uniform(key)}


@pytest.mark.parametrize("layers", [(), ("floor", "room", "wall", "building", "city")])
def test_loss__is_a_mean_over_what_may_come_next(layers):
    """Walls come first and rooms after them; a wall and two rooms cannot share a state."""
    config = FlaggConfig(coins=(1,), layers=layers, continuations=16, corruption=QUIET)
    model, graph = Flagg(config, Even(1, 1, 1), TellingFill(), Counting(1, 1)), on_device(SCENE)

    @jax.jit
    def both(key, again):
        cut = step.cut_graph(config, jax.random.split(again, 4)[0], graph)
        return model.loss(NEVER, key, graph)[1], cut.block.label[0]

    for seed in range(8):
        terms, label = both(jax.random.key(seed), jax.random.key(seed))
        np.testing.assert_allclose(terms["label"], label)
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
        return 2 * shown(graph), {"fill": shown(graph)}


@pytest.fixture(scope="module")
def losses():
    """The loss and its terms on several cuts, with what is expected of those, and their noise."""
    strong = step.CorruptionConfig(0.0, p_drop=0.5, p_add=0.05, sigma_position=0.1)
    config, graph = FlaggConfig(coins=(1, 2), corruption=strong), on_device(SCENE)
    model = Flagg(config, ShownInsert(1, 1, 2), ShownFill(), ShownHalt(1, 1))

    @jax.jit
    def all_of(key, again):
        key_cut, key_corrupt, *_ = jax.random.split(again, 4)
        cut = step.cut_graph(config, key_cut, graph)
        told = shown(corrupt(cut.survivors, key_corrupt, strong))
        halt = halt_loss(told, cut.complete, cut.inserted)
        insert = insert_loss(jnp.stack([told, jnp.zeros(())]), cut.insert_probs)
        expected = {"fill": told, "insert": insert, "halt": halt}
        return *model.loss(NEVER, key, graph), expected, told - shown(cut.survivors)

    of_seeds = [all_of(jax.random.key(seed), jax.random.key(seed)) for seed in range(6)]
    return jax.tree.map(np.asarray, of_seeds)


def test_loss__is_the_sum_of_the_three_modules_on_one_cut(losses):
    for total, terms, expected, _ in losses:
        assert set(terms) == {"fill", "insert", "halt"}
        loss_of_fill = 2 * expected["fill"]
        np.testing.assert_allclose(
            total, loss_of_fill + expected["insert"] + expected["halt"], rtol=1e-5
        )


def test_every_module__is_trained_on_the_perturbed_graph_and_the_clean_block(losses):
    for _, terms, expected, noise in losses:
        assert noise != 0
        chex.assert_trees_all_close(terms, expected, rtol=1e-5)


@pytest.mark.parametrize(("continuations", "ordering"), [(0, "H"), (2, "HP")])
def test_continuations__are_refused_where_there_are_none(continuations, ordering):
    with pytest.raises(ValueError, match=f"flagg.continuations is {continuations}, expected 1"):
        FlaggConfig(continuations=continuations, ordering=ordering)


@dataclasses.dataclass(frozen=True)
class AddAny(AddRooms):
    """Adds nodes of the concept that is its parameter."""

    def sample(self, params, key, graph, mask, rules=None):
        block: Block = super().sample(params, key, graph, mask, rules)
        return block._replace(label=jnp.where(mask, params, 0))


grow_by_any = jax.jit(grows_rooms(1, fill=AddAny()).step)


@pytest.mark.parametrize(("label", "fits"), [(ROOM, False), (WALL, True)])
def test_a_step__does_not_fit_where_kin_have_no_slot(label, fits):
    """Of 16 slots, a third is for nodes that hear of their kin: the floor and four rooms."""
    crowd = extended(SCENE, [ROOM, ROOM], np.zeros((2, 3)), [])
    graph = on_device(crowd)
    assert jax.jit(kin_fit)(graph)
    grown = grow_by_any(NEVER._replace(fill=jnp.int32(label)), jax.random.key(0), graph)
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


def test_loss__is_in_32_bits_whatever_jax_is_told_of_types():
    model, graph, key = grows_rooms(1, 2), on_device(two_rooms()), jax.random.key(0)
    expected = jax.eval_shape(model.loss, NEVER, key, graph)
    with jax.enable_x64(True), jax.numpy_dtype_promotion("strict"):
        chex.assert_trees_all_equal(jax.eval_shape(model.loss, NEVER, key, graph), expected)


def test_an_order_of_other_concepts__is_refused():
    with pytest.raises(
        ValueError, match=r"flagg\.layers must name each of wall, room, flat, floor"
    ):
        make_flagg(FlaggConfig(layers=PAPER_LAYERS), AddRooms(ontology=ONTOLOGY))
    make_flagg(FlaggConfig(layers=PAPER_LAYERS), AddRooms())


def test_upper_layers_of_what_is_not_grown__are_refused():
    sentence = (
        r"^flagg\.upper is 'plane', expected a concept that is grown: wall, room, flat, floor"
    )
    with pytest.raises(ValueError, match=sentence):
        make_flagg(FlaggConfig(upper="plane"), AddRooms(ontology=ONTOLOGY))
    make_flagg(FlaggConfig(upper="flat"), AddRooms(ontology=ONTOLOGY))
