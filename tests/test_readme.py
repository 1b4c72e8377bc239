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
def test_python_examples__run_from_a_clone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    examples = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(examples) == 2
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)

    exec(compile("".join(examples), "README.md", "exec"), {})

    out = capsys.readouterr().out
    assert out.startswith("HALTED {'wall': array([")
    assert out.endswith("(2, 3, 64)\n")
    assert (tmp_path / "floor.png").is_file()


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
