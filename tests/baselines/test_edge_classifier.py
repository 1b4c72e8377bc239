import dataclasses
import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from sg3d_jax.baselines.edge_classifier import (
    ECL,
    Classified,
    ECLConfig,
    ECSquare,
    ECSquareConfig,
    EdgeClassifier,
    certainty_of,
    classify_batch,
    sharing,
    target,
    turned,
)
from sg3d_jax.baselines.edge_features import Scales, near_planes
from sg3d_jax.data.synthetic import S_F, S_F_SQUARE, make_scene
from sg3d_jax.infer.complete import complete
from sg3d_jax.metrics.structure import exact_structure
from sg3d_jax.scene.graph import features_of, make_graph, observed_of, undirected_edges
from sg3d_jax.scene.ontology import BUILDING, FLOOR, PART_OF, PLANE, PROXIMITY, ROOM, WALL
from sg3d_jax.scene.proximity import connect_observed
from sg3d_jax.scene.validate import validate_graph
from tests.two_rooms import (
    NUM_PLANES,
    PART_OF_PAIRS,
    TWICE,
    moved,
    on_device,
    random_params,
    reordered,
    two_rooms,
    with_garbage,
)

pytestmark = pytest.mark.slow

SCENE = two_rooms()
SCALES = Scales(1.0, 5.0, 10.0)
SQUARE = ECSquareConfig(heads=2, width=4, decoder=(8,))
L = ECLConfig(node_width=4, heads=2, edge_width=5, decoder=(8,), readout_width=6)
CERTAIN = dataclasses.replace(L, dropout=0.0)
NO_PASSES = dataclasses.replace(L, certainty_passes=0)
MODELS = {
    SQUARE: ECSquare(SQUARE, SCALES),
    **{config: ECL(config, SCALES) for config in (L, CERTAIN, NO_PASSES)},
}
WIDE = MODELS[SQUARE].capacity(32, 0)
KEY = functools.partial(jax.random.key, 3)
either = pytest.mark.parametrize("config", [SQUARE, L])


@jax.jit
def connected(graph):
    """Connects planes, and returns which edges share a room and which a wall, too."""
    graph = connect_observed(graph)
    return graph, sharing(graph, ROOM), sharing(graph, WALL)


def lopsided():
    """Returns the scene with uneven rooms that do not stand in the middle of their planes."""
    position, width = SCENE.nodes.position.copy(), SCENE.nodes.width.copy()
    position[9:11, :2] += [[0.4, 0.2], [-0.3, 0.1]]
    width[[0, 4]] /= 2
    return SCENE._replace(nodes=SCENE.nodes._replace(position=position, width=width))


@functools.cache
def params_of(config):
    params = random_params(MODELS[config].init, on_device(SCENE))
    return jax.tree.map(lambda leaf: 2 * np.asarray(leaf), params)  # sure enough of some pairs


@functools.cache
def jitted(config, name):
    return jax.jit(getattr(MODELS[config], name))


@functools.partial(jax.jit, static_argnums=0)
def train(config, params, graph, rate):
    """Returns the losses and gradients of some steps."""
    model, optimiser = MODELS[config], optax.adam(rate)

    def step(carry, key):
        params, state = carry
        (loss, _), gradient = jax.value_and_grad(model.loss, has_aux=True)(params, key, graph)
        updates, state = optimiser.update(gradient, state, params)
        return (optax.apply_updates(params, updates), state), (loss, gradient)

    return jax.lax.scan(step, (params, optimiser.init(params)), jax.random.split(KEY(), 60))[1]


def near_pairs(graph):
    return near_planes(jax.tree.map(np.asarray, graph))


