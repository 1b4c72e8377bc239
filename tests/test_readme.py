"""What the README and docs/ show, a reader can run.

Commands run, page by page, in one folder that looks like a clone. Not run here are those that say
how long they take (`# long: ...`) or what they need (`# yours: ...`), those of programs that are
not ours, pipes of programs that never end, and `FOLLOWED`, which other tests run; their options are
looked up all the same. Python in a block marked `python` runs; in one marked `py` it shows a part
of a program.
"""

import contextlib
import inspect
import io
import json
import re
import shlex
import sys
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import jax
import matplotlib.pyplot as plt
import pytest

import sg3d_jax as sg
from sg3d_jax import cli
from sg3d_jax.infer import complete as completing
from sg3d_jax.train.weights import load_weights, names
from tests.command_line import weights_at_random

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
FILES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
PAGES = {path.stem: path.read_text() for path in FILES}
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
ORDER = ["README", "start", *sorted(PAGES.keys() - {"README", "start"})]
FILE = r"(?<![/\w])(?:examples|configs|benchmarks)/[\w./-]+\w(?![\w*<])"
GROUPS = {"data"}  # of commands
LEFT_OUT = " long: ", " yours: "  # what comments on commands begin with
WITH_COMMANDS = ("cards", "compile", "data", "files", "follow", "grow", "scores")
MODULES = {f"sg3d_jax.cli.{name}" for name in WITH_COMMANDS}
FUNCTIONS = [
    value
    for name, value in [*vars(cli).items(), *vars(cli.data).items()]
    if inspect.isfunction(value) and name[0] != "_" and value.__module__ in MODULES
]
FOLLOWED = {"follow", "train", "evaluate", "sheet"}  # tests/test_cli_*.py run them, on tiny models
COMPILING = {"sampling"}  # notebooks that compile growing anew: run on weights of `at_random`


class Command(NamedTuple):
    """A line of a page, or several that `\\` joins or a here-document needs."""

    page: str
    text: str
    left_out: bool
    content: str  # of the here-document


def commands(page):
    """Returns the commands of the bash blocks of a page."""
    found = []
    for block in re.findall(r"```bash\n(.*?)```", PAGES[page], re.DOTALL):
        lines = iter(block.replace("\\\n", " ").splitlines())
        for line in lines:
            text, _, comment = line.partition("  #")
            content = ""
            if text.endswith("<<END"):
                content = "".join(f"{row}\n" for row in takewhile(lambda row: row != "END", lines))
            if text.strip() and not text.startswith("#"):
                found.append(Command(page, text.strip(), comment.startswith(LEFT_OUT), content))
    return found


def words_of(part):
    """Returns the words of one command behind the name of our program; None for other programs."""
    words = shlex.split(part)
    for name in (["sg3d"], ["bin/sg3d"], ["python", "-m", "sg3d_jax"]):
        if words[: len(name)] == name:
            return words[len(name) :]
    return None


def named(words):
    """Returns the words that name a command."""
    return words[: 2 if words[0] in GROUPS else 1]


def is_run(command):
    """Returns whether a command is tried as it stands."""
    parts = [words_of(part) for part in command.text.split(" | ")]
    ours = [words for words in parts if words is not None]
    if command.content or not ours:
        return bool(command.content)
    foreign = len(ours) < len(parts) and not command.text.startswith("cat ")
    return not (command.left_out or foreign or any(named(words)[0] in FOLLOWED for words in ours))


def said_by(words):
    """Returns what our program prints; it may say so and exit, as `--help` does, but not refuse."""
    code = 0
    with contextlib.redirect_stdout(io.StringIO()) as said:
        try:
            cli.main(words)
        except SystemExit as stopped:
            code = stopped.code
    assert not code, words
    return said.getvalue()


