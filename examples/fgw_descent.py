"""Moves the displaced centroids of a floor back by gradient descent on the FGW distance.

Walls, rooms and the floor start metres away from their places; the observed planes stay. Neither
positions nor an assignment of nodes are given to the descent, only the distance to the true graph.

Run: python examples/fgw_descent.py [PICTURE]
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

import sg3d_jax as sg
from sg3d_jax.metrics.fgw_problem import one_hot
from sg3d_jax.viz.figure import contact_sheet

STEPS = 300
STEP_SIZE = 0.1  # metres
NOISE = 1.0  # metres an axis; at 1.5 some walls take their neighbours' places, and stay


def descend(
    start: sg.SceneGraph, truth: sg.SceneGraph
) -> tuple[Float[Array, "N 3"], Float[Array, " S"]]:
    """Returns the centroids after the descent, metres, and the distance at every step."""
    free = (start.nodes.mask & ~start.nodes.observed)[:, None]
    optimiser = optax.adam(optax.cosine_decay_schedule(STEP_SIZE, STEPS))
    distance = jax.value_and_grad(sg.fgw_loss)

    def step(state: tuple, _: None) -> tuple[tuple, Float[Array, ""]]:
        position, moments = state
        value, gradient = distance(position, one_hot(start), start, truth)
        moves, moments = optimiser.update(jnp.where(free, gradient, 0.0), moments)
        return (position + moves, moments), value

    position = start.nodes.position
    (position, _), values = jax.lax.scan(step, (position, optimiser.init(position)), length=STEPS)
    return position, values


def displaced(graph: sg.SceneGraph, seed: int) -> sg.SceneGraph:
    """Returns a host graph whose nodes, but for the planes, are somewhere else on their storey."""
    offset = np.random.default_rng(seed).normal(scale=NOISE, size=graph.nodes.position.shape)
    offset[graph.nodes.observed] = 0
    offset[:, 2] = 0
    return moved(graph, graph.nodes.position + offset)


def moved(graph: sg.SceneGraph, position: np.ndarray) -> sg.SceneGraph:
    """Returns a host graph with other positions, metres."""
    return graph._replace(nodes=graph.nodes._replace(position=position))


def main(picture: str = "fgw_descent.png") -> None:
    """Draws a floor displaced, after the descent, and as it is."""
    truth = max(sg.make_dataset("s-f", 8), key=lambda graph: len(graph.nodes.label))
    start = displaced(truth, seed=0)
    capacity = sg.bucket(len(truth.nodes.label), len(truth.senders))
    position, values = jax.jit(descend)(sg.pad(start, capacity), sg.pad(truth, capacity))
    after = moved(truth, np.asarray(position)[: len(truth.nodes.label)])

    errors = []
    for graph in (start, after):
        error = np.linalg.norm(graph.nodes.position - truth.nodes.position, axis=1)
        errors.append(error[~truth.nodes.observed].mean())
    print(
        f"FGW {values[0]:.3f} -> {values[-1]:.3f}; mean error {errors[0]:.2f} -> {errors[1]:.3f} m"
    )
    captions = [
        f"displaced: FGW {values[0]:.2f}",
        f"after {STEPS} steps: FGW {values[-1]:.3f}",
        "the true floor",
    ]
    contact_sheet([("", [start, after, truth])], picture, captions)


if __name__ == "__main__":
    main(*sys.argv[1:])
