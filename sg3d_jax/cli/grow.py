"""`sg3d complete | train`: completing scene graphs, and learning to."""

import dataclasses
import sys
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
    run_code,
    to_read,
    to_write,
)
from sg3d_jax.train import DEFAULT_WEIGHTS

GRAPHS: Final = (".json", ".jsonl")
MAX_DRAWN: Final = 100_000  # graphs in one call: all are kept until they are written
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
    normals: Literal["check", "as-given"] = "check",
    cut: Literal["auto", "never"] = "auto",
    lanes: int | None = None,
    code: Code = (),
) -> None:
    """Complete the scene graph of observed planes.

    What is mended on the way in, not plausible, or unsure is a remark on stderr and in the result.

    Args:
      planes: JSON, JSON Lines (a scene a line) or CSV, or graphs whose planes are taken; metres.
        Ids and further keys are carried to the result, of any format but npz. - for JSON or JSON
        Lines on standard input.
      output: JSON for one graph, or JSON Lines for several: the samples of the first scene first. -
        for standard output.
      picture: also draw the first graph, as PNG, PDF or SVG; fainter where it is unsure.
      samples: graphs a scene.
      candidates: graphs to draw for each of them, fewer once most are alike; what most of them have
        is kept. By default 8 for one sample, 1 for several.
      seed: another seed draws other samples.
      weights: weights by name, or an npz file.
      diffusion_steps: sampling steps of the topology; fewer are faster.
      keep: take everything in the file as given, such as rooms that are known, and grow on.
      normals: turn those that point out of rooms all over, or take all as given.
      cut: cut planes that rooms share where walls abut, and join the pieces again, or never.
      lanes: scenes grown together; the results do not depend on it.
      code: Python files to run first, which register the methods of your own weights.
    """
    from sg3d_jax.infer.complete import complete as complete_scenes
    from sg3d_jax.io.attributes import check_attributes, with_confidence
    from sg3d_jax.io.formats import check_writable, read_with_attributes, write_graphs
    from sg3d_jax.viz.figure import save_picture

    check_at_least("--samples", samples, 1)
    check_at_least("--candidates", 1 if candidates is None else candidates, 1)
    check_at_least("--lanes", 1 if lanes is None else lanes, 1)
    check_at_most("--lanes", lanes or 1, MAX_LANES)
    check_at_least("--seed", seed, 0)
    check_output(None if output == STANDARD else output, GRAPHS)
    check_output(picture, PICTURES)
    with to_read(planes) as (source, called):
        scenes = read_with_attributes(source)
    names = [f"{called}: graph {index}" for index in range(len(scenes))]
    names = names if len(scenes) > 1 else [called]
    for name, scene in zip(names, scenes, strict=True):
        check_attributes(scene.attributes, name)
    drawn = len(scenes) * samples * (candidates or 1)
    check_at_most("the number of scenes, samples and candidates together", drawn, MAX_DRAWN)
    if output != STANDARD:
        check_writable(output, len(scenes) * samples, "json")
    run_code(code)
    trained = _trained(weights, diffusion_steps)
    grown = complete_scenes(
        trained.model,
        trained.params,
        [scene.graph for scene in scenes],
        seed,
        samples,
        candidates,
        keep,
        lanes,
        names=names,
        normals=normals,
        cut=cut,
    )
    grown = [_with_card(completions, trained) for completions in grown]
    made = [
        (completion, _carried(read.attributes, completion), {"scene": scene, "sample": index})
        for scene, (read, completions) in enumerate(zip(scenes, grown, strict=True))
        for index, completion in enumerate(completions)
    ]
    extras = [
        {
            "halt_reason": completion.halt_reason,
            "steps": completion.steps,
            "weights": weights,
            "seed": seed,
            **place,
            **_ids_by_concept(completion, held),
            "confidence": completion.confidence._asdict(),
            "remarks": list(completion.remarks),
        }
        for completion, held, place in made
    ]
    graphs = [completion.graph for completion, _, _ in made]
    with to_write(output, GRAPHS[len(graphs) > 1]) as path:
        write_graphs(
            path,
            graphs,
            extras=extras,
            attributes=[with_confidence(held, one.node_confidence) for one, held, _ in made],
            edge_confidence=[one.edge_confidence for one, _, _ in made],
        )
    _say_what_was_grown(output, graphs, extras)
    for name, of_scene in zip(names, grown, strict=True):
        _say_remarks(name, [completion.remarks for completion in of_scene])
    if picture is not None:
        first, _, _ = made[0]
        save_picture(first.graph, picture, None, first.node_confidence, first.edge_confidence)
        _say(f"{picture}: picture of scene 0 sample 0", output)


