"""A Fill model without a network: it draws whatever the rules allow, and compiles quickly."""

import dataclasses
from typing import Any, Final

import jax
import jax.numpy as jnp

from sg3d_jax.fill.protocol import Statistics
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.padding import Block
from sg3d_jax.train.methods import register_fill

NAME: Final = "at-random"


@dataclasses.dataclass(frozen=True)
class AtRandomConfig:
    share: float = 0.3  # of the nodes that may be parts of a new one


@dataclasses.dataclass(frozen=True)
class AtRandom:
    config: AtRandomConfig
    statistics: Statistics
    ontology: Ontology
    kin: int = 0

    def init(self, key: jax.Array, graph: SceneGraph, block: Block) -> Any:
        return {"unused": jnp.zeros(1)}

    def loss(self, params: Any, key: jax.Array, graph: SceneGraph, block: Block) -> Any:
        return jnp.zeros(()), {}

    def sample(
        self, params: Any, key: jax.Array, graph: SceneGraph, mask: jax.Array, rules: Any = None
    ) -> Block:
        key_label, key_parts = jax.random.split(key)
        label = jax.random.categorical(key_label, jnp.where(rules.label, 0.0, -1e9))
        free = graph.nodes.mask & rules.part[label]
        drawn = jnp.where(free, jax.random.uniform(key_parts, free.shape), 2.0)
        parts = free & ((drawn < self.config.share) | (drawn == jnp.min(drawn)))
        position = jnp.sum(graph.nodes.position * parts[:, None], axis=0) / jnp.sum(parts)
        edges = jnp.concatenate([jnp.zeros(1, bool), parts])[None]
        return Block(label[None] * mask, position[None], edges & mask[:, None], mask)


def register() -> None:
    register_fill(NAME, AtRandomConfig, AtRandom)
