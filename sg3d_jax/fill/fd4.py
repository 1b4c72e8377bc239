"""FD4: topology by DiGress, distances by diffusion on the generated edges, centroids by MDS.

Source: paper, Sec. "Adapting D4".
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from sg3d_jax.diffusion.schedules import cosine
from sg3d_jax.fill import digress, distance
from sg3d_jax.fill.mds import recover_positions
from sg3d_jax.fill.protocol import Fill, Params, Statistics
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.graph_transformer import (
    DistanceNetwork,
    OldGraphEncoder,
    RectangleTransformer,
)
from sg3d_jax.scene.ontology import BUILDING
from sg3d_jax.scene.graph import SceneGraph
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
    kin: int = 0  # nearest nodes of its own concept that a room, floor or building hears of


def make_fd4(config: FD4Config, statistics: Statistics) -> Fill:
    """Builds the Fill model FD4.

    Args:
      config: sizes and steps.
      statistics: marginals and distance scale of the training set.
    """
    encoder = OldGraphEncoder(config.encoder_width, config.encoder_layers, config.gates, config.kin)
    topology = RectangleTransformer(
        config.node_width, config.pair_width, config.layers, config.heads, config.gates
    )
    lengths = DistanceNetwork(config.distance_width, config.distance_layers)
    schedule = cosine(config.diffusion_steps)

    def init(key: Key[Array, ""], graph: SceneGraph, block: Block) -> Params:
        keys = jax.random.split(key, 3)
        encoder_params = encoder.init(keys[0], graph)
        conditioning = apply(encoder, encoder_params, graph)
        time, edges = jnp.zeros(()), block.edges.astype(jnp.int32)
        inputs = conditioning, block.mask, block.label, edges, time
        return {
            "encoder": encoder_params,
            "topology": topology.init(keys[1], *inputs),
            "distance": lengths.init(
                keys[2], conditioning, block.label, block.edges, edges.astype(jnp.float32), time
            ),
        }

    def loss(
        params: Params, key: Key[Array, ""], graph: SceneGraph, block: Block
    ) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
        conditioning = apply(encoder, params["encoder"], graph)

        def at_one_level(key: Key[Array, ""]) -> dict[str, Float[Array, ""]]:
            key_topology, key_distance = jax.random.split(key)
            common = conditioning, block, schedule, statistics
            terms = digress.loss(topology, params["topology"], key_topology, *common)
            squared = distance.loss(lengths, params["distance"], key_distance, *common)
            return {**terms, "distance": squared}

        terms = jax.vmap(at_one_level)(jax.random.split(key, config.noise_levels))
        terms = {name: jnp.mean(values) for name, values in terms.items()}
        total = terms["label"] + digress.EDGE_WEIGHT * terms["edge"] + terms["distance"]
        return total, terms

    def sample(
        params: Params, key: Key[Array, ""], graph: SceneGraph, block_mask: Bool[Array, " M"]
    ) -> Block:
        key_topology, key_distance = jax.random.split(key)
        conditioning = apply(encoder, params["encoder"], graph)
        drawn = digress.sample(
            topology,
            params["topology"],
            key_topology,
            conditioning,
            block_mask,
            schedule,
            config.topology_steps,
            statistics,
        )
        edges = drawn.edges == 1
        metres = distance.sample(
            lengths,
            params["distance"],
            key_distance,
            conditioning,
            drawn.label,
            edges,
            schedule,
            config.distance_steps,
            statistics,
        )
        position = recover_positions(
            metres, edges, conditioning.surface, conditioning.mask, drawn.label >= BUILDING
        )
        label = jnp.where(block_mask, drawn.label, 0)
        return Block(label, jnp.where(block_mask[:, None], position, 0.0), edges, block_mask)

    return Fill(init, loss, sample)
