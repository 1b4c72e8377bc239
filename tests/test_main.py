"""How the program starts and is stopped: one line and the exit code of the signal, always."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sg3d_jax import __main__, cli

ROOT = Path(__file__).parents[1]
SIGNALS = [(signal.SIGINT, "interrupted", 130), (signal.SIGTERM, "terminated", 143)]
IMPORTING = """
import os, signal, sys
try:
    os.kill(os.getpid(), signal.{name})
except BaseException:
    os._exit(7)  # it has come here, where some packages swallow it
"""


@pytest.fixture
def ended(monkeypatch, capfd):
    """Runs the program in this process, which survives; returns exit code and stderr."""

    class Ended(BaseException):
        pass

    codes = []

    def end(code):  # does return, unlike the real one
        codes.append(code)
        raise Ended

    def run(command):
        monkeypatch.setattr(cli, "main", command)
        monkeypatch.setattr(os, "_exit", end)
        before = {number: signal.getsignal(number) for number, _, _ in SIGNALS}
        try:
            with pytest.raises(Ended):
                __main__.main()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        return codes[0], capfd.readouterr().err

    return run


@pytest.mark.parametrize(("number", "word", "code"), SIGNALS)
def test_a_signal_puts_files_in_order_and_ends_with_one_line(ended, number, word, code):
    passed = []

    def command():
        try:
            signal.raise_signal(number)
        finally:
            passed.append(True)

    assert ended(command) == (code, f"sg3d: {word}\n")
    assert passed


@pytest.mark.parametrize(("number", "word", "code"), SIGNALS)
def test_whatever_becomes_of_a_signal_on_its_way_it_is_no_traceback(ended, number, word, code):
    def command():
        try:
            signal.raise_signal(number)
        except BaseException as error:
            raise RecursionError from error

    assert ended(command) == (code, f"sg3d: {word}\n")


def test_a_line_that_the_command_line_has_said_is_not_said_again(ended):
    def command():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise SystemExit(130) from None

    assert ended(command) == (130, "")


def test_a_second_signal_ends_a_program_that_has_swallowed_the_first(ended):
    def command():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            signal.raise_signal(signal.SIGTERM)

    code, said = ended(command)
    assert (code, said.splitlines()[0]) == (143, "sg3d: terminated")


@pytest.mark.parametrize(("number", "word", "code"), SIGNALS)
def test_a_signal_during_an_import_that_would_swallow_it_ends_the_program(
    tmp_path, number, word, code
):
    (tmp_path / "tyro.py").write_text(IMPORTING.format(name=number.name))
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    program = [sys.executable, "-m", "sg3d_jax", "--version"]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", f"sg3d: {word}\n")


@pytest.mark.parametrize("command", ["--version", "complete --help"])
def test_a_pipe_that_nobody_reads_ends_it_quietly(command):
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "sg3d_jax", *command.split()]
    with os.fdopen(writer, "w") as closed:
        done = subprocess.run(words, cwd=ROOT, stdout=closed, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, "")
