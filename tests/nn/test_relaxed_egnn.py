from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.embed import surface_of
from sg3d_jax.nn.graph_transformer import OldGraphEncoder
from sg3d_jax.nn.relaxed_egnn import PositionUpdate, RelaxedTransformer, linked_mean
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY, ROOM, WALL
from tests.nn.gradients import with_gradient
from tests.two_rooms import (
    CAPACITY,
    TWICE,
    moved,
    on_device,
    random_params,
    reordered,
    rotation,
    two_rooms,
    with_garbage,
)

SCENE = two_rooms()
NUM_BLOCK, NUM_NEW, NUM_OLD = 4, 3, 12
ENCODER = OldGraphEncoder(8, 1, 3)
DENOISER = RelaxedTransformer(8, 8, 2, 2, 3, PAPER_ONTOLOGY.num_concepts)


class Inputs(NamedTuple):
    """The frame and what is noisy of a block."""

    centre: np.ndarray
    mask: np.ndarray
    label: np.ndarray
    edges: np.ndarray
    position: np.ndarray


def draw_inputs() -> Inputs:
    """A noisy block beside the twelve old nodes, without edges at padding."""
    rng = np.random.default_rng(2)
    mask = np.arange(NUM_BLOCK) < NUM_NEW
    square = np.tril(rng.random((NUM_BLOCK, NUM_BLOCK)) < 0.5, -1)
    across = rng.random((NUM_BLOCK, CAPACITY.nodes)) < 0.3
    real = np.concatenate([mask, np.arange(CAPACITY.nodes) < NUM_OLD])
    edges = np.concatenate([square | square.T, across], axis=1) & mask[:, None] & real[None]
    position = rng.normal(3, 2, (NUM_BLOCK, 3)) * mask[:, None]
    centre = SCENE.nodes.position.mean(axis=0)
    label = np.where(mask, [ROOM, WALL, FLOOR, ROOM], 0)
    return Inputs(centre, mask, label, edges + 0, position)


@jax.jit
def run(params, graph, inputs):
    """Logits of labels and of edges, and positions."""
    conditioning = apply(ENCODER, params["encoder"], graph)
    centre, position = (jnp.asarray(field, jnp.float32) for field in (inputs[0], inputs[-1]))
    noisy = inputs.mask, inputs.label, inputs.edges, position, jnp.float32(7)
    return apply(DENOISER, params["denoiser"], conditioning, centre, *noisy)


run_with_gradient = with_gradient(run)


def init(key):
    graph, inputs = on_device(SCENE), jax.tree.map(jnp.asarray, draw_inputs())
    keys = jax.random.split(key)
    encoder = ENCODER.init(keys[0], graph)
    conditioning = apply(ENCODER, encoder, graph)
    denoiser = DENOISER.init(keys[1], conditioning, *inputs, jnp.float32(0))
    return {"encoder": encoder, "denoiser": denoiser}


@pytest.fixture(scope="module")
def params():
    return random_params(init)


@pytest.fixture(scope="module")
def expected(params):
    return jax.tree.map(np.asarray, run(params, on_device(SCENE), draw_inputs()))


def widened(inputs):
    """The same block beside more slots for old nodes."""
    more = TWICE.nodes - CAPACITY.nodes
    return inputs._replace(edges=np.pad(inputs.edges, ((0, 0), (0, more))))


def real_part(outputs):
    """Drops what is said of padding."""
    label, edges, position = (np.asarray(output)[:NUM_NEW] for output in outputs)
    columns = np.r_[:NUM_NEW, NUM_BLOCK : NUM_BLOCK + NUM_OLD]
    return label, edges[:, columns], position


def assert_same(found, expected, atol=1e-4):
    for one, other in zip(real_part(found), real_part(expected), strict=True):
        np.testing.assert_allclose(one, other, atol=atol)


@pytest.mark.parametrize(
    ("angle", "offset", "flip"),
    [(2.0, (0, 0, 0), False), (0.0, (5, -7, 3), False), (-1.1, (4, 9, -3), True)],
)
def test_positions__are_turned_shifted_and_mirrored_with_the_scene(
    params, expected, angle, offset, flip
):
    matrix = rotation(angle) @ np.diag([1, -1 if flip else 1, 1])

    def move(position):
        return np.asarray(position) @ matrix.T + np.asarray(offset)

    inputs = draw_inputs()
    shaken = inputs._replace(centre=move(inputs.centre), position=move(inputs.position))
    found = run(params, on_device(moved(SCENE, angle, offset, flip)), shaken)
    assert np.abs(expected[2] - inputs.position)[:NUM_NEW].min() > 1e-3
    assert_same(found, (*expected[:2], move(expected[2])), atol=2e-3)


