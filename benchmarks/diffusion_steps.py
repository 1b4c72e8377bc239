"""Quality and time against the number of diffusion steps, on validation scenes.

    python benchmarks/diffusion_steps.py fd4-s-f --steps 2 4 8 16 32 64

Prints a row for each number of steps and writes benchmarks/results/diffusion_steps_NAME.json. The
same scenes are grown twice; the second time, compiled already, is the one reported.
"""

import argparse
import json
import os
import time
from pathlib import Path

from sg3d_jax.infer.complete import complete
from sg3d_jax.metrics.report import score
from sg3d_jax.train.dataset import load_split
from sg3d_jax.train.weights import load_weights, with_diffusion_steps

RESULTS = Path(__file__).parent / "results"


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights")
    parser.add_argument("--steps", type=int, nargs="+", default=[2, 4, 8, 16, 32, 64])
    parser.add_argument("--scenes", type=int, default=200)
    arguments = parser.parse_args()
    trained = load_weights(arguments.weights)
    truth = load_split(trained.config.data, "validation")[: arguments.scenes]
    rows = []
    for steps in arguments.steps:
        chosen = with_diffusion_steps(trained, steps)
        for _ in range(2):
            began = time.perf_counter()
            grown = complete(chosen.model, chosen.params, truth, candidates=1)
            seconds = time.perf_counter() - began
        report = score([completions[0].graph for completions in grown], truth)
        kept = {name: round(report[name], 4) for name in ("fgw", "gw", "w", "exact_structure")}
        rows.append({"steps": steps, **kept, "scenes_per_second": round(len(truth) / seconds, 1)})
        print(rows[-1], flush=True)
    content = {"weights": arguments.weights, "scenes": len(truth), "cores": os.cpu_count()}
    path = RESULTS / f"diffusion_steps_{Path(arguments.weights).stem}.json"
    path.write_text(json.dumps({**content, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
