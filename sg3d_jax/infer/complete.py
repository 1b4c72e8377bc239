"""The one way in: scene graphs completed from host graphs, by any model."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.grow import DEFAULT_MAX_STEPS, HALT_REASONS
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.confidence import Confidence, judged, sure_of
from sg3d_jax.infer.consensus import consensus
from sg3d_jax.infer.lanes import Finished, Model, complete_lanes
from sg3d_jax.infer.prepare import Scene, finished, prepare
from sg3d_jax.scene.graph import SceneGraph, ontology_of

INCOMPLETE = ("CAPACITY", "MAX_STEPS")  # halt reasons of graphs that did not come to their end


class Completion(NamedTuple):
    """A completed graph on the host."""

    graph: SceneGraph  # unpadded, float64; what was given comes first, bit for bit if it was right
    halt_reason: str  # HALTED: found complete; CAPACITY, MAX_STEPS: cut off; ONE_SHOT: did not grow
    steps: int  # blocks inserted
    source: np.ndarray  # int[k], row in the scene of each node that was given
    confidence: Confidence  # how sure it is; HALTED says nothing about it
    remarks: tuple[str, ...]  # what was mended, is not plausible, or unsure; one sentence each
    pieces: np.ndarray  # int[observed], into how many each was cut; a piece may have its own room
    # How likely each is right, 0 to 1; what was given has 1. None if one graph was drawn.
    node_confidence: np.ndarray | None = None  # float64[n]
    edge_confidence: np.ndarray | None = None  # float64[e], of the rows of `parts_first(graph)`

    @property
    def num_given(self) -> int:
        """How many nodes were given."""
        return len(self.source)

    @property
    def observed(self) -> dict[str, np.ndarray]:
        """The rows of the observed nodes by concept."""
        return self._rows(lambda rows, observed: observed)

    @property
    def kept(self) -> dict[str, np.ndarray]:
        """The rows of other nodes that were given, by concept; empty unless asked to keep them."""
        return self._rows(lambda rows, observed: ~observed & (rows < self.num_given))

    @property
    def grown(self) -> dict[str, np.ndarray]:
        """The rows of the grown nodes by concept."""
        return self._rows(lambda rows, observed: rows >= self.num_given)

    def _rows(
        self, choose: Callable[[np.ndarray, np.ndarray], np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Returns the chosen rows of each concept that has any, bottom-up."""
        nodes, names = self.graph.nodes, ontology_of(self.graph).names
        chosen = choose(np.arange(len(nodes.label)), nodes.observed)
        return {
            name: np.flatnonzero(chosen & (nodes.label == label))
            for label, name in enumerate(names)
            if (chosen & (nodes.label == label)).any()
        }


def complete(
    model: Model,
    params: Params,
    scenes: Sequence[SceneGraph],
    seed: int = 0,
    samples: int = 1,
    candidates: int = 1,
    keep: bool = False,
    lanes: int | None = None,
    outgrow: bool = True,
    max_steps: int = DEFAULT_MAX_STEPS,
    names: Sequence[str] | None = None,
    normals: str = "check",
    cut: str = "auto",
) -> list[list[Completion]]:
    """Completes scene graphs from host graphs, in compiled batches.

    Args:
      model: of any method.
      params: its parameters.
      scenes: host graphs of any size, such as `sg.planes` or `sg.read_graphs` gives. Of each the
        observed nodes are taken; MiDi+Or also counts the others.
      seed: with the position of a scene in `scenes` and the number of the sample, fixes it.
      samples: graphs a scene.
      candidates: graphs that are drawn for each of them; what most of them have is kept.
      keep: take all nodes and part-of edges of a scene as given, such as rooms that are known, and
        grow on from there.
      lanes: scenes grown together in one call; None for as many as suit. Results do not depend on
        it.
      outgrow: whether a graph that does not fit its bucket goes on in the next, with room for up to
        three nodes a plane; else it ends there, with the halt reason CAPACITY.
      max_steps: a limit on the number of blocks.
      names: what a refusal calls each scene, such as "planes.jsonl: line 3".
      normals: "check" to turn normals that point out of rooms all over, "as-given" to turn none.
      cut: "auto" to cut planes that several rooms share where other walls abut, and to join the
        pieces again; "never" to leave them whole.

    Returns:
      For every scene, in order, its samples.

    Raises:
      ValueError: one sentence that names the scene, the node, the field and what was expected: a
        scene without planes, numbers that are none, wrong shapes; a model that cannot keep; numbers
        out of range.
    """
    for name, value in (
        ("samples", samples),
        ("candidates", candidates),
        ("lanes", 1 if lanes is None else lanes),
    ):
        if value < 1:
            raise ValueError(f"{name} is {value}, expected at least 1")
    if keep and not isinstance(model, Flagg):
        given = model.ontology.observed_plural
        raise ValueError(f"keep: this model completes {given} alone, expected one that grows")
    prepared = prepare(scenes, model.ontology, keep, names, normals, cut)
    numbers = seed, samples * candidates, max_steps, lanes
    drawn = complete_lanes(model, params, prepared, *numbers, outgrow)
    return [
        _completions(scene, results, candidates)
        for scene, results in zip(prepared, drawn, strict=True)
    ]


def share_halted(completions: Sequence[Completion]) -> float | None:
    """Returns the share of graphs that a growing model found complete; None for other models."""
    reasons = [completion.halt_reason for completion in completions]
    return None if "ONE_SHOT" in reasons else reasons.count("HALTED") / len(reasons)


def _completions(scene: Scene, results: Sequence[Finished], candidates: int) -> list[Completion]:
    """Returns what is kept of all that was drawn of one scene, and how sure it is."""
    drawn, num_given = [finished(scene, result.graph) for result in results], len(scene.source)
    kept = []
    for start in range(0, len(drawn), candidates):
        graph, index = consensus(drawn[start : start + candidates], num_given)
        kept.append((graph, results[start + index]))
    graphs = [graph for graph, _ in kept]
    judgements = judged(graphs, drawn, num_given)
    # One draw alone tells nothing of its nodes and edges.
    sure = sure_of(graphs, drawn, num_given) if len(drawn) > 1 else [(None, None)] * len(graphs)
    return [
        Completion(
            graph,
            HALT_REASONS[result.halt_reason],
            result.steps,
            scene.source,
            confidence,
            (*scene.remarks, *doubts),
            scene.num_pieces,
            *of_parts,
        )
        for (graph, result), (confidence, doubts), of_parts in zip(
            kept, judgements, sure, strict=True
        )
    ]
