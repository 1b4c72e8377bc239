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
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.diffusion import gaussian
from sg3d_jax.diffusion.schedules import strided_times
from sg3d_jax.fill import digress, midi
from sg3d_jax.fill.midi import Frame, MiDiConfig, Schedules
from sg3d_jax.fill.protocol import Params, Statistics, frame_centre
from sg3d_jax.flagg.removal import one_shot_capacity, one_shot_cut
from sg3d_jax.flagg.grow import ONE_SHOT, Completion, Grown, complete_in_batches
from sg3d_jax.nn.apply import apply
from sg3d_jax.nn.graph_transformer import Conditioning, OldGraphEncoder
from sg3d_jax.scene.ontology import PLANE
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.padding import append_block, bucket, without_proximity
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


class MiDiOracle(NamedTuple):
    """The one-shot model: three pure functions on one padded graph.

    Attributes:
      init: (key, complete graph) -> params.
      loss: (params, key, complete graph) -> (loss, terms).
      sample: (params, key, planes, number of new nodes) -> the complete graph. The planes have room
        for what is to come, their edges are ignored, and they stay as they are, bit for bit.
    """

    init: Callable[[Key[Array, ""], SceneGraph], Params]
    loss: Callable[
        [Params, Key[Array, ""], SceneGraph],
        tuple[Float[Array, ""], dict[str, Float[Array, ""]]],
    ]
    sample: Callable[[Params, Key[Array, ""], SceneGraph, Int[Array, ""]], Grown]


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


def make_midi_oracle(config: MiDiOracleConfig, statistics: Statistics) -> MiDiOracle:
    """Builds the one-shot model.

    Args:
      config: sizes and steps.
      statistics: marginals and spread of positions, counted on one-shot cuts.
    """
    sizes = config.encoder_width, config.encoder_layers, config.gates
    encoder = OldGraphEncoder(*sizes, kin=config.kin, many_rows=True)
    network, schedules = midi.make_network(config), midi.make_schedules(config)

    def frame_of(planes: SceneGraph) -> Frame:
        centre = frame_centre(planes.nodes.position, planes.nodes.mask)
        return Frame(centre, statistics.position_std)

    def observe(
        params: Params,
        key: Key[Array, ""],
        planes: SceneGraph,
        frame: Frame,
        signal: Schedules,
    ) -> Conditioning:
        return apply(encoder, params["encoder"], inpaint(key, planes, frame, signal))

    def init(key: Key[Array, ""], graph: SceneGraph) -> Params:
        keys, cut = jax.random.split(key), one_shot_cut(graph)
        encoder_params = encoder.init(keys[0], cut.survivors)
        conditioning = apply(encoder, encoder_params, cut.survivors)
        block, centre = cut.block, frame_of(cut.survivors).centre
        inputs = block.mask, *digress.topology_of(block), block.position, jnp.zeros(())
        return {
            "encoder": encoder_params,
            "denoiser": network.init(keys[1], conditioning, centre, *inputs),
        }

    def loss(
        params: Params, key: Key[Array, ""], graph: SceneGraph
    ) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
        cut = one_shot_cut(graph)
        frame = frame_of(cut.survivors)

        def at_one_level(key: Key[Array, ""]) -> dict[str, Float[Array, ""]]:
            key_time, key_planes, key_noise = jax.random.split(key, 3)
            time = jax.random.randint(key_time, (), 1, config.diffusion_steps + 1)
            signal = schedules.at(time)
            conditioning = observe(params, key_planes, cut.survivors, frame, signal)
            inputs = conditioning, frame, cut.block, signal, time, statistics
            return midi.losses(network, params["denoiser"], key_noise, *inputs)

        terms = jax.vmap(at_one_level)(jax.random.split(key, config.noise_levels))
        terms = {name: jnp.mean(values) for name, values in terms.items()}
        return midi.total_loss(terms), terms

    def sample(
        params: Params, key: Key[Array, ""], planes: SceneGraph, num_new: Int[Array, ""]
    ) -> Grown:
        planes = connect_observed(planes)
        frame = frame_of(planes)
        block_mask = jnp.arange(one_shot_capacity(planes.nodes.mask.shape[0])) < num_new
        masks = block_mask, planes.nodes.mask
        num_draws = config.resamplings + 1

        def step(noisy: midi.State, inputs: tuple[Array, Array, Array]) -> tuple[midi.State, None]:
            key, now, then = inputs
            signal, signal_next = schedules.at(now), schedules.at(then)
            ratio = Schedules(*(low / high for low, high in zip(signal, signal_next, strict=True)))

            def draw(noisy: midi.State, key: Key[Array, ""]) -> tuple[midi.State, midi.State]:
                key_planes, key_draw, key_undo = jax.random.split(key, 3)
                conditioning = observe(params, key_planes, planes, frame, signal)
                known = conditioning, frame, block_mask
                predicted = midi.denoise(network, params["denoiser"], *known, noisy, signal, now)
                drawn = midi.reverse_step(
                    key_draw, noisy, predicted, signal_next, signal, *masks, statistics
                )
                return midi.add_noise(key_undo, drawn, ratio, *masks, statistics), drawn

            _, drawn = jax.lax.scan(draw, noisy, jax.random.split(key, num_draws))
            return jax.tree.map(lambda leaf: leaf[-1], drawn), None

        key_start, key_steps = jax.random.split(key)
        times = strided_times(config.diffusion_steps, config.sampling_steps)
        keys = jax.random.split(key_steps, config.sampling_steps)
        start = midi.draw_start(key_start, *masks, statistics)
        state, _ = jax.lax.scan(step, start, (keys, times[:-1], times[1:]))
        graph, _ = append_block(_with_room(planes), midi.to_block(state, frame, block_mask))
        return Grown(without_proximity(graph), jnp.asarray(ONE_SHOT), jnp.asarray(1))

    return MiDiOracle(init, loss, sample)


