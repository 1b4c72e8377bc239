"""How sure completed graphs are of their nodes and edges, against how often these are right.

    python benchmarks/calibration.py midi-general --data s-f s-c s-f@robot p-f.npz p-f.npz@robot
    python benchmarks/calibration.py midi-general --fit --data s-f s-c s-f@robot p-f.npz

Of each test scene K graphs are drawn (`--candidates`), and their consensus is kept. For each data
set, the expected calibration error of the confidence in grown nodes and in part-of edges, and a
reliability diagram: how much of what has a confidence is right, and how much has it. Writes
benchmarks/results/calibration.json and calibration.png.

With --fit, the two constants of `infer.confidence` that make the validation splits most likely are
printed instead: by those, for consensus graphs and for single ones, with 2, 4 and 8 draws.
"""

import argparse
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from sg3d_jax.cli.provenance import provenance_of_script
from sg3d_jax.infer import confidence
from sg3d_jax.infer.complete import complete
from sg3d_jax.infer.consensus import consensus
from sg3d_jax.infer.division import divided_alike
from sg3d_jax.metrics.calibration import (
    Reliability,
    calibration,
    correct_edges,
    correct_nodes,
    edge_identities,
    identities,
)
from sg3d_jax.scene.graph import SceneGraph, observed_of
from sg3d_jax.train.config import DataConfig
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.weights import Trained, load_weights, with_diffusion_steps

RESULTS: Final = Path(__file__).parent / "results"
DRAWN: Final = (2, 4, 8)  # graphs a scene that the constants are fitted to
PRIORS: Final = np.geomspace(0.05, 2.0, 41)
SHARPNESSES: Final = np.linspace(0.5, 5.0, 46)


def measured(
    trained: Trained, data: str, scenes: int, candidates: int, seed: int
) -> dict[str, Reliability]:
    """Returns the reliability of nodes and edges on the first scenes of a test split."""
    truth = load_split(DataConfig(data), "test")[:scenes]
    given = [observed_of(scene) for scene in truth]
    completed = complete(trained.model, trained.params, given, seed, candidates=candidates)
    made = [one for one, *_ in completed]
    return calibration(
        [one.graph for one in made],
        truth,
        [np.asarray(one.node_confidence) for one in made],
        [np.asarray(one.edge_confidence) for one in made],
    )


def row_of(found: dict[str, Reliability]) -> dict[str, Any]:
    """Returns reliability as JSON values."""
    return {
        name: {
            "error": round(of.error, 4),
            "right": round(float(of.count @ of.correct / of.count.sum()), 4),
            "bins": {
                "count": of.count.tolist(),
                "confidence": np.round(of.confidence, 4).tolist(),
                "correct": np.round(of.correct, 4).tolist(),
            },
        }
        for name, of in found.items()
    }


def draw(rows: dict[str, dict[str, Reliability]], path: Path) -> None:
    """Draws a reliability diagram for nodes and one for edges, and how much is in each bin."""
    from matplotlib.figure import Figure

    from sg3d_jax.viz.style import EDGE_COLOUR

    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, height_ratios=(3, 1))
    for column, name in enumerate(("nodes", "edges")):
        diagram, counts = axes[:, column]
        diagram.plot([0, 1], [0, 1], ":", color=EDGE_COLOUR, linewidth=1)
        for label, row in rows.items():
            of = row[name]
            held = of.count > 0
            text = f"{label} ({of.error:.3f})"
            diagram.plot(of.confidence[held], of.correct[held], "o-", markersize=3, label=text)
            counts.semilogy(of.confidence[held], of.count[held], "o-", markersize=3)
        diagram.set(
            title=f"Grown {name} (calibration error)",
            ylabel="share that is right",
            ylim=(-0.02, 1.02),
        )
        diagram.legend(frameon=False, fontsize=8)
        counts.set(xlabel="confidence", ylabel=name)
        counts.minorticks_off()
        for each in (diagram, counts):
            each.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def votes(graphs: Sequence[SceneGraph], truth: SceneGraph, num_given: int) -> np.ndarray:
    """Returns of grown nodes and edges of some draws how many have them, and which are right.

    Args:
      graphs: the draws of one scene.
      truth: the true graph.
      num_given: how many of their first nodes were given.

    Returns:
      int[k, 3]: draws that have it, draws, and 1 if it is right; of the consensus and of the first.
    """
    graphs = divided_alike(graphs, num_given)
    nodes, edges = [identities(one) for one in graphs], [edge_identities(one) for one in graphs]
    rows = []
    for graph in (consensus(graphs, num_given)[0], graphs[0]):
        for known, all_known, right in (
            (identities(graph)[num_given:], nodes, correct_nodes(graph, truth)[num_given:]),
            (edge_identities(graph), edges, correct_edges(graph, truth)),
        ):
            sets = [{*of_graph} for of_graph in all_known]
            held = [sum(one in of_graph for of_graph in sets) for one in known]
            rows += zip(held, itertools.repeat(len(graphs)), right.tolist(), strict=False)
    return np.array(rows).reshape(-1, 3)


def fitted(trained: Trained, data: Sequence[str], scenes: int, seed: int) -> tuple[float, float]:
    """Returns the prior and the sharpness under which what is right is most likely."""
    rows = []
    for name in data:
        truth = load_split(DataConfig(name), "validation")[:scenes]
        given = [observed_of(scene) for scene in truth]
        completed = complete(trained.model, trained.params, given, seed, samples=max(DRAWN))
        for scene, of_scene, true in zip(given, completed, truth, strict=True):
            graphs = [one.graph for one in of_scene]
            rows += [votes(graphs[:k], true, len(scene.nodes.label)) for k in DRAWN]
    count, total, right = np.concatenate(rows).T

    def loss(prior: float, sharpness: float) -> float:
        odds = ((count + prior) / (total - count + prior)) ** sharpness
        likely = odds / (1 + odds)
        return -float(np.mean(np.log(np.where(right, likely, 1 - likely))))

    return min(itertools.product(PRIORS, SHARPNESSES), key=lambda constants: loss(*constants))


def main() -> None:
    """Measures and writes, or fits."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights")
    parser.add_argument("--data", nargs="+", default=["s-f", "s-c", "s-f@robot"])
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--candidates", type=int, default=8)
    parser.add_argument("--diffusion-steps", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--fit", action="store_true")
    arguments = parser.parse_args()
    trained = with_diffusion_steps(load_weights(arguments.weights), arguments.diffusion_steps)
    if arguments.fit:
        prior, sharpness = fitted(trained, arguments.data, arguments.scenes, arguments.seed)
        print(f"PRIOR {prior:.2f} (now {confidence.PRIOR}), ", end="")
        print(f"SHARPNESS {sharpness:.2f} (now {confidence.SHARPNESS})")
        return
    rows = {}
    for name in arguments.data:
        label = Path(name).name.replace(".npz", "")
        rows[label] = measured(
            trained, name, arguments.scenes, arguments.candidates, arguments.seed
        )
        print(label, {key: round(of.error, 3) for key, of in rows[label].items()}, flush=True)
    about = provenance_of_script()
    content = {**about, "rows": {label: row_of(found) for label, found in rows.items()}}
    (RESULTS / "calibration.json").write_text(json.dumps(content, indent=2) + "\n")
    draw(rows, RESULTS / "calibration.png")


if __name__ == "__main__":
    main()
