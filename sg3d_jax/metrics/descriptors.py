"""What remains of a scene graph without labels and positions: histograms that MMD compares.

Each function describes one padded graph; `vmap` them over a stack. They see a graph as its dense
adjacency: symmetric, without loops, False at padding. Bins are those of networkx and numpy in
float64: run these under `jax.enable_x64`, as `mmd_scores` does, for in float32 a value next to the
border of a bin may fall to the other side.
"""

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

CLUSTERING_BINS: Final = np.linspace(0.0, 1.0, 101)
# An eigenvalue of 0 or 1, which every tree has, lies well inside its bin: hence the -1e-5.
SPECTRUM_BINS: Final = np.linspace(-1e-5, 2.0, 201)

BEYOND_SPECTRUM: Final = 3.0
SMALLEST_PIVOT: Final = 1e-30


def degree_histogram(
    adjacency: Bool[Array, "N N"], mask: Bool[Array, " N"], num_bins: int
) -> Float[Array, " num_bins"]:
    """Returns the share of nodes that have 0, 1, ..., num_bins - 1 neighbours.

    Args:
      adjacency: symmetric, without loops; False at padding.
      mask: True for real nodes.
      num_bins: more than the largest degree; what lies beyond is not counted.
    """
    return _histogram(jnp.sum(adjacency, axis=1), mask, num_bins)


def clustering_histogram(
    adjacency: Bool[Array, "N N"], mask: Bool[Array, " N"]
) -> Float[Array, "100"]:
    """Returns the histogram of local clustering coefficients over [0, 1], summing to 1.

    Args:
      adjacency: symmetric, without loops; False at padding.
      mask: True for real nodes. Those with fewer than two neighbours have coefficient 0.
    """
    links = _as_float(adjacency)
    degree = jnp.sum(links, axis=1)
    linked_pairs = jnp.sum((links @ links) * links, axis=1)  # of neighbours, in both directions
    coefficient = linked_pairs / jnp.maximum(degree * (degree - 1), 1)
    borders = jnp.asarray(CLUSTERING_BINS, links.dtype)
    num_bins = len(CLUSTERING_BINS) - 1
    bins = jnp.searchsorted(borders, coefficient, side="right") - 1
    return _histogram(jnp.minimum(bins, num_bins - 1), mask, num_bins)


def spectrum_histogram(
    adjacency: Bool[Array, "N N"], mask: Bool[Array, " N"]
) -> Float[Array, "200"]:
    """Returns the histogram of the eigenvalues of the normalised Laplacian, summing to 1.

    Args:
      adjacency: symmetric, without loops; False at padding.
      mask: True for real nodes. One without neighbours has eigenvalue 0.

    Differs: FLAGG's code loses the eigenvalue 2 of a bipartite graph where rounding puts it above
    2; ours counts it into the last bin.
    """
    laplacian = normalised_laplacian(adjacency)
    # Eigenvalues of padding lie behind the last bin. Not one of them is computed: a bin holds what
    # lies below its end and not below its start.
    padded = laplacian + jnp.diag(jnp.where(mask, 0.0, BEYOND_SPECTRUM))
    _, diagonal, off_diagonal, _ = jax.lax.linalg.tridiagonal(padded)
    borders = jnp.asarray(SPECTRUM_BINS[1:-1], laplacian.dtype)
    below = _num_eigenvalues_below(diagonal, off_diagonal, borders)
    num_nodes = jnp.sum(mask, dtype=below.dtype)
    counts = jnp.diff(below, prepend=0, append=num_nodes)
    return _as_float(counts) / jnp.maximum(num_nodes, 1)


def normalised_laplacian(adjacency: Bool[Array, "N N"]) -> Float[Array, "N N"]:
    """Returns I - D^(-1/2) A D^(-1/2), with zero rows for nodes without neighbours."""
    links = _as_float(adjacency)
    degree = jnp.sum(links, axis=1)
    scale = jnp.where(degree > 0, 1 / jnp.sqrt(jnp.maximum(degree, 1)), 0.0)
    return jnp.diag(jnp.where(degree > 0, 1.0, 0.0)) - scale[:, None] * links * scale[None, :]


def _num_eigenvalues_below(
    diagonal: Float[Array, " N"], off_diagonal: Float[Array, " N-1"], bounds: Float[Array, " K"]
) -> Int[Array, " K"]:
    """Counts the eigenvalues of a symmetric tridiagonal matrix below each bound.

    As many as negative pivots, when the matrix less the bound is eliminated (Sturm sequence).

    Source: Golub and van Loan, "Matrix Computations", 4th ed., Sec. 8.4.
    """

    def eliminate(state: tuple, row: tuple) -> tuple[tuple, None]:
        pivot, count = state
        entry, squared = row
        pivot = entry - bounds - squared / pivot
        pivot = jnp.where(jnp.abs(pivot) < SMALLEST_PIVOT, -SMALLEST_PIVOT, pivot)
        return (pivot, count + (pivot < 0)), None

    squares = jnp.concatenate([jnp.zeros_like(diagonal[:1]), off_diagonal**2])
    start = jnp.ones_like(bounds), jnp.zeros(bounds.shape, jnp.int32)
    return jax.lax.scan(eliminate, start, (diagonal, squares))[0][1]


def _histogram(
    bins: Int[Array, " N"], mask: Bool[Array, " N"], num_bins: int
) -> Float[Array, " num_bins"]:
    """Returns the share of real nodes in each bin."""
    weight = _as_float(mask) / jnp.maximum(jnp.sum(mask), 1)
    return jnp.zeros(num_bins).at[bins].add(weight, mode="drop")


def _as_float(array: Shaped[Array, "..."]) -> Float[Array, "..."]:
    """Returns counts, or 0 and 1, in the precision that is switched on."""
    return array.astype(jnp.result_type(float))
