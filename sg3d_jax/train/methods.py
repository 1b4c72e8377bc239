"""Methods by name: anything that turns planes into scene graphs and can be scored."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.baselines import rand
from sg3d_jax.data.formats import READABLE, read_graphs
from sg3d_jax.scene.graph import SceneGraph, planes_of
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.models import complete, sampling_steps, share_halted
from sg3d_jax.train.weights import load_weights, with_diffusion_steps

RAND: Final = "rand"  # sized as the text of the paper says
RAND_SIZED: Final = "rand-sized"  # sized as the paper's published pictures and scores are
BASELINES: Final = (RAND, RAND_SIZED)


class Result(NamedTuple):
    """What a method made of some scenes."""

    graphs: list[SceneGraph]  # one a scene
    halted: float | None  # share of graphs that a growing method found complete; None for others


class Method(NamedTuple):
    """A method on a data set."""

    data: DataConfig  # what it is scored on: its own data set unless another is asked for
    complete: Callable[[Sequence[SceneGraph], int], Result]  # of scenes and a seed
    diffusion_steps: int | None  # of the topology; None for methods without


def load_method(name: str, data: str | None = None, diffusion_steps: int | None = None) -> Method:
    """Returns a method, trained or fitted.

    Args:
      name: one of `BASELINES`; weights by name or as an npz file; or a file of graphs that were
        made of the scenes, in their order, in any format of `formats` but npz.
      data: a data set by name or a file; None for the one that weights were trained on.
      diffusion_steps: sampling steps of the topology; None for those of the weights.

    Raises:
      ValueError: there is no such method, it needs a data set, or it has no diffusion steps.
    """
    suffix = Path(name).suffix.lower()
    if name not in BASELINES and (suffix == ".npz" or suffix not in READABLE):
        return _weights(name, data, diffusion_steps)
    if diffusion_steps is not None:
        raise ValueError(f"{name} has no diffusion steps, got {diffusion_steps}")
    if data is None:
        raise ValueError(f"{name} is not of one data set, expected --data with one")
    source = DataConfig(name=data)
    if name not in BASELINES:
        return Method(source, lambda scenes, seed: Result(_read(name, scenes), None), None)
    training = load_split(source, "train")
    model = rand.fit(training) if name == RAND else rand.fit_sized(training, source.label)
    return Method(
        source, lambda scenes, seed: Result(rand.complete(model, scenes, seed), None), None
    )


def _weights(name: str, data: str | None, diffusion_steps: int | None) -> Method:
    """Returns growing by trained weights."""
    trained = load_weights(name)
    if diffusion_steps is not None:
        trained = with_diffusion_steps(trained, diffusion_steps)
    source = trained.config.data
    if data is not None and data != source.name:
        source = dataclasses.replace(source, name=data, num_graphs=None)

    def grow(scenes: Sequence[SceneGraph], seed: int) -> Result:
        made = [one for one, *_ in complete(trained.model, trained.params, scenes, seed)]
        return Result([one.graph for one in made], share_halted(made))

    return Method(source, grow, sampling_steps(trained.config.model))


def _read(path: str, scenes: Sequence[SceneGraph]) -> list[SceneGraph]:
    """Reads the graphs that somebody made of some scenes."""
    graphs = read_graphs(path)
    if len(graphs) != len(scenes):
        raise ValueError(
            f"{path}: holds {len(graphs)} graphs, expected one for {len(scenes)} scenes"
        )
    for index, pair in enumerate(zip(graphs, scenes, strict=True)):
        made, given = (planes_of(graph).nodes.position for graph in pair)
        if made.shape != given.shape or not np.allclose(made, given, atol=1e-6):
            raise ValueError(f"{path}: graph {index} has other planes than its scene")
    return graphs
