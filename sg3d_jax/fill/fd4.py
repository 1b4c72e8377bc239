"""FD4: topology by DiGress, distances by diffusion on the generated edges, centroids by MDS.

Source: paper, Sec. "Adapting D4".
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from sg3d_jax.diffusion.schedules import cosine
from sg3d_jax.fill import digress, distance
from sg3d_jax.fill.constraints import Rules
from sg3d_jax.fill.mds import recover_positions
from sg3d_jax.fill.protocol import Params, Statistics, Terms
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.graph_transformer import (
    DistanceNetwork,
    OldGraphEncoder,
    RectangleTransformer,
)
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, Ontology
from sg3d_jax.scene.padding import Block


@dataclasses.dataclass(frozen=True)
class FD4Config:
    """Sizes of the three networks, and the two diffusion processes."""

    encoder_width: int = 64
    encoder_layers: int = 3
    gates: int = 16  # channels in which rows are propagated along the old graph
    node_width: int = 64
    pair_width: int = 48
    layers: int = 4
    heads: int = 8
    distance_width: int = 48
    distance_layers: int = 2
    diffusion_steps: int = 500  # S, of the trained schedules
    noise_levels: int = 6  # diffusion times trained on one encoded graph
    topology_steps: int = 64  # sampling steps of stage one
    distance_steps: int = 8  # sampling steps of stage two
    kin: int = 0  # nearest nodes of its own concept that a node hears of


@dataclasses.dataclass(frozen=True)
class FD4:
    """The Fill model FD4.

    Attributes:
      config: sizes and steps.
      statistics: marginals and distance scale of the training set.
      ontology: the concepts.
    """

    config: FD4Config
    statistics: Statistics
    ontology: Ontology = PAPER_ONTOLOGY

    @property
    def kin(self) -> int:
        """The nearest kin that the encoder joins a node to."""
        return self.config.kin

    @property
    def encoder(self) -> OldGraphEncoder:
        """The encoder of the old graph."""
        config = self.config
        return OldGraphEncoder(
            config.encoder_width, config.encoder_layers, config.gates, config.kin
        )

    @property
    def topology(self) -> RectangleTransformer:
        """The denoiser of stage one."""
        config = self.config
        sizes = config.node_width, config.pair_width, config.layers, config.heads, config.gates
        return RectangleTransformer(*sizes, self.ontology.num_concepts)

    @property
    def lengths(self) -> DistanceNetwork:
        """The denoiser of stage two."""
        config = self.config
        return DistanceNetwork(
            config.distance_width, config.distance_layers, self.ontology.num_concepts
        )

    def init(self, key: Key[Array, ""], graph: SceneGraph, block: Block) -> Params:
        """Draws initial parameters."""
        keys = jax.random.split(key, 3)
        encoder_params = self.encoder.init(keys[0], graph)
        conditioning = apply(self.encoder, encoder_params, graph)
        time, edges = jnp.zeros(()), block.edges.astype(jnp.int32)
        inputs = conditioning, block.mask, block.label, edges, time
        return {
            "encoder": encoder_params,
            "topology": self.topology.init(keys[1], *inputs),
            "distance": self.lengths.init(
                keys[2], conditioning, block.label, block.edges, edges.astype(jnp.float32), time
            ),
        }

    def loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph, block: Block
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the sum of both stages' losses, a mean over diffusion times, and its terms."""
        conditioning = apply(self.encoder, params["encoder"], graph)
        schedule, marginals = cosine(self.config.diffusion_steps), self.statistics.marginals

        def at_one_level(key: Key[Array, ""]) -> Terms:
            key_topology, key_distance = jax.random.split(key)
            common = conditioning, block, schedule
            topology = self.topology, params["topology"], key_topology
            lengths = self.lengths, params["distance"], key_distance
            terms = digress.loss(*topology, *common, marginals)
            return {**terms, "distance": distance.loss(*lengths, *common, self.statistics)}

        terms = jax.vmap(at_one_level)(jax.random.split(key, self.config.noise_levels))
        terms = {name: jnp.mean(values) for name, values in terms.items()}
        total = terms["label"] + digress.EDGE_WEIGHT * terms["edge"] + terms["distance"]
        return total, terms

    def sample(
        self,
        params: Params,
        key: Key[Array, ""],
        graph: SceneGraph,
        block_mask: Bool[Array, " M"],
        rules: Rules | None = None,
    ) -> Block:
        """Draws a block: topology, then distances on its edges, then centroids that fit them."""
        config, schedule = self.config, cosine(self.config.diffusion_steps)
        key_topology, key_distance = jax.random.split(key)
        conditioning = apply(self.encoder, params["encoder"], graph)
        drawn, mask = digress.sample(
            self.topology,
            params["topology"],
            key_topology,
            conditioning,
            block_mask,
            schedule,
            config.topology_steps,
            self.statistics.marginals,
            rules,
        )
        edges = drawn.edges == 1
        metres = distance.sample(
            self.lengths,
            params["distance"],
            key_distance,
            conditioning,
            drawn.label,
            edges,
            schedule,
            config.distance_steps,
            self.statistics,
        )
        above = jnp.asarray(self.ontology.is_above)[drawn.label]
        old = conditioning.surface, conditioning.mask
        position = recover_positions(metres, edges, *old, above)
        label = jnp.where(mask, drawn.label, 0)
        return Block(label, jnp.where(mask[:, None], position, 0.0), edges, mask)
