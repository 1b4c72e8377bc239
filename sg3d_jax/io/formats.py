"""Scene graphs and planes in and out of files, whatever their format.

| format | suffix | graphs a file | who reads it |
|---|---|---|---|
| json | .json, .jsonl | one; one a line | anyone (`io.json`) |
| networkx | .json, .jsonl | one; one a line | `networkx.node_link_graph(document, edges="edges")` |
| spark-dsg | .json, .jsonl | one; one a line | `spark_dsg.DynamicSceneGraph.load` |
| s-graphs | .json, .jsonl | one; one a line | S-Graphs, its messages of one map (`io.s_graphs`) |
| graphml | .graphml | one | networkx, Gephi, yEd |
| npz | .npz | any number | `numpy.load`; the format of data sets (`io.npz`) |

What is in a JSON file is told by its keys. Read, too, are the published pickles (.zip, .pkl),
planes (`io.planes`; a .csv file, or {"planes": [...]}), planes as S-Graphs sends them, its messages
as `ros2 topic echo` prints them (.yaml), maps that it saved (a folder, or its graph.g2o), and files
of Hydra's. A file of graphs whose concepts are not the paper's says so: its `ontology` comes back
with them. So do ids, further keys of nodes, and how sure nodes and edges are (`io.attributes`), but
for npz and pickles; messages have ids alone.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sg3d_jax.io import npz, published
from sg3d_jax.io.attributes import (
    NAME,
    Attributes,
    Read,
    bare,
    check_attributes,
    check_edge_confidence,
)
from sg3d_jax.io.files import read_documents, write_document, write_documents
from sg3d_jax.io.graph_documents import read_adjacency, read_cytoscape
from sg3d_jax.io.graphml import NAMES as GRAPHML_NAMES
from sg3d_jax.io.graphml import read_gexf, read_graphml, write_graphml
from sg3d_jax.io.json import graph_to_dict, read_dict
from sg3d_jax.io.networkx import NAMES as NETWORKX_NAMES
from sg3d_jax.io.networkx import graph_to_node_link, read_node_link
from sg3d_jax.io.npz import Dataset
from sg3d_jax.io.planes import read_csv, read_planes_dict
from sg3d_jax.io.records import in_terms_of
from sg3d_jax.io.s_graphs import graph_to_messages, read_message, read_messages
from sg3d_jax.io.s_graphs_dump import read_dump
from sg3d_jax.io.spark_dsg import graph_to_spark_dsg, names_in_metadata, read_spark_dsg
from sg3d_jax.io.spark_dsg_document import HEADER, OLD_LAYERS, put_into
from sg3d_jax.io.yaml import SUFFIXES as YAML
from sg3d_jax.io.yaml import read_yaml
from sg3d_jax.scene.graph import Array, SceneGraph, observed_of, ontology_of
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, Ontology
from sg3d_jax.scene.padding import unpad, unpad_all
from sg3d_jax.scene.validate import check_observed, validate_graph

SPARK_DSG: Final = "spark-dsg"
S_GRAPHS: Final = "s-graphs"
FORMATS: Final = ("json", "networkx", SPARK_DSG, S_GRAPHS, "graphml", "npz")
DOCUMENTS: Final = (".json", ".jsonl")
CSV: Final = ".csv"
NAMES_OF_ROWS: Final = "names"  # in the header of a data set, of each graph by row
BINARY: Final = (".sparkdsg", ".bin")  # as Spark-DSG names what only its package can read
PICKLES: Final = (".zip", *published.SUFFIXES)
READABLE: Final = (*DOCUMENTS, ".npz", ".graphml", ".gexf", CSV, *YAML, ".g2o", *PICKLES)

# A key that tells what a JSON document is, and how it is read; the first that fits.
_DOCUMENTS: Final[tuple[tuple[str, Callable[..., Read]], ...]] = (
    (HEADER, read_spark_dsg),
    (OLD_LAYERS, read_spark_dsg),
    ("adjacency", read_adjacency),
    ("elements", read_cytoscape),
    ("multigraph", read_node_link),
    ("links", read_node_link),
    ("planes", read_planes_dict),
    ("x_planes", read_message),
    ("nodes", read_dict),
    ("ontology", read_planes_dict),
)
_TOLD: Final = (read_spark_dsg, read_planes_dict)  # of the concepts of what states none
_WRITERS: Final[Mapping[str, Callable[..., dict[str, Any]]]] = MappingProxyType(
    {
        "json": graph_to_dict,
        "networkx": graph_to_node_link,
        SPARK_DSG: graph_to_spark_dsg,
        S_GRAPHS: lambda graph, attributes, **_: graph_to_messages(graph, attributes),
    }
)


def read_graphs(path: str | Path) -> list[SceneGraph]:
    """Returns the host graphs of a file; planes alone come as a graph without edges.

    A graph that breaks the hierarchy is returned all the same, to be drawn and scored:
    `sg3d data check` says what is wrong with it.

    Raises:
      ValueError: one sentence that names the file, the graph and the field.
    """
    return [read.graph for read in read_with_attributes(path)]


def read_with_attributes(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    ontology: Ontology = PAPER_ONTOLOGY,
) -> list[Read]:
    """Returns the host graphs of a file, each with what else the file says of its nodes and edges.

    S-Graphs has ids, npz and pickles have nothing that is read; other formats have attributes of
    any name, and graphs in JSON, Spark-DSG, networkx and GraphML may say how sure edges are.

    Args:
      path: the file, or the folder of a map that S-Graphs saved.
      columns: of a CSV file, what its columns are called here, see `read_csv`.
      ontology: the concepts of what states none, such as those of a model.

    Raises:
      ValueError: one sentence that names the file, the graph and the field.
    """
    reads = _reads(path, columns, ontology)
    return [read._replace(graph=in_terms_of(read.graph, ontology)) for read in reads]


def _reads(path: str | Path, columns: Mapping[str, str] | None, ontology: Ontology) -> list[Read]:
    """Returns the graphs of a file; only formats with things beside planes need be told of them."""
    suffix = Path(path).suffix.lower()
    if columns and suffix != CSV:
        raise ValueError(f"{path}: columns are named, expected a {CSV} file")
    if suffix == ".g2o" or Path(path).is_dir():
        return [read_dump(path)]
    if suffix in DOCUMENTS:
        return [_read(document, where, ontology) for where, document in read_documents(path)]
    if suffix in YAML:
        return [_read(document, where, ontology) for where, document in read_yaml(path)]
    if suffix == CSV:
        return [read_csv(path, columns)]
    if suffix == ".npz":
        return _named(npz.load(path, rules=False))
    if suffix == ".graphml":
        return [read_graphml(path)]
    if suffix == ".gexf":
        return [read_gexf(path)]
    if suffix in PICKLES:
        return [bare(graph) for graph in published.read_published(path)]
    if suffix in BINARY:
        instead = "load it with spark_dsg and save it as .json"
        raise ValueError(f"{path}: binary Spark-DSG, expected its JSON: {instead}")
    raise ValueError(f"{path}: the name ends in {suffix!r}, expected one of {', '.join(READABLE)}")


def read_planes(path: str | Path, ontology: Ontology = PAPER_ONTOLOGY) -> list[SceneGraph]:
    """Returns what is observed of every scene of a file, each as a host graph without edges.

    Args:
      path: planes, or graphs whose planes are wanted; metres.
      ontology: the concepts of what states none, such as those of a model.

    Returns:
      The planes, and what else their ontology says is observed, as they are given.

    Raises:
      ValueError: one sentence that names the file, the scene, the plane and the field.
    """
    graphs = [observed_of(read.graph) for read in read_with_attributes(path, None, ontology)]
    for index, graph in enumerate(graphs):
        check_observed(graph, f"{path}: graph {index}" if len(graphs) > 1 else f"{path}")
    return graphs


def write_graphs(
    path: str | Path,
    graphs: Sequence[SceneGraph],
    to: str | None = None,
    extras: Sequence[Mapping[str, Any]] | None = None,
    walls: str = "edges",
    attributes: Sequence[Attributes] | None = None,
    edge_confidence: Sequence[Array | None] | None = None,
) -> None:
    """Writes host graphs in a format; reading them back gives the same graphs, digit for digit.

    Args:
      path: the file to write; its suffix is one of those that the format has.
      graphs: metres; those that are padded are written without padding.
      to: one of `FORMATS`; None for what the suffix names: GraphML, npz or JSON.
      extras: what else the JSON document of each graph should say of it, such as `halt_reason`;
        readers ignore it.
      walls: for Spark-DSG, see `graph_to_spark_dsg`.
      attributes: what else is said of the nodes of each graph, such as `id` and `confidence`; npz
        has no place for it.
      edge_confidence: of each graph how sure its edges are, float[e], 0 to 1, of the rows of
        `parts_first(graph)`, or None; npz has no place for it.

    Raises:
      ValueError: a graph breaks the data model, the suffix is not one of the format, attributes
        cannot be written, or the file holds one graph and there are several.
    """
    path, graphs = Path(path), unpad_all(graphs)
    to = _format_of(path) if to is None else to
    check_writable(path, len(graphs), to)
    if to == "npz":
        if attributes is not None:
            raise ValueError(f"{path}: there are attributes, expected none for {to}")
        if edge_confidence is not None:
            raise ValueError(f"{path}: there is edge_confidence, expected none for {to}")
        npz.save(path, graphs, {}, rules=False)
        return
    nothing = [None] * len(graphs)
    held = nothing if attributes is None else attributes
    sure = nothing if edge_confidence is None else edge_confidence
    said = [
        _checked(*beside, to, f"{path}: graph {index}")
        for index, beside in enumerate(zip(graphs, held, sure, strict=True))
    ]
    if to == "graphml":
        write_graphml(path, graphs[0], **said[0])
    else:
        extras = [{}] * len(graphs) if extras is None else extras
        options = {"walls": walls} if to == SPARK_DSG else {}
        documents = [
            _WRITERS[to](graph, **options, **of_graph, **extra)
            for graph, of_graph, extra in zip(graphs, said, extras, strict=True)
        ]
        if path.suffix.lower() == ".json":
            write_document(path, documents[0])
        else:
            write_documents(path, documents)


def _format_of(path: Path) -> str:
    """Returns the format that the suffix of a file names by itself."""
    suffix = path.suffix.lower()
    return suffix[1:] if suffix in (".graphml", ".npz") else "json"


def write_into(
    path: str | Path,
    graph: SceneGraph,
    theirs: str | Path,
    attributes: Attributes | None = None,
    edge_confidence: Array | None = None,
) -> list[str]:
    """Writes a file of Hydra's with the layers of a host graph added to it, as `put_into` does.

    Args:
      path: the file to write, a .json; it may be the same.
      graph: metres.
      theirs: the file of Hydra's, which stays as it is.
      attributes: what else is said of the nodes; an `id` that is the symbol of a node of theirs
        tells that it is the same node.
      edge_confidence: float[e], 0 to 1, of the rows of `parts_first(graph)`.

    Returns:
      Remarks: a sentence on what of theirs is gone.

    Raises:
      ValueError: one sentence that names the file, the node and the field.
    """
    check_writable(path, 1, SPARK_DSG)
    graph = unpad(graph)
    said = _checked(graph, attributes, edge_confidence, SPARK_DSG, f"{path}: graph 0")
    (where, document), *more = read_documents(theirs)
    if more:
        raise ValueError(f"{theirs}: holds {1 + len(more)} documents, expected one")
    try:
        json.dumps(document, allow_nan=False)
    except ValueError as error:
        problem = "holds NaN or infinity, which JSON does not know"
        raise ValueError(f"{where}: {problem}, expected finite numbers") from error
    made, remarks = put_into(document, graph_to_spark_dsg(graph, **said), where)
    write_document(path, made)
    return remarks


def check_writable(path: str | Path, num_graphs: int, to: str) -> None:
    """Refuses a file that cannot hold so many graphs in a format.

    Raises:
      ValueError: one sentence that names the file and what was expected.
    """
    suffix = Path(path).suffix.lower()
    if to not in FORMATS:
        raise ValueError(f"{path}: the format is {to!r}, expected one of {', '.join(FORMATS)}")
    expected = (f".{to}",) if to in ("graphml", "npz") else DOCUMENTS
    if suffix not in expected:
        raise ValueError(
            f"{path}: the name ends in {suffix!r}, expected {' or '.join(expected)} for {to}"
        )
    if num_graphs != 1 and suffix in (".json", ".graphml"):
        instead = "the name of a .jsonl file" if suffix == ".json" else "one of them"
        raise ValueError(f"{path}: holds one graph, expected {instead} for {num_graphs} graphs")


def _named(dataset: Dataset) -> list[Read]:
    """Returns the graphs of a data set, with what its header calls their nodes."""
    said = dataset.header.get(NAMES_OF_ROWS)
    if not isinstance(said, list) or len(said) != len(dataset.graphs):
        return [bare(graph) for graph in dataset.graphs]
    held = [names if isinstance(names, dict) else {} for names in said]
    return [
        Read(
            graph,
            [{NAME: n} if (n := names.get(f"{row}")) else {} for row in range(graph.n_node[0])],
        )
        for graph, names in zip(dataset.graphs, held, strict=True)
    ]


def _checked(
    graph: SceneGraph,
    attributes: Attributes | None,
    edge_confidence: Array | None,
    to: str,
    where: str,
) -> dict[str, Any]:
    """Returns what a writer takes beside a graph, when all three have been looked at."""
    validate_graph(graph, where, rules=False)
    if attributes is not None:
        num_nodes = len(graph.nodes.label)
        if len(attributes) != num_nodes:
            problem = f"attributes of {len(attributes)} nodes, expected those of {num_nodes}"
            raise ValueError(f"{where}: there are {problem}")
        check_attributes(attributes, ontology_of(graph), where, names=_names(graph, to))
    if edge_confidence is not None:
        check_edge_confidence(edge_confidence, graph, where)
    return {"attributes": attributes, "edge_confidence": edge_confidence}


def _names(graph: SceneGraph, to: str) -> tuple[str, ...]:
    """Returns what a format says of nodes itself, beside what all of them say."""
    if to == SPARK_DSG:
        return names_in_metadata(ontology_of(graph))
    return {"networkx": NETWORKX_NAMES, "graphml": GRAPHML_NAMES}.get(to, ())


def _read(document: Any, where: str, ontology: Ontology) -> Read:
    """Returns the graph of a JSON document of any kind."""
    keys = document if isinstance(document, dict) else {}
    if isinstance(keys.get("planes"), dict):
        return read_messages(document, where)
    for key, read in _DOCUMENTS:
        if key in keys:
            return read(document, where, *((ontology,) if read in _TOLD else ()))
    expected = "nodes and edges, or planes"
    raise ValueError(f"{where}: the document has no key that tells what it is, expected {expected}")
