import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import jax
import numpy as np
import numpy.testing as npt
import pytest
from jax.sharding import Mesh

from sg3d_jax.flagg.grow import CAPACITY, HALTED, MAX_STEPS
from sg3d_jax.infer import devices, lanes
from sg3d_jax.infer.devices import num_lanes
from sg3d_jax.infer.lanes import (
    Model,
    OneShot,
    complete_lanes,
    growth_capacity,
    largest_capacity,
    root_key,
    sample_keys,
)
from sg3d_jax.infer.prepare import prepare
from sg3d_jax.scene.graph import subgraph, undirected_edges
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, PART_OF
from sg3d_jax.scene.padding import NODE_CAPACITIES, Capacity
from tests.growing_rooms import NEVER, AddWalls, grows_rooms, stop_at
from tests.tiny_run import untrained_model
from tests.two_rooms import two_rooms

MODEL = grows_rooms(1, 2, fill=AddWalls())  # of which every slot may be one
LIMIT = 22  # steps: more than any test needs that does not ask for it
PARTS = [subgraph(two_rooms(), np.arange(count)) for count in (8, 5, 3, 2, 7)]


@pytest.fixture(autouse=True)
def _no_check_of_key_reuse():
    """JAX takes a vmapped loop over keys for their reuse."""
    with jax.debug_key_reuse(False):
        yield


def each(scenes, params, seed=0, samples=1, begun=(), **options):
    def course(scene):
        if isinstance(begun, list):
            begun.append(len(scene.given.nodes.label))
        return (yield range(samples))

    prepared = prepare(scenes, PAPER_ONTOLOGY, options.pop("keep", False))
    return complete_lanes(MODEL, params, prepared, course, seed, LIMIT, **options)


def completed(*args, **options):
    return list(each(*args, **options))


def assert_same(one, other):
    assert (one.halt_reason, one.steps) == (other.halt_reason, other.steps)
    for found, expected in zip(one.graph.nodes, other.graph.nodes, strict=True):
        npt.assert_array_equal(found, expected)
    npt.assert_array_equal(*(undirected_edges(each.graph, PART_OF) for each in (one, other)))


def assert_all_same(found, expected):
    for samples, others in zip(found, expected, strict=True):
        for one, other in zip(samples, others, strict=True):
            assert_same(one, other)


def test_results_depend_neither_on_the_number_of_lanes_nor_on_that_of_threads(monkeypatch):
    """Nor on the devices that batches are dealt to."""
    threads = set()
    run = lanes._Runner.run

    def noted(*arguments):
        threads.add(threading.get_ident())
        return run(*arguments)

    monkeypatch.setattr(lanes._Runner, "run", noted)
    monkeypatch.setattr(lanes, "num_workers", lambda: 3)
    expected = completed(PARTS, stop_at(11), samples=2)
    assert len(threads - {threading.get_ident()}) > 1
    monkeypatch.setattr(lanes, "num_workers", lambda: 1)
    # Of the six jobs of the larger bucket each device has three, for two lanes and eight places.
    larger = [0, 1, 4]
    mesh = Mesh(np.array(jax.devices()[:2]), ("lanes",))
    monkeypatch.setattr(lanes, "lane_mesh", lambda: mesh)
    scenes, options = [PARTS[place] for place in larger], {"numbers": larger, "lanes": 2}
    with jax.set_mesh(jax.make_mesh((2,), ("users",))):  # is for the user's own arrays
        found = completed(scenes, stop_at(11), samples=2, **options)
    assert_all_same(found, [expected[place] for place in larger])


def test_parts_of_a_list_are_completed_as_in_the_whole_of_it():
    whole = completed(PARTS, stop_at(11))
    assert_all_same(completed(PARTS[2:4], stop_at(11), numbers=range(2, 4)), whole[2:4])


