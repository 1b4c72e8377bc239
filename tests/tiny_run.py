"""A run so small that it trains in seconds, on floors that share one bucket of every kind."""

import dataclasses
import functools
import runpy
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sg3d_jax.baselines.edge_classifier import ECLConfig, ECSquareConfig
from sg3d_jax.baselines.edge_features import Scales
from sg3d_jax.baselines.midi_oracle import MiDiOracleConfig
from sg3d_jax.data import registry
from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.fill.protocol import Statistics
from sg3d_jax.infer.lanes import Model, growth_capacity
from sg3d_jax.io import npz
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig
from sg3d_jax.train.methods import METHODS, Measured, build_model
from sg3d_jax.train.weights import save_weights
from tests.two_rooms import on_device, random_params, two_rooms

ROOT: Final = Path(__file__).parents[1]
CONFIGS: Final = ROOT / "configs"
NODES: Final = 24  # of the one training bucket
GROWN_NODES: Final = 32  # of the one growth bucket
NUM_GRAPHS: Final = 10  # six to train on, two for validation, two for test


def read_config(name: str) -> Config:
    return runpy.run_path(str(CONFIGS / f"{name}.py"))["CONFIG"]


SMALL: Final = {
    "encoder_width": 8,
    "encoder_layers": 1,
    "gates": 2,
    "node_width": 8,
    "pair_width": 8,
    "layers": 1,
    "heads": 2,
    "noise_levels": 1,
    "sampling_steps": 2,
}


STATISTICS: Final = Statistics(
    label=(0.0, 0.3, 0.4, 0.2, 0.1, 0.0),
    block_edge=(0.9, 0.1),
    cross_edge=(0.8, 0.2),
    distance_mean=3.1,
    distance_std=1.7,
    position_std=1.3,
)
SCALES: Final = Scales(0.4, 7.0, 9.0)


@functools.cache
def small_floors() -> list[SceneGraph]:
    """Returns floors of about a dozen planes, the first of S-F-square that suit."""
    suited = [graph for graph in registry.make("s-f-square", 100) if _is_small(graph)]
    assert len(suited) >= NUM_GRAPHS
    return suited[:NUM_GRAPHS]


def _is_small(graph: SceneGraph) -> bool:
    capacity = growth_capacity(int(graph.nodes.observed.sum()))
    return len(graph.nodes.label) <= NODES and capacity.nodes == GROWN_NODES


MODELS: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "ec-square": ECSquareConfig(heads=1, width=4, decoder=(4,)),
        "ec-l": ECLConfig(
            node_width=4,
            heads=2,
            edge_width=4,
            decoder=(4,),
            certainty_passes=2,
            readout_width=4,
        ),
        "midi-or": MiDiOracleConfig(**SMALL),
        "fd4": read_config("test").model,
        "midi": MiDiConfig(**SMALL),
    }
)


def shortest_run(folder: Path, method: str) -> Config:
    """Returns a run of two steps of any method on `small_floors`, which it writes into a folder."""
    path, config = folder / "floors.npz", read_config("test")
    npz.save(path, small_floors(), registry.header("s-f-square"))
    return dataclasses.replace(
        config,
        data=DataConfig(name=str(path)),
        model=MODELS[method],
        flagg=config.flagg if METHODS[method].grows else None,
        optimiser=OptimiserConfig(warmup_steps=1),
        steps=2,
        steps_per_call=2,
        batch=2,
        capacities=(NODES,),
        validate_every=2,
    )


def measured(method: str) -> Measured:
    """Returns what a model of any method knows of a training set that is made up."""
    return SCALES if METHODS[method].statistics is Scales else STATISTICS


def untrained_model(method: str) -> Model:
    """Returns a model of any method, for a training set that is made up."""
    flagg = read_config("test").flagg if METHODS[method].grows else None
    return build_model(MODELS[method], flagg, measured(method), PAPER_ONTOLOGY)


def untrained_weights(folder: Path, method: str = "fd4") -> Path:
    """Writes weights of a method, drawn at random, for `small_floors`.

    Growing ones find a graph complete after the first block, so that they fill no bucket.
    """
    config, model = shortest_run(folder, method), untrained_model(method)
    params = random_params(model.init, on_device(two_rooms()))
    if METHODS[method].grows:
        params.halt["params"]["logits"]["bias"] += 1e6
    return save_weights(folder / f"{method}.npz", config, measured(method), params)
