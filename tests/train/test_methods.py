"""Every method can be trained, validated and stored by the same functions."""

import dataclasses

import jax
import numpy as np
import pytest

from sg3d_jax.baselines.edge_features import Scales
from sg3d_jax.fill.fd4 import FD4, FD4Config
from sg3d_jax.fill.protocol import Statistics
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.scene.ontology import FLOOR, PAPER_ONTOLOGY
from sg3d_jax.train import methods
from sg3d_jax.train.methods import METHODS
from sg3d_jax.train.step import init_state, make_train_call
from tests.tiny_run import MODELS, measured, shortest_run, untrained_model
from tests.two_rooms import on_device, two_rooms

GROWN = [name for name, spec in METHODS.items() if spec.grows]
CLASSIFIERS = [name for name, spec in METHODS.items() if spec.statistics is Scales]
DIFFUSING = [name for name, spec in METHODS.items() if spec.steps is not None]


def test_methods_are_those_of_the_paper_that_are_trained():
    assert list(METHODS) == list(MODELS) == ["ec-square", "ec-l", "midi-or", "fd4", "midi"]
    assert GROWN == ["fd4", "midi"]
    assert DIFFUSING == ["midi-or", "fd4", "midi"]


@pytest.mark.parametrize("method", METHODS)
def test_a_configuration_knows_its_method(method):
    assert methods.method_of(METHODS[method].config()) == method
    assert methods.method_of(MODELS[method]) == method


@pytest.mark.parametrize("method", ["ec-l", "midi-or", "midi"])  # the others train in other tests
def test_every_method_has_a_training_step(method, tmp_path):
    config, model = shortest_run(tmp_path, method), untrained_model(method)
    graph = on_device(two_rooms())
    stack = jax.tree.map(lambda leaf: np.asarray(leaf)[None], graph)

    def two_steps(stack):
        state = init_state(config, model, graph)
        return state, make_train_call(config, model)(state, jax.random.key(0), stack)

    before, (after, metrics) = jax.eval_shape(two_steps, stack)
    assert jax.tree.map(lambda leaf: leaf.shape, after) == jax.tree.map(
        lambda leaf: leaf.shape, before
    )
    assert {"loss", "gradient_norm"} < metrics.keys()
    assert {leaf.shape for leaf in metrics.values()} == {()}


@pytest.mark.parametrize("method", ["ec-l", "midi-or"])  # the others train in other tests
def test_what_is_counted_is_what_the_model_is_built_with(method):
    stack = jax.tree.map(lambda leaf: np.asarray(leaf)[None], on_device(two_rooms()))
    counted = methods.measure(MODELS[method], None, [stack])
    assert type(counted) is METHODS[method].statistics
    assert type(counted) is (Scales if method in CLASSIFIERS else Statistics)


def test_edge_classifiers_are_scored_without_floors():
    truth = two_rooms()
    for method in METHODS:
        target = METHODS[method].target(truth)
        if method in CLASSIFIERS:
            assert set(truth.nodes.label) - set(target.nodes.label) == {FLOOR}
        else:
            assert target is truth


@pytest.mark.parametrize("method", DIFFUSING)
def test_diffusion_steps_are_changed_by_one_function(method):
    config = MODELS[method]
    for steps in (1, 500):
        other = methods.with_sampling_steps(config, steps)
        assert methods.sampling_steps(other) == steps
        field = METHODS[method].steps
        assert dataclasses.replace(other, **{field: getattr(config, field)}) == config
    for steps in (0, 501):
        with pytest.raises(ValueError, match=rf"must be in 1\.\.500, got {steps}"):
            methods.with_sampling_steps(config, steps)


@pytest.mark.parametrize("method", CLASSIFIERS)
def test_a_method_without_diffusion_has_no_steps(method):
    assert methods.sampling_steps(MODELS[method]) is None
    with pytest.raises(ValueError, match=f"{method} has no diffusion steps, got 3"):
        methods.with_sampling_steps(MODELS[method], 3)


@pytest.mark.parametrize("method", METHODS)
def test_models_that_are_built_alike_are_one_to_a_compiler(method):
    one, again = untrained_model(method), untrained_model(method)
    assert one is not again
    assert one == again
    assert hash(one) == hash(again)
    statistics = measured(method)._replace(**{measured(method)._fields[-1]: 7.5})
    flagg = one.config if METHODS[method].grows else None
    other = methods.build_model(MODELS[method], flagg, statistics, PAPER_ONTOLOGY)
    assert other != one


def test_a_fill_model_of_ones_own_is_a_method(monkeypatch):
    monkeypatch.setattr(methods, "METHODS", dict(METHODS))

    @dataclasses.dataclass(frozen=True)
    class OwnConfig(FD4Config):
        pass

    methods.register_fill("own", OwnConfig, FD4, "topology_steps")
    methods.register_fill("own", OwnConfig, FD4, "topology_steps")  # its file may run twice
    assert methods.method_of(OwnConfig()) == "own"
    model = methods.build_model(OwnConfig(), FlaggConfig(), measured("fd4"), PAPER_ONTOLOGY)
    assert model.fill == FD4(OwnConfig(), measured("fd4"))
    assert methods.sampling_steps(OwnConfig(topology_steps=9)) == 9
    with pytest.raises(ValueError, match="a method 'own' is there already"):
        methods.register_fill("own", FD4Config, FD4)
    with pytest.raises(ValueError, match="int is the configuration of no method"):
        methods.method_of(3)
