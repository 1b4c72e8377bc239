"""What kind the grown nodes of complete graphs are of, with a probability for each kind."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.compiled import Compiled, in_32_bits
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.lanes import Model, padded_around
from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.scene.proximity import connect_observed


def chances_of_kinds(
    model: Model, params: Params, graph: SceneGraph, num_given: int
) -> np.ndarray | None:
    """Returns how likely each kind is for the grown nodes of a complete graph.

    Args:
      model: that grew it.
      params: its parameters.
      graph: host graph, over the pieces of what is observed.
      num_given: how many of its first nodes were given.

    Returns:
      float64[grown, K]: columns are the kinds of a node's concept, and zero beyond them. None if
      the model tells no kinds.
    """
    if not isinstance(model, Flagg) or model.kinds is None:
        return None
    packed, _ = padded_around(graph)
    chances = np.asarray(_chances(model, params, packed), np.float64)
    return chances[num_given : len(graph.nodes.label)]


def with_kinds(graph: SceneGraph, chances: np.ndarray) -> SceneGraph:
    """Returns a host graph whose last nodes have their likeliest kinds.

    Args:
      graph: unpadded.
      chances: of `chances_of_kinds`.
    """
    first = len(graph.nodes.label) - len(chances)
    kind = np.where(chances.any(axis=1), 1.0 + chances.argmax(axis=1), 0.0)
    kinds = np.concatenate([graph.nodes.kind[:first], kind])
    return graph._replace(nodes=graph.nodes._replace(kind=kinds))


@functools.partial(Compiled, static_argnames=("model",))
def _chances(model: Flagg, params: Params, graph: PackedGraph) -> Float[Array, "N K"]:
    """Returns the probabilities of the kinds of each node; zero where a concept has none."""
    assert model.kinds is not None
    graph = connect_observed(in_32_bits(graph))
    has_any = jnp.asarray(model.ontology.num_kinds)[graph.nodes.label] > 0
    logits = model.kinds.logits(params.kinds, graph)
    chances = jax.nn.softmax(jnp.where(has_any[:, None], logits, 0.0))
    return jnp.where((has_any & graph.nodes.mask)[:, None], chances, 0.0)
