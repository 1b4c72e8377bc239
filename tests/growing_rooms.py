"""A model that grows rooms without networks: how growing goes, whatever a model has learnt."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from sg3d_jax.fill.protocol import Fill
from sg3d_jax.flagg.halt import Halt
from sg3d_jax.flagg.insert import Insert
from sg3d_jax.flagg.step import Flagg, FlaggConfig, Params
from sg3d_jax.scene.graph import PackedGraph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, ROOM, WALL, Ontology
from sg3d_jax.scene.padding import Block


@dataclasses.dataclass(frozen=True)
class AddRooms:
    """Fills a block with rooms of the first planes, anywhere within a metre of the origin."""

    label: int = ROOM  # or with nodes of another concept
    planes: int = 2  # of each
    ontology: Ontology = PAPER_ONTOLOGY
    kin: int = 8  # a room more than a third of the slots does not fit

    def init(self, key: jax.Array, graph: PackedGraph, block: Block) -> None:
        return None

    def loss(self, params: Any, key: jax.Array, graph: PackedGraph, block: Block) -> Any:
        return jnp.float32(0), {}

    def sample(
        self, params: Any, key: jax.Array, graph: PackedGraph, mask: jax.Array, rules: Any = None
    ) -> Block:
        num_block, num_old = mask.shape[0], graph.nodes.mask.shape[0]
        edges = jnp.zeros((num_block, num_block + num_old), bool)
        parts = self.parts(jax.random.fold_in(key, 1), num_block, graph)
        edges = edges.at[:, num_block:].set(mask[:, None] & parts)
        position = jax.random.uniform(key, (num_block, 3), minval=-1.0) * mask[:, None]
        return Block(jnp.where(mask, self.label, 0), position, edges, mask)

    def parts(self, key: jax.Array, num_block: int, graph: PackedGraph) -> jax.Array:
        return jnp.zeros((num_block, len(graph.nodes.mask)), bool).at[:, : self.planes].set(True)


@dataclasses.dataclass(frozen=True)
class AddWalls(AddRooms):
    """Fills a block with walls of any planes, hardly ever the same ones again."""

    label: int = WALL

    def parts(self, key: jax.Array, num_block: int, graph: PackedGraph) -> jax.Array:
        planes = graph.nodes.mask & graph.nodes.observed
        drawn = jax.random.randint(key, (num_block, 1), 0, 2**20)  # the same with any padding
        return ((drawn >> jnp.arange(len(planes))[None]) % 2 == 1) & planes[None]


@dataclasses.dataclass(frozen=True)
class Even(Insert):
    """Inserts blocks of every size equally often."""

    def logits(self, params, graph):
        return jnp.zeros(self.num_coins)


@dataclasses.dataclass(frozen=True)
class Counting(Halt):
    """Halts at a number of nodes: its parameter."""

    def logit(self, params, graph):
        return (graph.n_node[0] - params + 0.5).astype(jnp.float32)


def grows_rooms(*coins: int, fill: Fill = AddRooms()) -> Flagg:
    """Returns a model of which nothing is learnt."""
    return Flagg(
        FlaggConfig(coins=coins, constrained=False), Even(1, 1, len(coins)), fill, Counting(1, 1)
    )


MODEL, ONE_BY_ONE = grows_rooms(1, 2), grows_rooms(1)


def stop_at(num_nodes: int) -> Params:
    """Returns the parameters of a model that finds a graph complete from so many nodes on."""
    return Params(None, None, jnp.float32(num_nodes))


NEVER = stop_at(10**6)
