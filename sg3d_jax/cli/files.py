"""`sg3d view | export`: scene graphs to look at, and for other programs."""

from pathlib import Path
from typing import Any, Final, Literal

from sg3d_jax.cli.arguments import (
    PAGES,
    PICTURES,
    Output,
    Positional,
    check_output,
    counted,
    read_with_attributes,
    say_remarks,
)

RELOAD: Final = 2.0  # seconds


def view(
    source: Positional[str],
    output: Output,
    index: int | None = None,
    plan: bool = False,
    truth: str | None = None,
    follow: bool = False,
) -> None:
    """Draw scene graphs: a picture of one, or an interactive page of all.

    Where a file says how sure nodes and edges are, those that are not are faint.

    Args:
      source: a file of graphs or planes in any format, or a data set by name.
      output: the picture (PNG, PDF, SVG) or the page (HTML, one file that needs no network).
      index: which graph of several; by default the first for a picture, up to the first hundred
        for a page.
      plan: draw the picture from above, floor by floor, with the names or ids of rooms.
      truth: for a plan or a page, a file or a data set that has the true graphs in the same order:
        what differs is marked, in the plan and in space.
      follow: draw a stream of graphs, a line each, as `sg3d follow --graphs` writes it, from a file
        or from standard input (-): the page is written again after every line, and loads itself
        again until the stream ends.
    """
    from sg3d_jax.io.attributes import node_confidence_of
    from sg3d_jax.viz.figure import save_picture
    from sg3d_jax.viz.page import save_page
    from sg3d_jax.viz.plan import save_plan

    if plan and follow:
        raise ValueError("--plan is for a picture of one graph, got --follow")
    if truth is not None and (follow or not (plan or output.suffix.lower() in PAGES)):
        raise ValueError("--truth is for --plan or a page, got neither")
    if follow:
        _view_stream(source, output, index)
        return
    check_output(output, PICTURES if plan else (*PICTURES, *PAGES))
    is_page = output.suffix.lower() in PAGES
    place = index if is_page else index or 0
    reads = read_with_attributes(source, place, 100)
    graphs = [read.graph for read in reads]
    of_nodes = [node_confidence_of(read.attributes) for read in reads]
    of_edges = [read.edge_confidence for read in reads]
    called = [_names_of(read) for read in reads]
    of_truth = None if truth is None else read_with_attributes(truth, place, len(graphs))
    true = of_truth and [read.graph for read in of_truth]
    if is_page:
        save_page(
            graphs,
            output,
            source,
            node_confidence=of_nodes,
            edge_confidence=of_edges,
            node_names=called,
            truth=true,
            truth_names=of_truth and [_names_of(read) for read in of_truth],
        )
        print(f"{output}: page of {counted(len(graphs))} of {source}")
    elif plan:
        save_plan(graphs[0], output, called[0], of_nodes[0], None if true is None else true[0])
        print(f"{output}: plan of {source}")
    else:
        save_picture(graphs[0], output, node_confidence=of_nodes[0], edge_confidence=of_edges[0])
        print(f"{output}: picture of {source}")


def _names_of(read: Any) -> list[int | str]:
    """Returns what nodes are called: by a name, else by their id, after a kind if it is known."""
    from sg3d_jax.io.attributes import NAME, node_ids
    from sg3d_jax.io.records import KIND, features_by_row

    held = zip(read.attributes, features_by_row(read.graph), node_ids(read.attributes), strict=True)
    return [
        said.get(NAME, f"{kind} {name}" if (kind := owned.get(KIND)) else name)
        for said, owned, name in held
    ]


def _view_stream(source: str, output: Path, index: int | None) -> None:
    """Draws the graph of every line of a stream on one page, the next over the one before."""
    from sg3d_jax.io.attributes import node_confidence_of
    from sg3d_jax.io.json import read_dict
    from sg3d_jax.io.stream import document_of, lines_of
    from sg3d_jax.viz.page import save_page

    check_output(output, PAGES)
    if index is not None:
        raise ValueError(f"--index is for one graph of several, got {index} with --follow")

    def draw(where: str, read: Any, reload: float) -> None:
        sure, called = node_confidence_of(read.attributes), _names_of(read)
        of_edges = [read.edge_confidence]
        save_page([read.graph], output, where, None, [sure], of_edges, reload, [called])

    drawn = None
    for where, line in lines_of(source):
        document = document_of(line, where)
        if isinstance(document, dict) and document.get("nodes") == []:  # of a map without anything
            continue
        drawn = where, read_dict(document, where)
        draw(*drawn, RELOAD)
    if drawn is None:
        raise ValueError(f"{source}: there are no graphs, expected one a line")
    draw(*drawn, 0.0)
    print(f"{output}: page of the last graph of {source}")


def export(
    source: Positional[str],
    output: Output,
    to: str = "json",
    index: int | None = None,
    walls: Literal["edges", "metadata"] = "edges",
    into: Path | None = None,
    columns: str | None = None,
) -> None:
    """Write scene graphs in the format of another program; nothing is lost.

    Ids, further keys of nodes, and how sure nodes and edges are go along; s-graphs has a place for
    ids alone, npz for none of them. What is in a file and cannot be read is a remark on stderr.

    Args:
      source: a file of graphs or planes in any format, a map that S-Graphs saved (its folder), or a
        data set by name.
      output: .json for one graph or .jsonl for several, .graphml, .npz.
      to: json, networkx (its node-link JSON), spark-dsg, s-graphs (its messages), graphml or npz.
      index: only this graph of several.
      walls: for spark-dsg, whether planes are joined to their walls by edges, or name them in their
        metadata; each plane has its room as its one parent, as Hydra expects.
      into: for spark-dsg, a file of Hydra's to add the layers of one graph to.
      columns: for planes as CSV, the names of its columns and what they are, such as
        x=cx,y=cy,length=width.
    """
    from sg3d_jax.io.formats import write_graphs, write_into

    check_output(output, (".json", ".jsonl", ".graphml", ".npz"))
    if (walls != "edges" or into is not None) and to != "spark-dsg":
        option = "--into" if into is not None else f"--walls {walls}"
        raise ValueError(f"{option} is for --to spark-dsg, got --to {to}")
    if walls != "edges" and into is not None:
        raise ValueError(f"--into has walls as edges, got --walls {walls}")
    reads = read_with_attributes(source, index, columns=columns)
    if into is not None:
        if len(reads) != 1:
            raise ValueError(
                f"--into is for one graph, expected --index, got {counted(len(reads))}"
            )
        ((graph, held, sure, _),) = reads
        say_remarks(write_into(output, graph, into, held, sure))
        print(f"{output}: {into} with the layers of {source}")
        return
    graphs = [read.graph for read in reads]
    said: dict[str, Any] = {
        "attributes": [read.attributes for read in reads],
        "edge_confidence": [read.edge_confidence for read in reads],
    }
    write_graphs(output, graphs, to, walls=walls, **({} if to == "npz" else said))
    print(f"{output}: {counted(len(graphs))} as {to}")
