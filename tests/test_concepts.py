"""Concepts are data: what works for all of them names none, and reaches node fields by name."""

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import pytest

from sg3d_jax.scene.ontology import PAPER_ONTOLOGY

PACKAGE: Final = Path(__file__).parents[1] / "sg3d_jax"
MODULES: Final = sorted(PACKAGE.rglob("*.py"))

# Generators (data/) and baselines (baselines/) may name concepts, and of the command line the names
# of commands and options do.
GENERAL: Final = (
    "scene",
    "diffusion",
    "nn",
    "fill",
    "flagg",
    "infer",
    "metrics",
    "train",
    "io",
    "viz",
)
AT_HOME: Final = (
    "scene/ontology.py",  # defines the default
    "io/s_graphs.py",  # reads and writes what another program calls planes, walls, rooms, floors
    "io/s_graphs_dump.py",  # reads what it saves
)

# Module -> strings that have to stay, as keys of files, names of the public API or of others.
ADMITTED: Final[Mapping[str, set[str]]] = {
    # Keys of documents of planes and of S-Graphs, and an option of `sg3d export`.
    "io/formats.py": {"planes", "x_planes", "walls", "nodes and edges, or planes"},
    # What the function `planes` says of its arguments.
    "io/planes.py": {
        "planes: ",
        "planes: nothing observed has normal and width, expected that something has",
        " is no array of numbers, expected a row a plane",
    },
    # The layer that has a class of nodes of its own in Spark-DSG, and an option.
    "io/spark_dsg.py": {"ROOMS", "walls is "},
    # The layers of Hydra, which its old files do not name.
    "io/spark_dsg_document.py": {"ROOMS", "BUILDINGS"},
    # A layer of EC-L, a baseline that knows planes and rooms alone, by its name in stored weights.
    "nn/edge_attention.py": {"planes"},
}

CONSTANTS: Final = {name.upper() for name in PAPER_ONTOLOGY.names}
WORDS: Final = {
    form
    for concept in PAPER_ONTOLOGY.concepts
    for form in (concept.name, f"{concept.name}s", concept.layer.lower())
}
# `sg.planes` is no concept but a function that users are told of.
NAMED: Final = re.compile(rf"(?<![a-z])(?<!\bsg\.)({'|'.join(WORDS)})(?![a-z])", re.IGNORECASE)


def _name(module: Path) -> str:
    return module.relative_to(PACKAGE).as_posix()


def _is_general(module: Path) -> bool:
    return _name(module).split("/")[0] in GENERAL and _name(module) not in AT_HOME


def _strings(tree: ast.AST) -> Iterator[str]:
    """Yields the strings of a module, those of f-strings in pieces, but not its docstrings."""
    docstrings = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        is_string = isinstance(node, ast.Constant) and isinstance(node.value, str)
        if is_string and node not in docstrings:
            yield node.value


def _identifiers(tree: ast.AST) -> Iterator[str]:
    """Yields the names that a module imports and uses."""
    for node in ast.walk(tree):
        match node:
            case ast.alias(name=name) | ast.Name(id=name) | ast.Attribute(attr=name):
                yield name


def _by_position(tree: ast.AST) -> Iterator[str]:
    """Yields what takes a field, or several, of `Nodes` by position."""
    for node in ast.walk(tree):
        match node:
            case ast.Subscript(
                value=ast.Attribute(attr="nodes") | ast.Name(id="nodes"),
                slice=ast.Slice() | ast.Constant() | ast.UnaryOp(),
            ):
                yield ast.unparse(node)


GENERAL_MODULES: Final = [module for module in MODULES if _is_general(module)]


@pytest.mark.parametrize("module", GENERAL_MODULES, ids=_name)
def test_general_module__names_no_concept(module: Path) -> None:
    tree = ast.parse(module.read_text())
    assert CONSTANTS & set(_identifiers(tree)) == set()
    named = {string for string in _strings(tree) if NAMED.search(string)}
    assert named == ADMITTED.get(_name(module), set())


@pytest.mark.parametrize("module", MODULES, ids=_name)
def test_module__takes_node_fields_by_name(module: Path) -> None:
    assert list(_by_position(ast.parse(module.read_text()))) == []


@pytest.mark.parametrize(
    "program",
    [
        "from sg3d_jax.scene.ontology import FLOOR",
        "ontology.label_of('room')",
        "LAYER = 'CITIES'",
        "raise ValueError(f'{where}: planes holds {held}')",
        "key = 'num_planes'",
        "from sg3d_jax.scene import ontology\nwalls = label == ontology.WALL",
    ],
)
def test_names_of_concepts__are_seen(program: str) -> None:
    tree = ast.parse(program)
    assert CONSTANTS & set(_identifiers(tree)) or any(map(NAMED.search, _strings(tree)))


@pytest.mark.parametrize(
    "program",
    [
        "'''Reads planes.'''",
        "raise ValueError('expected a host graph, as of sg.planes')",
        "jnp.floor(position)",
        "where = 'an aeroplane'",
    ],
)
def test_what_names_no_concept__is_let_through(program: str) -> None:
    tree = ast.parse(program)
    assert not CONSTANTS & set(_identifiers(tree))
    assert not any(map(NAMED.search, _strings(tree)))


@pytest.mark.parametrize("taken", ["graph.nodes[1:4]", "nodes[:4]", "truth.nodes[0]", "nodes[-1]"])
def test_positions__are_seen(taken: str) -> None:
    assert list(_by_position(ast.parse(taken))) == [taken]
