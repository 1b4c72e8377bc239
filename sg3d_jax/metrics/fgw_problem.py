"""What FGW minimises: two padded graphs as feature distances and hop distances on one scale.

    FGW = min over plans P of (1 - alpha) W(P) + alpha GW(P)
    W(P) = sum_ij P_ij |f_i - g_j|        GW(P) = sum_ijkl P_ij P_kl loss(a_ik, b_jl)

f, g are node features (position, one-hot label) and a, b hop distances over the part-of edges. Two
paddings meet here. *Dummies* make the two graphs equally large and carry mass; *padding* only fills
the arrays and carries none. Rows are `[real nodes | dummies | padding]` in both graphs.

The sum over four axes is never formed: sum_kl P_kl loss(a_ik, b_jl) is called `structure`, and for
hops it is a few matrix products.

Source: paper, Sec. "Metrics"; Peyré, Cuturi and Solomon, "Gromov-Wasserstein averaging of kernel
and distance matrices", ICML 2016, Eq. 6, for the squared loss.
Differs: the paper does not say how metres and hops are brought to one scale. Positions are centred
on the observed nodes and divided by their horizontal spread, hops by the larger of the two
graphs' largest distances: of the conventions tried, one that comes within 0.03 (rms) of the paper's
Rand rows.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sg3d_jax.metrics.shortest_path import part_of_hops
from sg3d_jax.scene.graph import SceneGraph, ontology_of
from sg3d_jax.scene.padding import centre_of_observed, moved_by

Scalar = float | Float[Array, ""]
Loss = Literal["absolute", "squared"]

ALPHA = 0.5


class Scale(NamedTuple):
    """What counts as distance 1; None for the paper's, which differs from pair to pair."""

    metres: Scalar | None = None  # None: the horizontal spread of what is observed in the truth
    # None: the largest distance in the two graphs, be it between unconnected nodes. A generated
    # graph in large pieces is measured in a larger unit, which makes it look better: see
    # `shortest_path.hop_distances`.
    hops: Scalar | None = None


PAPER_SCALE = Scale()


class Problem(NamedTuple):
    """Two graphs of equally many nodes, dummies included; padding rows and columns are zero."""

    features: Float[Array, "N N"]  # |f_i - g_j|
    hops: tuple[Int[Array, "N N"], Int[Array, "N N"]]  # within each graph
    unit: Float[Array, ""]  # the hops that count as distance 1
    size: Int[Array, ""]  # nodes with mass


def check_choices(alpha: Scalar, loss: str) -> None:
    """Refuses a weight of the structure and a loss that there are not.

    Args:
      alpha: a number; one that is traced or on the device is not looked at.
      loss: by name.

    Raises:
      ValueError: the weight is outside 0 to 1, or there is no such loss.
    """
    if not isinstance(alpha, jax.Array) and not 0 <= alpha <= 1:
        raise ValueError(f"alpha is {alpha}, expected a number from 0 to 1")
    if loss not in get_args(Loss):
        raise ValueError(f"the loss is {loss!r}, expected one of {', '.join(get_args(Loss))}")


def check_pair(generated: SceneGraph, truth: SceneGraph) -> None:
    """Refuses two graphs that are not padded alike; all that it looks at is static.

    Raises:
      ValueError: they have different ontologies or capacities, no slots, or are stacks.
    """
    if ontology_of(generated) != ontology_of(truth):
        raise ValueError("the generated graph has another ontology than the true one")
    left, right = (np.shape(graph.nodes.mask) for graph in (generated, truth))
    if not len(left) == len(right) == 1:
        raise ValueError(
            f"the node masks have the shapes {left} and {right}, expected one graph each; "
            "`jax.vmap` takes stacks of them"
        )
    if left != right or left == (0,):
        raise ValueError(
            f"the graphs have {left[0]} and {right[0]} slots, expected one capacity, above 0: "
            "`pad` both to it; `fgw_pairs` takes graphs of any size"
        )


def one_hot(graph: SceneGraph) -> Float[Array, "N C"]:
    """Returns the labels of a padded graph as distributions over its concepts."""
    dtype = jnp.result_type(graph.nodes.position)
    return jax.nn.one_hot(graph.nodes.label, ontology_of(graph).num_concepts, dtype=dtype)


