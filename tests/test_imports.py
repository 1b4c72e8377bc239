"""Imports point one way, file by file, and the heavy packages stay where they belong."""

import ast
import functools
import importlib.metadata
import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Final

import pytest

PACKAGE = Path(__file__).parents[1] / "sg3d_jax"
MODULES = sorted(PACKAGE.rglob("*.py"))

# Folder -> the others that its files may import from, inside functions, too. Together they are
#   scene <- diffusion, nn <- fill <- flagg, baselines <- infer <- train <- cli
#   scene <- io <- data <- train
#   scene <- metrics <- infer
#   io, metrics <- viz <- cli
GROWING: Final = {"scene", "diffusion", "nn", "fill", "flagg"}
TRAINING: Final = {*GROWING, "baselines", "metrics", "infer", "io", "data", "train"}
MAY_IMPORT: Final[Mapping[str, set[str]]] = {
    "scene": set(),
    "diffusion": {"scene"},
    "nn": {"scene"},
    "fill": {"scene", "diffusion", "nn"},
    "flagg": {"scene", "diffusion", "nn", "fill"},
    "baselines": GROWING,
    "metrics": {"scene"},
    "infer": {*GROWING, "baselines", "metrics"},
    "io": {"scene"},
    "data": {"scene", "io"},
    "train": {*TRAINING - {"train"}, "origin", "distributed"},
    "viz": {"scene", "io", "metrics"},
    "runtime": set(),
    "origin": set(),
    "distributed": set(),
    "__init__": {*TRAINING, "viz", "runtime", "origin", "distributed"},
    "cli": {*TRAINING, "viz", "runtime", "origin", "distributed", "__init__"},
    "__main__": {*TRAINING, "viz", "runtime", "origin", "distributed", "__init__", "cli"},
}

# Package -> where alone in sg3d_jax it may be imported.
HOMES: Final[Mapping[str, tuple[str, ...]]] = {
    "chex": ("train/loop.py",),
    "flax": ("nn/",),
    "jraph": ("scene/graph.py",),
    "matplotlib": ("viz/",),
    "mpl_toolkits": ("viz/",),
    "networkx": ("io/", "baselines/"),
    "optax": ("train/step.py", "baselines/edge_classifier.py"),
    "orbax": ("train/checkpoint.py",),
    "ott": ("metrics/entropic.py",),
    "plotly": ("viz/",),
    "rich": ("cli/", "train/log.py"),
    "scipy": ("data/", "metrics/oddities.py"),
    "yaml": ("io/yaml.py",),
    "shapely": ("data/",),
    "tyro": ("cli/", "train/config.py"),
}
EVERYWHERE: Final = {"jax", "jaxtyping", "numpy"}


def _name(module: Path) -> str:
    return module.relative_to(PACKAGE).as_posix()


def _folder(module: Path) -> str:
    return module.relative_to(PACKAGE).parts[0].removesuffix(".py")


@functools.cache
def _imports(module: Path) -> set[str]:
    """Returns the dotted names that a module imports, anywhere in it, `from a import b` as a.b."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno} is relative, expected a whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@functools.cache
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


def _foreign(module: Path) -> set[str]:
    """Returns the packages of others that a module imports."""
    tops = {name.split(".")[0] for name in _imports(module)}
    return tops - set(sys.stdlib_module_names) - {PACKAGE.name}


def test_arrows__point_one_way_and_nothing_is_reached_behind_another() -> None:
    assert set(TopologicalSorter(MAY_IMPORT).static_order()) == set(MAY_IMPORT)
    for lower in MAY_IMPORT.values():
        assert all(MAY_IMPORT[other] <= lower for other in lower)


@pytest.mark.parametrize("module", MODULES, ids=_name)
def test_module__imports_only_from_below(module: Path) -> None:
    lower = MAY_IMPORT[_folder(module)] | {_folder(module)}
    others = _imported_modules(module)
    assert {_name(other) for other in others if _folder(other) not in lower} == set()


def test_modules__import_one_another_in_no_circle() -> None:
    imported = {module: _imported_modules(module) for module in MODULES}
    assert set(TopologicalSorter(imported).static_order()) == set(MODULES)


@pytest.mark.parametrize("module", MODULES, ids=_name)
def test_packages_of_others__are_imported_only_at_home(module: Path) -> None:
    foreign = _foreign(module) - EVERYWHERE
    assert {top for top in foreign if not _name(module).startswith(HOMES.get(top, ()))} == set()


def test_packages_of_others__are_declared() -> None:
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    declared = {re.match(r"[\w-]+", line)[0] for line in project["dependencies"]}
    owners = importlib.metadata.packages_distributions()
    imported = set().union(*map(_foreign, MODULES))
    assert {top for top in imported if not declared & set(owners[top])} == set()


def test_package__is_imported_without_its_heavy_dependencies() -> None:
    program = "import sys, sg3d_jax; print(*{name.split('.')[0] for name in sys.modules})"
    run = [sys.executable, "-c", program]
    loaded = subprocess.run(run, cwd=PACKAGE.parent, check=True, capture_output=True, text=True)
    assert "sg3d_jax" in loaded.stdout.split()
    assert {"ott", "orbax", "matplotlib", "plotly"} & set(loaded.stdout.split()) == set()
