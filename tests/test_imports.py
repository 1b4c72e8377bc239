"""Imports point one way, and the heavy packages stay where they belong."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Final

import pytest

PACKAGE = Path(__file__).parents[1] / "sg3d_jax"
MODULES = sorted(PACKAGE.rglob("*.py"))

# A module may import from its own rank and from those above it in this list.
RANKS: Final = (
    {"scene"},
    {"nn", "diffusion", "data", "metrics", "interop", "viz"},
    {"fill", "flagg", "baselines"},
    {"train", "pretrained"},
    {"cli", "__init__", "__main__"},
)
RANK: Final = {name: rank for rank, names in enumerate(RANKS) for name in names}

# Package -> where alone in sg3d_jax it may be imported.
HOMES: Final = {
    "flax": "nn/",
    "orbax": "train/checkpoint.py",
    "ott": "metrics/entropic.py",
    "matplotlib": "viz/",
    "mpl_toolkits": "viz/",
    "plotly": "viz/",
    "shapely": "data/",
    "networkx": ("interop/", "baselines/"),
}


def _name(module: Path) -> str:
    return module.relative_to(PACKAGE).as_posix()


def _imports(module: Path) -> set[str]:
    """Returns the dotted names that a module imports, anywhere in it, `from a import b` as a.b."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def _imported_modules(module: Path) -> set[Path]:
    """Returns the files of this package that a module imports from."""
    files: set[Path | None] = set()
    for name in _imports(module):
        top, *parts = name.split(".")
        if top == PACKAGE.name:
            files.add(_file_of(PACKAGE.joinpath(*parts)) or _file_of(PACKAGE.joinpath(*parts[:-1])))
    return {file for file in files if file not in (None, module)}


def _file_of(path: Path) -> Path | None:
    """Returns the file that holds the module at a path without suffix, None if it is no module."""
    files = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _rank(module: Path) -> int:
    return RANK[module.relative_to(PACKAGE).parts[0].removesuffix(".py")]


@pytest.mark.parametrize("module", MODULES, ids=_name)
def test_imports__point_one_way(module: Path) -> None:
    upward = {_name(other) for other in _imported_modules(module) if _rank(other) > _rank(module)}
    assert upward == set()


def test_imports__have_no_cycle() -> None:
    imported = {module: _imported_modules(module) for module in MODULES}
    assert set(TopologicalSorter(imported).static_order()) == set(MODULES)


@pytest.mark.parametrize("module", MODULES, ids=_name)
def test_heavy_packages__are_imported_only_at_home(module: Path) -> None:
    tops = {name.split(".")[0] for name in _imports(module)}
    astray = {top for top in tops & set(HOMES) if not _name(module).startswith(HOMES[top])}
    assert astray == set()


def test_package__is_imported_without_its_heavy_dependencies() -> None:
    program = "import sys, sg3d_jax; print(*{name.split('.')[0] for name in sys.modules})"
    run = [sys.executable, "-c", program]
    loaded = subprocess.run(run, cwd=PACKAGE.parent, check=True, capture_output=True, text=True)
    assert "sg3d_jax" in loaded.stdout.split()
    assert {"ott", "orbax", "matplotlib", "plotly"} & set(loaded.stdout.split()) == set()