def run(command, monkeypatch):
    """Runs a command in this process, in the working directory: its pipe, and where it writes."""
    text, _, target = command.text.partition(" > ")
    out = command.content
    for part in [] if command.content else text.split(" | "):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(out.encode())))
        words = words_of(part)
        out = Path(part.removeprefix("cat ")).read_text() if words is None else said_by(words)
    if target := target.removesuffix(" <<END"):
        Path(target).write_text(out)


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """Makes the working directory one that holds the examples of a clone.

    Scenes are completed as a reader does, but of the first candidates alone.
    """
    monkeypatch.setattr(completing, "CANDIDATES", completing.ROUND)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@jax.debug_key_reuse(False)  # JAX takes a vmapped scan over keys for their reuse
def test_every_page__runs(clone, monkeypatch, capsys):
    for page in ORDER:
        for command in filter(is_run, commands(page)):
            run(command, monkeypatch)
        examples = re.findall(r"```python\n(.*?)```", PAGES[page], re.DOTALL)
        exec(compile("".join(examples), f"{page}.md", "exec"), {})
        if page == "README":
            assert capsys.readouterr().out.startswith("HALTED {'wall': array([")
    for name in ("floor.png", "home_plan.png", "home.html", "home.graphml", "messages.json"):
        assert (clone / name).is_file(), name


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_notebook__runs_and_is_kept_without_its_outputs(path, clone, monkeypatch):
    cells = json.loads(path.read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    program = "\n".join("".join(cell["source"]) for cell in code)
    if path.stem in COMPILING:
        with weights_at_random(clone) as weights:
            quick = load_weights(weights)
        monkeypatch.setattr(sg, "load_weights", lambda: quick)
    with jax.debug_key_reuse(False):
        exec(compile(program, path.name, "exec"), {})
    plt.close("all")


def test_what_the_readme_grows__is_grown_in_a_notebook():
    def code_of(lines):
        return {line.partition("  #")[0].strip() for line in lines}

    cells = json.loads((ROOT / "examples" / "sampling.ipynb").read_text())["cells"]
    (shown,) = re.findall(r"```py\n(.*?)```", README, re.DOTALL)
    assert code_of(shown.splitlines()) <= code_of(line for cell in cells for line in cell["source"])


@pytest.fixture(scope="module")
def options():
    """Returns the options of a command, asked for once."""
    known = {}

    def look_up(words):
        name = tuple(named(words))
        if name not in known:
            said = said_by([*name, "--help"])
            known[name] = {*re.findall(r"(?<![\w-])--?[a-z][a-z-]*", said)}
        return known[name]

    return look_up


@pytest.mark.parametrize("page", ORDER)
def test_every_command__exists_with_its_options(page, options):
    for command in commands(page):
        for part in command.text.split(" | "):
            words = words_of(part.partition(" > ")[0])
            if words is None or words[0].startswith("-") or named(words) == ["train"]:
                continue  # what a run can be told is what its configuration holds
            asked = {word for word in words if re.fullmatch(r"--?[a-z][a-z-]*", word)}
            assert asked <= options(words), command.text


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
def test_every_option__has_its_line_of_help(function):
    told = re.findall(r"^ {2}(\w+): ", inspect.getdoc(function), re.MULTILINE)  # without indents
    assert told == [*inspect.signature(function).parameters]


@pytest.mark.parametrize("page", ORDER)
def test_every_link__leads_somewhere(page):
    folder = ROOT if page == "README" else ROOT / "docs"
    for target in re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", PAGES[page]):
        assert (folder / target).exists(), target


def test_files_and_weights__exist():
    for text in PAGES.values():
        for path in re.findall(FILE, text):
            assert (ROOT / path).exists() or (ROOT / "benchmarks" / path).exists(), path
    for name in re.findall(r"fd4-[a-z-]+[a-z]", README):
        assert name in names(), name


def test_every_page__is_in_the_menu():
    menu = (ROOT / "mkdocs.yml").read_text().partition("nav:")[2]
    listed = re.findall(r"([\w-]+)\.md", menu)
    assert sorted(listed) == sorted(PAGES.keys() - {"README"})


def test_the_reference__names_all_that_is_public():
    listed = re.findall(r"^::: sg3d_jax\.(\w+)$", PAGES["reference"], re.MULTILINE)
    assert sorted(listed) == sorted(sg.__all__)