def by_pair(config, graph):
    """Returns what becomes of each pair of planes, by the numbers of the planes."""
    found = jitted(config, "classify")(params_of(config), KEY(), graph)
    senders, receivers, near = near_pairs(graph)
    table = np.zeros((3, NUM_PLANES, NUM_PLANES))
    for row, values in zip(table, found, strict=True):
        row[senders[near], receivers[near]] = np.asarray(values)[near]
    return table


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (ECSquare(ECSquareConfig(), SCALES), {"room": 21_985, "wall": 21_985}),
        (ECL(ECLConfig(), SCALES), {"classifier": 106_963}),
    ],
)
def test_networks__have_as_many_parameters_as_the_originals(model, expected):
    params = jax.eval_shape(model.init, KEY(), on_device(SCENE))
    for name, number in expected.items():
        assert sum(leaf.size for leaf in jax.tree.leaves(params[name])) == number


def test_pairs_of_planes__share_the_rooms_and_walls_that_they_are_parts_of():
    graph, in_room, in_wall = jax.tree.map(np.asarray, connected(on_device(SCENE, WIDE)))
    ends = np.stack([graph.senders, graph.receivers], axis=-1)
    near = near_planes(graph).mask
    room_of = dict(pair for pair in PART_OF_PAIRS if pair[1] in (9, 10))
    same_room = [room_of[i] == room_of[j] for i, j in ends[near].tolist()]
    same_wall = [{i, j} == {1, 4} for i, j in ends[near].tolist()]
    np.testing.assert_array_equal(in_room[near], same_room)
    np.testing.assert_array_equal(in_wall[near], same_wall)
    assert 0 < sum(same_room) < len(same_room)
    assert sum(same_wall) == 2


@either
def test_classification__sees_planes_and_their_proximity_alone(config):
    whole = by_pair(config, on_device(SCENE))
    near = undirected_edges(SCENE, PROXIMITY)
    alone = observed_of(SCENE)
    nodes, features = alone.nodes, features_of(alone)
    planes = make_graph(nodes.label, nodes.position, **features, proximity=near)
    np.testing.assert_allclose(whole, by_pair(config, on_device(planes)), atol=1e-4)


@either
def test_classification__is_the_same_in_both_directions(config):
    table = by_pair(config, on_device(SCENE))
    np.testing.assert_array_equal(table, table.swapaxes(1, 2))
    assert table[0].any() or table[1].any()


@pytest.mark.parametrize("config", [SQUARE, CERTAIN])
def test_classification_and_loss__do_not_depend_on_padding_and_numbering(config):
    expected = by_pair(config, on_device(SCENE))
    loss = jitted(config, "loss")(params_of(config), KEY(), on_device(SCENE))
    order = np.r_[np.random.default_rng(1).permutation(NUM_PLANES), np.arange(NUM_PLANES, 12)]
    place = np.ix_(range(3), order[:NUM_PLANES], order[:NUM_PLANES])
    for graph, table in (
        (on_device(SCENE, TWICE), expected),
        (with_garbage(on_device(SCENE), 2), expected),
        (on_device(reordered(SCENE, order)), expected[place]),
    ):
        np.testing.assert_allclose(by_pair(config, graph), table, atol=1e-4)
        found = jitted(config, "loss")(params_of(config), KEY(), graph)
        chex.assert_trees_all_close(found, loss, rtol=1e-3, atol=1e-4)


def test_ec_l__does_not_see_how_the_building_stands():
    expected = by_pair(CERTAIN, on_device(SCENE))
    shaken = on_device(moved(SCENE, 0.7, (3, -8, 2), flip=True))
    np.testing.assert_allclose(by_pair(CERTAIN, shaken), expected, atol=1e-2)


def test_training_of_ec_square__turns_the_building_and_that_of_ec_l_drops_states():
    for config in (SQUARE, L):
        losses, _ = train(config, params_of(config), on_device(SCENE), 0.0)
        assert abs(np.diff(losses[:2])) > 1e-3


def test_turned__is_a_rotation_about_the_vertical():
    found = jax.jit(turned)(on_device(SCENE), jnp.float32(0.7)).nodes
    expected = moved(SCENE, 0.7).nodes
    np.testing.assert_allclose(found.position[:12], expected.position, atol=1e-5)
    np.testing.assert_allclose(found.normal[:12], expected.normal, atol=1e-5)


