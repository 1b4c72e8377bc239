"""Importing the package keeps compiled programs, unless the user has said where, and whole ones."""

import os
import subprocess
import sys
import types
import zlib

import jax
import jax.numpy as jnp
import pytest
from jax.experimental.compilation_cache import compilation_cache

from sg3d_jax.runtime import ZSTANDARD, remove_damaged, silence_xla

PROGRAM = "import sg3d_jax, jax; print(jax.config.jax_compilation_cache_dir)"


@pytest.mark.parametrize(
    ("program", "variables", "expected"),
    [
        (PROGRAM, {}, "{cache}/sg3d_jax/compiled"),
        (f"import jax; {PROGRAM}", {}, "{cache}/sg3d_jax/compiled"),
        (PROGRAM, {"JAX_COMPILATION_CACHE_DIR": "/elsewhere"}, "/elsewhere"),
        (
            f"import jax; jax.config.update('jax_compilation_cache_dir', '/mine'); {PROGRAM}",
            {},
            "/mine",
        ),
    ],
)
def test_compiled_programs_are_kept_where_the_user_says_or_in_the_cache(
    program, variables, expected, tmp_path
):
    kept = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment = kept | {"XDG_CACHE_HOME": str(tmp_path)} | variables
    run = [sys.executable, "-c", program]
    done = subprocess.run(run, env=environment, check=True, capture_output=True, text=True)
    assert done.stdout.strip() == expected.format(cache=tmp_path)


@pytest.mark.parametrize(
    ("said", "level", "expected"),
    [("1", "NOTSET", ["CRITICAL", "NOTSET"]), ("0", "NOTSET", []), ("1", "INFO", [])],
    ids=["nobody said anything", "in the environment", "by JAX's option"],
)
def test_xla_is_silenced_after_jax_was_imported_unless_the_user_said_otherwise(
    said, level, expected, monkeypatch
):
    levels = []
    config = types.SimpleNamespace(
        jax_logging_level=level, update=lambda name, value: levels.append(value)
    )
    monkeypatch.setitem(sys.modules, "jax", types.SimpleNamespace(config=config))
    monkeypatch.setenv("TF_CPP_MIN_LOG_LEVEL", said)
    silence_xla()
    assert levels == expected


def test_programs_that_are_cut_short_are_removed_and_whole_ones_are_left(tmp_path):
    whole = zlib.compress(bytes(range(256)) * 40)
    contents = {"a": whole, "b": whole[:-1], "c": b"", "d": whole[:50] + b"!" + whole[51:]}
    for name, content in contents.items():
        (tmp_path / f"jit_{name}-cache").write_bytes(content)
    (tmp_path / "notes").write_text("of somebody else")
    remove_damaged(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"jit_a-cache", "notes", "checked"}


def test_only_programs_that_are_newer_than_the_last_check_are_read(tmp_path):
    old, new = tmp_path / "jit_old-cache", tmp_path / "jit_new-cache"
    old.write_bytes(zlib.compress(b"program"))
    remove_damaged(tmp_path)
    old.write_bytes(b"cut")
    os.utime(old, (1, 1))
    new.write_bytes(b"cut")
    remove_damaged(tmp_path)
    assert old.exists()
    assert not new.exists()


def test_programs_by_zstandard_are_checked_by_a_python_that_has_it(tmp_path, monkeypatch):
    path = tmp_path / "jit_f-cache"
    path.write_bytes(ZSTANDARD)
    monkeypatch.setitem(sys.modules, "compression.zstd", None)
    remove_damaged(tmp_path)
    assert path.exists()
    found = types.SimpleNamespace(decompress=lambda content: 1 / 0)
    monkeypatch.setitem(sys.modules, "compression.zstd", found)
    path.write_bytes(ZSTANDARD)
    remove_damaged(tmp_path)
    assert not path.exists()


@pytest.fixture
def keep_in():
    """Lets JAX keep every program in a folder, for the time of a test."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}

    def keep(folder, seconds=0.0):
        for name, value in zip(names, (folder, seconds), strict=True):
            jax.config.update(name, value)
        compilation_cache.reset_cache()

    yield keep
    keep(*before.values())


def test_what_jax_keeps_is_whole_and_once_removed_is_written_again(tmp_path, keep_in):
    def compiled():
        jax.jit(lambda x: jnp.sin(x) + 41)(1.0)  # unknown to JAX each time, but for its text

    keep_in(str(tmp_path))
    compiled()
    kept = sorted(tmp_path.glob("*-cache"))
    remove_damaged(tmp_path)
    assert sorted(tmp_path.glob("*-cache")) == kept
    (last,) = (path for path in kept if "lambda" in path.name)
    last.write_bytes(last.read_bytes()[:100])
    remove_damaged(tmp_path)
    compiled()
    assert last.stat().st_size > 100
