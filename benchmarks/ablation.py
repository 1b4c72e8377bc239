"""What each choice is worth on cities: short trainings that differ in one thing.

    python benchmarks/ablation.py [VARIANT ...] [--seed SEED]

Every variant is trained on the cities of S-C that have at most 128 nodes, for the same number of
steps from the weights of single floors, and grows validation scenes. Results are added to
benchmarks/results/ablation.json, so variants and seeds can be run one at a time. These trainings
are a fifth of those of the shipped weights: what is compared is how fast they get there.
"""

import argparse
import dataclasses
import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from sg3d_jax.data import registry
from sg3d_jax.flagg.corrupt import CorruptionConfig
from sg3d_jax.io import npz
from sg3d_jax.train.config import Config, DataConfig
from sg3d_jax.train.loop import train
from sg3d_jax.train.presets import find_config

RESULT: Final = Path(__file__).parent / "results" / "ablation.json"
MAX_NODES: Final = 128
STEPS: Final = 1500
SCENES: Final = 80

QUIET: Final = CorruptionConfig(0.0, 0.0, 0.0, 0.0)
LOUD: Final = CorruptionConfig(0.04, 0.04, 0.002, 0.2)
ROOMS_FIRST: Final = ("plane", "room", "wall", "floor", "building", "city")
ONE_CONTINUATION: Final = {"continuations": 1}
EIGHT_LEVELS: Final = {"noise_levels": 8}

# Of each variant what differs: fields of the run, of how it grows, and of the Fill model.
VARIANTS: Final[Mapping[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]]] = {
    "as shipped": ({}, {}, {}),
    "no edges between kin": ({}, {}, {"kin": 0}),
    "one continuation, eight noise levels": ({}, ONE_CONTINUATION, EIGHT_LEVELS),
    "the same in the order HP": ({}, {**ONE_CONTINUATION, "ordering": "HP"}, EIGHT_LEVELS),
    "rooms before walls": ({}, {"layers": ROOMS_FIRST}, {}),
    "no noise on the graph so far": ({}, {"corruption": QUIET}, {}),
    "four times that noise": ({}, {"corruption": LOUD}, {}),
    "from random parameters": ({"initial": None}, {}, {}),
    "from random parameters, one or four nodes a block": (
        {"initial": None},
        {"coins": (1, 4)},
        {},
    ),
    "from random parameters, five encoder layers": ({"initial": None}, {}, {"encoder_layers": 5}),
}


def variant(name: str, seed: int, data: str) -> Config:
    """Returns the configuration of a variant."""
    config = find_config("fd4-s-c")
    run, flagg, model = VARIANTS[name]
    assert config.flagg is not None
    return dataclasses.replace(
        config,
        data=DataConfig(name=data),
        seed=seed,
        model=dataclasses.replace(config.model, **model),
        flagg=dataclasses.replace(config.flagg, **flagg),
        steps=STEPS,
        capacities=(MAX_NODES,),
        validate_every=STEPS,
        validation_graphs=SCENES,
        **run,
    )


def measure(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Trains a variant and returns the scores of its validation scenes."""
    data = folder / "s-c.npz"
    small = [graph for graph in registry.make("s-c") if len(graph.nodes.label) <= MAX_NODES]
    npz.save(data, small, registry.header("s-c"))
    directory = folder / "run"
    train(variant(name, seed, str(data)), directory)
    lines = map(json.loads, (directory / "log.jsonl").read_text().splitlines())
    *_, last = (line for line in lines if line["kind"] == "validation")
    return {key: round(last[key], 4) for key in ("fgw", "gw", "w", "exact_structure", "halted")}


def add_scores(
    result: Path,
    about: Mapping[str, Any],
    order: Iterable[str],
    name: str,
    seed: int,
    scores: Mapping[str, Any],
) -> None:
    """Adds the scores of one training to the rows of a file, which keeps those that it has.

    Args:
      result: the file.
      about: how all were measured.
      order: of the rows; others that are there come last.
      name: of the row.
      seed: of the training.
      scores: of it.
    """
    rows = json.loads(result.read_text())["rows"] if result.exists() else {}
    rows[name] = rows.get(name, {}) | {f"seed {seed}": scores}
    ordered = {known: rows[known] for known in order if known in rows}
    result.write_text(json.dumps({**about, "rows": ordered | rows}, indent=2) + "\n")


def main() -> None:
    """Measures the variants that are asked for, and adds their rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("variants", nargs="*", default=list(VARIANTS))
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    arguments = parser.parse_args()
    for name in arguments.variants:
        with tempfile.TemporaryDirectory() as folder:
            scores = measure(name, arguments.seed, Path(folder))
        about = {"steps": STEPS, "scenes": SCENES, "cores": os.cpu_count()}
        add_scores(RESULT, about, VARIANTS, name, arguments.seed, scores)
        print(name, arguments.seed, scores, flush=True)


if __name__ == "__main__":
    main()
