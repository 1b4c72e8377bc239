"""Sound files of every kind that is read, who reads them, and how they are changed.

A map that S-Graphs saved is a folder; here it is a zip of one, which is unpacked to be read.
"""

import gzip
import io
import json
import pickle
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import networkx
import numpy as np

from sg3d_jax.data import registry
from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.io import npz
from sg3d_jax.io.files import read_documents
from sg3d_jax.io.formats import read_with_attributes, write_graphs, write_into
from sg3d_jax.io.planes import COLUMNS, write_planes
from sg3d_jax.io.stream import Heard, document_of, lines_of, read_changes
from sg3d_jax.metrics.paper import SCORES
from sg3d_jax.metrics.table import check_result, render
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, Ontology
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
from tests.io import test_objects as objects
from tests.io import test_s_graphs_dump as dump
from tests.io import test_stream as stream
from tests.io import test_yaml as printed
from tests.io.test_graph_documents import cytoscape, d3, d3_by_place, networkx_of
from tests.io.test_published import published
from tests.io.test_spark_dsg import saved_by_hydra
from tests.own_world import own_world
from tests.tiny_run import untrained_weights
from tests.two_rooms import two_rooms

MESSAGES: Final = json.loads((Path(__file__).parents[1] / "io" / "s_graphs.json").read_bytes())
THEIR_COLUMNS: Final = {f"their {name}": name for name in COLUMNS}


BYTES: Final = (mutated_bytes,)
DOCUMENTS: Final = (mutated_json, mutated_bytes)
ARCHIVES: Final = (mutated_npz, mutated_zip, mutated_bytes)
FOLDERS: Final = (mutated_zip,)


class Kind(NamedTuple):
    """A kind of file."""

    name: str  # of a file of this kind
    content: bytes  # of a sound one
    read: Callable[[Path], None]  # raises AssertionError if what is accepted breaks a rule
    mutations: tuple[Mutation, ...]


def kinds(folder: Path) -> list[Kind]:
    """Returns all kinds of files; sound ones are written into a folder."""
    return [
        *_own_formats(folder),
        *_documents_of_others(folder),
        *_maps_of_robots(),
        *_data_sets(folder),
        *_of_training(folder),
    ]


def _own_formats(folder: Path) -> list[Kind]:
    """Returns what the package writes itself."""
    graphs = [two_rooms(), own_world()]
    made = []
    for to in ("json", "networkx", "spark-dsg"):
        path = folder / f"{to}.json"
        write_graphs(path, graphs[:1], to, attributes=[[{"id": i, "a": 1} for i in range(12)]])
        made.append(Kind(path.name, path.read_bytes(), _read_graphs, DOCUMENTS))
        path = folder / f"{to}.jsonl"
        write_graphs(path, graphs, to)
        made.append(Kind(path.name, path.read_bytes(), _read_graphs, DOCUMENTS))
    write_graphs(folder / "a.graphml", graphs[1:], "graphml")
    write_planes(folder / "planes.json", graphs[0])
    cells = as_csv(SCENES[0])
    theirs = cells.replace(",".join(COLUMNS), ";".join(THEIR_COLUMNS)).replace(",", ";")
    things = [objects.thing("bed", id=4, size=[2, 1, 0.5]), objects.thing("sofa", colour="red")]
    furnished = {"planes": objects.PLANES, "objects": things}
    return [
        *made,
        Kind("a.graphml", (folder / "a.graphml").read_bytes(), _read_graphs, BYTES),
        Kind("planes.json", (folder / "planes.json").read_bytes(), _read_graphs, DOCUMENTS),
        Kind("planes.csv", cells.encode(), _read_graphs, BYTES),
        Kind("columns.csv", theirs.encode(), _read_graphs_as(columns=THEIR_COLUMNS), BYTES),
        Kind("objects.json", _json(furnished), _read_furnished, DOCUMENTS),
    ]


def _documents_of_others(folder: Path) -> list[Kind]:
    """Returns graphs as other programs write them."""
    graph = networkx_of(two_rooms())
    made = {
        "adjacency": networkx.adjacency_data(graph),
        "cytoscape": cytoscape(two_rooms()),
        "multigraph": networkx.node_link_data(networkx.MultiGraph(graph), edges="links"),
        "d3": d3(two_rooms()),
        "places": d3_by_place(two_rooms()),
    }
    write_graphs(folder / "b.graphml", [two_rooms()], "graphml")
    gexf = "\n".join(networkx.generate_gexf(networkx.read_graphml(folder / "b.graphml"))).encode()
    return [
        *[Kind(f"{k}.json", _json(held), _read_graphs, DOCUMENTS) for k, held in made.items()],
        Kind("a.gexf", gexf, _read_graphs, BYTES),
    ]


