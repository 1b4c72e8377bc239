"""MiDi: labels, edges and centroids of a block denoised together, in the frame of the old graph.

Source: paper, Sec. "Adapting MiDi", Eq. (midi_transition); MiDi.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from sg3d_jax.diffusion import gaussian
from sg3d_jax.diffusion.sampler import ancestral_sample
from sg3d_jax.diffusion.schedules import cosine
from sg3d_jax.fill import digress
from sg3d_jax.fill.constraints import Rules
from sg3d_jax.fill.digress import Levels, Logits, Topology
from sg3d_jax.fill.protocol import (
    Marginals,
    Params,
    Statistics,
    Terms,
    cross_marginal,
    frame_centre,
)
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.graph_transformer import Conditioning, OldGraphEncoder
from sg3d_jax.nn.relaxed_egnn import RelaxedTransformer
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, Ontology
from sg3d_jax.scene.padding import Block

EDGE_WEIGHT = 5.0
MAX_SIGNAL_TO_NOISE = 20.0
LEAST_SCALE = 0.5  # metres, of the frame of a scene


@dataclasses.dataclass(frozen=True)
class MiDiConfig:
    """Sizes of the two networks, and the diffusion process."""

    encoder_width: int = 64
    encoder_layers: int = 3
    gates: int = 16  # channels in which rows are propagated along the old graph
    node_width: int = 64
    pair_width: int = 48
    layers: int = 4
    heads: int = 8
    kin: int = 0  # nearest nodes of its own concept that a node hears of
    contacts: int = 0  # observed nodes that one hears of because their extents come close
    scene_scale: bool = False  # noise as wide as the scene, and its edges as many in every one
    diffusion_steps: int = 500  # S, of the trained schedules
    position_exponent: float = 2.5  # nu of the schedules: positions settle first,
    edge_exponent: float = 1.5  # then edges,
    label_exponent: float = 1.0  # then labels
    noise_levels: int = 6  # diffusion times trained on one encoded graph
    sampling_steps: int = 64


class Schedules(NamedTuple):
    """Signal levels at times 0..S, or at one of them."""

    position: Array  # float[S + 1]
    edge: Array  # float[S + 1]
    label: Array  # float[S + 1]

    def at(self, time: Int[Array, ""]) -> "Schedules":
        """Returns the levels at one time."""
        return Schedules(*(levels[time] for levels in self))

    @property
    def topology(self) -> Levels:
        """The levels of labels and edges."""
        return Levels(self.label, self.edge)


class State(NamedTuple):
    """A block as it is denoised."""

    topology: Topology  # labels and edges
    position: Array  # float[M, 3], in the frame of the old graph, of about unit spread


class Frame(NamedTuple):
    """Where the unit of positions lies in the scene."""

    centre: Array  # float[3], metres
    scale: Array  # float[], metres

    def to_unit(self, position: Float[Array, "M 3"]) -> Float[Array, "M 3"]:
        """Moves metres into the frame."""
        return (position - self.centre[None]) / self.scale

    def to_metres(self, position: Float[Array, "M 3"]) -> Float[Array, "M 3"]:
        """Moves positions out of the frame."""
        return position * self.scale + self.centre[None]


def make_schedules(config: MiDiConfig) -> Schedules:
    """Returns the schedules of a configuration."""
    exponents = config.position_exponent, config.edge_exponent, config.label_exponent
    return Schedules(*(cosine(config.diffusion_steps, exponent) for exponent in exponents))


def make_network(config: MiDiConfig, ontology: Ontology) -> RelaxedTransformer:
    """Returns the denoiser of a configuration."""
    sizes = config.node_width, config.pair_width, config.layers, config.heads, config.gates
    return RelaxedTransformer(*sizes, ontology.num_concepts)


def frame_of(graph: SceneGraph, statistics: Statistics) -> Frame:
    """Returns the frame of an old graph: its mean, and the spread of new nodes around it."""
    centre = frame_centre(graph.nodes.position, graph.nodes.mask)
    return Frame(centre, jnp.asarray(statistics.position_std, jnp.float32))


def scene_frame(graph: SceneGraph) -> Frame:
    """Returns the frame of an old graph of any size: its mean, and the spread of its nodes."""
    position, mask = graph.nodes.position, graph.nodes.mask
    centre = frame_centre(position, mask)
    squared = jnp.sum((position - centre[None]) ** 2 * mask[:, None])
    spread = jnp.sqrt(squared / (3 * jnp.maximum(jnp.sum(mask), 1)) + LEAST_SCALE**2)
    return Frame(centre, spread)


def state_of(block: Block, frame: Frame) -> State:
    """Returns the clean state of a block."""
    return State(digress.topology_of(block), frame.to_unit(block.position))


def add_noise(
    key: Key[Array, ""],
    state: State,
    signal: Schedules,
    block_mask: Bool[Array, " M"],
    old_mask: Bool[Array, " N"],
    marginals: Marginals,
) -> State:
    """Draws a noisier state: from a clean one, that of the time at which signals are such.

    The noise of positions has no centre of mass removed: the frame is that of the old graph.
    """
    key_topology, key_position = jax.random.split(key)
    noise = jax.random.normal(key_position, state.position.shape)
    masks = block_mask, old_mask
    return State(
        topology=digress.add_noise(
            key_topology, state.topology, signal.topology, *masks, marginals
        ),
        position=gaussian.add_noise(noise, state.position, signal.position),
    )


def denoise(
    network: RelaxedTransformer,
    params: Params,
    conditioning: Conditioning,
    frame: Frame,
    block_mask: Bool[Array, " M"],
    noisy: State,
    signal: Schedules,
    time: Int[Array, ""],
) -> tuple[Float[Array, "M C"], Float[Array, "M tokens 2"], Float[Array, "M 3"]]:
    """Predicts the clean block: logits of labels and edges, and positions in the frame.

    The network starts from signal x noisy position, the best guess without looking at anything.
    """
    guess = frame.to_metres(signal.position * noisy.position)
    inputs = conditioning, frame.centre, block_mask, *noisy.topology, guess
    label, edge, position = apply(network, params, *inputs, time.astype(jnp.float32))
    return label, edge, frame.to_unit(position)


def losses(
    network: RelaxedTransformer,
    params: Params,
    key: Key[Array, ""],
    conditioning: Conditioning,
    frame: Frame,
    block: Block,
    signal: Schedules,
    time: Int[Array, ""],
    marginals: Marginals,
) -> Terms:
    """Returns the terms of the loss at one diffusion time; all zero for an empty block.

    Source: MiDi (cross-entropies, and the squared error of clean positions).
    Differs: squared errors are weighted by their signal-to-noise ratio, at most
    `MAX_SIGNAL_TO_NOISE`, as min-SNR does (Hang et al. 2023): what is lost in noise has no say.
    """
    masks = block.mask, conditioning.mask
    noisy = add_noise(key, state_of(block, frame), signal, *masks, marginals)
    label, edge, position = denoise(
        network, params, conditioning, frame, block.mask, noisy, signal, time
    )
    variance = 1 - signal.position**2
    weight = jnp.minimum(signal.position**2 / jnp.maximum(variance, 1e-6), MAX_SIGNAL_TO_NOISE)
    squared = jnp.sum((position - frame.to_unit(block.position)) ** 2, axis=-1) * block.mask
    mean = jnp.sum(squared) / jnp.maximum(3 * jnp.sum(block.mask), 1)
    terms = digress.cross_entropies(label, edge, block, conditioning.mask)
    return {**terms, "position": weight * mean}


def total_loss(terms: Terms) -> Float[Array, ""]:
    """Returns the weighted sum of the terms of `losses`."""
    return terms["label"] + EDGE_WEIGHT * terms["edge"] + terms["position"]


def draw_start(
    key: Key[Array, ""],
    block_mask: Bool[Array, " M"],
    old_mask: Bool[Array, " N"],
    marginals: Marginals,
) -> State:
    """Draws pure noise."""
    key_topology, key_position = jax.random.split(key)
    return State(
        topology=digress.draw_start(key_topology, block_mask, old_mask, marginals),
        position=jax.random.normal(key_position, (block_mask.shape[0], 3)),
    )


def reverse_step(
    key: Key[Array, ""],
    noisy: State,
    predicted: tuple[Float[Array, "M C"], Float[Array, "M tokens 2"], Float[Array, "M 3"]],
    signal_next: Schedules,
    signal_now: Schedules,
    block_mask: Bool[Array, " M"],
    old_mask: Bool[Array, " N"],
    marginals: Marginals,
    rules: Rules | None = None,
) -> State:
    """Draws the block at an earlier diffusion time, given the prediction of the clean one.

    Source: paper, Eq. (midi_transition).
    """
    key_topology, key_position = jax.random.split(key)
    logits_label, logits_edge, position = predicted
    noise = jax.random.normal(key_position, position.shape)
    levels = signal_next.topology, signal_now.topology
    masks = block_mask, old_mask
    return State(
        topology=digress.reverse_step(
            key_topology,
            noisy.topology,
            logits_label,
            logits_edge,
            *levels,
            *masks,
            marginals,
            rules,
        ),
        position=gaussian.reverse_step(
            noise, position, noisy.position, signal_next.position, signal_now.position
        ),
    )


def to_block(state: State, frame: Frame, block_mask: Bool[Array, " M"]) -> Block:
    """Returns the denoised block, with c_{t-1} added back."""
    return Block(
        label=jnp.where(block_mask, state.topology.label, 0),
        position=jnp.where(block_mask[:, None], frame.to_metres(state.position), 0.0),
        edges=state.topology.edges == 1,
        mask=block_mask,
    )


@dataclasses.dataclass(frozen=True)
class MiDi:
    """The Fill model MiDi.

    Attributes:
      config: sizes and steps.
      statistics: marginals and spread of positions of the training set.
      ontology: the concepts.
    """

    config: MiDiConfig
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
        sizes = config.encoder_width, config.encoder_layers, config.gates
        return OldGraphEncoder(*sizes, kin=config.kin, contacts=config.contacts)

    @property
    def network(self) -> RelaxedTransformer:
        """The denoiser."""
        return make_network(self.config, self.ontology)

    def prior(self, graph: SceneGraph) -> tuple[Frame, Marginals]:
        """Returns where noise is drawn in a scene, and how: as in training, or by its size."""
        marginals = self.statistics.marginals
        if not self.config.scene_scale:
            return frame_of(graph, self.statistics), marginals
        cross = cross_marginal(self.statistics.cross_degree, graph.nodes.mask)
        return scene_frame(graph), marginals._replace(cross_edge=cross)

    def init(self, key: Key[Array, ""], graph: SceneGraph, block: Block) -> Params:
        """Draws initial parameters."""
        keys = jax.random.split(key)
        encoder_params = self.encoder.init(keys[0], graph)
        conditioning = apply(self.encoder, encoder_params, graph)
        centre = frame_of(graph, self.statistics).centre
        inputs = block.mask, *digress.topology_of(block), block.position, jnp.zeros(())
        return {
            "encoder": encoder_params,
            "denoiser": self.network.init(keys[1], conditioning, centre, *inputs),
        }

    def loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph, block: Block
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the weighted sum of `losses`, a mean over diffusion times, and its terms."""
        conditioning = apply(self.encoder, params["encoder"], graph)
        schedules = make_schedules(self.config)
        frame, marginals = self.prior(graph)

        def at_one_level(key: Key[Array, ""]) -> Terms:
            key_time, key_noise = jax.random.split(key)
            time = jax.random.randint(key_time, (), 1, self.config.diffusion_steps + 1)
            inputs = conditioning, frame, block, schedules.at(time), time, marginals
            return losses(self.network, params["denoiser"], key_noise, *inputs)

        terms = jax.vmap(at_one_level)(jax.random.split(key, self.config.noise_levels))
        terms = {name: jnp.mean(values) for name, values in terms.items()}
        return total_loss(terms), terms

    def sample(
        self,
        params: Params,
        key: Key[Array, ""],
        graph: SceneGraph,
        block_mask: Bool[Array, " M"],
        rules: Rules | None = None,
    ) -> Block:
        """Draws a block, all of it at once, in the frame of the old graph."""
        conditioning = apply(self.encoder, params["encoder"], graph)
        schedules = make_schedules(self.config)
        frame, marginals = self.prior(graph)
        masks = block_mask, conditioning.mask
        key_start, key_steps, key_last = jax.random.split(key, 3)

        def step(
            key: Array, state: tuple[State, Logits], now: Array, then: Array
        ) -> tuple[State, Logits]:
            noisy, _ = state
            signal = schedules.at(now)
            known = conditioning, frame, block_mask
            predicted = denoise(self.network, params["denoiser"], *known, noisy, signal, now)
            levels = schedules.at(then), signal
            drawn = reverse_step(key, noisy, predicted, *levels, *masks, marginals, rules)
            return drawn, predicted[:2]

        nothing = digress.no_logits(*masks, self.ontology.num_concepts)
        start = draw_start(key_start, *masks, marginals), nothing
        times = self.config.diffusion_steps, self.config.sampling_steps
        state, logits = ancestral_sample(step, start, key_steps, *times)
        topology, mask = digress.settled(key_last, state.topology, logits, block_mask, rules)
        return to_block(State(topology, state.position), frame, mask)
