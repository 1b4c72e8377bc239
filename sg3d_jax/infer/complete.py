"""The one way in: scene graphs completed from host graphs, by any model."""

from collections.abc import Callable, Generator, Sequence
from typing import Final, NamedTuple, SupportsIndex

import numpy as np

from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.grow import DEFAULT_MAX_STEPS, HALT_REASONS
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.arguments import check_params, whole_number
from sg3d_jax.infer.candidates import are_settled
from sg3d_jax.infer.confidence import Confidence, judged
from sg3d_jax.infer.consensus import consensus
from sg3d_jax.infer.division import divided_alike
from sg3d_jax.infer.kinds import chances_of_kinds, with_kinds
from sg3d_jax.infer.lanes import WORD, Course, Model, complete_lanes
from sg3d_jax.infer.placement import placed
from sg3d_jax.infer.prepare import Scene, in_place, prepare, whole_again
from sg3d_jax.scene.graph import SceneGraph, ontology_of

CANDIDATES: Final = 8  # at most, of one sample a scene
ROUND: Final = 2  # candidates that are drawn before it is asked whether they suffice
ENDED = ("HALTED", "ONE_SHOT")  # halt reasons of graphs that came to their end


class Completion(NamedTuple):
    """A completed graph on the host."""

    graph: SceneGraph  # unpadded, float64; what was given comes first, bit for bit if it was right
    # HALTED: found complete; REPEATED: one thing came again and again; CAPACITY, MAX_STEPS: was cut
    # off; ONE_SHOT: did not grow.
    halt_reason: str
    steps: int  # blocks inserted
    source: np.ndarray  # int[k], row in the scene of each node that was given
    confidence: Confidence  # how sure it is; HALTED says nothing about it
    remarks: tuple[str, ...]  # what was mended, is not plausible, or unsure; one sentence each
    # int[observed], into how many each was cut; a piece may have its own room. 0: seen twice
    pieces: np.ndarray
    # How likely each is right, 0 to 1; what was given has 1. None if one graph was drawn.
    node_confidence: np.ndarray | None = None  # float64[n]
    edge_confidence: np.ndarray | None = None  # float64[e], of the rows of `parts_first(graph)`
    # float64[grown, K], how likely each kind of its concept is for each grown node, in their order;
    # None if the model tells no kinds.
    kinds: np.ndarray | None = None

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
    seed: SupportsIndex = 0,
    samples: SupportsIndex = 1,
    candidates: SupportsIndex | None = None,
    keep: bool = False,
    lanes: SupportsIndex | None = None,
    outgrow: bool = True,
    max_steps: SupportsIndex = DEFAULT_MAX_STEPS,
    names: Sequence[str] | None = None,
    normals: str = "check",
    cut: str = "auto",
) -> list[list[Completion]]:
    """Completes scene graphs from host graphs, in compiled batches.

    Graphs grow in threads. What JAX is told by `jax.config.update` counts there, and so do those of
    its context managers around the call that `infer.lanes.TOLD` lists; others, such as
    `jax.set_mesh`, do not. Whatever it is told of types, graphs grow in 32 bits.

    Args:
      model: of any method.
      params: its parameters, all of them finite.
      scenes: host graphs of any size, such as `sg.planes` or `sg.read_graphs` gives. Of each the
        observed nodes are taken; MiDi+Or also counts the others.
      seed: 0 or more; with the position of a scene in `scenes`, the number of the sample, and how
        many candidates there are, fixes it.
      samples: graphs a scene.
      candidates: graphs that are drawn for each of them at most, and no more once more than half
        are alike; what most of them have is kept. None for 8 where one sample a scene is asked for,
        and for 1 where several are.
      keep: take all nodes and part-of edges of a scene as given, such as rooms that are known, and
        grow on from there.
      lanes: scenes that a device grows together; None for as many as suit. Results do not depend on
        it, but for rounding.
      outgrow: whether a graph that does not fit its bucket goes on in the next, with room for up to
        1.25 new nodes a plane; else it ends there, with the halt reason CAPACITY.
      max_steps: a limit on the number of blocks, at least 1; any of them takes the same program.
      names: what a refusal calls each scene, such as "planes.jsonl: line 3".
      normals: "check" to turn normals that point out of rooms, "as-given" to turn none.
      cut: "auto" to cut planes that several rooms share where other walls abut, and to join the
        pieces again, and to leave alone what shows a face again that an earlier plane shows;
        "never" to take all as they are.

    Returns:
      For every scene, in order, its samples.

    Raises:
      ValueError: one sentence that names the scene, the node, the field and what was expected: a
        scene without planes, numbers that are none, wrong shapes; a model that cannot keep;
        parameters that are not finite or of another model; numbers out of range.
    """
    return list(
        complete_each(
            model,
            params,
            scenes,
            seed,
            samples,
            candidates,
            keep,
            lanes,
            outgrow,
            max_steps,
            names,
            normals,
            cut,
        )
    )


