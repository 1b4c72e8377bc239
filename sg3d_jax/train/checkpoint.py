"""Checkpoints of a run: the latest, to go on from, and the best by validation FGW, to use.

The only file that knows orbax. Its `best_fn` with `max_to_keep` deletes the newest checkpoint
(orbax issue 526), so both are kept by name here.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from orbax.checkpoint import v1 as ocp

from sg3d_jax.train.step import TrainState


class Checkpoints(NamedTuple):
    """The open checkpoints of one run."""

    manager: Any  # ocp.training.Checkpointer


def open_checkpoints(directory: Path) -> Checkpoints:
    """Opens, or begins, the checkpoints of a run."""
    policies: Any = ocp.training.preservation_policies
    best = policies.BestN(n=1, get_metric_fn=lambda metrics: metrics["fgw"], reverse=True)
    keep = policies.AnyPreservationPolicy([policies.LatestN(1), best])
    location = str(directory.resolve())
    return Checkpoints(ocp.training.Checkpointer(location, preservation_policy=keep))


def save(checkpoints: Checkpoints, state: TrainState, fgw: float) -> None:
    """Saves the state under its step; orbax writes to a temporary name and renames."""
    checkpoints.manager.save_checkpointables(
        int(state.step), {"state": state}, metrics={"fgw": fgw}
    )


def steps(checkpoints: Checkpoints) -> list[tuple[int, float]]:
    """Returns step and validation FGW of what is kept, oldest first."""
    return [(kept.step, kept.metrics["fgw"]) for kept in checkpoints.manager.checkpoints]


def restore(checkpoints: Checkpoints, template: TrainState, step: int) -> TrainState:
    """Loads the state of one step.

    Args:
      checkpoints: of the run.
      template: a state of the same shapes; its values do not matter.
      step: one that is kept.
    """
    abstract = jax.tree.map(np.asarray, template)
    loaded = checkpoints.manager.load_checkpointables(step, {"state": abstract})["state"]
    return jax.tree.map(jnp.asarray, loaded)  # on no device in particular, as a new state


def close(checkpoints: Checkpoints) -> None:
    """Waits for pending writes and closes."""
    checkpoints.manager.close()
