"""Every method can be trained, validated and stored by the same functions."""

import dataclasses

import jax
import pytest

from sg3d_jax.baselines.edge_features import Scales
from sg3d_jax.fill.protocol import Statistics
from sg3d_jax.flagg.grow import Completion
from sg3d_jax.scene.ontology import FLOOR
from sg3d_jax.train import models
from sg3d_jax.train.methods import CLASSIFYING, GROWING, METHODS
from sg3d_jax.train.step import init_state, make_train_call
from tests.tiny_run import MODELS, shortest_run, small_floors, untrained_model
from tests.two_rooms import CAPACITY, on_device, two_rooms

GROWN = [name for name, spec in METHODS.items() if spec.kind is GROWING]
CLASSIFIERS = [name for name, spec in METHODS.items() if spec.kind is CLASSIFYING]
DIFFUSING = [name for name, spec in METHODS.items() if spec.steps is not None]


def test_methods_are_those_of_the_paper_that_are_trained():
    assert list(METHODS) == list(MODELS) == ["ec-square", "ec-l", "midi-or", "fd4", "midi"]
    assert GROWN == ["fd4", "midi"]
    assert DIFFUSING == ["midi-or", "fd4", "midi"]


@pytest.mark.parametrize("method", METHODS)
def test_a_configuration_knows_its_method(method):
    assert models.method_of(METHODS[method].config()) == method
    assert models.method_of(MODELS[method]) == method


@pytest.mark.parametrize("method", ["ec-l", "midi-or", "midi"])  # the others train in other tests
def test_every_method_has_a_training_step(method, tmp_path):
    config, model = shortest_run(tmp_path, method), untrained_model(method)
    graph = on_device(two_rooms(), CAPACITY)
    stack = jax.tree.map(lambda leaf: leaf[None], graph)

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
    stack = jax.tree.map(lambda leaf: leaf[None], on_device(two_rooms(), CAPACITY))
    counted = models.measure(MODELS[method], None, [stack])
    assert type(counted) is METHODS[method].kind.statistics
    assert type(counted) is (Scales if method in CLASSIFIERS else Statistics)


def test_edge_classifiers_are_scored_without_floors():
    truth = two_rooms()
    for method in METHODS:
        target = models.target(untrained_model(method), truth)
        if method in CLASSIFIERS:
            assert set(truth.nodes.label) - set(target.nodes.label) == {FLOOR}
        else:
            assert target is truth


def test_the_share_of_halted_graphs_is_of_growing_methods():
    graph = small_floors()[0]
    completions = [Completion(graph, reason, 3) for reason in ("HALTED", "CAPACITY")]
    assert models.share_halted(completions) == 0.5
    assert models.share_halted([Completion(graph, "ONE_SHOT", 1)]) is None


def test_of_several_candidates_the_medoid_is_kept(monkeypatch):
    graphs = small_floors()
    drawn = [[Completion(graphs[i], "HALTED", i) for i in range(6)] for _ in range(2)]
    asked = []

    def complete(model, params, scenes, seed, samples):
        asked.append(samples)
        return drawn

    model = untrained_model("fd4")
    kind = GROWING._replace(complete=complete)
    monkeypatch.setattr(models, "_KIND_OF", {type(model): kind})
    monkeypatch.setattr(models, "medoids", lambda groups: [len(group) - 1 for group in groups])
    kept = models.complete(model, None, graphs[:2], samples=2, candidates=3)
    assert [[one.steps for one in samples] for samples in kept] == [[2, 5], [2, 5]]
    assert models.complete(model, None, graphs[:2], samples=6) is drawn
    assert asked == [6, 6]


@pytest.mark.parametrize("method", DIFFUSING)
def test_diffusion_steps_are_changed_by_one_function(method):
    config = MODELS[method]
    for steps in (1, 500):
        other = models.with_sampling_steps(config, steps)
        assert models.sampling_steps(other) == steps
        field = METHODS[method].steps
        assert dataclasses.replace(other, **{field: getattr(config, field)}) == config
    for steps in (0, 501):
        with pytest.raises(ValueError, match=rf"must be in 1\.\.500, got {steps}"):
            models.with_sampling_steps(config, steps)


@pytest.mark.parametrize("method", CLASSIFIERS)
def test_a_method_without_diffusion_has_no_steps(method):
    assert models.sampling_steps(MODELS[method]) is None
    with pytest.raises(ValueError, match=f"{method} has no diffusion steps, got 3"):
        models.with_sampling_steps(MODELS[method], 3)
