"""Training steps, on a model of two parameters."""

import dataclasses
import functools
import runpy
import types

import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import optax
import pytest

from sg3d_jax.infer.lanes import root_key
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from sg3d_jax.scene.padding import Capacity, stack
from sg3d_jax.train import step
from sg3d_jax.train.config import OptimiserConfig
from sg3d_jax.train.step import TrainState, make_optimiser, make_train_call
from tests.tiny_run import ROOT, read_config, small_floors

CONFIG = dataclasses.replace(
    read_config("test"),
    optimiser=OptimiserConfig(warmup_steps=2, ema_decay=0.3),
    steps=12,
    batch=12,
)
SHARED = dataclasses.replace(CONFIG, batch=3, accumulate=4)  # as many graphs a step


class Toy:
    """A model of two parameters."""

    def loss(self, params, key, graph):
        noise, width = jax.random.normal(key), graph.nodes.width[0]
        terms = {"noise": noise, "width": width}
        return jnp.sum((params - jnp.stack([width, noise])) ** 2), terms

    def init(self, key, graph):
        return START

    ontology = PAPER_ONTOLOGY


START = jnp.array([2.0, -1.0])


def new_call(steps_per_call, config=CONFIG):
    return make_train_call(dataclasses.replace(config, steps_per_call=steps_per_call), Toy())


one_call = functools.cache(new_call)


@pytest.fixture(scope="module")
def graphs():
    return stack(small_floors(), Capacity(24, 64))


@functools.cache
def start():
    optimiser = make_optimiser(CONFIG).init(START)
    return TrainState(START, START, optimiser, jnp.zeros((), jnp.int32))


def copied(state):
    return jax.tree.map(np.array, state)


def run(call, graphs, num_calls):
    """Returns the states after every call, and the metrics."""
    states, metrics = [start()], []
    for _ in range(num_calls):
        state, values = call(copied(states[-1]), jax.random.key(7), graphs)
        states.append(state)
        metrics.append({name: float(value) for name, value in values.items()})
    return states, metrics


@pytest.mark.parametrize(("batch_nodes", "batch"), [(8192, 3), (72, 3), (71, 2), (48, 2), (5, 1)])
def test_batches_of_large_graphs_are_smaller(graphs, batch_nodes, batch):
    config = dataclasses.replace(CONFIG, batch=3, batch_nodes=batch_nodes)
    assert step.batch_of(config, graphs) == batch


def test_there_is_one_trace_a_bucket(graphs):
    other = stack(small_floors(), Capacity(32, 64))
    for bucket in (graphs, graphs, other, graphs, other):
        one_call(2)(copied(start()), jax.random.key(0), bucket)
    assert one_call(2)._cache_size() == 2


def test_a_call_of_many_steps_is_many_calls_of_one(graphs):
    together, averaged = run(one_call(2), graphs, 2)
    alone, metrics = run(one_call(1), graphs, 4)
    assert int(together[-1].step) == int(alone[-1].step) == 4
    for one, other in zip(*map(jax.tree.leaves, (together[-1], alone[-1])), strict=True):
        npt.assert_allclose(one, other, rtol=1e-5, atol=1e-7)
    for call, values in enumerate(averaged):
        for name, value in values.items():
            steps = [row[name] for row in metrics[2 * call : 2 * call + 2]]
            npt.assert_allclose(value, np.mean(steps), rtol=1e-5)


def test_the_average_follows_its_formula(graphs):
    states, _ = run(one_call(1), graphs, 6)
    average, decays = np.asarray(START), []
    for number, state in enumerate(states[1:]):
        decay = min(0.3, (1 + number) / (10 + number))
        decays.append(decay)
        average = decay * average + (1 - decay) * np.asarray(state.params)
        npt.assert_allclose(state.average, average, rtol=1e-5)
    assert decays[0] < 0.3 == decays[-1]
    assert not np.array_equal(states[-1].average, states[-1].params)


def test_the_update_is_adam_on_the_clipped_gradient_with_warm_up(graphs):
    states, metrics = run(one_call(1), graphs, 4)
    npt.assert_array_equal(states[1].params, START)  # the rate starts at zero
    moved = np.abs(np.asarray(states[2].params) - np.asarray(START))
    rate = CONFIG.optimiser.learning_rate / CONFIG.optimiser.warmup_steps
    assert (moved <= 1.5 * rate).all()
    assert (moved > 0).all()
    first_moment = optax.tree.get(states[1].optimiser, "mu")
    clipped = min(metrics[0]["gradient_norm"], CONFIG.optimiser.clip_norm)
    npt.assert_allclose(np.linalg.norm(first_moment), 0.1 * clipped, rtol=1e-4)


def test_draws_follow_from_the_key_and_the_step(graphs):
    call = one_call(1)
    (_, first), (_, again) = (run(call, graphs, 3) for _ in range(2))
    assert first == again
    assert len({row["noise"] for row in first}) == 3
    _, other = call(copied(start()), jax.random.key(8), graphs)
    assert float(other["noise"]) != first[0]["noise"]


def test_every_graph_of_a_bucket_is_drawn(graphs):
    _, metrics = run(one_call(1, dataclasses.replace(CONFIG, batch=1)), graphs, 60)
    widths = {np.float32(row["width"]) for row in metrics}
    assert widths == set(np.asarray(graphs.nodes.width[:, 0]).tolist())


def test_weights_and_metrics_do_not_depend_on_the_devices_bit_for_bit(graphs, monkeypatch):
    two, devices = one_call(2, SHARED), jax.devices()[:1]
    monkeypatch.setattr(jax, "devices", lambda: devices)
    reached = [run(call, graphs, 20) for call in (new_call(2, SHARED), two)]
    assert len(reached[1][0][-1].params.devices()) == 2
    for one, other in zip(*map(jax.tree.leaves, reached), strict=True):
        npt.assert_array_equal(one, other)


def test_several_batches_a_step_are_one_of_all_their_graphs(graphs):
    together, apart = (run(one_call(2, config), graphs, 5) for config in (CONFIG, SHARED))
    for one, other in zip(*map(jax.tree.leaves, (together, apart)), strict=True):
        npt.assert_allclose(one, other, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize(("accumulate", "devices"), [(1, 1), (2, 2), (3, 1), (4, 2)])
def test_a_step_is_spread_over_as_many_devices_as_share_it_evenly(accumulate, devices):
    assert step.mesh_of(dataclasses.replace(CONFIG, accumulate=accumulate)).size == devices


def test_a_call_takes_the_memory_of_the_state_that_it_is_given(graphs):
    call, given = one_call(1), jax.tree.map(jnp.copy, start())
    call(given, jax.random.key(7), graphs)
    assert all(leaf.is_deleted() for leaf in jax.tree.leaves(given))


def test_seeds_side_by_side_are_trainings_one_by_one(graphs):
    config = dataclasses.replace(CONFIG, steps_per_call=2)
    run = types.SimpleNamespace(config=config, model=Toy(), stacks=[graphs])
    script = runpy.run_path(str(ROOT / "examples" / "seeds.py"))
    together = list(script["trained"](run, (3, 8)))
    assert len(together) == 6
    last = together[-1][0]  # those before have lent it their memory
    for row, seed in enumerate((3, 8)):
        state, call, key = copied(start()), one_call(2), root_key(seed + 1)
        for _, metrics in together:
            state, values = call(copied(state), key, graphs)
            npt.assert_allclose(metrics["loss"][row], values["loss"], rtol=1e-5)
        npt.assert_allclose(last.average[row], state.average, rtol=1e-5)
    assert np.abs(last.params[0] - last.params[1]).max() > 1e-4