def _maps_of_robots() -> list[Kind]:
    """Returns what S-Graphs and Hydra write, and what a map tells while it comes about."""
    moved = json.dumps(stream.MESSAGE).replace("0.5", "0.75")
    printed_twice = f"{printed.MESSAGE}---\n{printed.MESSAGE}"
    hydra = {version: _json(saved_by_hydra(version)) for version in ("new", "oldest")}
    lines = [stream.LINE, {"planes": [stream.PLANE], "removed": [7]}, {}]
    told = "\n".join(map(json.dumps, lines)).encode()
    messages = f"{json.dumps(stream.MESSAGE)}\n{moved}".encode()
    return [
        Kind("message.json", _json(MESSAGES["planes"]), _read_graphs, DOCUMENTS),
        Kind("map.json", _json(MESSAGES), _read_graphs, DOCUMENTS),
        Kind("printed.yaml", printed_twice.encode(), _read_graphs, BYTES),
        Kind("old-map", _zipped(_folder(dump.old)), _read_folder, FOLDERS),
        Kind("new-map", _zipped(_folder(dump.new)), _read_folder, FOLDERS),
        Kind("hydra.json", hydra["new"], _read_furnished, DOCUMENTS),
        Kind("old-hydra.json", hydra["oldest"], _read_furnished, DOCUMENTS),
        Kind("into.json", hydra["new"], _put_into, DOCUMENTS),
        Kind("told.jsonl", told, _hear, DOCUMENTS),
        Kind("messages.jsonl", messages, _hear, DOCUMENTS),
    ]


def _data_sets(folder: Path) -> list[Kind]:
    """Returns what data sets are, and are made of."""
    theirs = pickle.dumps([published(two_rooms())])
    npz.save(folder / "graphs.npz", [two_rooms()] * 6, {"name": "a", "parts": ["train"] * 6})
    plans, own = _floor_plans(1), _floor_plans(1000)
    return [
        Kind("graphs.npz", (folder / "graphs.npz").read_bytes(), _read_data_set, ARCHIVES),
        Kind("theirs.pkl", theirs, _read_graphs, BYTES),
        Kind("theirs.zip", _zipped({"m-f.pkl": theirs}), _read_graphs, (mutated_zip, *BYTES)),
        Kind("msd.csv", _msd().encode(), _import_as("m-f"), BYTES),
        Kind("plans.jsonl", plans, _import_as("p-f"), DOCUMENTS),
        Kind("plans.jsonl.gz", gzip.compress(plans), _import_as("p-f"), (mutated_gzip, *BYTES)),
        Kind("own.jsonl", own, _import_as("home", like="p-f"), DOCUMENTS),
        Kind("own-mm.jsonl", own, _import_as("home", like="p-f", units="mm"), DOCUMENTS),
    ]


def _of_training(folder: Path) -> list[Kind]:
    """Returns weights and results."""
    weights = untrained_weights(folder, "ec-square").read_bytes()
    return [
        Kind("result.json", _result(), _put_into_table, DOCUMENTS),
        Kind("weights.npz", weights, _load_weights, ARCHIVES),
    ]


def _read_graphs_as(
    columns: Mapping[str, str] | None = None, ontology: Ontology = PAPER_ONTOLOGY
) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        for found in read_with_attributes(path, columns, ontology):
            _check(found.graph, rules=False)
            assert len(found.attributes) == len(found.graph.nodes.label)

    return read


_read_graphs = _read_graphs_as()
_read_furnished = _read_graphs_as(ontology=FURNISHED_ONTOLOGY)


def _read_folder(path: Path) -> None:
    folder = path.with_name(f"{path.name}-unpacked")
    shutil.rmtree(folder, ignore_errors=True)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    _read_graphs(folder)


def _put_into(path: Path) -> None:
    written = path.with_name("written.json")
    write_into(written, two_rooms(), path)
    _read_graphs(written)


def _hear(path: Path) -> None:
    heard = Heard()
    for where, line in lines_of(str(path)):
        changes, heard = read_changes(document_of(line, where), PAPER_ONTOLOGY, heard, where)
        assert len({*changes.ids}) == len(changes.ids)
        if changes.observed is not None:
            _check(changes.observed, rules=False)
            assert len(changes.ids) == len(changes.observed.nodes.label)


def _read_data_set(path: Path) -> None:
    for graph in registry.load(path).graphs:
        _check(graph)


def _import_as(name: str, **options: Any) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        graphs, header = registry.import_file(name, path, **options)
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


def _floor_plans(scale: float) -> bytes:
    corners = ([[0, 0], [4, 0], [4, 3], [0, 3]], [[4.2, 0], [7, 0], [7, 3], [4.2, 3]])
    rooms = [
        {"poly": (scale * np.array(poly)).tolist(), "name": f"room {i}"}
        for i, poly in enumerate(corners)
    ]
    floors = [{"building": f"b{i}", "storey": i, "rooms": rooms} for i in range(6)]
    return "\n".join(map(json.dumps, floors)).encode()


def _json(document: Any) -> bytes:
    return json.dumps(document).encode()


def _result() -> bytes:
    scores = {name: {"mean": 0.5, "sd": 0.1} for name in SCORES}
    about = {"method": "fd4", "weights": "fd4-s-f", "data": "s-f", "split": "test", "graphs": 60}
    return json.dumps({**about, "candidates": 4, "command": "sg3d", "scores": scores}).encode()


def _folder(write: Callable[[Path], None]) -> dict[str, bytes]:
    """Returns the files that are written into a folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "000000").mkdir()
        write(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        return {f"{path.relative_to(folder)}": path.read_bytes() for path in paths}


def _zipped(members: Mapping[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()