def _with_room(planes: SceneGraph) -> SceneGraph:
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


@functools.partial(jax.jit, static_argnums=0)
def _sample_batch(
    model: MiDiOracle,
    params: Params,
    keys: Key[Array, " B"],
    planes: SceneGraph,
    num_new: Int[Array, " B"],
) -> Grown:
    return jax.vmap(functools.partial(model.sample, params))(keys, planes, num_new)


def complete(
    model: MiDiOracle,
    params: Params,
    scenes: Sequence[SceneGraph],
    seed: int = 0,
    samples: int = 1,
) -> list[list[Completion]]:
    """Completes scene graphs from the planes of host graphs, in compiled batches.

    Args:
      model: the one-shot model.
      params: its parameters.
      scenes: complete host graphs; the oracle counts their high-level nodes, everything else but
        their planes is ignored.
      seed: with the position of a scene in `scenes` and the number of the sample, fixes it.
      samples: graphs a scene.

    Returns:
      For every scene, in order, its samples, with the halt reason "ONE_SHOT".

    Raises:
      ValueError: a scene has nothing beside its planes, so that there is no number to be told.
    """
    num_new = np.array([int(np.sum(scene.nodes.label != PLANE)) for scene in scenes])
    if not num_new.all():
        raise ValueError(
            f"scene {int(np.argmin(num_new))} has planes alone, expected a complete graph: "
            "MiDi+Or must be told how many nodes there are"
        )
    capacities = [
        bucket(max(len(scene.nodes.label), 2 * number))
        for scene, number in zip(scenes, num_new.tolist(), strict=True)
    ]

    def sample_lanes(keys: Key[Array, " B"], planes: SceneGraph, lanes: Sequence[int]) -> Grown:
        return _sample_batch(model, params, keys, planes, jnp.asarray(num_new[list(lanes)]))

    return complete_in_batches(sample_lanes, scenes, capacities, seed, samples)
