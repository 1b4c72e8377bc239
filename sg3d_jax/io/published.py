"""The data sets as their authors published them: zips of pickled networkx graphs.

A zip holds one pickle, a list of `networkx.Graph`. It is read as data (`io.pickles`): no class or
function of any package ever sees what is in it. What is kept of a node is its type, its centre and,
of planes, normal and width; of an edge, its ends. Edges are told by what they join: two planes are
near each other, anything else is a part and its whole.

Source: the attributes are those of snt-arg/situational_graphs_datasets. The width d of the paper is
their `length`. It is stale for some planes of S-F and S-C, which were cut or scaled after it was
measured; it is kept, for it is what was published. Where it is missing, or counts x only (the
authors' last step on the recordings), the distance of the ends is the width.

Differs: nodes are put in the order planes, walls, rooms, floors, buildings, city, and numbered so.
"""

import math
import struct
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from sg3d_jax.io.files import MAX_GRAPHS, read_bytes
from sg3d_jax.io.networkx import read_nodes_and_edges
from sg3d_jax.io.pickle_words import Asked, Name
from sg3d_jax.io.pickles import MAX_MEMORY, read_pickle
from sg3d_jax.scene.graph import SceneGraph, subgraph

EXPECTED: Final = "a pickled list of networkx graphs"
SUFFIXES: Final = (".pkl", ".pickle", ".p", ".gpickle")
# Of the pickle; the largest published one has about 300 million. Unpacking takes four times that.
MAX_BYTES: Final = 3 * 2**27
FIELDS: Final = ("type", "center", "normal", "length", "limits")

_GRAPH: Final = Name("networkx.classes.graph", "Graph")
_DTYPE: Final = Name("numpy", "dtype")
_ENCODE: Final = Name("_codecs", "encode")
_BUILTINS: Final = ("object", "dict", "bytes", "bytearray")
_MODULES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "networkx.classes.graph": ("Graph",),
        "networkx.classes.reportviews": ("NodeView", "EdgeView", "DegreeView"),
        "networkx.classes.coreviews": ("AdjacencyView", "AtlasView"),
        "numpy": ("ndarray", "dtype"),
        "numpy.core.multiarray": ("_reconstruct", "scalar"),
        "numpy.core.numeric": ("_frombuffer",),
        "numpy._core.multiarray": ("_reconstruct", "scalar"),
        "numpy._core.numeric": ("_frombuffer",),
        # What protocols 0 to 2 say for objects and bytes.
        "copyreg": ("_reconstructor",),
        "copy_reg": ("_reconstructor",),
        "builtins": _BUILTINS,
        "__builtin__": _BUILTINS,
        "_codecs": ("encode",),
        # Polygons that nodes of M may carry; they are not read.
        "shapely.geometry.polygon": ("Polygon",),
        "shapely.geometry.multipolygon": ("MultiPolygon",),
        "shapely.geometry.point": ("Point",),
        "shapely.io": ("from_wkb",),
    }
)
ADMITTED: Final = frozenset(Name(module, name) for module in _MODULES for name in _MODULES[module])

# How `struct` says what a numpy dtype says; objects, texts and records it cannot.
_LETTERS: Final[Mapping[str, str]] = MappingProxyType(
    {"f2": "e", "f4": "f", "f8": "d"}
    | {"i1": "b", "i2": "h", "i4": "i", "i8": "q"}
    | {"u1": "B", "u2": "H", "u4": "I", "u8": "Q"}
)
_ORDERS: Final[Mapping[str, str]] = MappingProxyType({"<": "<", ">": ">", "|": "<"})
_OTHER_ZIP_ERRORS: Final = (EOFError, OSError, ValueError, RuntimeError)
MAX_ITEMS: Final = 64  # of an array that is read; two points have six
MAX_SIZE: Final = 200_000  # nodes and ends of edges of a graph
BYTES_OF_AN_ARRAY: Final = 192  # beside its items
_KEPT: Final = ("_node", "_adj")
NO_GRAPH: Final = f": there are no {' and '.join(_KEPT)}, expected a networkx graph"


