"""MiDi+Or: all high-level nodes at once, their number given by an oracle, planes by inpainting.

The denoiser is that of the Fill model MiDi, with every high-level node in its block. The planes are
inpainted: at every diffusion time their positions are the truth with the noise of that time, in
training as in sampling, and without noise at the end; a step may be undone and taken again, so that
what is new and what is known come to agree.

Source: paper, Sec. "One-shot generation of 3DSGs"; RePaint (Lugmayr et al. 2022).
Differs: RePaint inpaints with a model of whole images, whose guess of the known part is thrown
away; we do not compute that guess, and learn no density of planes. Normals, widths and proximity
edges of the planes are clean: nothing is diffused but labels, edges and positions.
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.diffusion import gaussian
from sg3d_jax.diffusion.sampler import ancestral_sample
from sg3d_jax.fill import digress, midi
from sg3d_jax.fill.constraints import rules_of
from sg3d_jax.fill.midi import Frame, MiDiConfig, Schedules
from sg3d_jax.fill.protocol import Params, Statistics, Terms
from sg3d_jax.flagg.grow import ONE_SHOT, Grown
from sg3d_jax.flagg.removal import Cut, extract_block, keep_nodes
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.graph_transformer import Conditioning, OldGraphEncoder
from sg3d_jax.nn.relaxed_egnn import RelaxedTransformer
from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, Ontology
from sg3d_jax.scene.padding import Capacity, append_block, bucket, without_proximity
from sg3d_jax.scene.proximity import connect_observed


@dataclasses.dataclass(frozen=True)
class MiDiOracleConfig(MiDiConfig):
    """The numbers of MiDi, and how often a sampling step is undone and taken again.

    At the same cost, many draws of few steps do better than one of many: on 80 validation floors of
    S-F, 64 steps drawn once give FGW 0.040, and drawn twice 0.023; 32 steps drawn four times 0.017,
    16 steps drawn eight times 0.015.
    """

    sampling_steps: int = 16
    resamplings: int = 7


def inpaint(key: Key[Array, ""], planes: SceneGraph, frame: Frame, signal: Schedules) -> SceneGraph:
    """Replaces the positions of the planes by what the noise of one diffusion time leaves of them.

    As those of new nodes, they are shown to the network as signal x noisy position.

    Source: RePaint, Eq. for x^known.
    """
    clean = frame.to_unit(planes.nodes.position)
    noise = jax.random.normal(key, clean.shape)
    noisy = gaussian.add_noise(noise, clean, signal.position)
    position = frame.to_metres(signal.position * noisy)
    return planes._replace(nodes=planes.nodes._replace(position=position))


@dataclasses.dataclass(frozen=True)
class MiDiOracle:
    """The one-shot model.

    Attributes:
      config: sizes and steps.
      statistics: marginals and spread of positions, counted on one-shot cuts.
      ontology: the concepts.
    """

    config: MiDiOracleConfig
    statistics: Statistics
    ontology: Ontology = PAPER_ONTOLOGY

    @property
    def encoder(self) -> OldGraphEncoder:
        """The encoder of the planes."""
        config = self.config
        sizes = config.encoder_width, config.encoder_layers, config.gates
        return OldGraphEncoder(*sizes, kin=config.kin, many_rows=True)

    @property
    def network(self) -> RelaxedTransformer:
        """The denoiser."""
        return midi.make_network(self.config, self.ontology)

    def init(self, key: Key[Array, ""], graph: SceneGraph) -> Params:
        """Draws initial parameters, given any complete padded graph."""
        keys, cut = jax.random.split(key), one_shot_cut(graph)
        encoder_params = self.encoder.init(keys[0], cut.survivors)
        conditioning = apply(self.encoder, encoder_params, cut.survivors)
        block, centre = cut.block, midi.frame_of(cut.survivors, self.statistics).centre
        inputs = block.mask, *digress.topology_of(block), block.position, jnp.zeros(())
        return {
            "encoder": encoder_params,
            "denoiser": self.network.init(keys[1], conditioning, centre, *inputs),
        }

    def loss(
        self, params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], Terms]:
        """Returns the loss on one complete padded graph with proximity edges, and its terms."""
        cut, schedules = one_shot_cut(graph), midi.make_schedules(self.config)
        frame = midi.frame_of(cut.survivors, self.statistics)

        def at_one_level(key: Key[Array, ""]) -> Terms:
            key_time, key_planes, key_noise = jax.random.split(key, 3)
            time = jax.random.randint(key_time, (), 1, self.config.diffusion_steps + 1)
            signal = schedules.at(time)
            conditioning = self._observe(params, key_planes, cut.survivors, frame, signal)
            inputs = conditioning, frame, cut.block, signal, time, self.statistics.marginals
            return midi.losses(self.network, params["denoiser"], key_noise, *inputs)

        terms = jax.vmap(at_one_level)(jax.random.split(key, self.config.noise_levels))
        terms = {name: jnp.mean(values) for name, values in terms.items()}
        return midi.total_loss(terms), terms

    def sample(
        self, params: Params, key: Key[Array, ""], planes: PackedGraph, num_new: Int[Array, ""]
    ) -> Grown:
        """Draws the complete graph of planes and so many new nodes.

        Args:
          params: parameters.
          key: of all that is drawn.
          planes: packed, with room for what is to come; their edges are ignored, and they stay as
            they are, bit for bit.
          num_new: how many nodes there are beside the planes.
        """
        planes = connect_observed(planes)
        frame, schedules = midi.frame_of(planes, self.statistics), midi.make_schedules(self.config)
        block_mask = jnp.arange(one_shot_capacity(planes.nodes.mask.shape[0])) < num_new
        masks, marginals = (block_mask, planes.nodes.mask), self.statistics.marginals
        rules = rules_of(planes, block_mask.shape[0], last=True)
        num_draws = self.config.resamplings + 1
        Known = tuple[midi.State, digress.Logits]

        def step(key: Array, state: Known, now: Array, then: Array) -> Known:
            signal, signal_next = schedules.at(now), schedules.at(then)
            ratio = Schedules(*(low / high for low, high in zip(signal, signal_next, strict=True)))

            def draw(noisy: midi.State, key: Key[Array, ""]) -> tuple[midi.State, Known]:
                key_planes, key_draw, key_undo = jax.random.split(key, 3)
                known = self._observe(params, key_planes, planes, frame, signal), frame, block_mask
                predicted = midi.denoise(
                    self.network, params["denoiser"], *known, noisy, signal, now
                )
                drawn = midi.reverse_step(
                    key_draw, noisy, predicted, signal_next, signal, *masks, marginals, rules
                )
                undone = midi.add_noise(key_undo, drawn, ratio, *masks, marginals)
                return undone, (drawn, predicted[:2])

            _, drawn = jax.lax.scan(draw, state[0], jax.random.split(key, num_draws))
            return jax.tree.map(lambda leaf: leaf[-1], drawn)

        key_start, key_steps, key_last = jax.random.split(key, 3)
        nothing = digress.no_logits(*masks, self.ontology.num_concepts)
        start = midi.draw_start(key_start, *masks, marginals), nothing
        times = self.config.diffusion_steps, self.config.sampling_steps
        state, logits = ancestral_sample(step, start, key_steps, *times)
        topology, mask = digress.settled(key_last, state.topology, logits, block_mask, rules)
        block = midi.to_block(midi.State(topology, state.position), frame, mask)
        graph, _ = append_block(_with_room(planes), block)
        return Grown(without_proximity(graph), jnp.asarray(ONE_SHOT), jnp.asarray(1))

    def _observe(
        self,
        params: Params,
        key: Key[Array, ""],
        planes: SceneGraph,
        frame: Frame,
        signal: Schedules,
    ) -> Conditioning:
        return apply(self.encoder, params["encoder"], inpaint(key, planes, frame, signal))

    def capacity(self, num_observed: int, num_missing: int) -> Capacity:
        """Returns the bucket of a scene: its new nodes take at most half of it.

        Raises:
          ValueError: there is nothing beside the planes, so that there is no number to be told.
        """
        if not num_missing:
            raise ValueError(
                "has planes alone, expected a complete graph: MiDi+Or must be told how many nodes "
                "there are"
            )
        return bucket(max(num_observed + num_missing, 2 * num_missing))

    @functools.partial(jax.jit, static_argnums=0)
    def complete_lanes(
        self,
        params: Params,
        keys: Key[Array, " B"],
        given: PackedGraph,
        num_missing: Int[Array, " B"],
    ) -> Grown:
        """Completes a stack of planes, each told how many nodes are missing."""
        return jax.vmap(functools.partial(self.sample, params))(keys, given, num_missing)


def one_shot_cut(graph: SceneGraph) -> Cut:
    """Cuts a complete graph down to its planes: all other nodes are one block, in their order.

    Args:
      graph: padded and complete, `N` nodes of capacity.

    Returns:
      The cut; its block has room for `one_shot_capacity(N)` nodes. See `check_one_shot`.

    Source: FLAGG's one-shot schedule, T = 1.
    """
    nodes = graph.nodes
    high = nodes.mask & ~nodes.observed
    num_nodes, num_high = nodes.mask.shape[0], jnp.sum(high, dtype=jnp.int32)
    rank = jnp.where(high, jnp.cumsum(high, dtype=jnp.int32) - 1, -1)
    rank = jnp.where(nodes.mask, rank, num_nodes)
    capacity = one_shot_capacity(num_nodes)
    return Cut(
        survivors=keep_nodes(graph, rank < 0),
        block=extract_block(graph, rank, jnp.asarray(0), num_high, capacity),
        insert_probs=jnp.ones(1),
        complete=num_high == 0,
        has_block=num_high > 0,
        inserted=jnp.asarray(False),
    )


def one_shot_capacity(num_nodes: int) -> int:
    """Returns the room for new nodes in a graph of N slots: half of it, the rest is planes."""
    return num_nodes // 2


def check_one_shot(stacks: Sequence[SceneGraph]) -> None:
    """Refuses stacks of padded graphs that have no room for their other nodes in one block.

    Raises:
      ValueError: one sentence with the numbers, and what to change.
    """
    for graphs in stacks:
        nodes, room = graphs.nodes, one_shot_capacity(graphs.nodes.mask.shape[-1])
        most = int(jnp.max(jnp.sum(nodes.mask & ~nodes.observed, axis=-1)))
        if most > room:
            raise ValueError(
                f"a graph in the bucket of {nodes.mask.shape[-1]} nodes has {most} that are not "
                f"planes, expected at most {room}: leave this bucket out of capacities"
            )


def _with_room(planes: PackedGraph) -> PackedGraph:
    """Appends slots for every edge that a block can have, so that none is lost."""
    num_nodes = planes.nodes.mask.shape[0]
    num_block = one_shot_capacity(num_nodes)
    slots = num_block * (num_block + 2 * num_nodes)

    def widen(array: Array) -> Array:
        return jnp.pad(array, (0, slots))

    return planes._replace(
        edges=jax.tree.map(widen, planes.edges),
        senders=widen(planes.senders),
        receivers=widen(planes.receivers),
        n_edge=planes.n_edge + jnp.asarray([0, slots]),
    )
