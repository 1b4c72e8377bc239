"""Scene graphs and planes in and out of files, whatever their format.

| format | suffix | graphs a file | who reads it |
|---|---|---|---|
| json | .json, .jsonl | one; one a line | anyone (`io.json`) |
| networkx | .json, .jsonl | one; one a line | `networkx.node_link_graph(document, edges="edges")` |
| spark-dsg | .json, .jsonl | one; one a line | `spark_dsg.DynamicSceneGraph.load` |
| graphml | .graphml | one | networkx, Gephi, yEd |
| npz | .npz | any number | `numpy.load`; the format of data sets (`io.npz`) |

What is in a JSON file is told by its keys. Read, too, are the published pickles (.zip, .pkl),
planes (`io.planes`; a .csv file, or {"planes": [...]}) and planes as S-Graphs sends them. A file of
graphs whose concepts are not the paper's says so: its `ontology` comes back with them.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sg3d_jax.io import npz, published
from sg3d_jax.io.files import read_documents, write_document, write_documents
from sg3d_jax.io.graphml import read_graphml, write_graphml
from sg3d_jax.io.json import graph_from_dict, graph_to_dict
from sg3d_jax.io.networkx import graph_from_node_link, graph_to_node_link
from sg3d_jax.io.planes import planes_from_csv, planes_from_dict
from sg3d_jax.io.s_graphs import planes_from_message
from sg3d_jax.io.spark_dsg import graph_from_spark_dsg, graph_to_spark_dsg
from sg3d_jax.scene.graph import SceneGraph, observed_of
from sg3d_jax.scene.validate import checked_observed, validate_graph

FORMATS: Final = ("json", "networkx", "spark-dsg", "graphml", "npz")
DOCUMENTS: Final = (".json", ".jsonl")
PICKLES: Final = (".zip", *published.SUFFIXES)
READABLE: Final = (*DOCUMENTS, ".npz", ".graphml", ".csv", *PICKLES)

# A key that tells what a JSON document is, and how it is read; the first that fits.
_DOCUMENTS: Final[tuple[tuple[str, Callable[[Any, str], SceneGraph]], ...]] = (
    ("SPARK_DSG_header", graph_from_spark_dsg),
    ("multigraph", graph_from_node_link),
    ("planes", planes_from_dict),
    ("x_planes", planes_from_message),
    ("nodes", graph_from_dict),
    ("ontology", planes_from_dict),
)
_WRITERS: Final[Mapping[str, Callable[..., dict[str, Any]]]] = MappingProxyType(
    {"json": graph_to_dict, "networkx": graph_to_node_link, "spark-dsg": graph_to_spark_dsg}
)


def read_graphs(path: str | Path) -> list[SceneGraph]:
    """Returns the host graphs of a file; planes alone come as a graph without edges.

    A graph that breaks the hierarchy is returned all the same, to be drawn and scored:
    `sg3d data check` says what is wrong with it.

    Raises:
      ValueError: one sentence that names the file, the graph and the field.
    """
    suffix = Path(path).suffix.lower()
    if suffix in DOCUMENTS:
        return [_graph(document, where) for where, document in read_documents(path)]
    if suffix == ".npz":
        return npz.load(path, rules=False).graphs
    if suffix == ".graphml":
        return [read_graphml(path)]
    if suffix == ".csv":
        return [planes_from_csv(path)]
    if suffix in PICKLES:
        return published.read_published(path)
    raise ValueError(f"{path}: the name ends in {suffix!r}, expected one of {', '.join(READABLE)}")


def read_planes(path: str | Path) -> list[SceneGraph]:
    """Returns what is observed of every scene of a file, each as a host graph without edges.

    Args:
      path: planes, or graphs whose planes are wanted; metres.

    Returns:
      The planes, and what else their ontology says is observed. Normals that were rounded to two
      decimals have length 1.

    Raises:
      ValueError: one sentence that names the file, the scene, the plane and the field.
    """
    graphs = read_graphs(path)
    several = len(graphs) > 1
    return [
        checked_observed(observed_of(graph), f"{path}: graph {index}" if several else f"{path}")
        for index, graph in enumerate(graphs)
    ]


def write_graphs(
    path: str | Path,
    graphs: Sequence[SceneGraph],
    to: str = "json",
    extras: Sequence[Mapping[str, Any]] | None = None,
    walls: str = "edges",
) -> None:
    """Writes host graphs in a format; reading them back gives the same graphs, digit for digit.

    Args:
      path: the file to write; its suffix is one of those that the format has.
      graphs: unpadded, metres.
      to: one of `FORMATS`.
      extras: what else the JSON document of each graph should say of it, such as `halt_reason`;
        readers ignore it.
      walls: for Spark-DSG, see `graph_to_spark_dsg`.

    Raises:
      ValueError: a graph breaks the data model, the suffix is not one of the format, or the file
        holds one graph and there are several.
    """
    path = Path(path)
    check_writable(path, len(graphs), to)
    if to == "npz":
        npz.save(path, graphs, {}, rules=False)
        return
    for index, graph in enumerate(graphs):
        validate_graph(graph, f"{path}: graph {index}", rules=False)
    if to == "graphml":
        write_graphml(path, graphs[0])
    else:
        extras = [{}] * len(graphs) if extras is None else extras
        options = {"walls": walls} if to == "spark-dsg" else {}
        documents = [
            _WRITERS[to](graph, **options, **extra)
            for graph, extra in zip(graphs, extras, strict=True)
        ]
        if path.suffix.lower() == ".json":
            write_document(path, documents[0])
        else:
            write_documents(path, documents)


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


def _graph(document: Any, where: str) -> SceneGraph:
    """Returns the graph of a JSON document of any kind."""
    keys = document if isinstance(document, dict) else {}
    for key, read in _DOCUMENTS:
        if key in keys:
            return read(document, where)
    expected = "nodes and edges, or planes"
    raise ValueError(f"{where}: the document has no key that tells what it is, expected {expected}")