@either
def test_loss__falls_and_its_gradient_reaches_every_network(config):
    graph = on_device(lopsided())
    params = random_params(MODELS[config].init, graph)
    losses, gradients = jax.tree.map(np.asarray, train(config, params, graph, 3e-3))
    chex.assert_tree_all_finite(gradients)
    assert losses[-10:].mean() < 0.8 * losses[:10].mean()
    for network in gradients.values():
        assert any(np.any(leaf) for leaf in jax.tree.leaves(network))


@either
def test_gradient__is_finite_on_a_graph_of_padding_only(config):
    empty = jax.tree.map(np.zeros_like, on_device(SCENE))
    chex.assert_tree_all_finite(train(config, params_of(config), empty, 0.0))


def test_certainty__is_one_less_the_entropy_of_the_mean_prediction():
    sure, split = [9e9, 0, 0], [0, 0, -9e9]
    logits = jnp.asarray([[sure, split, [0, 0, 0], sure], [sure, split, [0, 0, 0], sure[::-1]]])
    expected = [1, 1 - np.log(2), 0, 1 - np.log(2)]
    np.testing.assert_allclose(jax.jit(certainty_of)(logits), expected, atol=1e-5)


@pytest.mark.parametrize(("config", "changes"), [(NO_PASSES, False), (L, True)])
def test_passes_with_dropout__change_the_certainty_and_not_the_classes(config, changes):
    classify = jitted(config, "classify")
    found, again = (
        jax.tree.map(np.asarray, classify(params_of(L), jax.random.key(seed), on_device(SCENE)))
        for seed in (0, 1)
    )
    chex.assert_trees_all_equal(found[:2], again[:2])
    near = near_pairs(on_device(SCENE)).mask
    assert (found.certainty[near] != again.certainty[near]).any() == changes
    assert ((found.certainty >= 0) & (found.certainty <= 1)).all()


class Knowing(EdgeClassifier):
    """A model that knows the classes: its parameters are same room and same wall, N x N."""

    def capacity(self, num_observed, num_missing):
        return WIDE

    def classify(self, params, key, graph):
        ends = graph.senders, graph.receivers
        near = near_planes(graph).mask
        tables = [near & table[ends] for table in params["truth"]]
        return Classified(*tables, jnp.ones(near.shape))


@dataclasses.dataclass(frozen=True)
class KnowingSquare(Knowing, ECSquare):
    pass


@dataclasses.dataclass(frozen=True)
class KnowingL(Knowing, ECL):
    pass


SQUARE_KNOWING = KnowingSquare(ECSquareConfig(), SCALES)
L_KNOWING = KnowingL(ECLConfig(room_centroids="mean"), SCALES)


def truth_of(scene):
    """Returns which planes share a room and which a wall."""
    label, pairs = scene.nodes.label, undirected_edges(scene, PART_OF)
    part_of = np.zeros((len(label), len(label)), bool)
    part_of[pairs[:, 0], pairs[:, 1]] = part_of[pairs[:, 1], pairs[:, 0]] = True
    tables = np.zeros((2, WIDE.nodes, WIDE.nodes), bool)
    num_planes = (label == PLANE).sum()
    for table, concept in zip(tables, (ROOM, WALL), strict=True):
        of_concept = part_of[:num_planes, label == concept]
        table[:num_planes, :num_planes] = of_concept.astype(int) @ of_concept.T > 0
    return tables


def all_near(scene, tables):
    """Returns whether all planes that share a room or wall are joined by proximity."""
    graph, *_ = connected(on_device(observed_of(scene), WIDE))
    near = np.zeros(tables.shape[1:], bool)
    near[graph.senders, graph.receivers] = graph.edges.mask
    return not (tables.any(axis=0) & ~near & ~np.eye(len(near), dtype=bool)).any()


