"""The linear layer is linen's, but for initial values, which it does not trace in vain."""

import functools

import jax
import numpy as np
import numpy.testing as npt
import pytest
from flax import errors
from flax import linen as nn

from sg3d_jax.nn.apply import Dense, apply

INPUTS = np.random.default_rng(0).normal(size=(2, 4, 3)).astype("f")
GIVEN = {"params": {"kernel": np.ones((3, 5), "f"), "bias": np.ones(5, "f")}}


@functools.cache
def ours_and_linens():
    """Returns both layers' initial parameters, and what they make of others; with bias and not."""

    def made(inputs):
        layers = [(Dense(5, use_bias), nn.Dense(5, use_bias)) for use_bias in (True, False)]
        params = [[layer.init(jax.random.key(0), inputs) for layer in pair] for pair in layers]
        outputs = [
            [apply(layer, jax.tree.map(lambda leaf: leaf + 1, ours), inputs) for layer in pair]
            for pair, (ours, _) in zip(layers, params, strict=True)
        ]
        return params, outputs

    return jax.tree.map(np.asarray, jax.jit(made)(INPUTS))


@pytest.mark.parametrize("case", [0, 1], ids=["with bias", "without"])
def test_initial_parameters__are_those_of_linen(case):
    ours, linens = ours_and_linens()[0][case]
    jax.tree.map(npt.assert_array_equal, ours, linens)


@pytest.mark.parametrize("case", [0, 1], ids=["with bias", "without"])
def test_outputs__are_those_of_linen_with_the_same_parameters(case):
    ours, linens = ours_and_linens()[1][case]
    npt.assert_array_equal(ours, linens)


def test_outputs__of_one_row_are_those_of_linen():
    row = INPUTS[:1, :1]
    outputs = [jax.jit(layer(5).apply)(GIVEN, row) for layer in (Dense, nn.Dense)]
    assert outputs[0].shape == (1, 1, 5)
    npt.assert_allclose(*outputs, rtol=1e-6)


@pytest.mark.parametrize(("name", "shape"), [("kernel", (4, 5)), ("bias", (6,))])
def test_parameters_of_another_shape__are_refused(name, shape):
    wrong = {"params": GIVEN["params"] | {name: np.ones(shape, "f")}}
    with pytest.raises(errors.ScopeParamShapeError, match=f'For parameter "{name}" in'):
        jax.eval_shape(Dense(5).apply, wrong, INPUTS)


def test_initial_values__are_not_asked_for_where_parameters_are_given(monkeypatch):
    def refuse(*_):
        raise AssertionError("an initial value is asked for")

    monkeypatch.setattr(nn.initializers, "zeros", refuse)
    layer = Dense(5, kernel_init=refuse)
    with pytest.raises(AssertionError, match="is asked for"):
        jax.eval_shape(layer.init, jax.random.key(0), INPUTS)
    assert jax.eval_shape(layer.apply, GIVEN, INPUTS).shape == (2, 4, 5)
