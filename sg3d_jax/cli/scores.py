"""`sg3d evaluate | table`: methods scored, and the paper's tables of the scores."""

import csv
import io
import json
import os
import time
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.table import Table

from sg3d_jax.cli.arguments import (
    PICTURES,
    OptionalOutput,
    Positional,
    check_at_least,
    check_output,
)
from sg3d_jax.interop.files import read_documents, replacing
from sg3d_jax.metrics.paper import HEADINGS, SCORES


def evaluate(
    method: Positional[str],
    data: str | None = None,
    split: Literal["train", "validation", "test", "all"] = "test",
    seeds: tuple[int, ...] = (0,),
    num_graphs: int | None = None,
    diffusion_steps: int | None = None,
    output: OptionalOutput = None,
    row: Path | None = None,
    sheet: Path | None = None,
) -> None:
    """Complete the scenes of a split from their planes and score them against the truth.

    Args:
      method: weights by name or as an npz file, rand, rand-sized, or a file of graphs that were
        made of the scenes, in their order.
      data: a data set by name, or a file of graphs; by default what the weights were trained on.
      split: which part of it, or all.
      seeds: of the samples; several give mean and standard deviation.
      num_graphs: only the first so many scenes of the split.
      diffusion_steps: sampling steps of the topology.
      output: also write everything as JSON, for `sg3d table`.
      row: also write the scores as a CSV file of one row.
      sheet: also draw the worst scenes of the first seed, the truth above what was made.
    """
    from sg3d_jax.metrics.report import score, summary
    from sg3d_jax.train.dataset import load_split
    from sg3d_jax.train.methods import load_method

    check_at_least("--num-graphs", 1 if num_graphs is None else num_graphs, 1)
    check_at_least("--seeds", min(seeds, default=-1), 0)
    check_output(output, (".json",))
    check_output(row, (".csv",))
    check_output(sheet, PICTURES)
    chosen = load_method(method, data, diffusion_steps)
    truth = load_split(chosen.data, split)[:num_graphs]
    began = time.monotonic()
    made = [chosen.complete(truth, seed) for seed in seeds]
    seconds = time.monotonic() - began
    runs: list[dict[str, Any]] = [
        {**score(result.graphs, truth), "halted": result.halted} for result in made
    ]
    about = {
        "method": method,
        "data": chosen.data.label,
        "split": split,
        "graphs": len(truth),
        "seeds": list(seeds),
        "diffusion_steps": chosen.diffusion_steps,
        "seconds": round(seconds, 1),
        "cores": os.cpu_count(),
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


def _result(path: Path) -> dict[str, Any]:
    """Reads a result file."""
    expected = "a file that `sg3d evaluate -o` wrote"
    (where, document), *more = read_documents(path)
    scores = document.get("scores") if isinstance(document, dict) else None
    if more or not isinstance(scores, dict) or not {"method", "data"} <= document.keys():
        raise ValueError(f"{path}: holds no result, expected {expected}")
    for name, value in scores.items():
        if not isinstance(value, dict) or not isinstance(value.get("mean"), (int, float)):
            raise ValueError(f"{where}: scores.{name:.40} has no mean, expected {expected}")
    return document


def _print_scores(content: dict[str, Any]) -> None:
    """Shows the scores as a table."""
    shown = Table(title=f"{content['method']} on {content['data']}, {content['split']} split")
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
    shown.add_row("seconds, compilation included", f"{content['seconds']}")
    Console().print(shown)


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
    rows = []
    for first in range(0, len(worst), 5):
        chosen = worst[first : first + 5]
        rows.append(("truth", [truth[i] for i in chosen]))
        rows.append(("made", [graphs[i] for i in chosen]))
    contact_sheet(rows, path)
