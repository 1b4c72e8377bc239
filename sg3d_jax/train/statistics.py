"""What a model must know of its training set before it is built."""

from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Array, Key

from sg3d_jax.fill.protocol import Statistics, count_statistics
from sg3d_jax.flagg.removal import Cut
from sg3d_jax.scene.graph import SceneGraph

CUTS_A_GRAPH = 16


def statistics_of(
    cut_graph: Callable[[Key[Array, ""], SceneGraph], Cut],
    stacks: Sequence[SceneGraph],
    cuts_a_graph: int = CUTS_A_GRAPH,
) -> Statistics:
    """Counts the statistics of a training set on fixed random cuts of every graph.

    Args:
      cut_graph: cuts one complete padded graph as in training.
      stacks: of padded graphs with proximity edges; each graph counts the same.
      cuts_a_graph: one is enough where every cut of a graph is the same.
    """

    def cut_all(graphs: SceneGraph, key: Key[Array, ""]) -> Statistics:
        def several(key: Key[Array, ""], graph: SceneGraph) -> object:
            keys = jax.random.split(key, cuts_a_graph)
            return jax.vmap(lambda key: cut_graph(key, graph))(keys)

        cuts = jax.vmap(several)(jax.random.split(key, graphs.n_node.shape[0]), graphs)
        return count_statistics(jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), cuts))

    keys = jax.random.split(jax.random.key(0), len(stacks))
    counted = [jax.jit(cut_all)(graphs, key) for graphs, key in zip(stacks, keys, strict=True)]
    shares = np.array([graphs.n_node.shape[0] for graphs in stacks], np.float32)
    shares /= shares.sum()
    return jax.tree.map(
        lambda *leaves: sum(share * leaf for share, leaf in zip(shares, leaves, strict=True)),
        *counted,
    )
