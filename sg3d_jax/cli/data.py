"""`sg3d data ...`: data sets made, imported, described, checked, drawn and driven through."""

import json
from pathlib import Path
from typing import Any, Final, Literal

import tyro
from rich.table import Table

from sg3d_jax.cli.arguments import (
    PICTURES,
    OptionalOutput,
    Output,
    Positional,
    check_at_least,
    check_output,
    counted,
    one_of,
    print_table,
    read,
)
from sg3d_jax.cli.progress import shown_data
from sg3d_jax.io.files import replacing

app: Final = tyro.extras.SubcommandApp()


@app.command
def make(
    name: Positional[str],
    output: Output,
    num_graphs: int | None = None,
    seed: int = 0,
    quiet: bool = False,
) -> None:
    """Generate a data set, or what a robot sees of one.

    Args:
      name: which one, such as s-f; s-f@robot, or runs/p-f.npz@robot, as a robot sees it.
      output: the npz file to write.
      num_graphs: how many; as many as the paper has by default.
      seed: another seed gives other graphs.
      quiet: show no progress on a terminal.
    """
    from sg3d_jax.data import registry
    from sg3d_jax.io import npz

    check_at_least("--num-graphs", 1 if num_graphs is None else num_graphs, 1)
    check_at_least("--seed", seed, 0)
    check_output(output, (".npz",))
    if not registry.is_name(name):
        raise ValueError(f"{name} is a file, expected the name of a data set such as s-f")
    with shown_data(quiet):
        dataset = registry.load(name, num_graphs, seed)
    npz.save(output, *dataset)
    print(f"{output}: {counted(len(dataset.graphs))}")


@app.command(name="import")
def import_(
    name: Positional[str],
    source: Positional[Path],
    output: Output,
    seed: int = 0,
    like: str | None = None,
    units: str | None = None,
    turn: bool = False,
    quiet: bool = False,
) -> None:
    """Make a data set from a file that you have.

    Args:
      name: a known one, such as m-f (`sg3d data describe` lists them), or any other name for a data
        set of your own.
      source: graphs in any format; for known names also the published zip or pickle (s-, m-, r-),
        the CSV of the MSD release (m-), floor plans as JSON Lines (p-).
      output: the npz file to write.
      seed: of rotations, of buildings that are put together, and of the split by building.
      like: for a name of your own, a known data set: the file is read as that one's files are, such
        as floor plans like p-f, and its highest concept is checked.
      units: of floor plans of your own: m, cm, mm, ft, in, or how many metres one is, such as 0.02
        where a pixel is 2 cm; by default what their rooms tell, if they do.
      turn: turn each of them by a random angle, as those of known sets are, for training.
      quiet: show no progress on a terminal.
    """
    from sg3d_jax.data import registry
    from sg3d_jax.io import npz

    check_at_least("--seed", seed, 0)
    check_output(output, (".npz",))
    with shown_data(quiet):
        graphs, header = registry.import_file(name, source, seed, like, units, turn)
    npz.save(output, graphs, header)
    print(f"{output}: {counted(len(graphs))}")
    if units is None and (unit := header.get("units", "m")) != "m":
        print(f"{output}: lengths are taken to be in {unit}")
    if "origins" in header and set(header["parts"]) == {"test"}:
        print(f"{output}: all for test: too few buildings for training, validation and test")
    left_out = header.get("left_out", [])
    for reason in left_out[:3]:
        print(f"{output}: left out {reason}")
    if len(left_out) > 3:
        print(f"{output}: left out {len(left_out)} floors or rooms in all")


@app.command
def describe(
    names: Positional[tuple[str, ...]] = (),
    output: OptionalOutput = None,
) -> None:
    """Compare data sets with the paper's table; without a name, list those there are.

    Args:
      names: data sets by name, or npz files.
      output: also write all statistics as JSON, by name.
    """
    from sg3d_jax.data import registry
    from sg3d_jax.metrics.describe import describe as statistics

    check_output(output, (".json",))
    if not names:
        _print_data_sets()
        return
    loaded = {name: registry.load(name) for name in names}
    summaries = {name: statistics(dataset.graphs) for name, dataset in loaded.items()}
    known = {name: str(dataset.header.get("name")) for name, dataset in loaded.items()}
    concepts = [name for dataset in loaded.values() for name in _concepts(dataset.graphs)]
    _print_statistics(summaries, known, [*dict.fromkeys(concepts)])
    if output is not None:
        with replacing(output) as temporary:
            temporary.write_text(json.dumps(summaries, indent=2) + "\n")


@app.command
def check(source: Positional[str]) -> None:
    """Check every graph of a file, and say what is unusual about them.

    Args:
      source: a file of graphs in any format, or a data set by name.
    """
    from sg3d_jax.metrics.oddities import check as remarks_on
    from sg3d_jax.scene.validate import validate_graph

    graphs = read(source)
    for index, graph in enumerate(graphs):
        validate_graph(graph, f"{source}: graph {index}")
    print(f"{source}: {counted(len(graphs))}, all sound")
    for remark in remarks_on(graphs):
        seen = f"{remark.nodes} in {counted(remark.graphs)}, first in graph {remark.first}"
        print(f"{source}: {remark.what}: {seen}")