@pytest.mark.parametrize(
    ("model", "drawn"),
    [(SQUARE_KNOWING, S_F_SQUARE), (L_KNOWING, S_F)],
    ids=["square", "l"],
)
def test_perfect_pairs__give_the_true_rooms_and_walls(model, drawn):
    sizes = []
    for index in range(12):
        scene = make_scene(drawn, 5, index)
        if len(observed_of(scene).nodes.label) > WIDE.nodes:
            continue
        tables = truth_of(scene)
        if all_near(scene, tables):
            [[found]] = complete(model, {"truth": tables}, [scene], candidates=1)
            validate_graph(found.graph, "found")
            assert exact_structure(found.graph, target(scene))
            walls = found.graph.nodes.position[found.graph.nodes.label == WALL]
            expected = scene.nodes.position[scene.nodes.label == WALL]
            np.testing.assert_allclose(
                walls[np.lexsort(walls.T)], expected[np.lexsort(expected.T)], atol=1e-4
            )
            sizes += np.bincount(undirected_edges(scene, PART_OF)[:, 1])[
                scene.nodes.label == ROOM
            ].tolist()
    assert len(sizes) >= 8
    assert (max(sizes) > 4) == (drawn == S_F)


def same(one, other):
    return all(jax.tree.leaves(jax.tree.map(np.array_equal, one, other)))


def test_seeds__do_not_change_what_ec_square_finds():
    one, other = (complete(MODELS[SQUARE], params_of(SQUARE), [SCENE], seed) for seed in (0, 1))
    assert same(one, other)


TRACED = []


@dataclasses.dataclass(frozen=True)
class Traced(ECSquare):
    def classify(self, params, key, graph):
        TRACED.append(graph.nodes.mask.shape)
        nothing = jnp.zeros(graph.edges.mask.shape, bool)
        return Classified(nothing, nothing, jnp.ones(nothing.shape))


def test_networks__are_compiled_once_a_bucket():
    TRACED.clear()
    classify_batch.clear_cache()
    floors = [make_scene(S_F_SQUARE, 0, index) for index in range(1, 5)]
    found = complete(Traced(SQUARE, SCALES), {}, floors)
    complete(Traced(SQUARE, Scales(1.0, 5.0, 10.0)), {}, floors[::-1], seed=3)
    assert len(TRACED) == len(set(TRACED)) > 1
    for (one,), floor in zip(found, floors, strict=True):
        assert same(one.graph.nodes, observed_of(floor).nodes)


def test_regressed_rooms__stand_off_the_mean_of_their_planes():
    truth = {"truth": truth_of(SCENE)}
    [one], [other] = (
        complete(model, params, [lopsided()], candidates=1)[0]
        for model, params in (
            (KnowingL(L, SCALES), {**params_of(L), **truth}),
            (L_KNOWING, truth),
        )
    )
    np.testing.assert_array_equal(one.graph.senders, other.graph.senders)
    apart = np.abs(one.graph.nodes.position - other.graph.nodes.position).max(axis=-1)
    np.testing.assert_array_equal(apart > 1e-4, one.graph.nodes.label == ROOM)
    np.testing.assert_allclose(
        other.graph.nodes.position[9:], SCENE.nodes.position[9:11], atol=1e-5
    )


def test_target__is_the_truth_without_floors():
    found = target(SCENE)
    validate_graph(found, "target")
    assert found.nodes.label.tolist() == [PLANE] * NUM_PLANES + [WALL, ROOM, ROOM]
    expected = sorted(pair for pair in PART_OF_PAIRS if pair[1] != 11)
    np.testing.assert_array_equal(undirected_edges(found, PART_OF), expected)
    first = np.r_[11, np.arange(11)]  # the floor comes first
    again = target(reordered(SCENE, first))
    np.testing.assert_array_equal(undirected_edges(again, PART_OF), expected)
    np.testing.assert_array_equal(again.nodes.position, found.nodes.position)


def test_target__of_a_building_is_refused():
    label = np.where(SCENE.nodes.label == FLOOR, BUILDING, SCENE.nodes.label)
    building = SCENE._replace(nodes=SCENE.nodes._replace(label=label))
    with pytest.raises(ValueError, match="know no concept above the room"):
        target(building)
