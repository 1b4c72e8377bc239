"""The training state and one pure training step, scanned several times a compiled call.

A step is of one batch, or of several (`Config.accumulate`), whose gradients are averaged. Several
are spread over the devices of a mesh; a device takes its own one after another. Every batch goes
through the same compiled loop, however few a device has, and the gradients are added in the order
of the batches, so that on CPUs the weights do not depend on the devices, bit for bit. They depend
on the threads that XLA has, by which it cuts loops: as many as cores, or devices if they are more.
"""

import functools
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, Key

from sg3d_jax.diffusion.threefry import unrolled
from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.compiled import quick_options
from sg3d_jax.infer.lanes import Model, root_key
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train.config import Config


class TrainState(NamedTuple):
    """Everything that a run carries from step to step."""

    params: Params  # as they are trained
    average: Params  # exponential moving average of params
    optimiser: Any  # the moments of AdamW, of all parameters as one vector
    step: Array  # int32[]


DEVICES: Final = "devices"  # the axis of the mesh
Metrics = dict[str, Float[Array, ""]]
TrainCall = Callable[[TrainState, Key[Array, ""], SceneGraph], tuple[TrainState, Metrics]]


def make_optimiser(
    config: Config, rate: optax.ScalarOrSchedule | None = None
) -> optax.GradientTransformation:
    """Builds AdamW with warm-up, cosine decay to zero over the run, and clipping by global norm.

    Args:
      config: the run.
      rate: the learning rate; None for the warm-up and decay of the run.
    """
    settings = config.optimiser
    if rate is None:
        rate = optax.warmup_cosine_decay_schedule(
            0.0, settings.learning_rate, settings.warmup_steps, config.steps
        )
    return optax.chain(
        optax.clip_by_global_norm(settings.clip_norm),
        optax.adamw(rate, weight_decay=settings.weight_decay),
    )


def init_state(
    config: Config,
    model: Model,
    graph: SceneGraph,
    optimiser: optax.GradientTransformation | None = None,
) -> TrainState:
    """Draws the initial state from the run's seed; `graph` is any padded graph."""
    params = _params(model, root_key(config.seed), graph)
    moments = (optimiser or make_optimiser(config)).init(ravel_pytree(params)[0])
    average = jax.tree.map(jnp.copy, params)  # not the same memory: a call takes that of both
    return TrainState(params, average, moments, jnp.zeros((), jnp.int32))


@functools.partial(jax.jit, static_argnames="model")  # no forward pass is run
def _params(model: Model, key: Key[Array, ""], graph: SceneGraph) -> Params:
    """Draws the parameters of a model; compiled once for all that are equal."""
    return model.init(key, graph)


