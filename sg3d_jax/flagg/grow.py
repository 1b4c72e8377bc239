"""Growing a whole graph: the FLAGG loop, a pure function of one packed graph.

proximity graph -> [insert -> fill -> append block -> halt]* -> drop proximity edges.

Source: paper, Eq. (flagg_full) and Sec. "Generating 3DSGs".
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, Key

from sg3d_jax.diffusion.threefry import unrolled
from sg3d_jax.flagg.compiled import Compiled
from sg3d_jax.flagg.step import Flagg, Params
from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.scene.padding import without_proximity
from sg3d_jax.scene.proximity import connect_observed

HALT_REASONS = ("RUNNING", "HALTED", "CAPACITY", "MAX_STEPS", "ONE_SHOT")
RUNNING, HALTED, CAPACITY, MAX_STEPS, ONE_SHOT = range(len(HALT_REASONS))
DEFAULT_MAX_STEPS = 2000


class Grown(NamedTuple):
    """A grown graph and why growing ended; on the device, padded."""

    graph: SceneGraph  # real nodes in the first slots, what was given first
    halt_reason: Array  # int32[], index into HALT_REASONS
    steps: Array  # int32[], blocks inserted


def grow(
    model: Flagg,
    params: Params,
    key: Key[Array, ""],
    given: PackedGraph,
    max_steps: int = DEFAULT_MAX_STEPS,
    ask_first: bool = False,
    steps: Int[Array, ""] | int = 0,
) -> Grown:
    """Grows a complete scene graph from what is given of it.

    Args:
      model: the three modules.
      params: their parameters.
      key: one key a sample; the same key and graph give the same result in any batch.
      given: observed nodes, and whatever is known above them: nodes with their part-of edges, which
        are kept and used. Proximity edges are made anew. With room for what is to come; `vmap` over
        scenes or keys.
      max_steps: a limit on the number of blocks.
      ask_first: whether what is given may be complete already: Halt is then asked before the first
        block, too. It is never asked about observed nodes alone, which it has not been trained on.
      steps: blocks that were inserted before, where a graph that did not fit goes on in a larger
        one.

    Returns:
      The graph without proximity edges; what was given is as it was, bit for bit, and comes first.

    Source: paper, Sec. "Generating 3DSGs".
    """
    graph, key = connect_observed(given), unrolled(key)
    reason, closing = jnp.asarray(RUNNING), jnp.zeros((), bool)
    if ask_first:
        is_asked = jnp.any(graph.nodes.mask & ~graph.nodes.observed) & (jnp.asarray(steps) == 0)
        halted, closing = model.halts(params, jax.random.fold_in(key, max_steps), graph)
        reason, closing = jnp.where(is_asked & halted, HALTED, RUNNING), is_asked & closing

    def running(state: tuple[PackedGraph, Array, Array, Array]) -> Bool[Array, ""]:
        return state[1] == RUNNING

    def step(
        state: tuple[PackedGraph, Array, Array, Array],
    ) -> tuple[PackedGraph, Array, Array, Array]:
        graph, _, steps, closing = state
        grown = model.step(params, jax.random.fold_in(key, steps), graph, closing)
        steps = steps + grown.fits
        reason = jnp.where(steps >= max_steps, MAX_STEPS, RUNNING)
        reason = jnp.where(grown.halted, HALTED, reason)
        reason = jnp.where(grown.fits, reason, CAPACITY)
        return grown.graph, reason, steps, grown.closing

    start = graph, reason, jnp.asarray(steps, jnp.int32), closing
    graph, reason, steps, _ = jax.lax.while_loop(running, step, start)
    return Grown(without_proximity(graph), reason, steps)


@functools.partial(Compiled, static_argnames=("model", "max_steps", "ask_first"))
def grow_lanes(
    model: Flagg,
    params: Params,
    keys: Key[Array, " B"],
    given: PackedGraph,
    steps: Int[Array, " B"],
    max_steps: int,
    ask_first: bool,
) -> Grown:
    """Grows a batch of stacked scenes: `grow`, vmapped and compiled."""

    def one(key: Key[Array, ""], given: PackedGraph, steps: Int[Array, ""]) -> Grown:
        return grow(model, params, key, given, max_steps, ask_first, steps)

    return jax.vmap(one)(keys, given, steps)
