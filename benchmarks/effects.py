"""What training on each effect is worth, on what it was not trained for, too.

    python benchmarks/effects.py [ROW ...] [--seed SEED]

MiDi is trained on from the weights of S-F, for as many steps in every row: on floors as they are,
and on views of them that show one kind of effect (`data.robot.VIEWS`), or all. Every row completes
the same validation scenes, as they are and effect by effect, a sample each. Results are added to
benchmarks/results/effects.json, so rows and seeds can be run one at a time.
"""

import argparse
import dataclasses
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from ablation import add_scores

from sg3d_jax.cli.provenance import provenance
from sg3d_jax.data.robot import VIEWS
from sg3d_jax.infer.complete import complete
from sg3d_jax.metrics.report import score
from sg3d_jax.scene.graph import observed_of
from sg3d_jax.train.config import Config, DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.loop import train
from sg3d_jax.train.presets import find_config
from sg3d_jax.train.weights import Trained, load_weights

RESULT: Final = Path(__file__).parent / "results" / "effects.json"
DATA: Final = "s-f"
STEPS: Final = 1500
SCENES: Final = 60

# The views that each row is trained on, beside the floors as they are, which all are trained on.
ROWS: Final[Mapping[str, tuple[str, ...]]] = {
    "as they are": (),
    "missing": ("missing", "path"),
    "shortened": ("shortened",),
    "merged and in parts": ("merged", "split", "doubled"),
    "noise": ("position", "heading", "height"),
    "clutter": ("clutter",),
    "all, mixed": ("robot",),
}
SEEN: Final = tuple(name for name in VIEWS if not name.endswith("bare"))


def configuration(views: tuple[str, ...], seed: int) -> Config:
    """Returns the run of a row: half of what it sees are floors as they are."""
    seen = [f"{DATA}@{view}" for view in views]
    config = find_config(f"midi-{DATA}")
    return dataclasses.replace(
        config,
        data=DataConfig(name="+".join([DATA] * max(1, len(seen)) + seen)),
        initial=f"midi-{DATA}",
        seed=seed,
        steps=STEPS,
        capacities=(48, 96),
        validate_every=STEPS,
        validation_graphs=1,
    )


def measure(trained: Trained, view: str) -> dict[str, float]:
    """Scores one sample of each validation scene, as a robot sees it."""
    truth = load_split(DataConfig(f"{DATA}@{view}"), "validation")[:SCENES]
    scenes = [observed_of(scene) for scene in truth]
    made = complete(trained.model, trained.params, scenes, candidates=1)
    report = score([samples[0].graph for samples in made], truth)
    return {key: round(report[key], 4) for key in ("fgw", "exact_structure")}


def main() -> None:
    """Trains the rows that are asked for, and adds their scores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", default=list(ROWS))
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    arguments = parser.parse_args()
    for name in arguments.rows:
        with tempfile.TemporaryDirectory() as folder:
            finished = train(configuration(ROWS[name], arguments.seed), Path(folder) / "run")
            trained = load_weights(finished.weights)
        scores = {view: measure(trained, view) for view in SEEN}
        source = {key: provenance()[key] for key in ("commit", "machine")}
        about = {"steps": STEPS, "scenes": SCENES, **source}
        add_scores(RESULT, about, ROWS, name, arguments.seed, scores)
        print(name, arguments.seed, scores, flush=True)


if __name__ == "__main__":
    main()