def batch_of(config: Config, graphs: SceneGraph) -> int:
    """Returns how many graphs of a stack are trained on in a step: fewer of large ones."""
    num_slots = graphs.nodes.mask.shape[-1]
    return max(1, min(config.batch, config.batch_nodes // num_slots))


def mesh_of(config: Config) -> Mesh:
    """Returns the devices that share the batches of a step: as many as get the same number of them.

    Raises:
      ValueError: there are several processes, and some would have nothing to do.
    """
    devices, processes = jax.devices(), jax.process_count()
    number = max(n for n in range(1, len(devices) + 1) if config.accumulate % n == 0)
    if processes > 1 and number < len(devices):
        raise ValueError(
            f"accumulate is {config.accumulate}, expected a multiple of {len(devices)}, the "
            f"devices of {processes} processes, so that each has batches"
        )
    return Mesh(np.array(devices[:number]), (DEVICES,))


def make_train_call(
    config: Config, model: Model, optimiser: optax.GradientTransformation | None = None
) -> Any:
    """Builds the compiled function that runs `steps_per_call` training steps on one bucket.

    Args:
      config: the run.
      model: what is trained.
      optimiser: of all parameters as one vector; None for that of the run (`make_optimiser`).

    Returns:
      A jitted `TrainCall`, (state, key, graphs) -> (state, metrics), over the devices of `mesh_of`;
      all of them have all that is given and returned, and the new state takes the memory of the
      old one. `graphs` is one stack; a step draws its batches and everything else from `key` and
      the state's step, so a run is a pure function of its configuration. Metrics are means over the
      call.
    """
    chosen, mesh = optimiser or make_optimiser(config), mesh_of(config)

    def batch_loss(
        params: Params, keys: Key[Array, " B"], graphs: SceneGraph
    ) -> tuple[Float[Array, ""], Metrics]:
        def one(key: Key[Array, ""], graph: SceneGraph) -> tuple[Float[Array, ""], Metrics]:
            return model.loss(params, key, graph)

        losses, terms = jax.vmap(one)(keys, graphs)
        return jnp.mean(losses), jax.tree.map(jnp.mean, terms)

    def of_device(
        params: Params, keys: Key[Array, "A B"], indices: Int[Array, "A B"], graphs: SceneGraph
    ) -> tuple[Float[Array, " P"], Metrics]:
        def of_batch(number: Int[Array, ""]) -> tuple[Float[Array, " P"], Metrics]:
            batch = jax.tree.map(lambda leaf: leaf[indices[number]], graphs)
            value_and_grad = jax.value_and_grad(batch_loss, has_aux=True)
            (loss, terms), gradient = value_and_grad(params, keys[number], batch)
            return ravel_pytree(gradient)[0], {"loss": loss, **terms}

        return _mean_in_order(*_share_of_rows(of_batch, config.accumulate))

    alike = PartitionSpec()
    spread = jax.shard_map(
        of_device,
        mesh=mesh,
        in_specs=alike,
        out_specs=alike,
        check_vma=False,  # a gradient is that of a device's own batches
    )

    def train_step(
        state: TrainState, key: Key[Array, ""], graphs: SceneGraph, unravel: Callable[..., Params]
    ) -> Any:
        key_index, key_loss = jax.random.split(jax.random.fold_in(unrolled(key), state.step))
        shape = config.accumulate, batch_of(config, graphs)
        indices = jax.random.randint(key_index, shape, 0, graphs.n_node.shape[0])
        keys = jax.random.split(key_loss, shape)
        gradient, terms = spread(unravel(state.params), keys, indices, graphs)
        updates, optimiser_state = chosen.update(gradient, state.optimiser, state.params)
        params = optax.apply_updates(state.params, updates)
        decay = jnp.minimum(config.optimiser.ema_decay, (1 + state.step) / (10 + state.step))
        average = optax.incremental_update(params, state.average, 1 - decay)
        metrics = {**terms, "gradient_norm": jnp.linalg.norm(gradient)}
        return TrainState(params, average, optimiser_state, state.step + 1), metrics

    def train_call(
        state: TrainState, key: Key[Array, ""], graphs: SceneGraph
    ) -> tuple[TrainState, Metrics]:
        # As one vector each: a few programs to compile, not a few a parameter.
        params, unravel = ravel_pytree(state.params)
        average, _ = ravel_pytree(state.average)

        def body(state: TrainState, _: None) -> tuple[TrainState, Metrics]:
            return train_step(state, key, graphs, unravel)

        state = state._replace(params=params, average=average)
        state, metrics = jax.lax.scan(body, state, None, length=config.steps_per_call)
        state = state._replace(params=unravel(state.params), average=unravel(state.average))
        return state, jax.tree.map(jnp.mean, metrics)

    everywhere = NamedSharding(mesh, alike)
    return jax.jit(
        train_call,
        donate_argnums=0,
        in_shardings=everywhere,
        out_shardings=everywhere,
        compiler_options=quick_options(),
    )


def _share_of_rows(function: Callable[[Int[Array, ""]], Any], count: int) -> Any:
    """Returns the stacked results of a function for the numbers that are this device's, in a loop.

    Shapes do not depend on how many are: the compiler would make another program, with another
    rounding, of a loop over one number than of one over two. Where there is one for all devices
    together, no loop is needed.

    Args:
      function: of a number.
      count: how many numbers there are, from zero, for all devices.
    """
    if count == 1:
        return jax.tree.map(lambda row: row[None], function(jnp.int32(0)))
    share = count // jax.lax.axis_size(DEVICES)
    first = share * jax.lax.axis_index(DEVICES)
    shapes = jax.eval_shape(function, first)
    empty = jax.tree.map(lambda one: jnp.zeros((count, *one.shape), one.dtype), shapes)

    def body(number: Int[Array, ""], made: Any) -> Any:
        replaced = functools.partial(jax.lax.dynamic_update_index_in_dim, index=number, axis=0)
        return jax.tree.map(replaced, made, function(number))

    made = jax.lax.fori_loop(first, first + share, body, empty)
    return jax.tree.map(lambda rows: jax.lax.dynamic_slice_in_dim(rows, first, share), made)


def _mean_in_order(
    vectors: Float[Array, "A P"], terms: dict[str, Float[Array, " A"]]
) -> tuple[Float[Array, " P"], Metrics]:
    """Returns the means over the batches of all devices, added in their order.

    Each device adds up a part of the vector for all, which moves as little as an all-reduce. How
    much is padded depends on the number of batches alone.
    """
    share, size = vectors.shape
    devices = jax.lax.axis_size(DEVICES)
    count = share * devices
    parts = jnp.pad(vectors, ((0, 0), (0, -size % count))).reshape(share, devices, -1)
    part = jax.lax.all_to_all(parts, DEVICES, split_axis=1, concat_axis=0, tiled=True)
    total = functools.reduce(jnp.add, part[:, 0])
    mean = jax.lax.all_gather(total, DEVICES, tiled=True)[:size] / count
    every = jax.lax.all_gather(terms, DEVICES, tiled=True)
    return mean, jax.tree.map(jnp.mean, every)
