"""Sound files of every kind that is read, who reads them, and how they are changed."""

import gzip
import io
import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.data import registry
from sg3d_jax.io import npz
from sg3d_jax.io.files import read_documents
from sg3d_jax.io.formats import read_with_attributes, write_graphs
from sg3d_jax.io.planes import write_planes
from sg3d_jax.metrics.paper import SCORES
from sg3d_jax.metrics.table import check_result, render
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.validate import validate_graph
from sg3d_jax.train.weights import load_weights
from tests.command_line import SCENES, as_csv
from tests.data.test_msd import APARTMENT, rows, table
from tests.fuzz.mutations import (
    Mutation,
    mutated_bytes,
    mutated_gzip,
    mutated_json,
    mutated_npz,
    mutated_zip,
)
from tests.io.test_published import published
from tests.own_world import own_world
from tests.tiny_run import untrained_weights
from tests.two_rooms import two_rooms

MESSAGE: Final = Path(__file__).parents[1] / "io" / "s_graphs.json"


class Kind(NamedTuple):
    """A kind of file."""

    name: str  # of a file of this kind
    content: bytes  # of a sound one
    read: Callable[[Path], None]  # raises AssertionError if what is accepted breaks a rule
    mutations: tuple[Mutation, ...]


def kinds(folder: Path) -> list[Kind]:
    """Returns all kinds of files; sound ones are written into a folder."""
    documents, archives = (mutated_json, mutated_bytes), (mutated_npz, mutated_zip, mutated_bytes)
    packed = mutated_gzip, mutated_bytes
    graphs = [two_rooms(), own_world()]
    made = []
    for to in ("json", "networkx", "spark-dsg"):
        path = folder / f"{to}.json"
        write_graphs(path, graphs[:1], to, attributes=[[{"id": i, "a": 1} for i in range(12)]])
        made.append(Kind(path.name, path.read_bytes(), _read_graphs, documents))
        path = folder / f"{to}.jsonl"
        write_graphs(path, graphs, to)
        made.append(Kind(path.name, path.read_bytes(), _read_graphs, documents))
    write_graphs(folder / "a.graphml", graphs[1:], "graphml")
    write_planes(folder / "planes.json", graphs[0])
    npz.save(folder / "graphs.npz", graphs[:1] * 6, {"name": "a", "parts": ["train"] * 6})
    weights = untrained_weights(folder, "ec-square")
    theirs = pickle.dumps([published(two_rooms())])
    plans = _floor_plans()
    return [
        *made,
        Kind("a.graphml", (folder / "a.graphml").read_bytes(), _read_graphs, (mutated_bytes,)),
        Kind("planes.json", (folder / "planes.json").read_bytes(), _read_graphs, documents),
        Kind("message.json", _message(), _read_graphs, documents),
        Kind("planes.csv", as_csv(SCENES[0]).encode(), _read_graphs, (mutated_bytes,)),
        Kind("graphs.npz", (folder / "graphs.npz").read_bytes(), _read_data_set, archives),
        Kind("theirs.pkl", theirs, _read_graphs, (mutated_bytes,)),
        Kind("theirs.zip", _zipped(theirs), _read_graphs, (mutated_zip, mutated_bytes)),
        Kind("msd.csv", _msd().encode(), _import_as("m-f"), (mutated_bytes,)),
        Kind("plans.jsonl", plans, _import_as("p-f"), documents),
        Kind("plans.jsonl.gz", gzip.compress(plans), _import_as("p-f"), packed),
        Kind("result.json", _result(), _put_into_table, documents),
        Kind("weights.npz", weights.read_bytes(), _load_weights, archives),
    ]


def _read_graphs(path: Path) -> None:
    for read in read_with_attributes(path):
        _check(read.graph, rules=False)
        assert len(read.attributes) == len(read.graph.nodes.label)


def _read_data_set(path: Path) -> None:
    for graph in registry.load(path).graphs:
        _check(graph)


def _import_as(name: str) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        graphs, header = registry.import_file(name, path)
        assert len(graphs) == len(header["parts"])
        for graph in graphs:
            _check(graph)

    return read


def _put_into_table(path: Path) -> None:
    for where, result in read_documents(path):
        check_result(result, where)
        assert "nan" not in render([{**result, "data": "s-f", "method": "fd4"}])


def _load_weights(path: Path) -> None:
    trained = load_weights(path)
    for leaf in _leaves(trained.params):
        assert np.isfinite(leaf).all()


def _leaves(tree: Any) -> list[Any]:
    if isinstance(tree, dict):
        return [leaf for branch in tree.values() for leaf in _leaves(branch)]
    return [tree]


def _check(graph: SceneGraph, rules: bool = True) -> None:
    try:
        validate_graph(graph, "accepted", rules)
    except ValueError as error:
        raise AssertionError(f"{error}") from error


def _msd() -> str:
    return table(
        *(rows(APARTMENT, f"a{i}", f"f{i}", f"b{i}") for i in range(6)), rows(APARTMENT[:1], "")
    )


def _floor_plans() -> bytes:
    corners = ([[0, 0], [4, 0], [4, 3], [0, 3]], [[4.2, 0], [7, 0], [7, 3], [4.2, 3]])
    rooms = [{"poly": poly} for poly in corners]
    floors = [{"building": f"b{i}", "storey": i, "rooms": rooms} for i in range(6)]
    return "\n".join(map(json.dumps, floors)).encode()


def _message() -> bytes:
    return json.dumps(json.loads(MESSAGE.read_bytes())["planes"]).encode()


def _result() -> bytes:
    scores = {name: {"mean": 0.5, "sd": 0.1} for name in SCORES}
    about = {"method": "fd4", "weights": "fd4-s-f", "data": "s-f", "split": "test", "graphs": 60}
    return json.dumps({**about, "candidates": 4, "command": "sg3d", "scores": scores}).encode()


def _zipped(content: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("m-f.pkl", content)
    return file.getvalue()