def read_published(path: str | Path, most: int = MAX_MEMORY) -> list[SceneGraph]:
    """Returns the host graphs of a published file, with the proximity edges that it has.

    Args:
      path: a zip that holds one pickle, or the pickle.
      most: bytes that the pickle and what is kept of it may take.

    Raises:
      ValueError: one sentence that names the file and what it asks for or holds: a pickle that
        would run something, another file, a graph, node or edge that breaks the data model.
    """
    pickled = _pickle_of(path)
    graphs = read_pickle(pickled, ADMITTED, f"{path}", EXPECTED, most, _made)
    if not isinstance(graphs, list) or not graphs:
        raise ValueError(f"{path}: the pickle holds no list or an empty one, expected {EXPECTED}")
    if len(graphs) > MAX_GRAPHS:
        raise ValueError(f"{path}: there are {len(graphs)} graphs, expected {MAX_GRAPHS} at most")
    return [_scene(graph, f"{path}: graph {index}") for index, graph in enumerate(graphs)]


def _pickle_of(path: str | Path) -> bytes:
    """Returns the bytes of the pickle in a zip, or of the file itself."""
    data = read_bytes(path, MAX_BYTES)
    if not data:
        raise ValueError(f"{path}: the file is empty, expected {EXPECTED}")
    if data.startswith(b"version https://git-lfs"):
        problem = "the file is a git-lfs pointer, not the data"
        raise ValueError(f"{path}: {problem}, expected what 'git lfs pull' puts in its place")
    if Path(path).suffix.lower() != ".zip" and not data.startswith(b"PK"):
        return data
    return _unzip(data, f"{path}")


def _unzip(data: bytes, where: str) -> bytes:
    """Returns the one pickle of a zip; folders and what a Mac adds do not count."""
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            members = [member for member in archive.infolist() if _is_pickle(member.filename)]
            problem = _zip_problem(members)
            pickled = b"" if problem else archive.read(members[0])
    except (zipfile.BadZipFile, zlib.error, struct.error, *_OTHER_ZIP_ERRORS) as error:
        raise ValueError(f"{where}: the zip is cut short or broken, expected {EXPECTED}") from error
    if problem:
        raise ValueError(f"{where}: the zip {problem}")
    return pickled


def _is_pickle(name: str) -> bool:
    *folders, last = name.split("/")
    hidden = "__MACOSX" in folders or last.startswith(".")
    return last.lower().endswith(SUFFIXES) and not hidden


def _zip_problem(members: list[zipfile.ZipInfo]) -> str | None:
    if len(members) != 1:
        return f"holds {len(members)} pickles, expected one"
    (member,) = members
    if member.flag_bits & 1:
        return "is encrypted, expected one that is not"
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return f"is compressed by method {member.compress_type}, expected deflate"
    if member.file_size > MAX_BYTES:
        return f"holds a pickle of {member.file_size} bytes, expected {MAX_BYTES} at most"
    return None


def _scene(graph: Any, where: str) -> SceneGraph:
    """Returns what was made of a networkx graph, or refuses it."""
    made = graph.state if isinstance(graph, Asked) and graph.name == _GRAPH else None
    if isinstance(made, SceneGraph):
        return made
    raise ValueError(f"{where}{made or NO_GRAPH}")


def _made(asked: Asked) -> tuple[Any, int]:
    """Returns the host graph that a networkx graph describes, or what is wrong with it, and bytes.

    What is wrong is the rest of a sentence: which graph of the list it is, is not yet known.
    """
    if asked.name != _GRAPH:
        return asked.state, 0
    try:
        scene = _read(asked.state, "")
    except ValueError as error:
        return f"{error}", sys.getsizeof(f"{error}") + BYTES_OF_AN_ARRAY
    ends = scene.senders, scene.receivers, scene.n_node, scene.n_edge
    arrays = (*scene.nodes, *scene.edges, *ends)
    return scene, sum(array.nbytes + BYTES_OF_AN_ARRAY for array in arrays)


def _read(state: Any, where: str) -> SceneGraph:
    """Returns the host graph that the state of a networkx graph describes."""
    nodes, adjacency = (state.get(key) if isinstance(state, dict) else None for key in _KEPT)
    if not isinstance(nodes, dict) or not isinstance(adjacency, dict):
        raise ValueError(f"{where}{NO_GRAPH}")
    size = len(nodes) + sum(len(each) for each in adjacency.values() if isinstance(each, dict))
    if size > MAX_SIZE:
        problem = f"there are {size} nodes and ends of edges"
        raise ValueError(f"{where}: {problem}, expected {MAX_SIZE} at most")
    read = read_nodes_and_edges(_nodes(nodes, where), _edges(adjacency, where), where).graph
    return subgraph(read, np.argsort(read.nodes.label, kind="stable"))


