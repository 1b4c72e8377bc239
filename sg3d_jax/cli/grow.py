"""`sg3d complete | train`: completing scene graphs, and learning to."""

import dataclasses
import sys
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import tyro

from sg3d_jax.cli.arguments import (
    PICTURES,
    STANDARD,
    Code,
    Output,
    Positional,
    check_at_least,
    check_at_most,
    check_output,
    columns_in,
    run_code,
    to_read,
    to_write,
)
from sg3d_jax.cli.progress import lines_to, progress
from sg3d_jax.train import DEFAULT_WEIGHTS

GRAPHS: Final = (".json", ".jsonl")
MAX_DRAWN: Final = 100_000  # graphs in one call
MOST_SAID: Final = 8  # graphs of which it is said what they hold
MAX_LANES: Final = 1024


def complete(
    planes: Positional[Path],
    output: Output,
    picture: Path | None = None,
    samples: int = 1,
    candidates: int | None = None,
    seed: int = 0,
    weights: str = DEFAULT_WEIGHTS,
    diffusion_steps: int | None = None,
    keep: bool = False,
    until: str | None = None,
    without: tuple[str, ...] = (),
    normals: Literal["check", "as-given"] = "check",
    cut: Literal["auto", "never"] = "auto",
    lanes: int | None = None,
    columns: str | None = None,
    quiet: bool = False,
    coordinator: str | None = None,
    num_processes: int | None = None,
    process_id: int | None = None,
    code: Code = (),
) -> None:
    """Complete the scene graph of observed planes.

    What is mended on the way in, not plausible, or unsure is a remark on stderr and in the result.

    Args:
      planes: JSON, JSON Lines (a scene a line) or CSV, or graphs whose planes are taken; metres.
        Doors, stairs and objects beside them help weights that know them. Ids and further keys are
        carried to the result, of any format but npz. - for JSON or JSON Lines on standard input.
      output: JSON for one graph, or JSON Lines for several: the samples of the first scene first. A
        line is written as soon as its graph is done, and stays if the command is stopped; one graph
        in JSON is written at the end. - for standard output.
      picture: also draw the first graph, as PNG, PDF or SVG; fainter where it is unsure.
      samples: graphs a scene.
      candidates: graphs to draw for each of them, fewer once most are alike; what most of them have
        is kept. By default 8 for one sample, 1 for several.
      seed: another seed draws other samples.
      weights: weights by name, or an npz file.
      diffusion_steps: sampling steps of the topology; fewer are faster.
      keep: take everything in the file as given, such as rooms that are known, and grow on.
      until: leave out of the result what is above this concept, such as room.
      without: leave these concepts out of the result, such as wall.
      normals: turn those that point out of rooms, or take all as given.
      cut: cut planes that rooms share where walls abut, and join the pieces again, and leave alone
        what shows a face again that an earlier plane shows; or never.
      lanes: scenes that a device grows together; results do not depend on it, but for rounding.
      columns: for planes as CSV, the names of its columns and what they are, such as
        x=cx,y=cy,length=width.
      quiet: show no progress on a terminal.
      coordinator: where several processes complete the scenes, the address of the first and a free
        port there, such as 10.0.0.1:1234, or auto on a cluster that JAX knows (Slurm, Open MPI,
        Kubernetes). Each writes its share to a file of its own, graphs.0-of-2.jsonl and so on.
      num_processes: how many there are; a cluster says so itself.
      process_id: which one this is, from 0; a cluster says so itself.
      code: Python files to run first, which register the methods of your own weights.
    """
    from sg3d_jax.distributed import initialise, own_file, part, share
    from sg3d_jax.infer.complete import complete_each
    from sg3d_jax.io.attributes import check_attributes
    from sg3d_jax.io.formats import check_writable, read_with_attributes
    from sg3d_jax.scene.graph import ontology_of
    from sg3d_jax.scene.restrict import kept_concepts
    from sg3d_jax.train.weights import load_weights, with_diffusion_steps

    check_at_least("--samples", samples, 1)
    check_at_least("--candidates", 1 if candidates is None else candidates, 1)
    check_at_least("--lanes", 1 if lanes is None else lanes, 1)
    check_at_most("--lanes", lanes or 1, MAX_LANES)
    check_at_least("--seed", seed, 0)
    check_output(None if output == STANDARD else output, GRAPHS)
    check_output(picture, PICTURES)
    initialise(coordinator, num_processes, process_id)
    run_code(code)
    trained = with_diffusion_steps(load_weights(weights), diffusion_steps)
    kept = kept_concepts(trained.model.ontology, until, without)
    with to_read(planes) as (source, called):
        scenes = read_with_attributes(source, columns_in(columns), trained.model.ontology)
    names = [f"{called}: graph {index}" for index in range(len(scenes))]
    names = names if len(scenes) > 1 else [called]
    for name, scene in zip(names, scenes, strict=True):
        check_attributes(scene.attributes, ontology_of(scene.graph), name)
    drawn = len(scenes) * samples * (candidates or 1)
    check_at_most("the number of scenes, samples and candidates together", drawn, MAX_DRAWN)
    if output != STANDARD:
        check_writable(output, len(scenes) * samples, "json")
    own = own_file(output)
    if own != output and output.suffix.lower() != ".jsonl":
        raise ValueError(f"{output}: is for one process, expected the name of a .jsonl file")
    numbers = share(range(len(scenes)))
    each = complete_each(
        trained.model,
        trained.params,
        [scenes[number].graph for number in numbers],
        seed,
        samples,
        candidates,
        keep,
        lanes,
        names=[names[number] for number in numbers],
        normals=normals,
        cut=cut,
        numbers=numbers,
    )
    origin, total = {"weights": weights, "seed": seed}, samples * len(numbers)
    first, said = None, []
    bar = progress(len(numbers), "scenes", quiet)
    with closing(each), _written(own, total) as write, bar as advance:
        for number, completions in zip(numbers, each, strict=True):
            completions = _with_card(completions, trained)
            completions = _with_remarks(completions, scenes[number].remarks)
            completions = [_restricted(completion, kept) for completion in completions]
            for sample, completion in enumerate(completions):
                place = {"scene": number, "sample": sample}
                write(_document(completion, scenes[number].attributes, origin, place))
                if len(said) < MOST_SAID:
                    said.append(_what_was_grown(completion, place))
                _warn_if_incomplete(completion, place)
            _say_remarks(names[number], [completion.remarks for completion in completions])
            first = first or completions[0]
            advance()
    for text in said:
        _say(f"{own}: {text}", output)
    if total > MOST_SAID:
        _say(f"{own}: {total} graphs in all", output)
    if picture is not None and first is not None and numbers[0] == 0:
        from sg3d_jax.viz.figure import save_picture

        save_picture(first.graph, picture, None, first.node_confidence, first.edge_confidence)
        _say(f"{picture}: picture of scene 0 sample 0", output)
    part()