def centred(generated: SceneGraph, truth: SceneGraph) -> tuple[SceneGraph, SceneGraph]:
    """Moves a pair of host graphs to the centre of what is observed in the truth, in float64.

    FGW does not depend on the origin, but the device's float32 does: 5000 km from it, its steps are
    half a metre. Graphs that are traced or on the device have lost that already, and stay as they
    are.
    """
    pair = generated, truth
    if not all(isinstance(graph.nodes.position, np.ndarray) for graph in pair):
        return pair
    offset = -centre_of_observed(truth)
    return moved_by(generated, offset), moved_by(truth, offset)


def pose(
    generated: SceneGraph,
    truth: SceneGraph,
    scale: Scale = PAPER_SCALE,
    label: Float[Array, "N C"] | None = None,
    softening: float = 0.0,
) -> Problem:
    """Puts two padded graphs on one scale and makes them equally large with dummies.

    Args:
      generated: padded; its proximity edges are ignored.
      truth: padded to the same capacity, of the same concepts. What is observed in it sets the
        origin of positions, and their unit.
      scale: the units of positions and hops.
      label: distributions over the concepts that replace the generated labels.
      softening: what is added to squared feature distances, which makes them smooth where they
        vanish.

    Returns:
      The problem, in the float type of the positions.
    """
    masks = generated.nodes.mask, truth.nodes.mask
    size = jnp.maximum(*(jnp.sum(mask, dtype=jnp.int32) for mask in masks))
    occupied = jnp.arange(masks[0].shape[0]) < size
    origin, spread = _frame_of_observed(truth)
    metres = spread if scale.metres is None else scale.metres
    labels = one_hot(generated) if label is None else label, one_hot(truth)
    left, right = (
        _features(graph, label, origin, metres)
        for graph, label in zip((generated, truth), labels, strict=True)
    )
    distance = _norm(left[:, None, :] - right[None, :, :], softening)
    hops = [part_of_hops(graph) for graph in (generated, truth)]
    longest = jnp.maximum(1, jnp.maximum(jnp.max(hops[0]), jnp.max(hops[1])))
    return Problem(
        features=jnp.where(occupied[:, None] & occupied[None, :], distance, 0.0),
        hops=(
            _with_dummies(hops[0], masks[0], occupied),
            _with_dummies(hops[1], masks[1], occupied),
        ),
        unit=jnp.asarray(longest if scale.hops is None else scale.hops, distance.dtype),
        size=size,
    )


def mass_of_nodes(problem: Problem) -> Float[Array, " N"]:
    """Returns the marginal of both graphs: equal for real nodes and dummies, zero for padding."""
    dtype = problem.features.dtype
    occupied = jnp.arange(problem.features.shape[0]) < problem.size
    return jnp.where(occupied, 1 / jnp.maximum(problem.size, 1).astype(dtype), 0.0)


def plan_of_assignment(problem: Problem, columns: Int[Array, " N"]) -> Float[Array, "N N"]:
    """Returns the plan that moves every row to its column: a vertex of the set of plans."""
    chosen = columns[:, None] == jnp.arange(columns.shape[0])[None, :]
    return jnp.where(chosen, mass_of_nodes(problem)[:, None], 0.0)


def structure_at_assignment(
    problem: Problem, columns: Int[Array, " N"], loss: Loss
) -> Float[Array, "N N"]:
    """Returns `structure` at the plan of an assignment that leaves padding in its place."""
    left, right = problem.hops
    mass = mass_of_nodes(problem)[0]

    def coupled(left: Array, right: Array) -> Array:
        return left @ right

    return mass * _structure(problem._replace(hops=(left, right[columns])), coupled, loss)


def structure_at_product(problem: Problem, loss: Loss) -> Float[Array, "N N"]:
    """Returns `structure` at the product plan, where every product has rank one."""
    mass = mass_of_nodes(problem)[0]

    def coupled(left: Array, right: Array) -> Array:
        return mass * jnp.sum(left, axis=1)[:, None] * jnp.sum(right, axis=0)[None, :]

    return mass * _structure(problem, coupled, loss)


