"""What every Fill model is, and what it must know of the data."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from sg3d_jax.fill.constraints import Rules
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import Ontology
from sg3d_jax.scene.padding import Block

Params = Any  # nested dictionaries of arrays
Terms = dict[str, Float[Array, ""]]  # of a loss, by name


class Marginals(NamedTuple):
    """What noise is drawn from."""

    label: Array  # float[C], of new labels; zero for concepts that are observed or do not occur
    block_edge: Array  # float[2], of {no edge, edge} inside a block
    cross_edge: Array  # float[2], between a block and the old graph


class Statistics(NamedTuple):
    """Noise distributions and scales of a training set: plain numbers, so that models hash.

    `train.statistics` counts them.
    """

    label: tuple[float, ...]  # [C], marginal of new labels
    block_edge: tuple[float, ...]  # [2], marginal of {no edge, edge} inside a block
    cross_edge: tuple[float, ...]  # [2], between a block and the old graph
    distance_mean: float  # metres, on new edges
    distance_std: float  # metres
    position_std: float  # metres a coordinate, of new nodes around the old graph's mean
    cross_degree: float = 0.0  # mean edges of a new node to the old graph

    @property
    def marginals(self) -> Marginals:
        """The marginals as arrays."""
        return Marginals(*(jnp.asarray(field, jnp.float32) for field in self[:3]))


@runtime_checkable
class Fill(Protocol):
    """A Fill model: three pure functions on one padded graph; `vmap` them for a batch.

    It is a frozen dataclass of what it is built from, so that two that are built alike are equal,
    hash alike, and compile once.
    """

    @property
    def ontology(self) -> Ontology:
        """The concepts of the graphs that it fills."""
        ...

    @property
    def kin(self) -> int:
        """The nearest kin that its encoder joins a node to (`nn.kin`); 0 if it has none."""
        ...

    def init(self, key: Key[Array, ""], graph: SceneGraph, block: Block) -> Params:
        """Draws initial parameters, given any graph and block of the shapes to come."""
        ...

    def loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph, block: Block
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the loss of a block given the old graph, and its terms; zero if it is empty."""
        ...

    def sample(
        self,
        params: Params,
        key: Key[Array, ""],
        graph: SceneGraph,
        block_mask: Bool[Array, " M"],
        rules: Rules | None = None,
    ) -> Block:
        """Draws a block of the places in the mask, given the old graph, within the rules.

        The mask of the block leaves out the nodes for which the rules leave no room.
        """
        ...


def cross_marginal(degree: float, old_mask: Bool[Array, " N"]) -> Float[Array, "2"]:
    """Returns the marginal of {no edge, edge} of a new node that has so many among the old ones.

    One chance for all sizes would hide four edges of a new node among thirty drawn ones in a city.
    """
    chance = jnp.clip(degree / jnp.maximum(jnp.sum(old_mask), 1), 1e-3, 0.5)
    return jnp.stack([1 - chance, chance])


def real_pairs(
    block_mask: Bool[Array, " M"], old_mask: Bool[Array, " N"]
) -> tuple[Bool[Array, "M M"], Bool[Array, "M N"]]:
    """Returns which pairs may carry an edge: inside the block (each pair once) and across."""
    once = jnp.tril(block_mask[:, None] & block_mask[None, :], -1)
    return once, block_mask[:, None] & old_mask[None, :]


def frame_centre(position: Float[Array, "N 3"], mask: Bool[Array, " N"]) -> Float[Array, "3"]:
    """Returns the mean position of the real nodes: c_{t-1}, the origin of MiDi's frame.

    Source: paper, Sec. "Adapting MiDi".
    """
    return jnp.sum(position * mask[:, None], axis=0) / jnp.maximum(jnp.sum(mask), 1)