def train(name: Positional[str], overrides: tyro.conf.Suppress[tuple[str, ...]] = ()) -> None:
    """Train a method on a data set; `sg3d train NAME --help` lists what can be overridden.

    Args:
      name: METHOD-DATASET, such as midi-s-f, or a Python file that defines CONFIG, such as those in
        configs/.
      overrides: further arguments, parsed against the configuration.
    """
    from sg3d_jax.distributed import initialise, is_first
    from sg3d_jax.train.config import Config
    from sg3d_jax.train.loop import train as run
    from sg3d_jax.train.presets import find_config

    @dataclasses.dataclass(frozen=True)
    class Run:
        """Train a configuration; a run that was cut short, or has more steps now, goes on."""

        config: Annotated[Config, tyro.conf.arg(name="")]
        output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]  # the run directory
        accept_changes: bool = False  # go on with other data or code than the run began with
        coordinator: str | None = None  # where several processes train it: see sg3d complete
        num_processes: int | None = None  # of them
        process_id: int | None = None  # of this one, from 0

    default = Run(find_config(name), Path("runs") / Path(name).stem)
    chosen = tyro.cli(
        Run,
        default=default,
        args=overrides,
        prog=f"sg3d train {name}",
        config=(tyro.conf.AvoidSubcommands,),  # the method is that of the configuration
    )
    initialise(chosen.coordinator, chosen.num_processes, chosen.process_id)
    done = run(chosen.config, chosen.output, chosen.accept_changes)
    if is_first():
        best = f"step {done.step}, which has the best validation FGW, {done.fgw:.4f}"
        print(f"{done.weights}: weights of {best}")


def _with_card(completions: list[Any], trained: Any) -> list[Any]:
    """Returns the completions of a scene; if no training scene was like it, they say so first."""
    from sg3d_jax.train.card import outside

    unlike = trained.card and outside(trained.card, completions[0].graph)
    if not unlike:
        return completions
    return _with_remarks(completions, (f"outside of what {trained.name} was trained on: {unlike}",))


