"""How far a set of generated graphs is from a set of true ones: maximum mean discrepancy.

    MMD^2 = E k(g, g') + E k(r, r') - 2 E k(g, r)        k(x, y) = exp(-|x - y|^2 / (2 sigma^2))

over generated graphs g and true ones r, each described by a histogram of degrees, of clustering
coefficients or of Laplacian eigenvalues, or by a random graph network (GIN). Only part-of edges
count; labels and positions do not. The convention:

- what is reported is MMD^2, at most 2; its means include each graph's pair with itself (biased);
- histograms sum to 1 and are compared by squared L2 distance, at the bandwidth sigma, of 30 fixed
  ones, where MMD^2 is largest;
- GIN embeddings are standardised feature by feature over the true graphs; the bandwidths are ten
  multiples of the root mean square distance between generated and true graphs, the largest MMD^2
  counts, and the mean over ten networks of one seed is reported.

Source: paper, Sec. "Metrics", Distribution evaluation: the formulas. Profile "cdgs" of FLAGG's
code (CognacS/flagg-graphgen, after GraphGDP and GGM-metrics): bins, bandwidths, bias, networks.
With it the paper's Rand rows come out (0.03 rms); with one bandwidth, or total variation or
earth mover's distance in place of L2, they do not.
"""

import itertools
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from sg3d_jax.metrics.descriptors import (
    clustering_histogram,
    degree_histogram,
    spectrum_histogram,
)
from sg3d_jax.metrics.gin import GIN, gin_embedding, init_gin
from sg3d_jax.scene.graph import SceneGraph, undirected_edges
from sg3d_jax.scene.ontology import PART_OF
from sg3d_jax.scene.padding import bucket, unpad_all

HostOrDevice = jax.Array | np.ndarray

GIN_SEED: Final = 0
NUM_GINS: Final = 10
HISTOGRAM_BANDWIDTHS: Final = np.exp(np.linspace(-5.0, 5.0, 50)[:30])
EMBEDDING_BANDWIDTHS: Final = np.array([0.01, 0.1, 0.25, 0.5, 0.75, 1.0, 2.5, 5.0, 7.5, 10.0])
GRAPHS_PER_CALL: Final = 64


class Description(NamedTuple):
    """What MMD sees of a set of `B` graphs."""

    degree: HostOrDevice  # float64[B, largest capacity]
    clustering: HostOrDevice  # float64[B, 100]
    spectrum: HostOrDevice  # float64[B, 200]
    gin: HostOrDevice  # float32[B, networks, features]


def mmd_scores(
    generated: Iterable[SceneGraph], reference: Iterable[SceneGraph], gin_seed: int = GIN_SEED
) -> dict[str, float]:
    """Scores a set of generated graphs against a set of true ones.

    Computed in float64, whatever precision is switched on.

    Args:
      generated: host graphs of any size, or padded ones, in any order; their proximity edges are
        ignored.
      reference: likewise; the sets need not be equally large.
      gin_seed: draws the random networks. Scores compare only at one seed.

    Returns:
      MMD^2 between 0 and 2 of `degree`, `clustering`, `spectrum` and `gin`. Being biased, it is
      above 0 also for two samples of one distribution (0.04 for 60 graphs each), and at or near 2
      for sets of one graph each unless they agree: compare only scores of equally large sets.

    Raises:
      ValueError: a set holds no graph with nodes or is one graph, or a graph exceeds the largest
        capacity.

    Source: paper, Sec. "Metrics": Deg., Clust., Spec., GIN.
    Differs: FLAGG keeps only the largest connected component of a generated graph. Here all of it
    counts, so that what is left unconnected shows.
    """
    sets = [
        [graph for graph in unpad_all(graphs) if len(graph.nodes.label)]
        for graphs in (generated, reference)
    ]
    if not all(sets):
        raise ValueError(
            f"MMD needs graphs with nodes in both sets, got {len(sets[0])} generated and "
            f"{len(sets[1])} true ones"
        )
    gins = _draw_gins(jax.random.key(gin_seed))
    num_bins = max(_node_capacity(graph) for graphs in sets for graph in graphs)
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"):
        made, true = (_describe(graphs, gins, num_bins) for graphs in sets)
        scores = {
            "degree": histogram_mmd(made.degree, true.degree),
            "clustering": histogram_mmd(made.clustering, true.clustering),
            "spectrum": histogram_mmd(made.spectrum, true.spectrum),
            "gin": _mean_embedding_mmd(made.gin, true.gin),
        }
    return {name: float(score) for name, score in scores.items()}


@jax.jit
def histogram_mmd(
    generated: Float[Array, "G F"], reference: Float[Array, "R F"]
) -> Float[Array, ""]:
    """Returns the largest MMD^2 over `HISTOGRAM_BANDWIDTHS` of two sets of histograms."""
    distances = _all_squared_distances(generated, reference)
    return _largest_mmd(distances, jnp.asarray(HISTOGRAM_BANDWIDTHS, generated.dtype))


