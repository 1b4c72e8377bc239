"""A run so small that it trains in seconds, on floors that share one bucket of every kind."""

import dataclasses
import functools
import runpy
from pathlib import Path
from typing import Final

import jax

from sg3d_jax.data import registry, schema
from sg3d_jax.flagg.sample import growth_capacity
from sg3d_jax.scene.concepts import PLANE
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train import loop
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig
from sg3d_jax.train.step import init_state
from sg3d_jax.train.weights import save_weights

ROOT: Final = Path(__file__).parents[1]
CONFIGS: Final = ROOT / "configs"
NODES: Final = 24  # of the one training bucket
GROWN_NODES: Final = 32  # of the one growth bucket
NUM_GRAPHS: Final = 10  # six to train on, two for validation, two for test


def read_config(name: str) -> Config:
    return runpy.run_path(str(CONFIGS / f"{name}.py"))["CONFIG"]


@functools.cache
def small_floors() -> list[SceneGraph]:
    """Returns floors of about a dozen planes, the first of S-F-square that suit."""
    suited = [graph for graph in registry.make("s-f-square", 100) if _is_small(graph)]
    assert len(suited) >= NUM_GRAPHS
    return suited[:NUM_GRAPHS]


def _is_small(graph: SceneGraph) -> bool:
    label = graph.nodes.label
    capacity = growth_capacity(int((label == PLANE).sum()))
    return len(label) <= NODES and capacity.nodes == GROWN_NODES


def tiny_config(folder: Path) -> Config:
    """Returns a run on `small_floors`, which it writes into a folder."""
    path = folder / "floors.npz"
    schema.save(path, small_floors(), registry.header("s-f-square"))
    return dataclasses.replace(
        read_config("test"),
        data=DataConfig(name=str(path)),
        optimiser=OptimiserConfig(learning_rate=1e-2, warmup_steps=2),
        steps=24,
        steps_per_call=4,
        batch=2,
        capacities=(NODES,),
        validate_every=12,
    )


def untrained_weights(folder: Path) -> Path:
    """Writes the initial weights of a run on `small_floors`."""
    run = loop.prepare(tiny_config(folder))
    state = init_state(run.config, run.model, jax.tree.map(lambda leaf: leaf[0], run.stacks[0]))
    return save_weights(folder / "tiny.npz", run.config, run.statistics, state.params)
