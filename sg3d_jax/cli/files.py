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
    read,
    read_with_attributes,
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
      truth: of a plan, a file or a data set that has the true graph at the same place: what differs
        is marked.
      follow: draw a stream of graphs, a line each, as `sg3d follow --graphs` writes it, from a file
        or from standard input (-): the page is written again after every line, and loads itself
        again until the stream ends.
    """
    from sg3d_jax.io.attributes import node_confidence_of, node_ids
    from sg3d_jax.viz.figure import save_picture
    from sg3d_jax.viz.page import save_page
    from sg3d_jax.viz.plan import save_plan

    if plan and follow:
        raise ValueError("--plan is for a picture of one graph, got --follow")
    if truth is not None and not plan:
        raise ValueError("--truth is for --plan, got a truth alone")
    if follow:
        _view_stream(source, output, index)
        return
    check_output(output, PICTURES if plan else (*PICTURES, *PAGES))
    is_page = output.suffix.lower() in PAGES
    reads = read_with_attributes(source, index if is_page else index or 0, 100)
    graphs = [read.graph for read in reads]
    of_nodes = [node_confidence_of(read.attributes) for read in reads]
    of_edges = [read.edge_confidence for read in reads]
    if is_page:
        save_page(graphs, output, source, node_confidence=of_nodes, edge_confidence=of_edges)
        print(f"{output}: page of {counted(len(graphs))} of {source}")
    elif plan:
        held = reads[0].attributes
        names = [own.get("name", name) for own, name in zip(held, node_ids(held), strict=True)]
        true = None if truth is None else read(truth, index or 0)[0]
        save_plan(graphs[0], output, names, of_nodes[0], true)
        print(f"{output}: plan of {source}")
    else:
        save_picture(graphs[0], output, node_confidence=of_nodes[0], edge_confidence=of_edges[0])
        print(f"{output}: picture of {source}")


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
        of_nodes = [node_confidence_of(read.attributes)]
        save_page([read.graph], output, where, None, of_nodes, [read.edge_confidence], reload)

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
) -> None:
    """Write scene graphs in the format of another program; nothing is lost.

    Ids, further keys of nodes, and how sure nodes and edges are go along; npz has no place for
    them.

    Args:
      source: a file of graphs or planes in any format, or a data set by name.
      output: .json for one graph or .jsonl for several, .graphml, .npz.
      to: json, networkx (its node-link JSON), spark-dsg, graphml or npz.
      index: only this graph of several.
      walls: for spark-dsg, whether planes are joined to their walls by edges, or name them in their
        metadata, so that each plane has one parent as Hydra expects.
    """
    from sg3d_jax.io.formats import write_graphs

    check_output(output, (".json", ".jsonl", ".graphml", ".npz"))
    if walls != "edges" and to != "spark-dsg":
        raise ValueError(f"--walls {walls} is for --to spark-dsg, got --to {to}")
    reads = read_with_attributes(source, index)
    graphs = [read.graph for read in reads]
    said: dict[str, Any] = {
        "attributes": [read.attributes for read in reads],
        "edge_confidence": [read.edge_confidence for read in reads],
    }
    write_graphs(output, graphs, to, walls=walls, **({} if to == "npz" else said))
    print(f"{output}: {counted(len(graphs))} as {to}")