def _nodes(nodes: dict[Any, Any], where: str) -> Iterator[tuple[int | str, dict[str, Any]]]:
    for key, attributes in nodes.items():
        name = _id(key, where)
        if not isinstance(attributes, dict):
            problem = f"has no attributes, expected {', '.join(FIELDS)}"
            raise ValueError(f"{where}: node {name!r:.40} {problem}")
        yield name, {key: _plain(attributes[key]) for key in FIELDS if key in attributes}


def _edges(
    adjacency: dict[Any, Any], where: str
) -> Iterator[tuple[int | str, int | str, dict[str, Any]]]:
    """Gives each edge once, without attributes: the type that a file states is always the same."""
    directed: dict[tuple[int | str, int | str], bool] = {}  # whether the opposite was given
    for key, neighbours in adjacency.items():
        source = _id(key, where)
        if not isinstance(neighbours, dict):
            problem = "has no neighbours in _adj, expected a mapping"
            raise ValueError(f"{where}: node {source!r:.40} {problem}")
        for target in (_id(other, where) for other in neighbours):
            if (source, target) in directed:
                edge = f"edge ({source!r:.40}, {target!r:.40})"
                raise ValueError(f"{where}: {edge} is there twice, expected once")
            directed[source, target] = False
    for (source, target), given in directed.items():
        if (target, source) not in directed:
            edge = f"edge ({source!r:.40}, {target!r:.40})"
            raise ValueError(f"{where}: {edge} has no opposite, expected an undirected graph")
        if not given:
            directed[target, source] = True
            yield source, target, {}


def _id(key: Any, where: str) -> int | str:
    name = _plain(key)
    if isinstance(name, bool) or not isinstance(name, (int, str)):
        raise ValueError(f"{where}: a node has id {key!r:.40}, expected an integer or a name")
    return name


def _plain(value: Any, depth: int = 2) -> Any:
    """Returns numbers and lists of numbers as Python has them, anything else as it is."""
    if isinstance(value, Asked):
        try:
            return _array(value)
        except (ValueError, LookupError, TypeError, struct.error):
            return value  # the reader of the field says that this is not what it expects
    if depth and isinstance(value, (list, tuple)) and len(value) <= MAX_ITEMS:
        return [_plain(item, depth - 1) for item in value]
    return value


def _array(asked: Asked) -> Any:
    """Returns the number or list that numpy would make of a request; raises if it would not."""
    if asked.name.name == "scalar":
        (dtype, raw), shape, by_column = asked.arguments, (), False
    elif asked.name.name == "_frombuffer":
        raw, dtype, shape, order = asked.arguments
        by_column = order == "F"
    elif asked.name.name == "_reconstruct":
        _, shape, dtype, by_column, raw = asked.state
    else:
        raise TypeError(f"{asked!r} is no array")
    if len(shape) > 2 or min(shape, default=0) < 0 or math.prod(shape) > MAX_ITEMS:
        raise ValueError(f"{asked!r} is larger than what is read")
    size = math.prod(shape)
    byte_order, letter = _layout(dtype)
    flat = list(struct.unpack(f"{byte_order}{size}{letter}", _bytes(raw)))
    if len(shape) < 2:
        return flat if shape else flat[0]
    rows, columns = shape
    if by_column:
        return [flat[row::rows] for row in range(rows)]
    return [flat[row * columns : (row + 1) * columns] for row in range(rows)]


def _layout(dtype: Any) -> tuple[str, str]:
    """Returns byte order and letter by which `struct` knows a plain numeric dtype."""
    if not isinstance(dtype, Asked) or dtype.name != _DTYPE:
        raise TypeError("what should be a dtype is none")
    return _ORDERS[dtype.state[1]], _LETTERS[dtype.arguments[0]]


def _bytes(raw: Any) -> Any:
    """Returns bytes as they are, and the request as which protocols 0 to 2 write them, as bytes."""
    if isinstance(raw, Asked) and raw.name == _ENCODE:
        text, encoding = raw.arguments
        if not isinstance(text, str) or encoding != "latin1":
            raise TypeError(f"{raw!r} is no bytes")
        return text.encode("latin1")
    return raw