@app.command
def sheet(source: Positional[str], output: Output, num_graphs: int = 24, first: int = 0) -> None:
    """Draw the graphs of a data set beside one another.

    Args:
      source: a data set by name, or a file of graphs in any format.
      output: the picture to write: PNG, PDF or SVG.
      num_graphs: how many, six in a row.
      first: the first of them.
    """
    from sg3d_jax.viz.figure import dataset_sheet

    check_at_least("--num-graphs", num_graphs, 1)
    check_at_least("--first", first, 0)
    check_output(output, PICTURES)
    graphs = read(source, count=first + num_graphs)[first:]
    dataset_sheet(graphs, output, first)
    print(f"{output}: {counted(len(graphs))} of {source}")


@app.command
def replay(
    source: Positional[str],
    output: Output,
    index: int = 0,
    split: Literal["train", "validation", "test"] | None = None,
    how: Literal["clean", "drive", "loop", "works"] = "drive",
    seed: int = 0,
    truth: Path | None = None,
) -> None:
    """Drive a robot through a complete graph: what its map is told, for `sg3d follow`.

    Args:
      source: a data set by name, or a file of graphs in any format.
      output: the JSON Lines to write, a step a line.
      index: which graph of it.
      split: which graph of this part of it.
      how: clean, all is seen as it is; drive, in part, with noise, planes that are taken for one,
        and furniture; loop, with odometry that drifts until the loop closes; works, with a wall
        that is taken down and one that is built.
      seed: another seed gives another way.
      truth: also write what of the graph the map then shows, a graph a step, as JSON Lines.
    """
    from sg3d_jax.data.replay import REPLAYS
    from sg3d_jax.data.replay import replay as steps_of
    from sg3d_jax.io.files import write_documents
    from sg3d_jax.io.formats import write_graphs
    from sg3d_jax.io.stream import changes_to_dict

    check_at_least("--seed", seed, 0)
    check_output(output, (".jsonl",))
    check_output(truth, (".jsonl",))
    graph = _graph(source, index, split)
    steps = steps_of(graph, REPLAYS[how], seed, index)
    write_documents(output, [changes_to_dict(step.changes) for step in steps])
    if truth is not None:
        graphs = [step.truth for step in steps]
        write_graphs(truth, graphs, attributes=[_ids(step, graph) for step in steps])
    print(f"{output}: {counted(len(steps), 'step')} through graph {index} of {source}")


def _ids(step: Any, graph: Any) -> list[dict[str, int | str]]:
    """Returns the ids of a step: of its planes, and such as "room-12", a row of the graph."""
    from sg3d_jax.scene.graph import ontology_of

    names, label = ontology_of(graph).names, graph.nodes.label
    rest = [f"{names[label[row]]}-{row}" for row in step.rows.tolist()]
    return [{"id": name} for name in (*step.ids, *rest)]


def _graph(source: str, index: int, split: str | None) -> Any:
    """Returns one graph of a data set or a file, or of a part of it."""
    if split is None:
        return read(source, index)[0]
    from sg3d_jax.train.config import DataConfig
    from sg3d_jax.train.dataset import load_split

    return one_of(source, load_split(DataConfig(source), split), index)


def _print_data_sets() -> None:
    """Shows every data set that has a name."""
    from sg3d_jax.data.registry import DATASETS, VIEWS

    views = f"NAME@VIEW or FILE@VIEW: what a robot sees of it; views: {', '.join(VIEWS)}"
    table = Table(title="Data sets", caption=views)
    for column in (
        "name",
        "graphs",
        "levels",
        "paper: graphs, |V|, |E|, degree",
        "split",
        "source",
    ):
        table.add_column(column, overflow="fold")
    for name, spec in DATASETS.items():
        paper = "" if spec.paper is None else ", ".join(f"{value:g}" for value in spec.paper)
        size = "" if spec.num_graphs is None else str(spec.num_graphs)
        levels = ", ".join(spec.levels[1:])
        table.add_row(name, size, levels, paper, spec.split, spec.provenance)
    print_table(table)


def _concepts(graphs: list[Any]) -> list[str]:
    """Returns the names of the concepts of some graphs, those that do not occur among them, too."""
    from sg3d_jax.scene.graph import ontology_of

    return [name for graph in graphs for name in ontology_of(graph).names]


def _print_statistics(
    summaries: dict[str, dict[str, Any]], known: dict[str, str], concepts: list[str]
) -> None:
    """Shows the columns of the paper's table of data sets, the paper's figures in brackets."""
    from sg3d_jax.data.registry import DATASETS

    table = Table(title=r"Means over graphs \[the paper's]")
    table.add_column("data set")
    for column in ("graphs", "|V|", "|E|", "degree", *concepts):
        table.add_column(column, justify="right")
    for name, summary in summaries.items():
        paper = DATASETS[known[name]].paper if known[name] in DATASETS else None
        stated = ("", "", "", "") if paper is None else [rf" \[{value:g}]" for value in paper]
        ours = [str(summary["num_graphs"])]
        ours += [f"{summary[column]['mean']:.1f}" for column in ("nodes", "edges", "degree")]
        counts = [summary["concepts"].get(concept) for concept in concepts]
        shown = ["" if count is None else f"{count['mean']:.2f}" for count in counts]
        columns = [mine + theirs for mine, theirs in zip(ours, stated, strict=True)]
        table.add_row(name, *columns, *shown)
    print_table(table)