def _with_remarks(completions: list[Any], remarks: tuple[str, ...]) -> list[Any]:
    """Returns the completions of a scene that say something else first."""
    return [one._replace(remarks=(*remarks, *one.remarks)) for one in completions]


def _restricted(completion: Any, kept: Any) -> Any:
    """Returns a completion of some concepts, bool[C]; what it says of the whole stays."""
    from sg3d_jax.scene.graph import parts_first, subgraph

    rows = kept[completion.graph.nodes.label]
    places = {
        "source": rows[: completion.num_given],
        "node_confidence": rows,
        "edge_confidence": rows[parts_first(completion.graph)].all(axis=1),
        "kinds": rows[completion.num_given :],
    }
    held = {name: getattr(completion, name) for name in places}
    left = {name: held[name][places[name]] for name in places if held[name] is not None}
    return completion._replace(graph=subgraph(completion.graph, rows), **left)


@contextmanager
def _written(output: Path, total: int) -> Generator[Callable[[dict[str, Any]], None]]:
    """Gives what writes a document: as a line, at once, or the only one of a JSON file."""
    from sg3d_jax.io.files import write_document

    if output.suffix.lower() == ".jsonl" or total != 1:
        with lines_to(output, total) as write:
            yield write
        return
    with to_write(output, ".json") as path:
        yield lambda document: write_document(path, document)


def _document(
    completion: Any, attributes: Any, origin: dict[str, Any], place: dict[str, int]
) -> dict[str, Any]:
    """Returns what is written of a completion."""
    from sg3d_jax.io.attributes import with_confidence, with_kinds
    from sg3d_jax.io.json import graph_to_dict

    held = _carried(attributes, completion)
    sure = with_confidence(held, completion.node_confidence)
    return graph_to_dict(
        completion.graph,
        with_kinds(sure, completion.graph, completion.kinds),
        completion.edge_confidence,
        halt_reason=completion.halt_reason,
        steps=completion.steps,
        **origin,
        **place,
        **_ids_by_concept(completion, held),
        confidence=completion.confidence._asdict(),
        remarks=list(completion.remarks),
    )


def _carried(attributes: Any, completion: Any) -> list[Any]:
    """Returns the attributes of the nodes of a completion: those that were given have some."""
    num_grown = len(completion.graph.nodes.label) - completion.num_given
    return [*(attributes[row] for row in completion.source.tolist()), *[{}] * num_grown]


def _ids_by_concept(completion: Any, attributes: Any) -> dict[str, dict[str, list[int | str]]]:
    """Returns the ids of what was observed, kept and grown, by concept."""
    from sg3d_jax.io.attributes import node_ids

    ids = node_ids(attributes)
    return {
        name: {
            concept: [ids[row] for row in rows.tolist()]
            for concept, rows in getattr(completion, name).items()
        }
        for name in ("observed", "kept", "grown")
    }


def _say(text: str, output: Path) -> None:
    """Prints what was written; on stderr if the graphs themselves are on standard output."""
    print(text, file=sys.stderr if output == STANDARD else sys.stdout)


def _say_remarks(name: str, remarks: list[tuple[str, ...]]) -> None:
    """Prints the remarks on the samples of a scene, those that all have once."""
    shared = [remark for remark in remarks[0] if all(remark in of_one for of_one in remarks)]
    said = [f"{name}: {remark}" for remark in shared]
    for sample, of_one in enumerate(remarks):
        said += [f"{name}: sample {sample}: {remark}" for remark in of_one if remark not in shared]
    for remark in said:
        print(f"sg3d: remark: {remark}", file=sys.stderr)


def _what_was_grown(completion: Any, place: dict[str, int]) -> str:
    """Returns what a graph holds, by concept."""
    from sg3d_jax.scene.graph import ontology_of

    graph = completion.graph
    found = Counter(graph.nodes.label.tolist())
    counts = [(found[label], c) for label, c in enumerate(ontology_of(graph).concepts)]
    shown = ", ".join(f"{n} {c.name if n == 1 else c.layer.lower()}" for n, c in counts if n)
    return f"scene {place['scene']} sample {place['sample']}: {shown}"


def _warn_if_incomplete(completion: Any, place: dict[str, int]) -> None:
    """Prints that a graph did not come to its end, if it did not."""
    from sg3d_jax.infer.complete import ENDED

    if completion.halt_reason not in ENDED:
        print(
            f"sg3d: warning: scene {place['scene']} sample {place['sample']} stopped by "
            f"{completion.halt_reason}, so its graph is incomplete",
            file=sys.stderr,
        )
