"""One tiny run, trained once for every test here, and its compiled programs."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import pytest

from sg3d_jax import origin
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train import loop, rounds
from sg3d_jax.train.config import Config
from sg3d_jax.train.dataset import training_set
from sg3d_jax.train.loop import Run
from sg3d_jax.train.step import TrainCall, TrainState, init_state, make_train_call
from tests.tiny_run import tiny_config


class Trained(NamedTuple):
    directory: Path
    run: Run
    initial: TrainState
    train_call: TrainCall


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """The run from beginning to end, as `sg3d train` does it."""
    folder = tmp_path_factory.mktemp("trained")
    with jax.debug_key_reuse(False), pytest.MonkeyPatch.context() as patch:
        run = loop.prepare(tiny_config(folder))
        graph = jax.tree.map(lambda leaf: leaf[0], run.stacks[0])
        initial = init_state(run.config, run.model, graph)
        programs = Trained(folder / "run", run, initial, make_train_call(run.config, run.model))
        use(programs, patch)
        loop.train(run.config, programs.directory)
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
