"""The command line: `sg3d complete | follow | view | export | train | evaluate | table | ...`.

Every command delegates. A refusal is one sentence on stderr and exit code 2, with nothing written;
with SG3D_DEBUG=1 in the environment it is a traceback instead.
"""

import os
import signal
import sys

import tyro

import sg3d_jax
from sg3d_jax.cli import data, provenance
from sg3d_jax.cli.cards import weights
from sg3d_jax.cli.compile import compile_growth
from sg3d_jax.cli.files import export, view
from sg3d_jax.cli.follow import follow
from sg3d_jax.cli.grow import complete, train
from sg3d_jax.cli.scores import evaluate, sheet, table

app = tyro.extras.SubcommandApp()
for command in (complete, follow, view, export, train, evaluate, table, sheet, weights):
    app.command(command)
app.command(name="compile")(compile_growth)
app.command(
    data.app, name="data", help="Make, import, describe, check, draw or drive through data sets."
)


def main(arguments: list[str] | None = None) -> None:
    """Runs the command line; exits with 2 after a refusal, with 130 after Ctrl-C."""
    arguments = sys.argv[1:] if arguments is None else arguments
    provenance.arguments.set(tuple(arguments))
    try:
        _run(arguments)
    except BrokenPipeError:  # nobody reads on; what is left would be tried again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(128 + signal.SIGPIPE) from None
    except (ValueError, OverflowError, OSError, FloatingPointError, MemoryError) as error:
        if os.environ.get("SG3D_DEBUG"):
            raise
        print(f"sg3d: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("sg3d: interrupted", file=sys.stderr)
        raise SystemExit(130) from None


def _run(arguments: list[str]) -> None:
    """Runs a command, and hands on all that it says, also before it exits."""
    try:
        match arguments:
            case ["--version"]:
                print(f"sg3d {sg3d_jax.__version__}")
            case ["train", name, *overrides] if not name.startswith("-"):
                train(name, tuple(overrides))
            case _:
                app.cli(args=arguments or ["--help"], prog="sg3d", description=sg3d_jax.__doc__)
    finally:
        sys.stdout.flush()
