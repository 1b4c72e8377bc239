"""Growing a whole graph: the FLAGG loop, a pure function of one packed graph.

proximity graph -> [insert -> fill -> append block -> halt]* -> drop proximity edges.

Source: paper, Eq. (flagg_full) and Sec. "Generating 3DSGs".
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Bool, Int, Key

from sg3d_jax.diffusion.threefry import unrolled
from sg3d_jax.fill.constraints import num_parts, upwards
from sg3d_jax.flagg.compiled import Compiled, in_32_bits, own_types
from sg3d_jax.flagg.step import Flagg, Params, check_grows
from sg3d_jax.scene.graph import PackedGraph, SceneGraph
from sg3d_jax.scene.padding import without_proximity
from sg3d_jax.scene.proximity import connect_observed

HALT_REASONS = ("RUNNING", "HALTED", "CAPACITY", "MAX_STEPS", "ONE_SHOT", "REPEATED")
RUNNING, HALTED, CAPACITY, MAX_STEPS, ONE_SHOT, REPEATED = range(len(HALT_REASONS))
DEFAULT_MAX_STEPS = 2000
TWINS = 8  # nodes of one concept and the same parts; true graphs, as a robot sees them, have five


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
    max_steps: Int[Array, ""] | int = DEFAULT_MAX_STEPS,
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
      The graph without proximity edges, in 32 bits, whatever JAX is told; what was given is as it
      was, bit for bit, and comes first.

    Raises:
      ValueError: the model does not grow, or the parameters are none of one that does.

    Source: paper, Sec. "Generating 3DSGs".
    """
    check_grows(model, params)
    with own_types():
        begun = _begun(model, params, key, given, max_steps, ask_first, steps)

        def layers(above: Bool[Array, ""], growing: _Growing) -> _Growing:
            chosen = model.drawing(params, above)
            step = functools.partial(_with_block, model, chosen, unrolled(key), max_steps)
            return jax.lax.while_loop(functools.partial(_goes_on, above), step, growing)

        return _ended(_layer_by_layer(model, layers, begun))


class _Growing(NamedTuple):
    """A graph while it grows."""

    graph: PackedGraph
    reason: Array  # int32[], index into HALT_REASONS
    steps: Array  # int32[], blocks inserted
    closing: Array  # bool[], whether only the wholes that nodes lack may come
    upper: Array  # bool[], whether the upper layers have been reached (`FlaggConfig.upper`)


def _goes_on(above: Bool[Array, ""], growing: _Growing) -> Bool[Array, "..."]:
    """Returns whether a graph grows in the upper layers, or in those below them."""
    return (growing.reason == RUNNING) & (growing.upper == above)


def _layer_by_layer(
    model: Flagg, grow: Callable[[Bool[Array, ""], _Growing], _Growing], growing: _Growing
) -> _Growing:
    """Grows what is below the upper layers, then these, if they have parameters of their own.

    Which of both it is no `vmap` makes a batch of, and so none of the parameters.
    """
    number = 2 if model.config.upper else 1
    return jax.lax.fori_loop(0, number, lambda i, growing: grow(i == 1, growing), growing)


def _begun(
    model: Flagg,
    params: Params,
    key: Key[Array, ""],
    given: PackedGraph,
    max_steps: Int[Array, ""] | int,
    ask_first: bool,
    steps: Int[Array, ""] | int,
) -> _Growing:
    """Returns what is given before its first block."""
    graph = connect_observed(in_32_bits(given))
    steps, reason, closing = jnp.asarray(steps, jnp.int32), jnp.int32(RUNNING), jnp.zeros((), bool)
    if ask_first:
        is_asked = jnp.any(graph.nodes.mask & ~graph.nodes.observed) & (steps == 0)
        key = jax.random.fold_in(unrolled(key), max_steps)
        halted, closing = model.halts(params, key, graph)
        reason, closing = jnp.where(is_asked & halted, HALTED, reason), is_asked & closing
    upper = (steps > 0) & model.ends_upper(graph)
    return _Growing(graph, reason, steps, closing, upper)


def _with_block(
    model: Flagg,
    params: Params,
    key: Key[Array, ""],
    max_steps: Int[Array, ""] | int,
    growing: _Growing,
) -> _Growing:
    """Returns a graph with the next block, and whether that was the last one."""
    key = jax.random.fold_in(key, growing.steps)
    grown = model.step(params, key, growing.graph, growing.closing, growing.upper)
    steps = growing.steps + grown.inserted
    reason = jnp.where(steps >= max_steps, jnp.int32(MAX_STEPS), RUNNING)
    reason = jnp.where(num_twins(grown.graph) > TWINS, REPEATED, reason)
    reason = jnp.where(grown.halted, HALTED, reason)
    reason = jnp.where(grown.fits, reason, CAPACITY)
    return _Growing(grown.graph, reason, steps, grown.closing, grown.upper)


