"""One growth step and its loss: Insert, Fill and Halt put together.

Source: paper, Eq. (flagg_transition).
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from sg3d_jax.fill.protocol import Fill
from sg3d_jax.flagg.corrupt import CorruptionConfig, corrupt
from sg3d_jax.flagg.halt import Halt, draw_halt, halt_loss, make_halt
from sg3d_jax.flagg.insert import Insert, draw_size, insert_loss, make_insert
from sg3d_jax.flagg.ordering import Ordering
from sg3d_jax.flagg.removal import Cut, draw_continuations, draw_cut
from sg3d_jax.scene.ontology import CONCEPTS
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.padding import Block, append_block


@dataclasses.dataclass(frozen=True)
class FlaggConfig:
    """The removal process, the noise augmentation, and the sizes of Insert and Halt."""

    coins: tuple[int, ...] = (1, 4)  # block sizes
    ordering: Ordering = "H"
    layers: tuple[str, ...] = CONCEPTS  # sigma_C, the order in which concepts are inserted
    continuations: int = 1  # blocks that may come next, trained on one encoded graph
    corruption: CorruptionConfig = CorruptionConfig()
    width: int = 32  # of Insert and Halt
    depth: int = 2  # GINE layers of Insert and Halt
    halt_by_threshold: bool = True  # False: by a draw

    def __post_init__(self) -> None:
        """Refuses layers that are not an order of the concepts from the plane upwards."""
        if self.layers[:1] != ("plane",) or sorted(self.layers) != sorted(CONCEPTS):
            raise ValueError(
                f"flagg.layers must begin with 'plane' and name each of {', '.join(CONCEPTS)} "
                f"once, got {', '.join(self.layers)}"
            )
        if self.continuations < 1 or (self.continuations > 1 and self.ordering != "H"):
            raise ValueError(
                f"flagg.continuations is {self.continuations}, expected 1, or more in the order H: "
                "HP leaves one node that comes next"
            )


class Flagg(NamedTuple):
    """The three modules and what they share."""

    insert: Insert
    fill: Fill
    halt: Halt
    config: FlaggConfig


class Params(NamedTuple):
    """Parameters of the three modules; nothing else holds any."""

    insert: Any
    fill: Any
    halt: Any


def make_flagg(config: FlaggConfig, fill: Fill) -> Flagg:
    """Puts Insert and Halt around a Fill model."""
    return Flagg(
        insert=make_insert(config.width, config.depth, len(config.coins)),
        fill=fill,
        halt=make_halt(config.width, config.depth),
        config=config,
    )


def cut_graph(config: FlaggConfig, key: Key[Array, ""], graph: SceneGraph) -> Cut:
    """Cuts a complete padded graph at a random step of a random insertion sequence."""
    return draw_cut(graph, key, config.coins, config.ordering, config.layers)


def init(model: Flagg, key: Key[Array, ""], graph: SceneGraph) -> Params:
    """Draws initial parameters; `graph` is any padded graph."""
    keys = jax.random.split(key, 4)
    cut = cut_graph(model.config, keys[0], graph)
    return Params(
        insert=model.insert.init(keys[1], cut.survivors),
        fill=model.fill.init(keys[2], cut.survivors, cut.block),
        halt=model.halt.init(keys[3], cut.survivors),
    )


def loss(
    model: Flagg, params: Params, key: Key[Array, ""], graph: SceneGraph
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Returns the sum of all losses on one random cut of one complete graph, and its terms.

    All three modules see the perturbed conditioning graph; the clean block is the target.

    Source: FLAGG (one sum of the losses of all modules); paper, Sec. "Noise augmentation".
    """
    key_cut, key_corrupt, key_blocks, key_fill = jax.random.split(key, 4)
    config, number = model.config, model.config.continuations
    cut = cut_graph(config, key_cut, graph)
    old = corrupt(cut.survivors, key_corrupt, config.corruption)
    if number == 1:
        blocks = jax.tree.map(lambda leaf: leaf[None], cut.block)
    else:
        blocks = draw_continuations(graph, cut, key_blocks, number, config.layers)

    def fill(key: Key[Array, ""], block: Block) -> Any:  # encodes the old graph once under vmap
        return model.fill.loss(params.fill, key, old, block)

    losses = jax.vmap(fill)(jax.random.split(key_fill, number), blocks)
    fill_loss, terms = jax.tree.map(jnp.mean, losses)
    terms["insert"] = insert_loss(model.insert.logits(params.insert, old), cut.insert_probs)
    terms["halt"] = halt_loss(model.halt.logit(params.halt, old), cut.complete, cut.inserted)
    return fill_loss + terms["insert"] + terms["halt"], terms


class Growth(NamedTuple):
    """What one growth step leaves."""

    graph: SceneGraph
    halted: Array  # bool[], Halt's decision
    fits: Array  # bool[], whether the block had room; the graph is unchanged if not


def grow(model: Flagg, params: Params, key: Key[Array, ""], graph: SceneGraph) -> Growth:
    """Inserts one block into a padded graph and asks Halt.

    Source: paper, Eq. (flagg_transition).
    """
    key_insert, key_fill, key_halt = jax.random.split(key, 3)
    coins = model.config.coins
    size = draw_size(key_insert, model.insert.logits(params.insert, graph), coins)
    block_mask: Bool[Array, " M"] = jnp.arange(max(coins)) < size
    block: Block = model.fill.sample(params.fill, key_fill, graph, block_mask)
    grown, fits = append_block(graph, block)
    grown = jax.tree.map(lambda new, old: jnp.where(fits, new, old), grown, graph)
    logit = model.halt.logit(params.halt, grown)
    return Growth(grown, draw_halt(key_halt, logit, model.config.halt_by_threshold), fits)
