"""What can be scored, by name: anything that turns planes into scene graphs."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sg3d_jax.baselines import rand
from sg3d_jax.infer.complete import complete, share_halted
from sg3d_jax.io.formats import READABLE, read_graphs
from sg3d_jax.scene.graph import SceneGraph, observed_of, ontology_of
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.methods import METHODS, sampling_steps
from sg3d_jax.train.presets import BASELINES, parse
from sg3d_jax.train.weights import load_weights, names, with_diffusion_steps


class Result(NamedTuple):
    """What a method made of some scenes."""

    graphs: list[SceneGraph]  # one a scene
    halted: float | None = None  # share of graphs that a growing method found complete
    pieces: list[np.ndarray] | None = None  # of each graph, see `score`; None for one each
    # Of each graph, how likely its nodes and part-of edges are right; None if it was not told.
    confidence: list[tuple[np.ndarray, np.ndarray]] | None = None


class Contender(NamedTuple):
    """A method on a data set, trained or fitted, or graphs that somebody made."""

    name: str  # of the method; of graphs that somebody made, their file
    weights: str | None  # name or file; None for methods without
    data: DataConfig  # what it is scored on: its own data set unless another is asked for
    complete: Callable[[Sequence[SceneGraph], int], Result]  # of scenes and a seed
    target: Callable[[SceneGraph], SceneGraph] = lambda graph: graph  # what is to be completed
    diffusion_steps: int | None = None  # of the topology; None for methods without


def load_contender(
    name: str, data: str | None = None, diffusion_steps: int | None = None, candidates: int = 1
) -> Contender:
    """Returns a method, trained or fitted.

    Args:
      name: weights by name or as an npz file; METHOD-DATASET, such as rand-s-f; rand or rand-sized;
        or a file of graphs that were made of the scenes, in their order, in any format of `formats`
        but npz.
      data: a data set by name or a file; None for that of the name or of the weights.
      diffusion_steps: sampling steps of the topology; None for those of the weights.
      candidates: graphs that trained weights draw of each scene; what most have is kept.

    Raises:
      ValueError: there is no such method, it needs a data set, it has no diffusion steps, or it
        draws no candidates.
    """
    suffix = Path(name).suffix.lower()
    named = parse(name)
    method, home = named or (name, None)
    data = data or home
    if method not in BASELINES and (suffix == ".npz" or suffix not in READABLE):
        weights = _weights_of(*named) if named else name
        return _trained(weights, data, diffusion_steps, candidates)
    if diffusion_steps is not None:
        raise ValueError(f"{name} has no diffusion steps, got {diffusion_steps}")
    if candidates != 1:
        raise ValueError(f"{name} has no trained weights, expected 1 candidate, got {candidates}")
    if data is None:
        raise ValueError(f"{name} is not of one data set, expected --data with one")
    source = DataConfig(name=data)
    if method not in BASELINES:
        return Contender(name, None, source, lambda scenes, seed: Result(_read(name, scenes)))
    model = BASELINES[method](load_split(source, "train"), source.label)
    return Contender(
        method, None, source, lambda scenes, seed: Result(rand.complete(model, scenes, seed))
    )


def _weights_of(method: str, data: str) -> str:
    """Returns the name of the weights with which a method is scored on a data set."""
    spec = METHODS[method]
    name = f"{method}-{spec.home if spec.trained_at_home else data}"
    if name not in names():
        raise ValueError(
            f"no weights {name} come with the package: `sg3d train {name}` trains them, and "
            f"`sg3d evaluate runs/{name}/weights.npz` scores them"
        )
    return name


def _trained(
    name: str, data: str | None, diffusion_steps: int | None, candidates: int
) -> Contender:
    """Returns completing by trained weights."""
    trained = load_weights(name)
    if diffusion_steps is not None:
        trained = with_diffusion_steps(trained, diffusion_steps)
    config, source = trained.config, trained.config.data
    if data is None and len(source.names) > 1:
        raise ValueError(f"{name} is not of one data set, expected --data with one")
    if data is not None and data != source.name:
        source = DataConfig(data, None, source.seed, source.split_seed)

    def complete_all(scenes: Sequence[SceneGraph], seed: int) -> Result:
        completed = complete(trained.model, trained.params, scenes, seed, candidates=candidates)
        made = [one for one, *_ in completed]
        told = [
            (one.node_confidence, one.edge_confidence)
            for one in made
            if one.node_confidence is not None and one.edge_confidence is not None
        ]
        confidence = told if len(told) == len(made) else None
        pieces = [one.pieces for one in made]
        return Result([one.graph for one in made], share_halted(made), pieces, confidence)

    return Contender(
        name=config.method,
        weights=name,
        data=source,
        complete=complete_all,
        target=METHODS[config.method].target,
        diffusion_steps=sampling_steps(config.model),
    )


def _read(path: str, scenes: Sequence[SceneGraph]) -> list[SceneGraph]:
    """Reads the graphs that somebody made of some scenes."""
    graphs = read_graphs(path)
    if len(graphs) != len(scenes):
        raise ValueError(
            f"{path}: holds {len(graphs)} graphs, expected one for {len(scenes)} scenes"
        )
    for index, pair in enumerate(zip(graphs, scenes, strict=True)):
        made, given = (observed_of(graph).nodes.position for graph in pair)
        if made.shape != given.shape or not np.allclose(made, given, atol=1e-6):
            observed = ontology_of(pair[1]).observed_plural
            raise ValueError(f"{path}: graph {index} has other {observed} than its scene")
    return graphs
