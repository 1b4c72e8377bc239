"""The training state and one pure training step, scanned several times a compiled call."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Key

from sg3d_jax.diffusion.threefry import unrolled
from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.compiled import Compiled
from sg3d_jax.infer.lanes import Model, root_key
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.train.config import Config


class TrainState(NamedTuple):
    """Everything that a run carries from step to step."""

    params: Params  # as they are trained
    average: Params  # exponential moving average of params
    optimiser: Any  # the moments of AdamW
    step: Array  # int32[]


Metrics = dict[str, Float[Array, ""]]
TrainCall = Callable[[TrainState, Key[Array, ""], SceneGraph], tuple[TrainState, Metrics]]


def make_optimiser(
    config: Config, rate: optax.ScalarOrSchedule | None = None
) -> optax.GradientTransformation:
    """Builds AdamW with warm-up, cosine decay to zero over the run, and clipping by global norm.

    It works on all parameters as one vector: a few programs to compile, not a few a parameter.

    Args:
      config: the run.
      rate: the learning rate; None for the warm-up and decay of the run.
    """
    settings = config.optimiser
    if rate is None:
        rate = optax.warmup_cosine_decay_schedule(
            0.0, settings.learning_rate, settings.warmup_steps, config.steps
        )
    return optax.flatten(
        optax.chain(
            optax.clip_by_global_norm(settings.clip_norm),
            optax.adamw(rate, weight_decay=settings.weight_decay),
        )
    )


def init_state(
    config: Config,
    model: Model,
    graph: SceneGraph,
    optimiser: optax.GradientTransformation | None = None,
) -> TrainState:
    """Draws the initial state from the run's seed; `graph` is any padded graph."""
    params = jax.jit(model.init)(root_key(config.seed), graph)  # compiled: no forward pass is run
    moments = (optimiser or make_optimiser(config)).init(params)
    return TrainState(params, params, moments, jnp.zeros((), jnp.int32))


def batch_of(config: Config, graphs: SceneGraph) -> int:
    """Returns how many graphs of a stack are trained on in a step: fewer of large ones."""
    num_slots = graphs.nodes.mask.shape[-1]
    return max(1, min(config.batch, config.batch_nodes // num_slots))


def make_train_call(
    config: Config, model: Model, optimiser: optax.GradientTransformation | None = None
) -> Any:
    """Builds the compiled function that runs `steps_per_call` training steps on one bucket.

    Args:
      config: the run.
      model: what is trained.
      optimiser: None for that of the run (`make_optimiser`).

    Returns:
      A jitted `TrainCall`, (state, key, graphs) -> (state, metrics). `graphs` is one stack; a step
      draws a batch of it and everything else from `key` and the state's step, so a run is a pure
      function of its configuration. Metrics are means over the call.
    """
    chosen = optimiser or make_optimiser(config)

    def batch_loss(
        params: Params, key: Key[Array, ""], graphs: SceneGraph
    ) -> tuple[Float[Array, ""], Metrics]:
        def one(key: Key[Array, ""], graph: SceneGraph) -> tuple[Float[Array, ""], Metrics]:
            return model.loss(params, key, graph)

        keys = jax.random.split(key, graphs.n_node.shape[0])
        losses, terms = jax.vmap(one)(keys, graphs)
        return jnp.mean(losses), jax.tree.map(jnp.mean, terms)

    def train_step(state: TrainState, key: Key[Array, ""], graphs: SceneGraph) -> Any:
        key_index, key_loss = jax.random.split(jax.random.fold_in(unrolled(key), state.step))
        num_graphs = graphs.n_node.shape[0]
        indices = jax.random.randint(key_index, (batch_of(config, graphs),), 0, num_graphs)
        batch = jax.tree.map(lambda leaf: leaf[indices], graphs)
        value_and_grad = jax.value_and_grad(batch_loss, has_aux=True)
        (loss, terms), gradient = value_and_grad(state.params, key_loss, batch)
        updates, optimiser_state = chosen.update(gradient, state.optimiser, state.params)
        params = optax.apply_updates(state.params, updates)
        decay = jnp.minimum(config.optimiser.ema_decay, (1 + state.step) / (10 + state.step))
        average = optax.incremental_update(params, state.average, 1 - decay)
        norm = jnp.linalg.norm(ravel_pytree(gradient)[0])  # one vector, as the optimiser's
        metrics = {"loss": loss, **terms, "gradient_norm": norm}
        return TrainState(params, average, optimiser_state, state.step + 1), metrics

    @Compiled
    def train_call(
        state: TrainState, key: Key[Array, ""], graphs: SceneGraph
    ) -> tuple[TrainState, Metrics]:
        def body(state: TrainState, _: None) -> tuple[TrainState, Metrics]:
            return train_step(state, key, graphs)

        state, metrics = jax.lax.scan(body, state, None, length=config.steps_per_call)
        return state, jax.tree.map(jnp.mean, metrics)

    return train_call
