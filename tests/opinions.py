"""Fill models whose networks are small: they predict anything, by what they see of a node alone."""

import jax.numpy as jnp
from flax import linen as nn

from sg3d_jax.fill.fd4 import FD4
from sg3d_jax.fill.midi import MiDi
from sg3d_jax.nn.embed import surface_of
from sg3d_jax.nn.graph_transformer import (
    Conditioning,
    DistanceNetwork,
    OldGraphEncoder,
    RectangleTransformer,
)
from sg3d_jax.nn.relaxed_egnn import RelaxedTransformer
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from tests.two_rooms import NO_GATES

NUM_CONCEPTS = PAPER_ONTOLOGY.num_concepts


class Blind(OldGraphEncoder):
    """An encoder that tells of a graph what is no matter of learning."""

    def __call__(self, graph):
        return Conditioning(jnp.zeros(0), NO_GATES, surface_of(graph.nodes), graph.nodes.mask)


def opinions(network, label, edges):
    """Returns logits by the noisy label of a node and the noisy pair, as parameters say."""
    by_label = network.param("label", nn.initializers.normal(2), (NUM_CONCEPTS, NUM_CONCEPTS))
    by_pair = network.param("pair", nn.initializers.normal(2), (NUM_CONCEPTS, 2, 2))
    return 5 * by_label[label], 5 * by_pair[label[:, None], edges]


class Opinions(RelaxedTransformer):
    """The denoiser of MiDi."""

    @nn.compact
    def __call__(self, conditioning, centre, block_mask, label, edges, position, time):
        return *opinions(self, label, edges), position


class TopologyOpinions(RectangleTransformer):
    """The denoiser of the topology of FD4."""

    @nn.compact
    def __call__(self, conditioning, block_mask, label, edges, time):
        return opinions(self, label, edges)


class SeenDistances(DistanceNetwork):
    """The denoiser of the distances of FD4."""

    def __call__(self, conditioning, label, edges, distance, time):
        return distance


class OpinionatedMiDi(MiDi):
    """MiDi with such networks."""

    encoder = Blind(8, 1, 2)
    network = Opinions(8, 8, 1, 2, 2, NUM_CONCEPTS)


class OpinionatedFD4(FD4):
    """FD4 with such networks."""

    encoder = Blind(8, 1, 2)
    topology = TopologyOpinions(8, 8, 1, 2, 2, NUM_CONCEPTS)
    lengths = SeenDistances(8, 1, NUM_CONCEPTS)
