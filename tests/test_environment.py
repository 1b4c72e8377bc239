"""What the project stands on: a JAX that computes right, pins that agree, commands that explain."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
REQUIREMENTS = [
    Requirement(line)
    for line in (
        *PROJECT["project"]["dependencies"],
        *PROJECT["project"]["optional-dependencies"]["tensorboard"],
        *PROJECT["dependency-groups"]["dev"],
    )
]
JAX = next(requirement for requirement in REQUIREMENTS if requirement.name == "jax")


def _pins() -> dict[str, list[str]]:
    pins: dict[str, list[str]] = {}
    for name, pinned in re.findall(r"^([\w.-]+)==(\S+)", _lock(), re.MULTILINE):
        pins.setdefault(name, []).append(pinned)
    return pins


def _lock() -> str:
    return (ROOT / "requirements.lock").read_text()


def _own_files() -> list[Path]:
    listing = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    try:
        names = subprocess.run(listing, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout")
    files = [ROOT / name for name in names.split("\0") if name]
    return [file for file in files if file.is_file()]


def test_jax_sums_products_correctly() -> None:
    # The program of jax issue 39103: JAX 0.10.2 answers 1065369600.
    num_rows = 32_769
    rows = jnp.zeros((num_rows, 3)).at[:, 0].set(jnp.arange(num_rows))

    def squared_norms(matrix: jax.Array, rows: jax.Array) -> jax.Array:
        return jax.vmap(lambda row: jnp.sum((matrix @ row) ** 2))(rows)

    assert jax.jit(squared_norms)(jnp.eye(3), rows)[-1] == (num_rows - 1) ** 2


@pytest.mark.parametrize("bad", ["0.9.2", "0.10.1", "0.10.2", "0.11.0"])
def test_jax_requirement__refuses_broken_versions(bad: str) -> None:
    assert bad not in JAX.specifier


@pytest.mark.parametrize("good", ["0.10.0", "0.11.1", "0.12.0.1"])
def test_jax_requirement__admits_sound_versions(good: str) -> None:
    assert good in JAX.specifier


@pytest.mark.parametrize("requirement", REQUIREMENTS, ids=str)
def test_lock__pins_what_pyproject_asks_for(requirement: Requirement) -> None:
    pinned = _pins()[requirement.name.lower()]
    assert all(requirement.specifier.contains(pin, prereleases=True) for pin in pinned)


def test_lock__is_what_is_installed() -> None:
    assert version("jax") in _pins()["jax"]


def test_lock__has_hashes_and_no_addresses() -> None:
    pins = len(re.findall(r"^[\w.-]+==", _lock(), re.MULTILINE))
    pins_with_hash = re.findall(r"^[\w.-]+==[^\n]*\\\n +--hash=sha256:", _lock(), re.MULTILINE)
    assert len(pins_with_hash) == pins
    assert "://" not in _lock()


def test_own_files__name_neither_a_package_index_nor_a_path_of_a_machine() -> None:
    private = re.compile(r"index-url[ =]\S*://|(?<![\w.~}])/(root|work|opt|home/\w+|Users/\w+)/")
    named = {
        str(file.relative_to(ROOT)): match.group()
        for file in _own_files()
        if (match := private.search(file.read_text(errors="ignore")))
    }
    assert named == {}


def test_package__calls_no_jraph_function_that_fails_on_this_jax() -> None:
    dead = re.compile(
        r"zero_out_padding|with_zero_out_padding_outputs|get_fully_connected_graph|sharded_graphnet"
    )
    modules = (ROOT / "sg3d_jax").rglob("*.py")
    assert [module.name for module in modules if dead.search(module.read_text())] == []


def test_wheel__holds_every_file_of_the_package(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    own = {str(file.relative_to(ROOT)) for file in _own_files()}
    expected = {name for name in own if name.startswith("sg3d_jax/")}
    expected |= {f"sg3d_jax/{name}" for name in own if name.startswith("configs/")}
    assert expected <= set(zipfile.ZipFile(wheel).namelist())


def _run_command(**environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [ROOT / "bin" / "sg3d"],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_command__says_that_python_is_missing(tmp_path: Path) -> None:
    venv = tmp_path / "venv"
    result = _run_command(SG3D_PYTHON="no-such-python", SG3D_VENV=str(venv))
    assert result.returncode == 1
    assert result.stderr == (
        "sg3d: Python 3.11 or newer with pip is needed; tried no-such-python.\n"
    )
    assert not venv.exists()


def test_command__leaves_a_folder_alone_that_is_no_environment(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    result = _run_command(SG3D_VENV=str(tmp_path))
    assert result.returncode == 1
    assert "is no environment with Python 3.11 or newer" in result.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]