def complete_each(
    model: Model,
    params: Params,
    scenes: Sequence[SceneGraph],
    seed: SupportsIndex = 0,
    samples: SupportsIndex = 1,
    candidates: SupportsIndex | None = None,
    keep: bool = False,
    lanes: SupportsIndex | None = None,
    outgrow: bool = True,
    max_steps: SupportsIndex = DEFAULT_MAX_STEPS,
    names: Sequence[str] | None = None,
    normals: str = "check",
    cut: str = "auto",
    numbers: Sequence[SupportsIndex] | None = None,
) -> Generator[list[Completion]]:
    """Completes scene graphs as `complete` does, and hands out each as soon as it is there.

    Others are grown meanwhile. Only some are begun ahead of the next to be handed out, so that
    there may be any number. Arguments are those of `complete`, but for `numbers`: those of the
    scenes, which with the seed fix their samples. By default they are the positions in `scenes`;
    parts of a list are completed as in the whole of it if they say where they were.

    Returns:
      For every scene, in order, its samples. What is refused is so before anything is begun.
    """
    seed, samples = whole_number("the seed", seed, least=0), whole_number("samples", samples)
    max_steps = whole_number("max_steps", max_steps, most=2**31 - 1)
    candidates = None if candidates is None else whole_number("candidates", candidates)
    lanes = None if lanes is None else whole_number("lanes", lanes)
    check_params(model, params)
    if keep and not isinstance(model, Flagg):
        given = model.ontology.observed_plural
        raise ValueError(f"keep: this model completes {given} alone, expected one that grows")
    prepared = prepare(scenes, model.ontology, keep, names, normals, cut)
    numbers = None if numbers is None else _numbers(numbers, len(prepared))
    most = (CANDIDATES if samples == 1 else 1) if candidates is None else candidates

    def told(scene: Scene, graph: SceneGraph) -> tuple[SceneGraph, np.ndarray | None]:
        graph = placed(model, params, graph, scene.num_in_pieces)
        return graph, chances_of_kinds(model, params, graph, scene.num_in_pieces)

    def course(scene: Scene) -> Course[list[Completion]]:
        drawn = yield from _drawn(scene, samples, most)
        return _completions(scene, drawn, told)

    limits = seed, max_steps, numbers, lanes, outgrow, samples * min(most, ROUND)
    return complete_lanes(model, params, prepared, course, *limits)


def _numbers(numbers: Sequence[SupportsIndex], count: int) -> list[int]:
    """Returns the numbers of so many scenes, which JAX takes as words of 32 bits."""
    if len(numbers) != count:
        raise ValueError(f"there are {len(numbers)} numbers of {count} scenes, expected as many")
    return [whole_number("a number of a scene", number, 0, 2**WORD - 1) for number in numbers]


def share_halted(completions: Sequence[Completion]) -> float | None:
    """Returns the share of graphs that a growing model found complete; None for other models."""
    reasons = [completion.halt_reason for completion in completions]
    return None if "ONE_SHOT" in reasons else reasons.count("HALTED") / len(reasons)


def _drawn(scene: Scene, samples: int, candidates: int) -> Course[list[list[_Drawn]]]:
    """Draws the candidates of every sample of a scene: round by round, as many as it needs."""
    drawn: list[list[_Drawn]] = [[] for _ in range(samples)]
    waiting = list(range(samples))
    for first in range(0, candidates, ROUND):
        numbers = range(first, min(first + ROUND, candidates))
        draws = [(sample, number) for sample in waiting for number in numbers]
        results = yield [sample * candidates + number for sample, number in draws]
        for (sample, _), result in zip(draws, results, strict=True):
            graph = in_place(scene, result.graph)
            drawn[sample].append(_Drawn(graph, result.halt_reason, result.steps))
        waiting = [
            sample
            for sample in waiting
            if not are_settled(_graphs(drawn[sample]), scene.num_in_pieces)
        ]
        if not waiting:
            break
    return drawn


def _has_ended(drawn: _Drawn) -> bool:
    """Returns whether a graph came to its end; one that did not repeats itself, and has no vote."""
    return HALT_REASONS[drawn.halt_reason] in ENDED


def _graphs(drawn: Sequence[_Drawn]) -> list[SceneGraph]:
    return [one.graph for one in drawn]


def _completions(
    scene: Scene,
    samples: Sequence[Sequence[_Drawn]],
    told: Callable[[Scene, SceneGraph], tuple[SceneGraph, np.ndarray | None]],
) -> list[Completion]:
    """Returns what is kept of all that was drawn of one scene, and how sure it is.

    Args:
      scene: what was given.
      samples: the candidates of each.
      told: where what is kept stands, and how likely each kind is, told by its edges.
    """
    kept: list[_Drawn] = []
    drawn: list[SceneGraph] = []
    chances: list[np.ndarray | None] = []
    for candidates in samples:
        ended = [one for one in candidates if _has_ended(one)]
        voters = ended or candidates
        # Pieces of one observed node may belong to several wholes, so they vote apart.
        alike = divided_alike(_graphs(voters), scene.num_in_pieces)
        graph, index = consensus(alike, scene.num_in_pieces)
        others = [one.graph for one in candidates if ended and not _has_ended(one)]
        drawn += [whole_again(scene, one) for one in (*alike, *others)]
        graph, of_kinds = told(scene, graph)
        chances.append(of_kinds)
        graph = whole_again(scene, graph)
        graph = graph if chances[-1] is None else with_kinds(graph, chances[-1])
        kept.append(voters[index]._replace(graph=graph))
    graphs = [one.graph for one in kept]
    judgements = judged(graphs, drawn, scene.num_given, scene.set_aside)
    return [
        Completion(
            one.graph,
            HALT_REASONS[one.halt_reason],
            one.steps,
            scene.source,
            judgement.confidence,
            (*scene.remarks, *judgement.remarks),
            scene.num_pieces,
            judgement.nodes,
            judgement.edges,
            kinds=of_kinds,
        )
        for one, judgement, of_kinds in zip(kept, judgements, chances, strict=True)
    ]
