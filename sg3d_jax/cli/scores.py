"""`sg3d evaluate | table | sheet`: methods scored, in the paper's tables, and drawn."""

import csv
import io
import json
import time
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any, Final, Literal

from rich.table import Table

from sg3d_jax.cli.arguments import (
    PICTURES,
    Code,
    OptionalOutput,
    Output,
    Positional,
    check_at_least,
    check_at_most,
    check_output,
    counted,
    print_table,
    run_code,
)
from sg3d_jax.cli.progress import lines_to, progress
from sg3d_jax.cli.provenance import provenance
from sg3d_jax.io.files import read_documents, replacing
from sg3d_jax.metrics.paper import HEADINGS, SCORES, TITLES

MAX_CANDIDATES: Final = 1000  # of a scene: all are kept until they are compared


def evaluate(
    method: Positional[str],
    data: str | None = None,
    split: Literal["train", "validation", "test", "all"] = "test",
    seeds: tuple[int, ...] = (0,),
    num_graphs: int | None = None,
    diffusion_steps: int | None = None,
    candidates: int = 1,
    output: OptionalOutput = None,
    graphs: Path | None = None,
    row: Path | None = None,
    sheet: Path | None = None,
    quiet: bool = False,
    coordinator: str | None = None,
    num_processes: int | None = None,
    process_id: int | None = None,
    code: Code = (),
) -> None:
    """Complete the scenes of a split from their planes and score them against the truth.

    Args:
      method: METHOD-DATASET, such as rand-s-f or midi-s-f; weights as an npz file; or a file of
        graphs that were made of the scenes, in their order.
      data: a data set by name, or a file of graphs; by default that of the name, or what the
        weights were trained on.
      split: which part of it, or all.
      seeds: of the samples; several give mean and standard deviation.
      num_graphs: only the first so many scenes of the split.
      diffusion_steps: sampling steps of the topology.
      candidates: graphs to draw of each scene; what most of them have is kept, and how sure each
        node and edge is shows in the calibration errors.
      output: also write everything as JSON, for `sg3d table`.
      graphs: also write what is made with the first seed as JSON Lines, each graph as soon as it is
        done. If the command is stopped, `sg3d evaluate` scores those that are in the file.
      row: also write the scores as a CSV file of one row.
      sheet: also draw the worst scenes of the first seed, the truth above what was made.
      quiet: show no progress on a terminal.
      coordinator: where several processes complete the scenes, the address of the first and a free
        port there, such as 10.0.0.1:1234, or auto on a cluster that JAX knows (Slurm, Open MPI,
        Kubernetes). The first scores what all have made; with --graphs each writes its own.
      num_processes: how many there are; a cluster says so itself.
      process_id: which one this is, from 0; a cluster says so itself.
      code: Python files to run first, which register the methods of your own weights.
    """
    from sg3d_jax.distributed import gathered, initialise, is_first, own_file, part
    from sg3d_jax.metrics.report import score, summary
    from sg3d_jax.train.dataset import load_split
    from sg3d_jax.train.evaluation import joined, load_contender

    check_at_least("--num-graphs", 1 if num_graphs is None else num_graphs, 1)
    check_at_least("--seeds", min(seeds, default=-1), 0)
    check_at_least("--candidates", candidates, 1)
    check_at_most("--candidates", candidates, MAX_CANDIDATES)
    check_output(output, (".json",))
    check_output(graphs, (".jsonl",))
    check_output(row, (".csv",))
    check_output(sheet, PICTURES)
    initialise(coordinator, num_processes, process_id)
    run_code(code)
    chosen = load_contender(method, data, diffusion_steps, candidates)
    in_split = load_split(chosen.data, split, chosen.name)
    scenes = in_split[:num_graphs]
    truth = [chosen.target(scene) for scene in scenes]
    made, seconds = [], []
    for seed in seeds:
        began = time.monotonic()
        file = None if graphs is None or made else own_file(graphs)
        own = _completed(chosen, scenes, seed, quiet, file)
        made.append(joined(gathered(own)))
        seconds.append(round(time.monotonic() - began, 2))
    if not is_first():
        part()
        return
    runs: list[dict[str, Any]] = [
        {
            **score(result.graphs, truth, pieces=result.pieces),
            "halted": result.halted,
            **_calibration_errors(result, truth),
        }
        for result in made
    ]
    about = {
        "method": chosen.name,
        "weights": chosen.weights,
        "data": chosen.data.label,
        "split": split,
        "graphs": len(truth),
        "split_graphs": len(in_split),
        "seeds": list(seeds),
        "diffusion_steps": chosen.diffusion_steps,
        "candidates": candidates,
        "seconds": seconds,  # a seed; compilation is in the first
        **provenance(),
    }
    content = {**about, "scores": summary(runs), "runs": runs}
    _print_scores(content)
    if output is not None:
        with replacing(output) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n")
    if row is not None:
        _write_row(row, content)
    if sheet is not None:
        _draw_worst(sheet, made[0].graphs, truth, runs[0]["fgw_per_graph"])
    part()