def test_outputs__do_not_depend_on_the_amount_of_padding(params, expected):
    found, _ = run_with_gradient(params, on_device(SCENE, TWICE), widened(draw_inputs()))
    assert_same(found, expected)


def test_outputs__do_not_depend_on_what_is_in_the_padding(params, expected):
    inputs = draw_inputs()
    position = np.where(inputs.mask[:, None], inputs.position, 40.0)
    found = run(params, with_garbage(on_device(SCENE), 3), inputs._replace(position=position))
    assert_same(found, expected)


def test_outputs__follow_the_numbering_of_the_old_graph(params, expected):
    inputs, order = draw_inputs(), np.random.default_rng(4).permutation(NUM_OLD)
    columns = np.arange(NUM_BLOCK + CAPACITY.nodes)
    columns[NUM_BLOCK : NUM_BLOCK + NUM_OLD] = NUM_BLOCK + order
    shuffled = inputs._replace(edges=inputs.edges[:, columns])
    label, edges, position = run(params, on_device(reordered(SCENE, order)), shuffled)
    assert_same((label, np.asarray(edges)[:, np.argsort(columns)], position), expected)


def test_outputs__follow_the_numbering_of_the_block(params, expected):
    inputs, order = draw_inputs(), np.array([2, 0, 1, 3])
    columns = np.concatenate([order, NUM_BLOCK + np.arange(CAPACITY.nodes)])
    shuffled = Inputs(
        inputs.centre,
        inputs.mask[order],
        inputs.label[order],
        inputs.edges[order][:, columns],
        inputs.position[order],
    )
    label, edges, position = map(np.asarray, run(params, on_device(SCENE), shuffled))
    rows, back = np.argsort(order), np.argsort(columns)
    assert_same((label[rows], edges[rows][:, back], position[rows]), expected)


@pytest.mark.parametrize("field", ["label", "edges", "position", "centre"])
def test_every_output__sees_every_noisy_input_and_the_frame(params, expected, field):
    inputs = draw_inputs()
    change = {
        "label": inputs.label[::-1],
        "edges": 1 - inputs.edges,
        "position": inputs.position + 0.3 * np.arange(NUM_BLOCK)[:, None],
        "centre": inputs.centre + 1.0,
    }
    found = run(params, on_device(SCENE), inputs._replace(**{field: change[field]}))
    for one, other in zip(found, expected, strict=True):
        assert np.abs(np.asarray(one) - other)[:NUM_NEW].max() > 1e-4


def test_positions__stay_where_they_are_before_any_training(params):
    """So they do whatever the parameters are beside those that move them."""
    inputs, tokens = draw_inputs(), NUM_BLOCK + CAPACITY.nodes
    shapes = [(NUM_BLOCK, 3), (NUM_BLOCK, 8), (NUM_BLOCK, tokens, 8), (NUM_BLOCK, tokens)]
    zeros = [np.zeros(shape, np.float32) for shape in shapes]
    old, mask = surface_of(on_device(SCENE).nodes), np.ones(tokens, bool)
    initial = jax.jit(PositionUpdate().init)(jax.random.key(0), *zeros, old, mask)["params"]
    untrained = jax.tree.map(lambda leaf: leaf, params)
    layers = untrained["denoiser"]["params"]["layers"]
    layers["position"] = jax.tree.map(lambda leaf: np.stack([leaf] * 2), initial)
    _, _, position = run(untrained, on_device(SCENE), inputs)
    np.testing.assert_allclose(position, inputs.position, rtol=1e-6)


def test_gradient__is_finite_where_everything_is_padding(params):
    graph = jax.tree.map(np.zeros_like, on_device(SCENE, TWICE))
    nothing = jax.tree.map(np.zeros_like, widened(draw_inputs()))
    _, gradient = run_with_gradient(params, graph, nothing)
    chex.assert_tree_all_finite(gradient)


def test_linked_mean__is_that_of_the_linked_or_the_place_itself():
    position = np.array([[1, 2, 3], [7, 8, 9]], "f")
    tokens = np.concatenate([position, np.array([[0, 0, 0], [2, 0, 4]], "f")])
    linked = np.array([[0, 0, 1, 1], [0, 0, 0, 0]], "f")
    mean, count = jax.jit(linked_mean)(position, linked, tokens)
    np.testing.assert_allclose(mean, [[1, 0, 2], [7, 8, 9]])
    np.testing.assert_array_equal(count, [[2], [0]])
