"""Training sets that are drawn anew: what a round has, and what becomes of workers."""

import dataclasses
import multiprocessing
import os
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import closing

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data import registry
from sg3d_jax.io import npz
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import stack_by_size, training_graphs, training_set
from sg3d_jax.train.rounds import made_side_by_side, rounds, workers
from tests.tiny_run import NODES, read_config, small_floors


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A set that is generated, a file, and views of the file, twice."""
    path = tmp_path_factory.mktemp("floors") / "floors.npz"
    npz.save(path, small_floors(), registry.header("s-f-square"))
    return DataConfig(f"s-f-square:5+{path}:5+{path}:5@robot+{path}:5@robot", views=2)


@pytest.fixture(scope="module")
def run(data):
    """Returns a run whose rounds are of ten steps, and its first stacks."""
    config = dataclasses.replace(
        read_config("test"), data=data, steps=30, fresh_every=10, capacities=(2 * NODES,)
    )
    return config, stack_by_size(training_graphs(data), config.capacities, spare=0.2)


def positions(graphs):
    return [graph.nodes.position.tobytes() for graph in graphs]


def test_all_that_is_drawn_is_drawn_anew_and_files_stay(data):
    first, second, again, third = (
        positions(training_graphs(data.anew(number))) for number in (0, 1, 1, 2)
    )
    assert second == again
    assert first == positions(training_graphs(data))
    assert len(first) == 3 + 3 + 4 * 3
    assert first[3:6] == second[3:6] == third[3:6]
    others = {each for graphs in (first, second, third) for each in graphs[:3] + graphs[6:]}
    assert len(others) == 3 * 15


def test_graphs_that_are_made_side_by_side_are_those_that_are_made_at_once(data):
    def make(jobs):
        assert len(jobs) == 1 + 1 + 2 + 2
        return [training_set(*job) for job in jobs]

    assert positions(made_side_by_side(make, data)) == positions(training_graphs(data))


def test_a_round_follows_from_its_number_and_has_the_shapes_of_the_first(run, drawn):
    config, stacks = run
    with closing(rounds(config, stacks, 0)) as coming:
        at_once = list(coming)
    with closing(rounds(config, stacks, 20)) as coming:
        (later,) = coming
    assert [one.until for one in at_once] == [10, 20, 30]
    assert drawn == [1, 2, 2]
    for one, other in zip(*map(jax.tree.leaves, (later, at_once[2])), strict=True):
        npt.assert_array_equal(one, other)
    for one in at_once:
        assert jax.tree.map(np.shape, one.stacks) == jax.tree.map(np.shape, stacks)
    seen = {np.asarray(one.stacks[0].nodes.position).tobytes() for one in at_once}
    assert len(seen) == 3
    assert at_once[0].stacks is stacks


def test_rounds_end_with_the_run_and_one_that_is_done_has_none(run, drawn):
    config, stacks = run
    short = dataclasses.replace(config, steps=14)
    assert [one.until for one in rounds(short, stacks, 12)] == [14]
    assert list(rounds(short, stacks, 14)) == []
    assert drawn == [1]


def test_what_is_not_drawn_anew_is_one_round(run):
    config, stacks = run
    config = dataclasses.replace(config, fresh_every=None)
    assert list(rounds(config, stacks, 4)) == [(stacks, 30)]


def test_graphs_that_are_left_out_are_remarked_on(run, drawn, capsys):
    config, stacks = run
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, title="floors"))
    narrow = [stacks[0]._replace(senders=stacks[0].senders[:, :100])]
    list(rounds(config, narrow, 20))
    sentence = "graphs that were drawn anew for the steps from 20 are left out, because they are la"
    assert f"of the 18 {sentence}" in capsys.readouterr().err


@pytest.mark.slow
def test_workers_give_way_and_end_with_their_block_whatever_they_do():
    with ThreadPoolExecutor(1) as asking:
        with workers() as make:
            job = DataConfig("s-f-square", num_graphs=5), 0
            assert positions(make([job])[0]) == positions(training_set(*job))
            with pytest.raises(ValueError, match="unknown data set 's-g'"):
                make([(DataConfig("s-g"), 0)])
            asked = asking.submit(make, [(DataConfig("s-c", num_graphs=30_000), 0)] * 9)
            begun = multiprocessing.active_children()
            nicer = {os.getpriority(os.PRIO_PROCESS, worker.pid) for worker in begun}
            assert min(19, os.nice(0) + 10) in nicer
            time.sleep(0.1)  # it is at work
        with pytest.raises((MemoryError, CancelledError)):
            asked.result()
    for worker in begun:
        worker.join(60)
        assert worker.exitcode is not None