def table(
    results: Positional[tuple[Path, ...]],
    to: Literal["markdown", "latex"] = "markdown",
    output: OptionalOutput = None,
) -> None:
    """Put results together as the paper's tables, with the paper's own figures.

    Args:
      results: JSON files that `sg3d evaluate -o` wrote.
      to: how tables are written.
      output: a file to write them to, .md or .tex; by default they are printed.
    """
    from sg3d_jax.metrics.table import render

    check_at_least("the number of results", len(results), 1)
    check_output(output, (".md", ".tex"))
    text = render([_result(path) for path in results], to)
    if output is None:
        print(text, end="")
    else:
        with replacing(output) as temporary:
            temporary.write_text(text, encoding="utf-8")


def sheet(
    methods: Positional[tuple[str, ...]],
    output: Output,
    data: str | None = None,
    split: Literal["train", "validation", "test", "all"] = "test",
    num_graphs: int = 6,
    first: int = 0,
    seed: int = 0,
    quiet: bool = False,
    code: Code = (),
) -> None:
    """Draw what methods make of the same scenes: a row a method with its FGW, the truth below.

    Args:
      methods: as for evaluate, all of one data set.
      output: the picture to write: PNG, PDF or SVG.
      data: a data set by name, or a file of graphs; by default that of the methods.
      split: which part of it, or all.
      num_graphs: how many scenes, one a column.
      first: the first of them.
      seed: of the samples.
      quiet: show no progress on a terminal.
      code: Python files to run first, which register the methods of your own weights.
    """
    from sg3d_jax.metrics.fgw import fgw_pairs
    from sg3d_jax.train.dataset import load_split
    from sg3d_jax.train.evaluation import joined, load_contender
    from sg3d_jax.viz.figure import contact_sheet

    check_at_least("the number of methods", len(methods), 1)
    check_at_least("--num-graphs", num_graphs, 1)
    check_at_least("--first", first, 0)
    check_at_least("--seed", seed, 0)
    check_output(output, PICTURES)
    run_code(code)
    chosen = [load_contender(method, data) for method in methods]
    source, *others = (method.data for method in chosen)
    for name, other in zip(methods[1:], others, strict=True):
        if other != source:
            raise ValueError(
                f"{name} is of {other.label} and {methods[0]} of {source.label}, expected methods "
                "of one data set, or --data"
            )
    scenes = load_split(source, split, *(method.name for method in chosen))
    if first >= len(scenes):
        raise ValueError(f"--first must be in 0..{len(scenes) - 1}, got {first}")
    scenes = scenes[first : first + num_graphs]
    rows, captions = [], []
    for method in chosen:
        graphs = joined(_completed(method, scenes, seed, quiet)).graphs
        rows.append((TITLES.get(method.name, method.name), graphs))
        scores = fgw_pairs(graphs, [method.target(scene) for scene in scenes]).value
        captions += [_caption(*pair) for pair in enumerate(scores.tolist(), first)]
    captions += [str(index) for index in range(first, first + len(scenes))]
    contact_sheet([*rows, ("truth", scenes)], output, captions)
    print(f"{output}: {counted(len(chosen), 'method')} on {counted(len(scenes), 'scene')}")