def test_results_come_while_only_some_are_begun(monkeypatch):
    begun = []
    monkeypatch.setattr(lanes, "num_workers", lambda: 1)
    monkeypatch.setattr(lanes, "BEGUN", 2)
    results = each(PARTS, stop_at(11), begun=begun)
    assert begun == []
    for count, (one,) in enumerate(results, 1):
        assert begun == [8, 5, 3, 2, 7][: count + 1]
        assert np.sum(one.graph.nodes.observed) == begun[count - 1]


def test_a_scene_is_asked_again_until_it_has_enough():
    told = []

    def course(scene):
        told.append((yield [0]))
        told.append((yield [2, 1]))
        return "enough"

    prepared = prepare(PARTS[:1], PAPER_ONTOLOGY, False)
    assert list(complete_lanes(MODEL, stop_at(11), prepared, course, 0, LIMIT)) == ["enough"]
    ((first, second, third),) = completed(PARTS[:1], stop_at(11), samples=3)
    assert_all_same(told, [[first], [third, second]])


def test_all_threads_are_told_what_the_caller_is():
    """By the context managers of JAX, such as which device to use."""
    told = dict.fromkeys(lanes.TOLD, True) | {
        "default_device": jax.devices()[1],
        "default_matmul_precision": "highest",
        "default_prng_impl": "rbg",
        "numpy_dtype_promotion": "strict",
        "numpy_rank_promotion": "warn",
    }

    def heard():
        return {name: getattr(jax.config, f"jax_{name}") for name in lanes.TOLD}

    before = heard()
    with ExitStack() as everything:
        for name, value in told.items():
            everything.enter_context(getattr(jax, name)(value))
        expected, run = heard(), lanes.as_here(heard)
    assert all(expected[name] != before[name] for name in lanes.TOLD)
    with ThreadPoolExecutor() as pool:
        assert pool.submit(run).result() == expected
        assert pool.submit(heard).result() != expected


def test_a_program_is_compiled_once_while_others_are_compiled_beside_it(monkeypatch):
    both, lock = threading.Barrier(2, timeout=60), threading.Lock()
    run, active = lanes._Runner.run, []

    def noted(runner, capacity, jobs):
        if runner.program(capacity) not in lanes._programs:
            with lock:
                assert capacity not in active
                active.append(capacity)
            both.wait()  # the other bucket is begun, too
        return run(runner, capacity, jobs)

    monkeypatch.setattr(lanes._Runner, "run", noted)
    monkeypatch.setattr(lanes, "_programs", set())
    monkeypatch.setattr(lanes, "num_workers", lambda: 2)
    given_back = []
    monkeypatch.setattr(lanes, "give_back_memory", lambda: given_back.append(1))
    completed(PARTS, stop_at(11))
    assert sorted(capacity.nodes for capacity in active) == [16, 24]
    monkeypatch.setattr(lanes, "growth_capacity", lambda *_: Capacity(24, 288))
    completed(PARTS, stop_at(11))
    assert len(active) == len(given_back) == 2


def test_what_goes_wrong_in_a_thread_is_told_and_nothing_more_is_begun(monkeypatch):
    monkeypatch.setattr(lanes, "num_workers", lambda: 1)
    begun = []

    def run(runner, capacity, jobs):
        begun.append(jobs)
        raise KeyboardInterrupt

    monkeypatch.setattr(lanes._Runner, "run", run)
    with pytest.raises(KeyboardInterrupt):
        completed(PARTS[:1] * 50, stop_at(11))
    assert len(begun) <= 2


def test_a_graph_that_does_not_fit_goes_on_in_the_next_bucket():
    """As it would have grown in a large one from the start, with the same keys."""
    scenes = [PARTS[0], PARTS[4]]
    assert growth_capacity(8).nodes == 24
    grown = completed(scenes, stop_at(30))
    assert [one.halt_reason for (one,) in grown] == [HALTED, HALTED]
    assert all(len(one.graph.nodes.label) >= 30 for (one,) in grown)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lanes, "growth_capacity", lambda *_: Capacity(48, 576))
        for (one,), (other,) in zip(grown, completed(scenes, stop_at(30)), strict=True):
            assert_same(one, other)


