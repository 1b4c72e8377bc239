"""One tiny run, trained once for every test here, and its compiled programs.

It is of a world of one's own, of which nothing of the package knows: a configuration says it all.
"""

import contextlib
import runpy
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import jax
import numpy as np
import pytest

from sg3d_jax import origin
from sg3d_jax.io import npz
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train import loop, rounds
from sg3d_jax.train.config import Config
from sg3d_jax.train.dataset import training_set
from sg3d_jax.train.loop import Run
from sg3d_jax.train.step import TrainCall, TrainState, init_state, make_train_call
from tests import command_line
from tests.own_world import ONTOLOGY, own_world

CONFIGURATION: Final = """
from sg3d_jax.fill.fd4 import FD4Config
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.scene.ontology import Concept, Ontology, Rule
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

ONTOLOGY = {ontology}

CONFIG = Config(
    data=DataConfig(name={data}),
    ontology=ONTOLOGY,
    model=FD4Config(encoder_width=8, encoder_layers=1, gates=2, node_width=8, pair_width=8,
        layers=1, heads=2, distance_width=8, distance_layers=1, noise_levels=2, topology_steps=3,
        distance_steps=2, kin=2),
    flagg=FlaggConfig(width=8, depth=1),
    optimiser=OptimiserConfig(learning_rate=1e-2, warmup_steps=2),
    steps=24, steps_per_call=4, batch=2, capacities=(32,), validate_every=12, validation_graphs=1,
)
"""


def worlds(count: int = 10) -> list[SceneGraph]:
    """Returns own worlds of different sizes."""
    graph = own_world()
    nodes = graph.nodes
    return [
        graph._replace(
            nodes=nodes._replace(position=nodes.position * factor, width=nodes.width * factor)
        )
        for factor in np.linspace(0.8, 1.2, count)
    ]


class Trained(NamedTuple):
    file: Path  # of the configuration
    directory: Path
    run: Run
    initial: TrainState
    train_call: TrainCall


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """The run from beginning to end, as `sg3d train` does it."""
    folder = tmp_path_factory.mktemp("trained")
    data, file = str(folder / "worlds.npz"), folder / "own.py"
    npz.save(data, worlds(), {"name": "worlds"})
    file.write_text(CONFIGURATION.format(ontology=repr(ONTOLOGY), data=repr(data)))
    with jax.debug_key_reuse(False), pytest.MonkeyPatch.context() as patch:
        run = loop.prepare(runpy.run_path(str(file))["CONFIG"])
        graph = jax.tree.map(lambda leaf: leaf[0], run.stacks[0])
        initial = init_state(run.config, run.model, graph)
        call = make_train_call(run.config, run.model)
        programs = Trained(file, folder / "run", run, initial, call)
        use(programs, patch)
        command_line.run("train", file, "-o", programs.directory)
    return programs


@pytest.fixture
def programs(trained: Trained, monkeypatch: pytest.MonkeyPatch) -> Trained:
    """Lets `loop.train` use what is already compiled, for whatever number of steps."""
    use(trained, monkeypatch)
    return trained


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Has jobs of workers done here; tells which rounds have been drawn."""
    seen = []

    def make(jobs: Sequence[rounds.Job]) -> list[list[SceneGraph]]:
        seen.append(jobs[0][0].seed >> 32)
        return [training_set(*job) for job in jobs]

    for where in (loop, rounds):
        monkeypatch.setattr(where, "workers", lambda: contextlib.nullcontext(make))
    return seen


@pytest.fixture(autouse=True)
def _no_check_of_key_reuse() -> Iterator[None]:
    """JAX takes a vmapped scan over keys for their reuse."""
    with jax.debug_key_reuse(False):
        yield


def use(programs: Trained, patch: pytest.MonkeyPatch) -> None:
    def prepare(config: Config) -> Run:
        return programs.run._replace(config=config)

    patch.setattr(loop, "prepare", prepare)
    patch.setattr(origin, "code", lambda: "as it is")  # also while somebody edits it
    patch.setattr(loop, "init_state", lambda config, model, graph: programs.initial)
    patch.setattr(loop, "make_train_call", lambda config, model: programs.train_call)
    patch.setattr(loop, "compile_calls", lambda call, *given: [call] * len(programs.run.stacks))
