"""`sg3d follow`: the graph of a map that comes about, update by update."""

import json
import os
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, Final

from sg3d_jax.cli.arguments import (
    Code,
    OptionalOutput,
    Positional,
    check_at_least,
    check_output,
    run_code,
)
from sg3d_jax.train import DEFAULT_WEIGHTS

LINES: Final = (".jsonl",)


def follow(
    source: Positional[str] = "-",
    output: OptionalOutput = None,
    weights: str = DEFAULT_WEIGHTS,
    graphs: bool = False,
    seed: int = 0,
    diffusion_steps: int = 8,
    planes: int = 0,
    log: Path | None = None,
    code: Code = (),
) -> None:
    """Grow the graph of a map while it comes about: changes of its planes in, of the graph out.

    A line in is answered by a line out, at once. A line that is no such change ends the command,
    when all before it have been answered; Ctrl-C, SIGTERM and a closed pipe end it, too. Lines are
    described in docs/streaming.md.

    Args:
      source: JSON Lines, or - for standard input: planes that are new, have moved, were merged or
        are gone; or whole messages of planes of S-Graphs.
      output: the JSON Lines to write; standard output by default.
      weights: weights by name, or an npz file.
      graphs: write the whole graph every time, and not what has changed.
      seed: another seed draws other samples.
      diffusion_steps: sampling steps of the topology; fewer are faster.
      planes: compile ahead what maps of up to so many planes need, so that no answer waits for it;
        else it is compiled when it is first needed.
      log: keep every line in this file before it is answered. If there are some in it already, the
        map begins with them: with the same weights and options it goes on as it was, bit for bit.
      code: Python files to run first, which register the methods of your own weights.
    """
    from sg3d_jax.flagg.step import Flagg
    from sg3d_jax.io.stream import lines_of
    from sg3d_jax.train.weights import load_weights, with_diffusion_steps

    check_at_least("--seed", seed, 0)
    check_at_least("--diffusion-steps", diffusion_steps, 1)
    check_at_least("--planes", planes, 0)
    check_output(output, LINES)
    check_output(log, LINES)
    lines = lines_of(source)
    run_code(code)
    trained = load_weights(weights)
    if not isinstance(trained.model, Flagg):
        given = trained.model.ontology.observed_plural
        raise ValueError(f"{weights} completes {given} alone, expected weights of what grows")
    trained = with_diffusion_steps(trained, diffusion_steps)
    state = _begun(trained, seed, planes)
    if log is not None and log.exists():
        _drop_half_line(log)
        for where, line in lines_of(str(log)):
            state, _ = _followed(trained, *state, line, where)
    with _kept_in(log) as keep, _opened(output) as file:
        for where, line in lines:
            state, changes = _followed(trained, *state, line, where)
            keep(line)
            answer = _whole(state[0]) if graphs else changes
            print(json.dumps(answer, allow_nan=False), file=file, flush=True)


def _begun(trained: Any, seed: int, planes: int) -> tuple[Any, Any]:
    """Returns what is known before the first line, once what so many planes need is compiled."""
    from sg3d_jax.infer.session import begin, warm_up
    from sg3d_jax.io.stream import Heard

    if planes:
        warm_up(trained.model, trained.params, planes)
    return begin(trained.model.ontology, seed), Heard()


def _followed(
    trained: Any, session: Any, heard: Any, line: bytes, where: str
) -> tuple[tuple[Any, Any], Any]:
    """Returns what is known after a line, and the document that says what it has changed."""
    from sg3d_jax.infer.session import update
    from sg3d_jax.io.stream import document_of, graph_changes_to_dict, read_changes

    ontology = trained.model.ontology
    changes, heard = read_changes(document_of(line, where), ontology, heard, where)
    try:
        session, done = update(trained.model, trained.params, session, changes)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    return (session, heard), graph_changes_to_dict(done, ontology, session.updates)


def _whole(session: Any) -> Any:
    """Returns the document of the whole graph after an update."""
    from sg3d_jax.infer.session import graph_of, ids_of, nodes_of
    from sg3d_jax.io.stream import map_to_dict

    nodes = nodes_of(session).values()
    return map_to_dict(graph_of(session), ids_of(session), nodes, session.updates)


def _opened(output: Path | None) -> Any:
    """Returns the file to write to, which the command closes if it has opened it."""
    return nullcontext(sys.stdout) if output is None else output.open("w", encoding="utf-8")


@contextmanager
def _kept_in(log: Path | None) -> Generator[Callable[[bytes], None]]:
    """Gives what keeps a line, so that neither a crash nor a lack of power can take it back."""
    if log is None:
        yield lambda line: None
        return
    with log.open("ab") as file:

        def keep(line: bytes) -> None:
            file.write(line + b"\n")
            file.flush()
            os.fsync(file.fileno())

        yield keep


def _drop_half_line(log: Path) -> None:
    """Cuts off what follows the last end of a line: it was never answered."""
    with log.open("rb+") as file:
        whole = file.read().rfind(b"\n") + 1
        file.truncate(whole)
