"""Growth without this package: a program that JAX alone runs, and all that its caller has to know.

`jax.export` writes growing down as StableHLO, for all platforms at once; parameters stay beside it,
so that it compiles as it does here. What `complete` does on the host is left to the caller: nothing
is mended or cut, no larger bucket is tried, and of several samples none is chosen.
"""

import functools
import json
from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import export
from jaxtyping import Array, Int, UInt32

from sg3d_jax.diffusion.threefry import unrolled
from sg3d_jax.fill.protocol import Params
from sg3d_jax.flagg.compiled import quick_options
from sg3d_jax.flagg.grow import HALT_REASONS, Grown, grow
from sg3d_jax.flagg.step import Flagg
from sg3d_jax.infer.lanes import growth_capacity
from sg3d_jax.scene.graph import PackedGraph, make_graph
from sg3d_jax.scene.ontology import FEATURES, Ontology
from sg3d_jax.scene.padding import Capacity, pad, part_of_adjacency

FORMAT: Final = "sg3d_jax growth 1"
PLATFORMS: Final = ("cpu", "cuda")

Arrays = Mapping[str, Any]  # by name


def export_growth(
    model: Flagg, params: Params, num_observed: int, samples: int, about: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    """Writes down the growth of scenes of up to so many observed nodes.

    On a CPU it draws what `complete` draws of one scene, bit for bit: with the same seed and
    samples, one candidate, nothing cut, and the same bucket. Positions are about any point that is
    near; `complete` takes the mean of what is observed.

    Args:
      model: grows.
      params: its parameters.
      num_observed: how many observed nodes there is room for.
      samples: graphs that are drawn in one call.
      about: JSON values that go into the header, too.

    Returns:
      The arrays of an npz file. `header` is a JSON object: what goes in and comes out, and what its
      numbers mean; `program` are the bytes of `jax.export`, a function of the list of `parameters`
      that the header names, of what is `given`, of the number of rows of it that count, and of the
      seed; the rest are those parameters.

    Raises:
      ValueError: no bucket is so large.
    """
    capacity, ontology = growth_capacity(num_observed), model.ontology
    leaves, structure = jax.tree.flatten(params)

    def program(
        parameters: list[Array], given: Arrays, count: Int[Array, ""], seed: UInt32[Array, ""]
    ) -> Arrays:
        own = jax.tree.unflatten(structure, parameters)
        graph = _packed(given, count, capacity, ontology)
        key = jax.random.fold_in(unrolled(jax.random.key(seed)), 0)  # as of the first scene

        def sample(number: Int[Array, ""]) -> Arrays:
            return _told(grow(model, own, jax.random.fold_in(key, number), graph))

        # One after another is as fast on a CPU, where none then waits for another.
        one_by_one, numbers = functools.partial(jax.lax.map, sample), jnp.arange(samples)
        if samples == 1:
            return one_by_one(numbers)
        return jax.lax.platform_dependent(numbers, cpu=one_by_one, default=jax.vmap(sample))

    given = _inputs(num_observed, ontology)
    count, seed = (jax.ShapeDtypeStruct((), kind) for kind in (jnp.int32, jnp.uint32))
    exported = export.export(jax.jit(program), platforms=PLATFORMS)(leaves, given, count, seed)
    named = {f"parameter_{number:03}": np.asarray(leaf) for number, leaf in enumerate(leaves)}
    header = {
        "format": FORMAT,
        **about,
        "given": _described(given),
        "outputs": _described(jax.tree.unflatten(exported.out_tree, exported.out_avals)),
        "halt_reasons": HALT_REASONS,
        "ontology": ontology.to_dict(),
        "platforms": PLATFORMS,
        "compiler_options": {jax.default_backend(): quick_options() or {}},
        "jax": jax.__version__,
        "parameters": list(named),
    }
    code = np.frombuffer(exported.serialize(), np.uint8)
    return {"header": np.array(json.dumps(header)), "program": code, **named}


def _inputs(num_observed: int, ontology: Ontology) -> dict[str, jax.ShapeDtypeStruct]:
    """Returns the fields of observed nodes: label, position, and features that some concept has."""
    features = {name: shape for name, shape in FEATURES.items() if ontology.has(name).any()}
    fields = {
        name: jax.ShapeDtypeStruct((num_observed, *shape), jnp.float32)
        for name, shape in {"position": (3,), **features}.items()
    }
    return {"label": jax.ShapeDtypeStruct((num_observed,), jnp.int32), **fields}


def _packed(
    given: Arrays, count: Int[Array, ""], capacity: Capacity, ontology: Ontology
) -> PackedGraph:
    """Returns the padded graph of the first so many rows of what is given, without edges."""
    nothing = pad(make_graph([], np.zeros((0, 3)), ontology=ontology), capacity)
    graph = jax.tree.map(jnp.asarray, nothing)
    real = jnp.arange(capacity.nodes) < count

    def padded(rows: Array) -> Array:
        filler = [(0, capacity.nodes - len(rows)), *[(0, 0)] * (rows.ndim - 1)]
        mask = real.reshape(-1, *[1] * (rows.ndim - 1))
        return jnp.where(mask, jnp.pad(rows, filler), jnp.zeros((), rows.dtype))

    fields = {name: padded(rows) for name, rows in given.items()}
    return graph._replace(
        nodes=graph.nodes._replace(**fields, observed=real, mask=real),
        n_node=jnp.stack([count, capacity.nodes - count]),
    )


def _told(grown: Grown) -> Arrays:
    """Returns a grown graph as arrays by name."""
    nodes = grown.graph.nodes
    upwards = nodes.label[:, None] < nodes.label[None, :]
    return {
        "label": nodes.label,
        "position": nodes.position,
        "mask": nodes.mask,
        "part_of": part_of_adjacency(grown.graph) & upwards,
        "halt_reason": grown.halt_reason,
        "steps": grown.steps,
    }


def _described(arrays: Arrays) -> dict[str, dict[str, Any]]:
    """Returns types and shapes as JSON values."""
    return {name: {"type": str(one.dtype), "shape": one.shape} for name, one in arrays.items()}