@jax.jit
def embedding_mmd(
    generated: Float[Array, "G F"], reference: Float[Array, "R F"]
) -> Float[Array, ""]:
    """Returns the largest MMD^2 over `EMBEDDING_BANDWIDTHS` of two sets of embeddings.

    The unit of the bandwidths is the root mean square distance between the sets. Features are
    divided by their standard deviation over the reference, except those that are constant there.
    """
    constant = jnp.max(reference, axis=0) == jnp.min(reference, axis=0)
    deviation = jnp.sqrt(jnp.where(constant, 1.0, jnp.var(reference, axis=0)))[None, :]
    distances = _all_squared_distances(generated / deviation, reference / deviation)
    mean = jnp.mean(distances[2])
    unit = jnp.sqrt(jnp.where(mean > 0, mean, 1.0))
    return _largest_mmd(distances, jnp.asarray(EMBEDDING_BANDWIDTHS, unit.dtype) * unit)


def _all_squared_distances(
    generated: Float[Array, "G F"], reference: Float[Array, "R F"]
) -> tuple[Float[Array, "G G"], Float[Array, "R R"], Float[Array, "G R"]]:
    """Returns the distances within both sets, then between them."""
    pairs = (generated, generated), (reference, reference), (generated, reference)
    within_generated, within_reference, between = (_squared_distances(*pair) for pair in pairs)
    return within_generated, within_reference, between


def _squared_distances(
    left: Float[Array, "L F"], right: Float[Array, "R F"]
) -> Float[Array, "L R"]:
    """Returns squared distances; exactly zero for equal rows, as a matrix product would not be."""
    return jax.lax.map(lambda row: jnp.sum((right - row[None, :]) ** 2, axis=1), left)


def _largest_mmd(
    distances: tuple[Float[Array, "..."], ...], bandwidths: Float[Array, " K"]
) -> Float[Array, ""]:
    """Returns the largest biased estimate of MMD^2 over the bandwidths, at least 0."""

    def estimate(bandwidth: Float[Array, ""]) -> Float[Array, ""]:
        gamma = 0.5 / bandwidth**2
        made, true, between = (jnp.mean(jnp.exp(-gamma * squared)) for squared in distances)
        return made + true - 2 * between

    return jnp.maximum(jnp.max(jax.lax.map(estimate, bandwidths)), 0.0)


def _mean_embedding_mmd(generated: HostOrDevice, reference: HostOrDevice) -> Float[Array, ""]:
    """Returns the mean over networks of `embedding_mmd`; both are [graphs, networks, features]."""
    sets = (embeddings.swapaxes(0, 1).astype(np.float64) for embeddings in (generated, reference))
    networks = zip(*sets, strict=True)
    return jnp.mean(jnp.stack([embedding_mmd(*pair) for pair in networks]))


@jax.jit
def _draw_gins(key: PRNGKeyArray) -> GIN:
    """Draws the parameters of `NUM_GINS` networks, stacked.

    Not by `vmap`: jaxlib 0.10 hands batched QR to a pool of threads and waits for it on a thread of
    that pool. Several at once have hung for good on two cores.
    """
    return jax.lax.map(init_gin, jax.random.split(key, NUM_GINS))


def _describe(graphs: Sequence[SceneGraph], gins: GIN, num_bins: int) -> Description:
    """Describes a set of host graphs, which has no order; one compilation a size bucket."""
    chunks = [
        _describe_chunk(members[start : start + GRAPHS_PER_CALL], capacity, gins, num_bins)
        for capacity, group in itertools.groupby(sorted(graphs, key=_node_capacity), _node_capacity)
        for members in [list(group)]
        for start in range(0, len(members), GRAPHS_PER_CALL)
    ]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *chunks)


def _describe_chunk(
    graphs: Sequence[SceneGraph], capacity: int, gins: GIN, num_bins: int
) -> Description:
    """Describes at most `GRAPHS_PER_CALL` graphs; graphs without nodes fill the call up."""
    described = _describe_stacked(*_stack(graphs, capacity), gins, num_bins)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(graphs)], described)


@partial(jax.jit, static_argnames="num_bins")
def _describe_stacked(
    adjacency: Bool[Array, "B N N"], mask: Bool[Array, "B N"], gins: GIN, num_bins: int
) -> Description:
    """Describes a stack of padded graphs, one after another."""

    def describe(graph: tuple[Bool[Array, "N N"], Bool[Array, " N"]]) -> Description:
        embedding = jax.vmap(gin_embedding, in_axes=(0, None, None))(gins, *graph)
        return Description(
            degree=degree_histogram(*graph, num_bins),
            clustering=clustering_histogram(*graph),
            spectrum=spectrum_histogram(*graph),
            # The order of nodes shows in the last digits. Bandwidths follow the distances, however
            # small: without rounding, two orders of one graph would be as far apart as two graphs.
            gin=embedding.astype(jnp.float32),
        )

    return jax.lax.map(describe, (adjacency, mask))


def _stack(graphs: Sequence[SceneGraph], capacity: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns bool[B, N, N] part-of adjacencies and bool[B, N] masks; B is `GRAPHS_PER_CALL`."""
    adjacency = np.zeros((GRAPHS_PER_CALL, capacity, capacity), bool)
    mask = np.zeros((GRAPHS_PER_CALL, capacity), bool)
    for links, real, graph in zip(adjacency, mask, graphs, strict=False):
        first, second = undirected_edges(graph, PART_OF).T
        links[first, second] = links[second, first] = True
        real[: len(graph.nodes.label)] = True
    return adjacency, mask


def _node_capacity(graph: SceneGraph) -> int:
    """Returns the bucket of a graph."""
    return bucket(len(graph.nodes.label)).nodes
