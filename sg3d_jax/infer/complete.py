"""The one way in: scene graphs completed from host graphs, by any model."""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.grow import DEFAULT_MAX_STEPS, HALT_REASONS
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.candidates import are_settled
from sg3d_jax.infer.confidence import Confidence, judged, sure_of
from sg3d_jax.infer.consensus import consensus
from sg3d_jax.infer.lanes import Finished, Model, complete_lanes
from sg3d_jax.infer.prepare import Scene, in_place, prepare, whole_again
from sg3d_jax.scene.graph import SceneGraph, ontology_of

CANDIDATES: Final = 8  # at most, of one sample a scene
ROUND: Final = 2  # candidates that are drawn before it is asked whether they suffice
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


class _Drawn(NamedTuple):
    """What was drawn of a scene, in the user's frame."""

    graph: SceneGraph  # over the pieces of what is observed
    halt_reason: int  # index into HALT_REASONS
    steps: int  # blocks inserted


def complete(
    model: Model,
    params: Params,
    scenes: Sequence[SceneGraph],
    seed: int = 0,
    samples: int = 1,
    candidates: int | None = None,
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
      candidates: graphs that are drawn for each of them at most, and no more once more than half
        are alike; what most of them have is kept. None for 8 where one sample a scene is asked for,
        and for 1 where several are.
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
        ("candidates", 1 if candidates is None else candidates),
        ("lanes", 1 if lanes is None else lanes),
    ):
        if value < 1:
            raise ValueError(f"{name} is {value}, expected at least 1")
    if keep and not isinstance(model, Flagg):
        given = model.ontology.observed_plural
        raise ValueError(f"keep: this model completes {given} alone, expected one that grows")
    prepared = prepare(scenes, model.ontology, keep, names, normals, cut)
    most = (CANDIDATES if samples == 1 else 1) if candidates is None else candidates

    def draw(draws: Sequence[tuple[int, int]]) -> list[Finished]:
        return complete_lanes(model, params, prepared, draws, seed, max_steps, lanes, outgrow)

    drawn = _drawn(draw, prepared, samples, most)
    return [_completions(*of_scene) for of_scene in zip(prepared, drawn, strict=True)]


def share_halted(completions: Sequence[Completion]) -> float | None:
    """Returns the share of graphs that a growing model found complete; None for other models."""
    reasons = [completion.halt_reason for completion in completions]
    return None if "ONE_SHOT" in reasons else reasons.count("HALTED") / len(reasons)


def _drawn(
    draw: Callable[[Sequence[tuple[int, int]]], list[Finished]],
    scenes: Sequence[Scene],
    samples: int,
    candidates: int,
) -> list[list[list[_Drawn]]]:
    """Returns the candidates of every sample of every scene: round by round, as many as it needs.

    What is drawn of a scene does not depend on the others, nor do its rounds.
    """
    drawn: list[list[list[_Drawn]]] = [[[] for _ in range(samples)] for _ in scenes]
    waiting = [(scene, sample) for scene in range(len(scenes)) for sample in range(samples)]
    for first in range(0, candidates, ROUND):
        numbers = range(first, min(first + ROUND, candidates))
        draws = [(place, number) for place in waiting for number in numbers]
        results = draw([(scene, sample * candidates + n) for (scene, sample), n in draws])
        for ((scene, sample), _), result in zip(draws, results, strict=True):
            graph = in_place(scenes[scene], result.graph)
            drawn[scene][sample].append(_Drawn(graph, result.halt_reason, result.steps))
        waiting = [
            (scene, sample)
            for scene, sample in waiting
            if not are_settled(_graphs(drawn[scene][sample]), scenes[scene].num_in_pieces)
        ]
    return drawn


def _graphs(drawn: Sequence[_Drawn]) -> list[SceneGraph]:
    return [one.graph for one in drawn]


def _completions(scene: Scene, samples: Sequence[Sequence[_Drawn]]) -> list[Completion]:
    """Returns what is kept of all that was drawn of one scene, and how sure it is."""
    kept: list[_Drawn] = []
    for candidates in samples:
        # Pieces of one observed node may belong to several wholes, so they vote apart.
        graph, index = consensus(_graphs(candidates), scene.num_in_pieces)
        kept.append(candidates[index]._replace(graph=whole_again(scene, graph)))
    drawn = [whole_again(scene, one.graph) for candidates in samples for one in candidates]
    graphs = [one.graph for one in kept]
    judgements = judged(graphs, drawn, scene.num_given)
    # One draw alone tells nothing of its nodes and edges.
    several = len(drawn) > 1
    sure = sure_of(graphs, drawn, scene.num_given) if several else [(None, None)] * len(graphs)
    return [
        Completion(
            one.graph,
            HALT_REASONS[one.halt_reason],
            one.steps,
            scene.source,
            confidence,
            (*scene.remarks, *doubts),
            scene.num_pieces,
            *of_parts,
        )
        for one, (confidence, doubts), of_parts in zip(kept, judgements, sure, strict=True)
    ]
