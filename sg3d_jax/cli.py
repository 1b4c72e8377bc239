"""The command line: `sg3d complete | train | evaluate | view | data`. Each command delegates.

A refusal is one sentence on stderr and exit code 2, with nothing written.
"""

import dataclasses
import json
import os
import runpy
import sys
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

import sg3d_jax
from sg3d_jax.interop.files import replacing

DEFAULT_WEIGHTS = "fd4-s-f"
GRAPHS = (".json", ".jsonl")
PICTURES = (".png", ".pdf", ".svg")

Positional = tyro.conf.Positional
Output = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
app = tyro.extras.SubcommandApp()
data_app = tyro.extras.SubcommandApp()


@app.command
def complete(
    planes: Positional[Path],
    output: Output,
    picture: Path | None = None,
    samples: int = 1,
    seed: int = 0,
    weights: str = DEFAULT_WEIGHTS,
    diffusion_steps: int | None = None,
) -> None:
    """Grow the scene graph of observed planes.

    Args:
      planes: JSON, JSON Lines (a scene a line) or CSV; metres.
      output: JSON for one graph, or JSON Lines for several: the samples of the first scene first.
      picture: also draw the first graph, as PNG, PDF or SVG.
      samples: graphs a scene.
      seed: another seed draws other samples.
      weights: weights by name, or an npz file.
      diffusion_steps: sampling steps of the topology; fewer are faster.
    """
    from sg3d_jax.flagg import sample
    from sg3d_jax.interop.json import write_graph, write_graphs
    from sg3d_jax.interop.planes import read_planes
    from sg3d_jax.viz.figure import save_picture

    _check_at_least("--samples", samples, 1)
    _check_at_least("--seed", seed, 0)
    _check_output(output, GRAPHS)
    _check_output(picture, PICTURES)
    scenes = read_planes(planes)
    several = output.suffix.lower() == ".jsonl"
    if not several and len(scenes) * samples > 1:
        raise ValueError(
            f"{output}: a .json file holds one graph, expected the name of a .jsonl file for "
            f"{len(scenes) * samples} graphs"
        )
    trained = _trained(weights, diffusion_steps)
    grown = sample.complete(trained.model, trained.params, scenes, seed, samples)
    extras = [
        {
            "halt_reason": completion.halt_reason,
            "steps": completion.steps,
            "weights": weights,
            "seed": seed,
            "scene": scene,
            "sample": index,
        }
        for scene, completions in enumerate(grown)
        for index, completion in enumerate(completions)
    ]
    graphs = [completion.graph for completions in grown for completion in completions]
    if several:
        write_graphs(output, graphs, extras)
    else:
        write_graph(output, graphs[0], **extras[0])
    _say_what_was_grown(output, graphs, extras)
    if picture is not None:
        save_picture(graphs[0], picture)
        print(f"{picture}: picture of scene 0 sample 0")


@app.command
def view(graph: Positional[Path], output: Output, index: int = 0) -> None:
    """Draw a scene graph.

    Args:
      graph: JSON or JSON Lines, as written by `sg3d complete`.
      output: the picture to write: PNG, PDF or SVG.
      index: which graph of a file that holds several.
    """
    from sg3d_jax.interop.json import read_graphs
    from sg3d_jax.viz.figure import save_picture

    graphs = read_graphs(graph)
    if not 0 <= index < len(graphs):
        raise ValueError(f"{graph}: --index must be in 0..{len(graphs) - 1}, got {index}")
    save_picture(graphs[index], output)
    print(f"{output}: picture of {graph}")


@app.command
def train(config: Positional[Path], overrides: tyro.conf.Suppress[tuple[str, ...]] = ()) -> None:
    """Train a configuration; `sg3d train CONFIG --help` lists what can be overridden.

    Args:
      config: a Python file that defines CONFIG, such as those in configs/.
      overrides: further arguments, parsed against the configuration.
    """
    from sg3d_jax.train.config import Config
    from sg3d_jax.train.loop import train as run

    @dataclasses.dataclass(frozen=True)
    class Run:
        """Train a configuration; a run that was cut short goes on where it was."""

        config: Annotated[Config, tyro.conf.arg(name="")]
        output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]  # the run directory

    default = Run(_read_config(config), Path("runs") / config.stem)
    chosen = tyro.cli(Run, default=default, args=overrides, prog=f"sg3d train {config}")
    print(f"{run(chosen.config, chosen.output)}: weights of the best validation FGW")


