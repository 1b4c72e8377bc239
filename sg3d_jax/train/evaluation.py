"""What can be scored, by name: anything that turns planes into scene graphs."""

from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sg3d_jax.baselines import rand
from sg3d_jax.infer.complete import complete_each
from sg3d_jax.io.formats import READABLE, read_graphs
from sg3d_jax.scene.graph import SceneGraph, observed_of, ontology_of
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.methods import METHODS, sampling_steps
from sg3d_jax.train.presets import BASELINES, parse
from sg3d_jax.train.weights import load_weights, names, with_diffusion_steps


class Made(NamedTuple):
    """What a method made of a scene."""

    graph: SceneGraph  # on the host
    halted: bool | None = None  # whether it was found complete; None if it did not grow
    pieces: np.ndarray | None = None  # see `score`; None if nothing is in pieces
    # How likely nodes and part-of edges are right; None if it was not told.
    confidence: tuple[np.ndarray, np.ndarray] | None = None


class Result(NamedTuple):
    """What a method made of some scenes."""

    graphs: list[SceneGraph]  # one a scene
    halted: float | None = None  # share of graphs that a growing method found complete
    pieces: list[np.ndarray] | None = None  # of each graph, see `score`; None for one each
    # Of each graph, how likely its nodes and part-of edges are right; None if it was not told.
    confidence: list[tuple[np.ndarray, np.ndarray]] | None = None


# Of scenes, a seed, and the places of those that are wanted: what is made of each, in order.
CompleteEach = Callable[[Sequence[SceneGraph], int, Sequence[int]], Generator[Made]]


class Contender(NamedTuple):
    """A method on a data set, trained or fitted, or graphs that somebody made."""

    name: str  # of the method; of graphs that somebody made, their file
    weights: str | None  # name or file; None for methods without
    data: DataConfig  # what it is scored on: its own data set unless another is asked for
    complete_each: CompleteEach
    target: Callable[[SceneGraph], SceneGraph] = lambda graph: graph  # what is to be completed
    diffusion_steps: int | None = None  # of the topology; None for methods without

    def complete(self, scenes: Sequence[SceneGraph], seed: int) -> Result:
        """Completes all of some scenes."""
        return joined(list(self.complete_each(scenes, seed, range(len(scenes)))))


def joined(made: Sequence[Made]) -> Result:
    """Puts what a method made of each scene together."""
    graphs, halted, pieces, confidence = (list(field) for field in zip(*made, strict=True))
    return Result(
        graphs,
        None if None in halted else float(np.mean(halted)),
        None if any(one is None for one in pieces) else pieces,
        None if None in confidence else confidence,
    )


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
        return Contender(name, None, source, _at_once(lambda scenes, seed: _read(name, scenes)))
    model = BASELINES[method](load_split(source, "train"), source.label)
    drawn = _at_once(lambda scenes, seed: rand.complete(model, scenes, seed))
    return Contender(method, None, source, drawn)


def _at_once(complete: Callable[[Sequence[SceneGraph], int], list[SceneGraph]]) -> CompleteEach:
    """Returns completing by what makes all graphs at once."""

    def complete_each(
        scenes: Sequence[SceneGraph], seed: int, places: Sequence[int]
    ) -> Generator[Made]:
        graphs = complete(scenes, seed)
        yield from (Made(graphs[place]) for place in places)

    return complete_each


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
    trained = with_diffusion_steps(load_weights(name), diffusion_steps)
    config, source = trained.config, trained.config.data
    if data is None and len(source.names) > 1:
        raise ValueError(f"{name} is not of one data set, expected --data with one")
    if data is not None and data != source.name:
        source = DataConfig(data, None, source.seed, source.split_seed)

    def each(scenes: Sequence[SceneGraph], seed: int, places: Sequence[int]) -> Generator[Made]:
        wanted = [scenes[place] for place in places]
        names = [f"scene {place}" for place in places]
        completed = complete_each(
            trained.model,
            trained.params,
            wanted,
            seed,
            candidates=candidates,
            names=names,
            numbers=places,
        )
        for (one,) in completed:
            halted = None if one.halt_reason == "ONE_SHOT" else one.halt_reason == "HALTED"
            sure = None
            if one.node_confidence is not None and one.edge_confidence is not None:
                sure = one.node_confidence, one.edge_confidence
            yield Made(one.graph, halted, one.pieces, sure)

    return Contender(
        name=config.method,
        weights=name,
        data=source,
        complete_each=each,
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