def train(name: Positional[str], overrides: tyro.conf.Suppress[tuple[str, ...]] = ()) -> None:
    """Train a method on a data set; `sg3d train NAME --help` lists what can be overridden.

    Args:
      name: METHOD-DATASET, such as midi-s-f, or a Python file that defines CONFIG, such as those in
        configs/.
      overrides: further arguments, parsed against the configuration.
    """
    from sg3d_jax.train.config import Config
    from sg3d_jax.train.loop import train as run
    from sg3d_jax.train.presets import find_config

    @dataclasses.dataclass(frozen=True)
    class Run:
        """Train a configuration; a run that was cut short, or has more steps now, goes on."""

        config: Annotated[Config, tyro.conf.arg(name="")]
        output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]  # the run directory
        accept_changes: bool = False  # go on with other data or code than the run began with

    default = Run(find_config(name), Path("runs") / Path(name).stem)
    chosen = tyro.cli(
        Run,
        default=default,
        args=overrides,
        prog=f"sg3d train {name}",
        config=(tyro.conf.AvoidSubcommands,),  # the method is that of the configuration
    )
    done = run(chosen.config, chosen.output, chosen.accept_changes)
    best = f"step {done.step}, which has the best validation FGW, {done.fgw:.4f}"
    print(f"{done.weights}: weights of {best}")


def _trained(weights: str, diffusion_steps: int | None) -> Any:
    """Loads weights, with another number of sampling steps if one is asked for."""
    from sg3d_jax.train.weights import load_weights, with_diffusion_steps

    trained = load_weights(weights)
    return trained if diffusion_steps is None else with_diffusion_steps(trained, diffusion_steps)


def _with_card(completions: list[Any], trained: Any) -> list[Any]:
    """Returns the completions of a scene; if no training scene was like it, they say so first."""
    from sg3d_jax.train.card import outside

    unlike = trained.card and outside(trained.card, completions[0].graph)
    if not unlike:
        return completions
    remark = f"outside of what {trained.name} was trained on: {unlike}"
    return [one._replace(remarks=(remark, *one.remarks)) for one in completions]


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


def _say_what_was_grown(output: Path, graphs: list, extras: list[dict[str, Any]]) -> None:
    """Prints what was written, and every graph that did not come to its end."""
    from sg3d_jax.infer.complete import INCOMPLETE
    from sg3d_jax.scene.graph import ontology_of

    for graph, extra in zip(graphs[:8], extras, strict=False):
        labels = graph.nodes.label.tolist()
        counts = [(labels.count(i), c) for i, c in enumerate(ontology_of(graph).concepts)]
        shown = ", ".join(f"{n} {c.name if n == 1 else c.layer.lower()}" for n, c in counts if n)
        place = f"scene {extra['scene']} sample {extra['sample']}"
        _say(f"{output}: {place}: {shown}", output)
    if len(graphs) > 8:
        _say(f"{output}: {len(graphs)} graphs in all", output)
    for extra in extras:
        if extra["halt_reason"] in INCOMPLETE:
            print(
                f"sg3d: warning: scene {extra['scene']} sample {extra['sample']} stopped by "
                f"{extra['halt_reason']}, so its graph is incomplete",
                file=sys.stderr,
            )