def structure_at_plan(
    problem: Problem, plan: Float[Array, "N N"], loss: Loss
) -> Float[Array, "N N"]:
    """Returns `structure` at any plan with the marginals of the problem."""
    mass = mass_of_nodes(problem)[0]
    share = plan / jnp.where(mass > 0, mass, 1.0)

    # A GPU rounds products of float32 matrices to ten bits unless told otherwise.
    def coupled(left: Array, right: Array) -> Array:
        exact = jax.lax.Precision.HIGHEST
        return jnp.matmul(left, jnp.matmul(share, right, precision=exact), precision=exact)

    return mass * _structure(problem, coupled, loss)


def _structure(
    problem: Problem, coupled: Callable[[Array, Array], Array], loss: Loss
) -> Float[Array, "N N"]:
    """Returns `structure` divided by the mass of a node.

    `coupled(u, v)` is sum_kl P_kl u_ik v_lj divided by that mass. Both losses have the form
    f(a) + f(b) - h(a, b); the marginals alone determine the first two terms.
    """
    dtype = problem.features.dtype
    left, right = problem.hops
    if loss == "squared":
        left, right = left.astype(dtype), right.astype(dtype)
        squares = jnp.sum(left**2, axis=1)[:, None] + jnp.sum(right**2, axis=0)[None, :]
        return (squares - 2 * coupled(left, right)) / problem.unit**2

    # |a - b| = a + b - 2 min(a, b), and min(a, b) counts the thresholds that both exceed: a product
    # of 0/1 matrices a threshold instead of a tensor of four axes. Exact in float32, on any device.
    def overlap(threshold: Array, total: Array) -> Array:
        return total + coupled(*((hops > threshold).astype(dtype) for hops in (left, right)))

    thresholds = jnp.minimum(jnp.max(left), jnp.max(right))
    shared = jax.lax.fori_loop(0, thresholds, overlap, jnp.zeros_like(problem.features))
    sums = jnp.sum(left, axis=1)[:, None] + jnp.sum(right, axis=0)[None, :]
    return (sums.astype(dtype) - 2 * shared) / problem.unit


def _frame_of_observed(graph: SceneGraph) -> tuple[Float[Array, "3"], Float[Array, ""]]:
    """Returns the mean position of the observed nodes and their horizontal spread a axis, metres.

    The spread is 1 m where they do not define one: fewer than two of them, or all in a place.
    """
    observed = graph.nodes.observed[:, None]
    count = jnp.maximum(jnp.sum(observed, dtype=graph.nodes.position.dtype), 1)
    origin = jnp.sum(jnp.where(observed, graph.nodes.position, 0.0), axis=0) / count
    offset = jnp.where(observed, graph.nodes.position - origin[None, :], 0.0)[:, :2]
    spread = _norm(offset.ravel()) / jnp.sqrt(2.0 * count)
    return origin, jnp.where(spread > 0, spread, 1.0)


def _features(
    graph: SceneGraph, label: Float[Array, "N C"], origin: Float[Array, "3"], metres: Scalar
) -> Float[Array, "N F"]:
    """Returns position and label distribution of every node; zero for dummies and padding."""
    position = (graph.nodes.position - origin[None, :]) / metres
    features = jnp.concatenate([position, label.astype(position.dtype)], axis=1)
    return jnp.where(graph.nodes.mask[:, None], features, 0.0)


def _with_dummies(
    hops: Int[Array, "N N"], mask: Bool[Array, " N"], occupied: Bool[Array, " N"]
) -> Int[Array, "N N"]:
    """Sets every distance from and to a dummy to one more than the largest distance."""
    dummy = occupied & ~mask
    apart = (dummy[:, None] & occupied[None, :]) | (occupied[:, None] & dummy[None, :])
    apart = apart & ~jnp.eye(mask.shape[0], dtype=bool)
    return jnp.where(apart, 1 + jnp.max(hops), hops)


def _norm(vector: Float[Array, "*rows F"], softening: float = 0.0) -> Float[Array, "*rows"]:
    """Returns Euclidean norms, with a gradient of zero rather than NaN where they are zero."""
    squared = jnp.sum(vector**2, axis=-1) + softening
    zero = squared == 0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, squared)))