@app.command
def evaluate(
    weights: Positional[str],
    data: str | None = None,
    split: Literal["train", "validation", "test"] = "test",
    seed: int = 0,
    num_graphs: int | None = None,
    diffusion_steps: int | None = None,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    sheet: Path | None = None,
) -> None:
    """Grow the scenes of a split from their planes and score them against the truth.

    Args:
      weights: weights by name, or an npz file.
      data: a data set by name, or an npz file; by default the one the weights were trained on.
      split: which part of it.
      seed: of the samples.
      num_graphs: only the first so many scenes of the split.
      diffusion_steps: sampling steps of the topology.
      output: also write the scores as JSON.
      sheet: also draw the worst scenes, the truth above what was grown.
    """
    from sg3d_jax.flagg import sample
    from sg3d_jax.metrics.report import score
    from sg3d_jax.train.dataset import load_split

    _check_at_least("--num-graphs", 1 if num_graphs is None else num_graphs, 1)
    _check_at_least("--seed", seed, 0)
    _check_output(output, (".json",))
    _check_output(sheet, PICTURES)
    trained = _trained(weights, diffusion_steps)
    source = trained.config.data
    if data is not None and data != source.name:
        source = dataclasses.replace(source, name=data, num_graphs=None)
    truth = load_split(source, split)[:num_graphs]
    began = time.monotonic()
    grown = sample.complete(trained.model, trained.params, truth, seed)
    seconds = time.monotonic() - began
    graphs = [completions[0].graph for completions in grown]
    report = score(graphs, truth)
    report["halted"] = sum(c[0].halt_reason == "HALTED" for c in grown) / len(grown)
    about = {
        "weights": weights,
        "data": source.name,
        "split": split,
        "seed": seed,
        "diffusion_steps": trained.config.fill.topology_steps,
        "seconds_growing": round(seconds, 1),
        "cores": os.cpu_count(),
    }
    _print_report(about, report)
    if output is not None:
        with replacing(output) as temporary:
            Path(temporary).write_text(json.dumps({**about, **report}, indent=2) + "\n")
    if sheet is not None:
        _draw_worst(sheet, graphs, truth, report["fgw_per_graph"])


@data_app.command
def make(
    name: Positional[str], output: Output, num_graphs: int | None = None, seed: int = 0
) -> None:
    """Generate a data set.

    Args:
      name: which one, such as s-f.
      output: the npz file to write.
      num_graphs: how many; as many as the paper has by default.
      seed: another seed gives other graphs.
    """
    from sg3d_jax.data import registry, schema

    _check_at_least("--num-graphs", 1 if num_graphs is None else num_graphs, 1)
    _check_at_least("--seed", seed, 0)
    _check_output(output, (".npz",))
    graphs = registry.make(name, num_graphs, seed)
    schema.save(output, graphs, registry.header(name, seed))
    print(f"{output}: {len(graphs)} graphs")


@data_app.command
def describe(name: Positional[str]) -> None:
    """Print the statistics of a data set as JSON.

    Args:
      name: a data set by name, or an npz file.
    """
    from sg3d_jax.data import registry
    from sg3d_jax.data.describe import describe as statistics

    print(json.dumps(statistics(registry.load(name)), indent=2))


app.command(data_app, name="data", help="Generate or describe data sets.")


def _check_at_least(option: str, value: int, least: int) -> None:
    """Refuses a number that is too small."""
    if value < least:
        raise ValueError(f"{option} must be at least {least}, got {value}")


