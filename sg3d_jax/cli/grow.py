"""`sg3d complete | train`: completing scene graphs, and learning to."""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from sg3d_jax.cli.arguments import (
    PICTURES,
    Code,
    Output,
    Positional,
    check_at_least,
    check_output,
    run_code,
)

DEFAULT_WEIGHTS: Final = "fd4-s-f"
GRAPHS: Final = (".json", ".jsonl")


def complete(
    planes: Positional[Path],
    output: Output,
    picture: Path | None = None,
    samples: int = 1,
    candidates: int = 1,
    seed: int = 0,
    weights: str = DEFAULT_WEIGHTS,
    diffusion_steps: int | None = None,
    keep: bool = False,
    lanes: int | None = None,
    code: Code = (),
) -> None:
    """Complete the scene graph of observed planes.

    Args:
      planes: JSON, JSON Lines (a scene a line) or CSV, or graphs whose planes are taken; metres.
      output: JSON for one graph, or JSON Lines for several: the samples of the first scene first.
      picture: also draw the first graph, as PNG, PDF or SVG.
      samples: graphs a scene.
      candidates: graphs to draw for each of them; the one in the middle, under FGW, is kept.
      seed: another seed draws other samples.
      weights: weights by name, or an npz file.
      diffusion_steps: sampling steps of the topology; fewer are faster.
      keep: take everything in the file as given, such as rooms that are known, and grow on.
      lanes: scenes grown together; the results do not depend on it.
      code: Python files to run first, which register the methods of your own weights.
    """
    from sg3d_jax.infer.complete import complete as complete_scenes
    from sg3d_jax.io.formats import check_writable, read_graphs, write_graphs
    from sg3d_jax.viz.figure import save_picture

    check_at_least("--samples", samples, 1)
    check_at_least("--candidates", candidates, 1)
    check_at_least("--lanes", 1 if lanes is None else lanes, 1)
    check_at_least("--seed", seed, 0)
    check_output(output, GRAPHS)
    check_output(picture, PICTURES)
    scenes = read_graphs(planes)
    check_writable(output, len(scenes) * samples, "json")
    run_code(code)
    trained = _trained(weights, diffusion_steps)
    names = [f"{planes}: graph {index}" for index in range(len(scenes))]
    grown = complete_scenes(
        trained.model,
        trained.params,
        scenes,
        seed,
        samples,
        candidates,
        keep,
        lanes,
        names=names if len(scenes) > 1 else [f"{planes}"],
    )
    extras = [
        {
            "halt_reason": completion.halt_reason,
            "steps": completion.steps,
            "weights": weights,
            "seed": seed,
            "scene": scene,
            "sample": index,
            "observed": _plain(completion.observed),
            "kept": _plain(completion.kept),
            "grown": _plain(completion.grown),
        }
        for scene, completions in enumerate(grown)
        for index, completion in enumerate(completions)
    ]
    graphs = [completion.graph for completions in grown for completion in completions]
    write_graphs(output, graphs, extras=extras)
    _say_what_was_grown(output, graphs, extras)
    if picture is not None:
        save_picture(graphs[0], picture)
        print(f"{picture}: picture of scene 0 sample 0")


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
        """Train a configuration; a run that was cut short goes on where it was."""

        config: Annotated[Config, tyro.conf.arg(name="")]
        output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]  # the run directory

    default = Run(find_config(name), Path("runs") / Path(name).stem)
    chosen = tyro.cli(
        Run,
        default=default,
        args=overrides,
        prog=f"sg3d train {name}",
        config=(tyro.conf.AvoidSubcommands,),  # the method is that of the configuration
    )
    print(f"{run(chosen.config, chosen.output)}: weights of the best validation FGW")


def _trained(weights: str, diffusion_steps: int | None) -> Any:
    """Loads weights, with another number of sampling steps if one is asked for."""
    from sg3d_jax.train.weights import load_weights, with_diffusion_steps

    trained = load_weights(weights)
    return trained if diffusion_steps is None else with_diffusion_steps(trained, diffusion_steps)


def _plain(rows: dict[str, Any]) -> dict[str, list[int]]:
    """Returns the rows of each concept as JSON values."""
    return {concept: of_concept.tolist() for concept, of_concept in rows.items()}


def _say_what_was_grown(output: Path, graphs: list, extras: list[dict[str, Any]]) -> None:
    """Prints what was written, and every graph that did not come to its end."""
    from sg3d_jax.infer.complete import INCOMPLETE
    from sg3d_jax.scene.graph import ontology_of

    for graph, extra in zip(graphs[:8], extras, strict=False):
        labels = graph.nodes.label.tolist()
        counts = [(labels.count(i), c) for i, c in enumerate(ontology_of(graph).concepts)]
        shown = ", ".join(f"{n} {c.name if n == 1 else c.layer.lower()}" for n, c in counts if n)
        print(f"{output}: scene {extra['scene']} sample {extra['sample']}: {shown}")
    if len(graphs) > 8:
        print(f"{output}: {len(graphs)} graphs in all")
    for extra in extras:
        if extra["halt_reason"] in INCOMPLETE:
            print(
                f"sg3d: warning: scene {extra['scene']} sample {extra['sample']} stopped by "
                f"{extra['halt_reason']}, so its graph is incomplete",
                file=sys.stderr,
            )