def test_a_graph_beyond_its_largest_bucket_is_given_up():
    assert growth_capacity(5).nodes == 24
    assert largest_capacity(5).nodes == 32
    assert largest_capacity(500).nodes == 1536
    assert largest_capacity(330).nodes == 768
    assert largest_capacity(5, 100).nodes == 128
    assert largest_capacity(10**6).nodes == NODE_CAPACITIES[-1]
    ((one,),) = completed(PARTS[1:2], NEVER)
    assert one.halt_reason == CAPACITY
    assert len(one.graph.nodes.label) in (31, 32)


def test_a_graph_may_be_kept_in_its_bucket():
    ((one,),) = completed(PARTS[1:2], NEVER, outgrow=False)
    assert one.halt_reason == CAPACITY
    assert len(one.graph.nodes.label) in (23, 24)


def test_the_number_of_steps_is_limited_over_all_buckets():
    ((one,),) = completed(PARTS[:1], NEVER)
    assert (one.halt_reason, one.steps) == (MAX_STEPS, LIMIT)
    assert len(one.graph.nodes.label) > growth_capacity(8).nodes


def test_a_partial_graph_has_room_for_what_is_given():
    assert growth_capacity(8).nodes == growth_capacity(8, 12).nodes == 24
    assert growth_capacity(8, 60).nodes == 96
    assert growth_capacity(3, 60).nodes >= 68


def test_small_buckets_have_more_lanes_on_a_device_that_is_no_cpu(monkeypatch):
    capacities = [Capacity(nodes, 12 * nodes) for nodes in NODE_CAPACITIES]
    assert {num_lanes(capacity) for capacity in capacities} == {1}
    assert lanes.lane_mesh() is None
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    widths = [num_lanes(capacity) for capacity in capacities]
    assert widths == sorted(widths, reverse=True)
    assert (widths[0], widths[-1]) == (1024, 32)
    floors = Capacity(48, 576)
    of_few = [num_lanes(floors, count) for count in (1, 16, 17, 300, 9999)]
    assert of_few == [16, 16, 64, 1024, 1024]
    monkeypatch.setattr(devices, "device_memory", lambda: 6 * 2**30)
    assert [num_lanes(capacity) for capacity in capacities[2:5]] == [768, 512, 384]
    monkeypatch.setattr(devices, "device_memory", lambda: 2**20)
    assert {num_lanes(capacity) for capacity in capacities} == {1}
    assert lanes.num_workers() == 4
    assert lanes.lane_mesh().size == len(jax.local_devices())
    with jax.default_device(jax.devices()[0]):
        assert lanes.lane_mesh() is None


def test_keys_depend_on_scene_and_sample_alone():
    keys = sample_keys(3, [0, 0, 1, 5], [0, 1, 0, 2])
    data = jax.random.key_data(keys)
    assert len(np.unique(np.asarray(data), axis=0)) == 4
    npt.assert_array_equal(jax.random.key_data(sample_keys(3, [5], [2]))[0], data[3])


def test_seeds_of_any_size_give_different_keys():
    seeds = [0, 1, 2**31, 2**32 - 1, 2**32, 2**32 + 1, 2**64, 10**30]
    data = [tuple(np.asarray(jax.random.key_data(root_key(seed))).tolist()) for seed in seeds]
    assert len(set(data)) == len(seeds)
    for seed in (0, 7, 2**32 - 1):  # those that JAX takes are its own
        npt.assert_array_equal(
            jax.random.key_data(root_key(seed)), jax.random.key_data(jax.random.key(seed))
        )
    with pytest.raises(ValueError, match="the seed is -1, expected 0 or more"):
        root_key(-1)


@pytest.mark.parametrize("method", ["ec-square", "ec-l", "midi-or", "fd4", "midi"])
def test_every_model_is_one(method):
    model = untrained_model(method)
    assert isinstance(model, Model)
    assert isinstance(model, OneShot) == (method in ("ec-square", "ec-l", "midi-or"))
