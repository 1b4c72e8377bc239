"""Kills `sg3d` at random moments, damages what it left, and compares what it comes to in the end.

    python benchmarks/kills.py [--kills N] [--runs M] [--seed S] [--only NAME] [-o RESULT.json]

Every command that writes is killed (SIGKILL) N times while an old file stands where it writes, by
turns at any moment and as soon as a file of its own appears: afterwards there is the old file or
the whole new one, byte for byte but for the seconds. Of what is written line by line there are the
first lines; `follow` with its log then goes on, and answers what is left as if nothing had been.
Small runs are killed M times, four times each, trained to their end, and compared with one that
nobody disturbed: weights, bit for bit, and every row of the log but the seconds. Then, M times
each: the latest checkpoint of such a run is damaged, or the disk is full for files of some size,
before the run goes on; `complete` is stopped by Ctrl-C or SIGTERM, and must say so in one line. At
last compiled programs are cut short. Prints a row a kind, and writes benchmarks/results/kills.json
after each.
"""

import argparse
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.cli.provenance import provenance
from sg3d_jax.data import registry
from sg3d_jax.io import npz
from sg3d_jax.io.files import TEMPORARY
from sg3d_jax.io.planes import planes_to_dict
from sg3d_jax.runtime import CACHE_VARIABLE

RESULT: Final = Path(__file__).parent / "results" / "kills.json"
SG3D: Final = (sys.executable, "-m", "sg3d_jax")
NODES: Final = 24  # of the floors, so that there is one bucket
KILLS_A_RUN: Final = 4
TRAINED: Final = ("train", "damaged checkpoints", "full disks")  # kinds that need a run
OLD: Final = b"what was there before"
GRAPHS: Final = "floors.npz"
STEPS: Final = "steps.jsonl"
METHOD: Final = ("rand-s-f-square",)
SCENES: Final = ("--data", GRAPHS, "--split", "all", "--num-graphs", "3")

RESULT_FILE: Final = "result.json"
WALL: Final = re.compile(rb'"seconds": \[[^]]*\]')  # what no two results have in common
SOON: Final = 0.02  # at most so many seconds after a file has appeared, mostly at once

# What is run, and the file that it writes; all of it comes out the same every time.
COMMANDS: Final = {
    "complete": (("complete", "planes.json", "--weights", "fd4-s-f"), "grown.json"),
    "evaluate": (("evaluate", *METHOD, *SCENES), RESULT_FILE),
    "table": (("table", RESULT_FILE), "table.md"),
    "sheet": (("sheet", *METHOD, *SCENES), "drawn.png"),
    "weights": (("weights",), "cards.md"),
    "compile": (("compile", "fd4-s-f", "--planes", "12", "--diffusion-steps", "2"), "grow.npz"),
    "export": (("export", GRAPHS), "graphs.jsonl"),
    "view (picture)": (("view", GRAPHS), "graph.png"),
    "view (page)": (("view", GRAPHS), "graphs.html"),
    "view (plan)": (("view", GRAPHS, "--plan"), "plan.png"),
    "data make": (("data", "make", "s-f", "--num-graphs", "300"), "made.npz"),
    "data import": (("data", "import", "mine", "graphs.json"), "mine.npz"),
    "data describe": (("data", "describe", GRAPHS), "statistics.json"),
    "data replay": (("data", "replay", GRAPHS), STEPS),
    "data sheet": (("data", "sheet", GRAPHS, "--num-graphs", "6"), "sheet.png"),
}
# What is written line by line, as it comes.
STREAMS: Final = {
    "complete (lines)": (("complete", GRAPHS, "--weights", "fd4-s-f"), "grown.jsonl"),
    "follow": (("follow", STEPS, "--weights", "fd4-s-f"), "followed.jsonl"),
}
TRAIN: Final = (
    *("train", "test", "--data.name", GRAPHS, "--capacities", str(NODES), "--batch", "2"),
    *("--steps", "48", "--steps-per-call", "4", "--validate-every", "8"),
    *("--optimiser.warmup-steps", "2", "--validation-graphs", "1", "-o"),
)