def _completed(
    chosen: Any, scenes: list, seed: int, quiet: bool, graphs: Path | None = None
) -> list[Any]:
    """Returns what is made of this process's share of the scenes; also writes it, to a file."""
    from sg3d_jax.distributed import share
    from sg3d_jax.io.json import graph_to_dict

    places, made = share(range(len(scenes))), []
    each = chosen.complete_each(scenes, seed, places)
    bar = progress(len(places), f"scenes by {chosen.name}, seed {seed}", quiet)
    lines = nullcontext() if graphs is None else lines_to(graphs, len(places))
    with closing(each), lines as write, bar as advance:
        for one in each:
            made.append(one)
            if write is not None:
                write(graph_to_dict(one.graph))
            advance()
    return made


def _calibration_errors(result: Any, truth: list) -> dict[str, float]:
    """Returns how far confidence in nodes and in edges is from what is right, if there is any."""
    from sg3d_jax.metrics.calibration import calibration

    if result.confidence is None:
        return {}
    compared = calibration(result.graphs, truth, *zip(*result.confidence, strict=True))
    return {f"calibration_error_{name}": of.error for name, of in compared.items()}


def _result(path: Path) -> dict[str, Any]:
    """Reads a result file."""
    from sg3d_jax.metrics.table import check_result

    (where, document), *more = read_documents(path)
    if more:
        raise ValueError(
            f"{path}: holds several results, expected one that `sg3d evaluate -o` wrote"
        )
    check_result(document, where)
    return document


def _print_scores(content: dict[str, Any]) -> None:
    """Shows the scores as a table."""
    name = TITLES.get(content["method"], content["method"])
    shown = Table(title=f"{name} on {content['data']}, {content['split']} split")
    shown.add_column("score")
    shown.add_column("value", justify="right")
    shown.add_row("graphs", str(content["graphs"]))
    headings = dict(zip(SCORES, HEADINGS, strict=True))
    for name, value in content["scores"].items():
        if value["mean"] or not name.startswith("node count error"):
            spread = "" if value["sd"] is None else f" ± {value['sd']:.4f}"
            shown.add_row(headings.get(name, name), f"{value['mean']:.4f}{spread}")
    for kind, seen in content["runs"][0]["failures"].items():
        shown.add_row(f"graphs with {kind}", f"{seen['share']:.2%}")
    shown.add_row("seconds, compilation included", f"{sum(content['seconds']):.1f}")
    print_table(shown)


def _write_row(path: Path, content: dict[str, Any]) -> None:
    """Writes one row: what was scored, then mean and standard deviation of every score."""
    cells = {name: content[name] for name in ("method", "data", "split", "graphs")}
    cells["seeds"] = " ".join(map(str, content["seeds"]))
    for name, value in content["scores"].items():
        cells |= {name: value["mean"], f"{name} sd": value["sd"]}
    text = io.StringIO()
    writer = csv.DictWriter(text, cells)
    writer.writeheader()
    writer.writerow(cells)
    with replacing(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8", newline="")


def _draw_worst(path: Path, graphs: list, truth: list, fgw: list[float], count: int = 20) -> None:
    """Draws the scenes of the largest FGW, five in a row, the truth above what was made."""
    from sg3d_jax.viz.figure import contact_sheet

    worst = sorted(range(len(fgw)), key=lambda index: -fgw[index])[:count]
    rows, captions = [], []
    for first in range(0, len(worst), 5):
        chosen = worst[first : first + 5]
        rows.append(("truth", [truth[i] for i in chosen]))
        rows.append(("made", [graphs[i] for i in chosen]))
        captions += [*map(str, chosen), *(_caption(i, fgw[i]) for i in chosen)]
    contact_sheet(rows, path, captions)


def _caption(index: int, fgw: float) -> str:
    """Returns what is printed above a graph: the place of its scene in the split, and its FGW."""
    return f"{index}: FGW {fgw:.3f}"
