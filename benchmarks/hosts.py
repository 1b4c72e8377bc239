"""The same training on one device and on several, by one process and by two: are the weights equal?

    python benchmarks/hosts.py [-o RESULT.json]

Trains `configs/test.py` for 50 steps of four batches on 1, 2 and 4 devices of a CPU, by two
processes of two devices each, and once in turns: two processes that are killed, then one. Each run
is a command of its own, as a user starts it. Says how long each took beside one another, of which
compiling is the most, and a digest of its weights; exits with 1 if they differ.
"""

import argparse
import hashlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np

ROOT: Final = Path(__file__).parents[1]
STEPS: Final = 50
RUN: Final = (
    *("train", "configs/test.py", "--accumulate", "4", "--steps", f"{STEPS}"),
    *("--steps-per-call", "5", "--validate-every", "25", "--data.num-graphs", "12"),
)
PLACES: Final = ((1, 1), (1, 2), (1, 4), (2, 2))  # processes, devices of each


def start(directory: Path, processes: int, devices: int) -> list[subprocess.Popen]:
    """Starts a training by so many processes of so many devices each."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    alike = {"NPROC": "4"}  # threads of XLA, by which it cuts loops, and with them the rounding
    environment = {**os.environ, **alike, "JAX_NUM_CPU_DEVICES": f"{devices}"}
    command = [sys.executable, "-m", "sg3d_jax", *RUN, "-o", str(directory)]
    together = ["--coordinator", address, "--num-processes", f"{processes}", "--process-id"]
    return [
        subprocess.Popen(
            [*command, *([*together, f"{number}"] if processes > 1 else [])],
            cwd=ROOT,
            env=environment,
            stderr=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        for number in range(processes)
    ]


def finish(running: list[subprocess.Popen]) -> None:
    """Waits for the processes of a training to end well."""
    codes = [process.wait() for process in running]
    if any(codes):
        raise RuntimeError("a training failed")


def digest(directory: Path) -> str:
    """Returns a digest of the parameters of a run."""
    whole = hashlib.blake2b(digest_size=8)
    with np.load(directory / "weights.npz") as weights:
        for name in sorted(weights.files):
            if weights[name].dtype.kind == "f":
                whole.update(name.encode() + weights[name].tobytes())
    return whole.hexdigest()


def killed(directory: Path) -> None:
    """Trains by two processes until there is a checkpoint, and kills them."""
    running = start(directory, 2, 2)
    while not (directory / "checkpoints" / f"{STEPS // 2}" / "digest").exists():
        if any(process.poll() is not None for process in running):
            raise RuntimeError("a training ended before it was killed")
        time.sleep(0.1)
    for process in running:
        process.kill()
        process.wait()


def main() -> None:
    """Trains, prints a table, and writes it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, help="the table, json")
    output = parser.parse_args().output
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for processes, devices in PLACES:
            directory, began = Path(folder, f"{processes}x{devices}"), time.monotonic()
            finish(start(directory, processes, devices))
            seconds = round(time.monotonic() - began, 1)
            rows.append({"run": f"{processes} x {devices}", "seconds": seconds})
            rows[-1]["digest"] = digest(directory)
            print(rows[-1], flush=True)
        directory = Path(folder, "turns")
        killed(directory)
        finish(start(directory, 1, 1))
        rows.append({"run": "2 x 2 killed, then 1 x 1", "digest": digest(directory)})
        print(rows[-1])
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(json.dumps(rows, indent=2) + "\n")
    raise SystemExit(int(len({row["digest"] for row in rows}) > 1))


if __name__ == "__main__":
    main()