class Shell:
    """Runs `sg3d` in a folder, with compiled programs kept there, too."""

    def __init__(self, folder: Path) -> None:
        """Names the folder; nothing is run."""
        self.folder = folder
        root = str(Path(__file__).parents[1])
        cache = {"XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPATH": root}
        kept = {k: v for k, v in os.environ.items() if k != CACHE_VARIABLE}
        self.environment = kept | cache

    def start(self, *arguments: str, limit: int = resource.RLIM_INFINITY) -> subprocess.Popen[str]:
        """Starts a command; files may grow to so many bytes."""
        process = subprocess.Popen(
            [*SG3D, *arguments],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
        return process

    def run(self, *arguments: str, limit: int = resource.RLIM_INFINITY) -> tuple[int, str]:
        """Runs a command to its end; returns its exit code and what it said on stderr."""
        process = self.start(*arguments, limit=limit)
        _, said = process.communicate()
        return process.returncode, said

    def succeed(self, *arguments: str) -> tuple[float, str]:
        """Runs a command that must succeed; returns seconds and what it said on stderr."""
        began = time.monotonic()
        code, said = self.run(*arguments)
        if code:
            raise RuntimeError(f"{' '.join(arguments)} exits with {code}: {said}")
        return time.monotonic() - began, said

    def stop(
        self, after: float, number: int, *arguments: str, seen: Callable[[], bool] | None = None
    ) -> tuple[int, str]:
        """Sends a signal to a command after some seconds; returns as `run` does.

        If there is something to be `seen`, they count from then on.
        """
        process = self.start(*arguments)
        while seen is not None and process.poll() is None and not seen():
            time.sleep(0.001)
        try:
            process.wait(after)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        _, said = process.communicate()
        return process.returncode, said

    def temporaries(self) -> list[Path]:
        """Returns what is half written in the folder."""
        return list(self.folder.glob(f"{TEMPORARY}*"))


def prepare(folder: Path) -> None:
    """Writes what the commands read."""
    graphs = [g for g in registry.make("s-f-square", 100) if len(g.nodes.label) <= NODES][:10]
    npz.save(folder / GRAPHS, graphs, registry.header("s-f-square"))
    (folder / "planes.json").write_text(json.dumps(planes_to_dict(graphs[0])))
    shell = Shell(folder)
    shell.succeed("export", GRAPHS, "--index", "0", "-o", "graphs.json")
    shell.succeed("data", "replay", GRAPHS, "-o", STEPS)
    shell.succeed("evaluate", *METHOD, *SCENES, "-o", RESULT_FILE)


def kill_command(shell: Shell, name: str, kills: int, draw: random.Random) -> Counter[str]:
    """Kills a command while an old file is where it writes; counts what is there afterwards."""
    given, written = COMMANDS[name]
    arguments, output = (*given, "-o", written), shell.folder / written
    shell.succeed(*arguments)  # compiles
    seconds, _ = shell.succeed(*arguments)
    whole, found = _without_seconds(output), Counter[str]()
    for index in range(kills):
        output.write_bytes(OLD)
        if index % 2:
            after, seen = SOON * draw.random() ** 4, lambda: bool(shell.temporaries())
        else:
            after, seen = draw.uniform(0.5, 1.05) * seconds, None
        code, _ = shell.stop(after, signal.SIGKILL, *arguments, seen=seen)
        content = _without_seconds(output)
        found["killed"] += code == -signal.SIGKILL
        found["while writing"] += len(shell.temporaries())
        found["old file" if content == OLD else "new file" if content == whole else "half"] += 1
        for temporary in shell.temporaries():
            temporary.unlink()
    shell.succeed(*arguments)
    found["different at the end"] += _without_seconds(output) != whole
    return found


def kill_stream(shell: Shell, name: str, kills: int, draw: random.Random) -> Counter[str]:
    """Kills a command that writes lines; counts those that are not the first of the whole."""
    given, written = STREAMS[name]
    output = shell.folder / written
    shell.succeed(*given, "-o", written)  # compiles
    seconds, _ = shell.succeed(*given, "-o", written)
    whole, found = output.read_bytes(), Counter[str]()
    for _ in range(kills):
        output.unlink(missing_ok=True)  # of one that was killed before it wrote
        after, seen = draw.uniform(0, 1) * seconds, None
        if draw.random() < 0.5:  # when the first lines are there
            after, seen = after / 8, lambda: output.exists() and output.stat().st_size > 0
        log = () if name != "follow" else ("--log", "log.jsonl")
        code, _ = shell.stop(after, signal.SIGKILL, *given, *log, "-o", written, seen=seen)
        content = output.read_bytes() if output.exists() else b""
        found["killed"] += code == -signal.SIGKILL
        found["lines"] += _lines(content)
        found["other lines"] += not whole.startswith(content)
        if log:
            found["different after it"] += not _goes_on(shell, given, content, whole)
    return found


def _goes_on(shell: Shell, given: Sequence[str], answered: bytes, whole: bytes) -> bool:
    """Returns whether `follow` answers from its log what a killed one has not.

    A line is in the log before it is answered; which of those are answered is in the other file.
    """
    log, steps = shell.folder / "log.jsonl", (shell.folder / STEPS).read_bytes().splitlines(True)
    kept = _lines(log.read_bytes()) if log.exists() else 0
    (shell.folder / "rest.jsonl").write_bytes(b"".join(steps[kept:]))
    command = given[0], "rest.jsonl", *given[2:], "--log", "log.jsonl", "-o", "rest-of-it.jsonl"
    shell.succeed(*command)
    later = (shell.folder / "rest-of-it.jsonl").read_bytes()
    is_kept = log.read_bytes() == b"".join(steps)
    log.unlink()
    return is_kept and later == b"".join(whole.splitlines(True)[kept:]) and kept >= _lines(answered)


def _lines(content: bytes) -> int:
    return content.count(b"\n")


def _without_seconds(path: Path) -> bytes:
    return WALL.sub(b"", path.read_bytes())


def is_same_run(one: Path, other: Path) -> bool:
    """Returns whether weights and logs of two run directories are the same but for the seconds."""
    with np.load(one / "weights.npz") as first, np.load(other / "weights.npz") as second:
        same = first.files == second.files
        same &= all(first[name].tobytes() == second[name].tobytes() for name in first.files)
    return same and list(rows(one)) == list(rows(other))


def rows(directory: Path) -> Iterator[dict[str, Any]]:
    """Yields the rows of a log without seconds."""
    for line in (directory / "log.jsonl").read_text().splitlines():
        yield {k: v for k, v in json.loads(line).items() if not k.startswith("seconds")}


def kill_runs(
    shell: Shell, whole: Path, seconds: float, kills: int, draw: random.Random
) -> Counter[str]:
    """Kills runs again and again, and lets them end."""
    found = Counter[str]()
    run = shell.folder / "killed"
    while found["killed"] < kills:
        shutil.rmtree(run, ignore_errors=True)
        for _ in range(min(KILLS_A_RUN, kills - found["killed"])):
            after = draw.uniform(0.3, 1.0) * seconds
            code, _ = shell.stop(after, signal.SIGKILL, *TRAIN, "killed")
            found["killed"] += code == -signal.SIGKILL
        _, said = shell.succeed(*TRAIN, "killed")
        found["runs"] += 1
        found["remarks"] += said.count("sg3d: remark")
        found["different at the end"] += not is_same_run(run, whole)
    return found


def cut(path: Path, draw: random.Random) -> None:
    """Cuts a file short."""
    path.write_bytes(path.read_bytes()[: draw.randrange(max(1, path.stat().st_size))])


def flip(path: Path, draw: random.Random) -> None:
    """Flips a bit of a file."""
    content = bytearray(path.read_bytes())
    content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
    path.write_bytes(content)


DAMAGES: Final[dict[str, Callable[[Path, random.Random], Any]]] = {
    "cut": cut,
    "flip": flip,
    "remove": lambda path, draw: path.unlink(),
    "zeros": lambda path, draw: path.write_bytes(bytes(path.stat().st_size)),
}


def damage_checkpoints(shell: Shell, whole: Path, times: int, draw: random.Random) -> Counter[str]:
    """Damages a file of the latest checkpoint, makes it an empty folder, or adds one."""
    found = Counter[str]()
    for index in range(times):
        run = shell.folder / "damaged"
        shutil.rmtree(run, ignore_errors=True)
        shutil.copytree(whole, run)
        (run / "weights.npz").unlink()
        latest = max((run / "checkpoints").iterdir(), key=lambda path: int(path.name))
        kind = [*DAMAGES, "empty folder", "stray number"][index % (len(DAMAGES) + 2)]
        if kind == "stray number":
            (run / "checkpoints" / "1000000").mkdir()
        elif kind == "empty folder":
            shutil.rmtree(latest)
            latest.mkdir()
        else:
            files = sorted(p for p in latest.rglob("*") if p.is_file() and p.stat().st_size)
            DAMAGES[kind](draw.choice(files), draw)
        code, said = shell.run(*TRAIN, "damaged")
        found["damaged"] += 1
        found["remarks"] += said.count("sg3d: remark")
        found["tracebacks"] += "Traceback" in said
        found["different at the end"] += code != 0 or not is_same_run(run, whole)
    return found


def fill_disks(shell: Shell, whole: Path, times: int, draw: random.Random) -> Counter[str]:
    """Lets files grow to some size only, then to any, as when somebody has made room."""
    largest = max(p.stat().st_size for p in whole.rglob("*") if p.is_file())
    found, run = Counter[str](), shell.folder / "full"
    for _ in range(times):
        shutil.rmtree(run, ignore_errors=True)
        limit = int(largest ** draw.uniform(0.3, 1.0))
        code, said = shell.run(*TRAIN, "full", limit=limit)
        complaints = [line for line in said.splitlines() if not line.startswith("step ")]
        found["full"] += code == 2
        named = [line for line in complaints if line.startswith("sg3d: ") and "full/" in line]
        found["not one line with the file"] += code == 2 and len(complaints + named) != 2
        shell.succeed(*TRAIN, "full")
        found["different at the end"] += not is_same_run(run, whole)
    return found


def interrupt(shell: Shell, times: int, draw: random.Random) -> Counter[str]:
    """Stops a command by Ctrl-C or SIGTERM, mostly while it starts."""
    given, written = COMMANDS["complete"]
    arguments = (*given, "-o", written)
    shell.succeed(*arguments)  # compiles
    seconds, _ = shell.succeed(*arguments)
    found = Counter[str]()
    for index in range(times):
        number, word = [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")][index % 2]
        after = draw.uniform(0.1, seconds)
        code, said = shell.stop(after, number, *arguments)
        found["stopped"] += code == 128 + number
        found["before Python had begun"] += code == -number
        clean = (code, said) == (128 + number, f"sg3d: {word}\n") or code in (0, -number)
        found["not one line"] += not clean
    return found


def cut_compiled(shell: Shell) -> dict[str, float]:
    """Cuts every compiled program short; returns seconds of `complete` before and after."""
    given, written = COMMANDS["complete"]
    arguments = (*given, "-o", written)
    before, _ = shell.succeed(*arguments)
    for path in (shell.folder / "cache").rglob("*-cache"):
        path.write_bytes(path.read_bytes()[:1000])
    first, said = shell.succeed(*arguments)
    second, said_again = shell.succeed(*arguments)
    seconds = {"before": before, "first": first, "second": second}
    warned = (said + said_again).count("compilation cache")
    return {name: round(value, 1) for name, value in seconds.items()} | {"warnings": warned}


def main() -> None:
    """Kills, compares and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=8, help="of each command")
    parser.add_argument(
        "--runs", type=int, default=20, help="kills of runs, and damages of each kind"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--only", default="", help="kinds whose name has this in it")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    given = parser.parse_args()
    about = provenance()
    about = {"commit": about["commit"], "machine": about["machine"]}
    about |= {"kills": given.kills, "runs": given.runs, "seed": given.seed}
    results: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        shell = Shell(Path(folder))
        prepare(shell.folder)
        for name, found in _kinds(shell, given.kills, given.runs, given.only):
            results[name] = dict(found(random.Random(f"{given.seed} {name}")))
            said = ", ".join(f"{key} {value}" for key, value in results[name].items())
            print(f"{name}: {said}", flush=True)
            given.output.write_text(json.dumps({**about, "rows": results}, indent=2) + "\n")


def _kinds(
    shell: Shell, kills: int, runs: int, only: str
) -> Iterator[tuple[str, Callable[[random.Random], Mapping[str, float]]]]:
    """Yields what is tried, and the function that tries it."""
    whole = shell.folder / "whole"
    seconds = 0.0

    def train(draw: random.Random) -> Counter[str]:
        return kill_runs(shell, whole, seconds, runs, draw)

    kinds: dict[str, Callable[[random.Random], Mapping[str, float]]] = {
        **{name: partial(kill_command, shell, name, kills) for name in COMMANDS},
        **{name: partial(kill_stream, shell, name, kills) for name in STREAMS},
        "train": train,
        "damaged checkpoints": partial(damage_checkpoints, shell, whole, runs),
        "full disks": partial(fill_disks, shell, whole, runs),
        "Ctrl-C and SIGTERM": partial(interrupt, shell, runs),
        "compiled programs cut": lambda _: cut_compiled(shell),
    }
    for name, found in kinds.items():
        if only not in name:
            continue
        if name in TRAINED and not whole.exists():
            shell.succeed(*TRAIN, "warm-up")
            seconds, _ = shell.succeed(*TRAIN, "whole")
        yield name, found


if __name__ == "__main__":
    main()