def _check_output(path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Refuses, before minutes of work, a file that could not be written after them."""
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        expected = " or ".join(suffixes)
        raise ValueError(f"{path}: the name ends in {path.suffix!r}, expected {expected}")
    if path.is_dir() or not (path.parent.is_dir() and os.access(path.parent, os.W_OK)):
        raise ValueError(f"{path}: cannot be written, expected a file in a folder that can")


def _trained(weights: str, diffusion_steps: int | None) -> Any:
    """Loads weights, with another number of sampling steps if one is asked for."""
    from sg3d_jax.train.weights import load_weights, with_diffusion_steps

    trained = load_weights(weights)
    return trained if diffusion_steps is None else with_diffusion_steps(trained, diffusion_steps)


def _read_config(path: Path) -> Any:
    """Runs a configuration file and returns its CONFIG."""
    from sg3d_jax.train.config import Config

    if not path.is_file():
        raise ValueError(f"{path}: no such configuration file; configs/ holds some")
    config = runpy.run_path(str(path)).get("CONFIG")
    if not isinstance(config, Config):
        raise ValueError(f"{path}: expected a variable CONFIG of type sg3d_jax.train.config.Config")
    return config


def _say_what_was_grown(output: Path, graphs: list, extras: list[dict[str, Any]]) -> None:
    """Prints what was written, and every graph that did not come to its end."""
    from sg3d_jax.scene.concepts import CONCEPTS

    for graph, extra in zip(graphs[:8], extras, strict=False):
        labels = [CONCEPTS[label] for label in graph.nodes.label]
        counts = [f"{labels.count(c)} {c}{'s' * (labels.count(c) != 1)}" for c in CONCEPTS]
        shown = ", ".join(text for text in counts if not text.startswith("0 "))
        print(f"{output}: scene {extra['scene']} sample {extra['sample']}: {shown}")
    if len(graphs) > 8:
        print(f"{output}: {len(graphs)} graphs in all")
    for extra in extras:
        if extra["halt_reason"] != "HALTED":
            print(
                f"sg3d: warning: scene {extra['scene']} sample {extra['sample']} stopped by "
                f"{extra['halt_reason']}, so its graph is incomplete",
                file=sys.stderr,
            )


def _print_report(about: dict[str, Any], report: dict[str, Any]) -> None:
    """Shows the scores as a table."""
    table = Table(title=f"{about['weights']} on {about['data']}, {about['split']} split")
    table.add_column("score")
    table.add_column("value", justify="right")
    for name in ("graphs", "fgw", "gw", "w", "exact_structure", "halted"):
        value = report[name]
        table.add_row(name.replace("_", " "), str(value) if name == "graphs" else f"{value:.4f}")
    error = report["node_count_error"]["absolute"]
    for concept in ("total", *[name for name in error if name != "total"]):
        if error[concept]:
            table.add_row(f"node count error, {concept}", f"{error[concept]:.4f}")
    for kind, seen in report["failures"].items():
        table.add_row(f"graphs with {kind}", f"{seen['share']:.2%}")
    table.add_row("seconds growing, compilation included", f"{about['seconds_growing']}")
    Console().print(table)


def _draw_worst(path: Path, graphs: list, truth: list, fgw: list[float], count: int = 20) -> None:
    """Draws the scenes of the largest FGW, five in a row, the truth above what was grown."""
    from sg3d_jax.viz.figure import contact_sheet

    worst = sorted(range(len(fgw)), key=lambda index: -fgw[index])[:count]
    rows = []
    for first in range(0, len(worst), 5):
        chosen = worst[first : first + 5]
        rows.append(("truth", [truth[i] for i in chosen]))
        rows.append(("grown", [graphs[i] for i in chosen]))
    contact_sheet(rows, path)


def main(arguments: list[str] | None = None) -> None:
    """Runs the command line; exits with 2 after a refusal, with 130 after Ctrl-C."""
    # XLA takes its own compiled programs, read back from disk, for those of another machine.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        match arguments:
            case ["--version"]:
                print(f"sg3d {sg3d_jax.__version__}")
            case ["train", config, *overrides] if not config.startswith("-"):
                train(Path(config), tuple(overrides))
            case _:
                app.cli(args=arguments or ["--help"], prog="sg3d", description=sg3d_jax.__doc__)
    except (ValueError, OverflowError, OSError, FloatingPointError) as error:
        print(f"sg3d: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("sg3d: interrupted", file=sys.stderr)
        raise SystemExit(130) from None
