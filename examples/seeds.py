"""Trainings of several seeds side by side in one program: `vmap` over states and keys.

    python examples/seeds.py midi-s-f --seeds 0 1 2 -o runs/seeds

For a GPU that one training of graphs of this size leaves half idle, which is untried; a CPU
gains nothing. Every seed draws parameters, batches and noise of its own; data, and the order of the
buckets, are those of the configuration. Where there is one bucket, the weights are those that
`sg3d train --seed` gives, up to rounding. Nothing is saved on the way: these are the last averages,
not those of the best validation.
"""

import argparse
import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp

from sg3d_jax.flagg.compiled import quick_options
from sg3d_jax.infer.lanes import root_key
from sg3d_jax.train.config import check
from sg3d_jax.train.loop import Run, bucket_of_call, prepare, start_from_weights, validate
from sg3d_jax.train.presets import find_config
from sg3d_jax.train.processes import on_all_devices
from sg3d_jax.train.statistics import shares_of
from sg3d_jax.train.step import TrainState, init_state, make_train_call, mesh_of
from sg3d_jax.train.weights import save_weights


def trained(run: Run, seeds: Sequence[int]) -> Iterator[tuple[TrainState, dict[str, jax.Array]]]:
    """Yields the states after every call, stacked by seeds, and their metrics; the next takes them.

    Args:
      run: of a configuration; its own seed counts for the order of the buckets alone.
      seeds: of the trainings.
    """
    config, shares = run.config, shares_of(run.stacks)
    graph = jax.tree.map(lambda leaf: leaf[0], run.stacks[0])
    each = [dataclasses.replace(config, seed=seed) for seed in seeds]
    begun = [start_from_weights(one, init_state(one, run.model, graph)) for one in each]
    states = jax.tree.map(lambda *leaves: jnp.stack(leaves), *begun)
    keys = jnp.stack([root_key(seed + 1) for seed in seeds])
    states, keys, stacks = on_all_devices((states, keys, run.stacks), mesh_of(config))
    one_training = make_train_call(config, run.model).__wrapped__  # compiled with the others
    side_by_side = jax.vmap(one_training, in_axes=(0, 0, None))
    call = jax.jit(side_by_side, donate_argnums=0, compiler_options=quick_options())
    for number in range(config.steps // config.steps_per_call):
        bucket = bucket_of_call(config, shares, number)
        states, metrics = call(states, keys, stacks[bucket])
        yield states, metrics


def main() -> None:
    """Trains, validates and writes weights, a file a seed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("config", help="METHOD-DATASET or a Python file that defines CONFIG")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--steps", type=int, help="as configured by default")
    parser.add_argument("-o", "--output", type=Path, required=True, help="a folder")
    given = parser.parse_args()
    config = find_config(given.config)
    config = dataclasses.replace(config, steps=given.steps or config.steps)
    check(config)
    run = prepare(config)
    began = time.monotonic()
    for states, metrics in trained(run, given.seeds):
        losses = "  ".join(f"{float(loss):.4f}" for loss in metrics["loss"])
        print(f"{time.monotonic() - began:.0f} s  step {int(states.step[0])}  losses {losses}")
    given.output.mkdir(parents=True, exist_ok=True)
    for row, seed in enumerate(given.seeds):
        average = jax.tree.map(lambda leaf, row=row: leaf[row], states.average)
        of_seed = dataclasses.replace(run.config, seed=seed)
        path = given.output / f"{Path(given.config).stem}-{seed}.npz"
        save_weights(path, of_seed, run.statistics, average, run.card)
        print(f"{path}: FGW {validate(run, average)['fgw']:.4f} on the validation graphs")


if __name__ == "__main__":
    main()
