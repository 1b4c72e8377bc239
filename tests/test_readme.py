"""What the README shows, a reader can run."""

import re
from pathlib import Path

import jax
import pytest

from sg3d_jax import cli
from sg3d_jax.train.weights import names

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


@jax.debug_key_reuse(False)  # JAX takes a vmapped scan over keys for their reuse
def test_python_example__runs_from_a_clone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    monkeypatch.chdir(ROOT)

    exec(compile(example, "README.md", "exec"), {})

    assert capsys.readouterr().out.startswith("HALTED")


def test_commands__exist() -> None:
    named = set(re.findall(r"sg3d (?:data )?[a-z]+", README))
    for command in named - {"sg3d train"}:
        with pytest.raises(SystemExit) as stopped:
            cli.main([*command.split()[1:], "--help"])
        assert stopped.value.code == 0, command


def test_files_and_weights__exist() -> None:
    for path in re.findall(r"(?:examples|configs|benchmarks)/[\w./-]+\w", README):
        assert (ROOT / path).exists() or (ROOT / "benchmarks" / path).exists(), path
    for name in re.findall(r"fd4-[a-z-]+[a-z]", README):
        assert name in names(), name