def num_twins(graph: PackedGraph) -> Int[Array, ""]:
    """Returns how many other nodes have the concept and just the parts of the last one, if any.

    In graphs larger than those that Halt was trained on it may never want to end, and Fill then
    draws one node without end.
    """
    nodes, is_part = graph.nodes, upwards(graph)
    last = jnp.sum(nodes.mask) - 1
    none, size = jnp.zeros(nodes.label.shape, jnp.int32), num_parts(graph)
    parts = none.at[graph.senders].max(is_part & (graph.receivers == last))
    shared = none.at[graph.receivers].add(is_part * parts[graph.senders])
    alike = nodes.mask & (nodes.label == nodes.label[last])
    alike &= (size == size[last]) & (shared == size[last]) & (size > 0)
    return jnp.maximum(jnp.sum(alike) - 1, 0)


def _ended(growing: _Growing) -> Grown:
    return Grown(without_proximity(growing.graph), growing.reason, growing.steps)


@functools.partial(Compiled, static_argnames=("model", "ask_first", "lanes", "mesh"))
def grow_lanes(
    model: Flagg,
    params: Params,
    keys: Key[Array, " B"],
    given: PackedGraph,
    steps: Int[Array, " B"],
    max_steps: Int[Array, ""] | int,
    ask_first: bool,
    lanes: int | None = None,
    mesh: Mesh | None = None,
) -> Grown:
    """Grows a batch of stacked scenes: `grow` of each, bit for bit, in one program.

    Args:
      model: see `grow`.
      params: see `grow`.
      keys: a key a scene.
      given: what is given of each scene.
      steps: blocks that were inserted before into each. A scene whose steps are `max_steps` already
        is no scene, but fills the batch, and is not grown.
      max_steps: see `grow`.
      ask_first: see `grow`.
      lanes: how many grow side by side on a device; where one is complete, the next takes its
        place. None for all.
      mesh: of one axis, devices that the batch is dealt to, each a run of it; None for the one on
        which it is.
    """
    grown = functools.partial(_lanes_grown, model, ask_first, lanes)
    if mesh is not None:
        same, dealt = PartitionSpec(), PartitionSpec(mesh.axis_names)
        specs = same, same, dealt, dealt, dealt
        grown = jax.shard_map(grown, mesh=mesh, in_specs=specs, out_specs=dealt, check_vma=False)
    return grown(params, jnp.asarray(max_steps, jnp.int32), keys, given, steps)


def _lanes_grown(
    model: Flagg,
    ask_first: bool,
    lanes: int | None,
    params: Params,
    max_steps: Int[Array, ""],
    keys: Key[Array, " B"],
    given: PackedGraph,
    steps: Int[Array, " B"],
) -> Grown:
    """Grows a batch on one device: a lane is the place of a scene in it, until that is complete."""
    count = len(steps)
    if count == 1:  # on a CPU: `vmap` would make tracing half as long again
        key, graph, before = jax.tree.map(lambda leaf: leaf[0], (keys, given, steps))
        grown = grow(model, params, key, graph, max_steps, ask_first, before)
        return jax.tree.map(lambda leaf: leaf[None], grown)

    def begun(key: Key[Array, ""], given: PackedGraph, steps: Int[Array, ""]) -> _Growing:
        scene = _begun(model, params, key, given, max_steps, ask_first, steps)
        return scene._replace(reason=jnp.where(steps >= max_steps, MAX_STEPS, scene.reason))

    def layers(above: Bool[Array, ""], scenes: _Growing) -> _Growing:
        chosen, goes_on = model.drawing(params, above), functools.partial(_goes_on, above)

        def with_block(key: Key[Array, ""], growing: _Growing) -> _Growing:
            return _with_block(model, chosen, unrolled(key), max_steps, growing)

        def step(state: tuple[_Growing, Array, Array]) -> tuple[_Growing, Array, Array]:
            scenes, places, first_waiting = state
            one = jax.tree.map(lambda leaf: leaf.at[places].get(mode="clip"), (keys, scenes))
            running = (places < count) & goes_on(one[1])
            grown = jax.vmap(with_block)(*one)
            to = jnp.where(running, places, count)  # else dropped
            scenes = jax.tree.map(
                lambda leaf, new: leaf.at[to].set(new, mode="drop"), scenes, grown
            )
            free = ~running | ~goes_on(grown)
            places = jnp.where(free, first_waiting + jnp.cumsum(free) - 1, places)
            return scenes, places, first_waiting + jnp.sum(free)

        places = jnp.arange(min(lanes or count, count))
        start = scenes, places, jnp.asarray(len(places))
        return jax.lax.while_loop(lambda state: jnp.any(goes_on(state[0])), step, start)[0]

    begun_all = jax.vmap(begun)(keys, given, steps)
    return jax.vmap(_ended)(_layer_by_layer(model, layers, begun_all))
