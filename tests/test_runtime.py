"""Importing the package keeps compiled programs, unless the user has said where."""

import os
import subprocess
import sys

import pytest

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
