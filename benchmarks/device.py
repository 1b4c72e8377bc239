"""What a device does: growing and training rates, against a peer, in minutes.

    python benchmarks/device.py [WEIGHTS ...] [--minutes 4]

A row is a program at one size: scenes grown by so many lanes, the same completed by `sg.complete`
with all that the host does for them, graphs trained on by so large a batch, and the peer
(benchmarks/peer.py), of which ten sampling steps are timed and scaled to its 500. Each is measured
in a process of its own, which reports what compiling took (nothing is read from disk), the peak
memory, and which share of the device's own matrix products the products of the program reach. The
most telling rows come first; a row for which no time is left is named, and left out. Products are
counted in the traced program: XLA's own analysis counts the body of a loop once, however often it
runs, and growing consists of loops.

Prints a table and writes benchmarks/results/device_<kind>.json.
"""

import argparse
import dataclasses
import json
import math
import os
import re
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from itertools import cycle, islice
from pathlib import Path
from typing import Any, Final, NamedTuple

RESULTS: Final = Path(__file__).parent / "results"
WEIGHTS: Final = ("fd4-s-f", "midi-s-c")
PEER_STEPS: Final = 10  # that are timed, of its 500,
PEER_NODES: Final = 32  # and nodes of its graphs, as S-F has
CALL_STEPS: Final = 10  # training steps of a call
DRAWN: Final = 128  # scenes that are drawn at most; lanes beyond that have some of them again
FRESH: Final = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}  # compiles all anew
SHARE: Final = 0.6  # of the time left that a row may take, if it is not the last
LEAST_LEFT: Final = 5.0  # seconds, in which no row can be measured


class Row(NamedTuple):
    """What is measured in one process."""

    what: str  # one of `MEASURES`
    size: int  # lanes, or graphs a batch
    of: str = "peer"  # weights


def rows_of(is_cpu: bool, weights: tuple[str, ...]) -> list[Row]:
    """Returns what is worth measuring on a device, the most telling first."""
    lanes, batches, peers = ((1, 4), (32, 8), 8) if is_cpu else ((1024, 256, 4), (1024, 256), 256)
    rows = [Row("growing", lanes[0], weights[0]), Row("sampling", peers)]
    rows += [Row("sampling, PyTorch", peers)] * (find_spec("torch") is not None)
    rows += [Row("training", batches[0], weights[0]), Row("learning", batches[0])]
    rows += [Row("growing", min(lanes[0], 512), name) for name in weights[1:]]
    rows += [Row("completing", lanes[0], weights[0])]
    rows += [Row("growing", size, weights[0]) for size in lanes[1:]]
    rows += [Row("training", size, weights[0]) for size in batches[1:]]
    return rows + [Row("training", batches[0], name) for name in weights[1:]]


def main() -> None:
    """Measures row by row, prints, and writes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights", nargs="*", default=WEIGHTS)
    parser.add_argument("--minutes", type=float, default=4.0, help="of all rows together")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS, help="a folder")
    parser.add_argument("--row", nargs=4, help=argparse.SUPPRESS)  # what, size, of, seconds
    arguments = parser.parse_args()
    if arguments.row:
        what, size, of, seconds = arguments.row
        print(json.dumps(MEASURES[what](Row(what, int(size), of), float(seconds))))
        return
    arguments.output.mkdir(parents=True, exist_ok=True)  # now, not when all is measured
    ends = time.monotonic() + 60 * arguments.minutes
    device = measured(Row("products", 0), ends, waiting=2)
    if "failed" in device:
        raise SystemExit(f"the device itself was not measured: {device['failed']}")
    peak = device["gflops"]
    print(f"{device['machine']['device']}: {peak:,.0f} GFLOP/s in products of matrices, float32")
    print(f"{'':31}{'graphs/s':>10}{'compiling':>12}{'memory':>11}{'of products':>13}")
    rows, left_out = [], []
    waiting = rows_of(device["is_cpu"], tuple(arguments.weights))
    for number, row in enumerate(waiting):
        found = measured(row, ends, len(waiting) - number)
        shown = f"{row.what}, {row.of}, {row.size}"
        if "failed" in found:
            left_out.append(f"{shown}: {found['failed']}")
            print(f"{shown:31} left out: {found['failed']}", flush=True)
            continue
        share = None if found["gflops"] is None else found["gflops"] / peak
        rows.append(row._asdict() | found | {"share_of_products": share})
        figures = f"{found['graphs_a_second']:>10,.2f}{found['compiling_seconds']:>10.1f} s"
        told = "" if share is None else f"{share:.1%}"
        print(f"{shown:31}{figures}{found['peak_gib']:>7.2f} GiB{told:>13}", flush=True)
    content = device | {"minutes": arguments.minutes, "rows": rows, "left_out": left_out}
    kind = re.sub(r"[^a-z0-9]+", "-", device["machine"]["device"].lower())
    path = arguments.output / f"device_{kind}.json"
    path.write_text(json.dumps(content, indent=2) + "\n")
    print(path)


def measured(row: Row, ends: float, waiting: int) -> dict[str, Any]:
    """Measures a row in a process of its own; returns why not, if that failed or took too long.

    Args:
      row: what is measured.
      ends: the time by which it has ended.
      waiting: how many rows are still to be measured, with this one.
    """
    left = ends - time.monotonic()
    if left < LEAST_LEFT:
        return {"failed": "no time left"}
    most = left if waiting == 1 else SHARE * left
    of_row = [row.what, str(row.size), row.of, str(min(5.0, left / waiting / 4))]
    command = [sys.executable, __file__, "--row", *of_row]
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, timeout=most, check=True, env=FRESH
        )
    except subprocess.TimeoutExpired:
        return {"failed": "not done in time"}
    except subprocess.CalledProcessError as error:
        return {"failed": (error.stderr.strip().splitlines() or ["it was killed"])[-1]}
    return json.loads(run.stdout.splitlines()[-1])


# --- in the process of a row ---


def products(row: Row, seconds: float) -> dict[str, Any]:
    """Measures products of large matrices, which nothing can exceed, and says where this is."""
    import jax
    import jax.numpy as jnp

    from sg3d_jax.cli.provenance import provenance

    is_cpu = jax.default_backend() == "cpu"
    size = 2048 if is_cpu else 8192
    square = jnp.ones((size, size))
    product = jax.jit(lambda left, right: left @ right)
    taken, _ = _timed(lambda: jax.block_until_ready(product(square, square)), seconds)
    about = {name: provenance()[name] for name in ("commit", "machine")}
    return about | {"jax": jax.__version__, "is_cpu": is_cpu, "gflops": 2e-9 * size**3 / taken}


def growing(row: Row, seconds: float) -> dict[str, Any]:
    """Grows scenes of one bucket, of the kind that the weights were trained on."""
    import jax
    import numpy as np

    from sg3d_jax.flagg.grow import DEFAULT_MAX_STEPS, grow_lanes
    from sg3d_jax.infer.lanes import sample_keys
    from sg3d_jax.infer.prepare import prepare
    from sg3d_jax.scene.padding import stack
    from sg3d_jax.scene.proximity import connect_observed
    from sg3d_jax.train.weights import load_weights

    trained = load_weights(row.of)
    model: Any = trained.model
    drawn, capacity = _scenes_of(trained)
    scenes = _in_turn(prepare(drawn, model.ontology, keep=False, cut="never"), row.size)
    given = stack([scene.centred for scene in scenes], capacity)
    keys = sample_keys(0, range(len(scenes)), [0] * len(scenes))
    all_of_them = keys, given, np.zeros(len(scenes), np.int32)
    size = 1 if row.size == 1 else len(scenes)  # one at a time, as a core of a CPU has them
    batches = [
        jax.tree.map(lambda leaf, at=start: leaf[at : at + size], all_of_them)
        for start in range(0, len(scenes), size)
    ]
    limits = DEFAULT_MAX_STEPS, False, row.size

    def run() -> list[Any]:
        grown = [grow_lanes(model, trained.params, *batch, *limits) for batch in batches]
        return jax.block_until_ready(grown)

    taken, first = _timed(run, seconds)
    blocks = sum(int(jax.numpy.sum(grown.steps)) for grown in run())
    graph = connect_observed(jax.tree.map(lambda leaf: leaf[0], given))
    block = jax.make_jaxpr(model.step)(trained.params, jax.random.key(0), graph)
    flops = blocks * _flops_of(block.jaxpr)
    return _told(len(scenes), taken, first, flops) | {"nodes": capacity.nodes, "blocks": blocks}


def completing(row: Row, seconds: float) -> dict[str, Any]:
    """Completes the same scenes as a user does, with all that the host has to do for them."""
    from sg3d_jax.infer.complete import complete
    from sg3d_jax.train.weights import load_weights

    trained = load_weights(row.of)
    drawn, capacity = _scenes_of(trained)
    scenes = _in_turn(drawn, row.size)
    options: Any = {"candidates": 1, "cut": "never", "lanes": row.size, "outgrow": False}

    def run() -> None:
        complete(trained.model, trained.params, scenes, **options)

    taken, first = _timed(run, seconds)
    return _told(len(scenes), taken, first, None) | {"nodes": capacity.nodes}


def _scenes_of(trained: Any) -> tuple[list[Any], Any]:
    """Returns scenes of one bucket, of the kind that weights were trained on, and that bucket."""
    from sg3d_jax.data import registry
    from sg3d_jax.infer.lanes import growth_capacity
    from sg3d_jax.scene.graph import observed_of

    drawn = [observed_of(graph) for graph in registry.make(_data_of(trained), 2 * DRAWN, seed=1)]
    buckets = [growth_capacity(len(scene.nodes.label)) for scene in drawn]
    ((commonest, _),) = Counter(buckets).most_common(1)
    chosen = [scene for scene, its in zip(drawn, buckets, strict=True) if its == commonest]
    return chosen[:DRAWN], commonest


def _in_turn(scenes: list[Any], lanes: int) -> list[Any]:
    """Returns as many scenes as lanes take one after another, if need be some of them again."""
    from sg3d_jax.infer.lanes import QUEUE

    return list(islice(cycle(scenes), max(8, QUEUE * lanes)))


def training(row: Row, seconds: float) -> dict[str, Any]:
    """Trains on graphs of the commonest bucket of a training set."""
    import jax

    from sg3d_jax.data import registry
    from sg3d_jax.train.dataset import slots_of, stack_by_size
    from sg3d_jax.train.processes import on_all_devices
    from sg3d_jax.train.step import init_state, make_train_call, mesh_of
    from sg3d_jax.train.weights import load_weights

    trained = load_weights(row.of)
    graphs = registry.make(_data_of(trained), 256, seed=1)
    slots = sorted(map(slots_of, graphs))[len(graphs) // 2]  # of one in the middle
    nodes = next(nodes for nodes in (*trained.config.capacities, slots) if nodes >= slots)
    (stacked,) = stack_by_size([graph for graph in graphs if slots_of(graph) <= nodes], [nodes])
    sizes = {"batch": row.size, "batch_nodes": row.size * nodes, "accumulate": 1}
    config = dataclasses.replace(trained.config, **sizes, steps_per_call=CALL_STEPS)
    state = init_state(config, trained.model, jax.tree.map(lambda leaf: leaf[0], stacked))
    state = jax.tree.map(jax.numpy.copy, state)  # a call takes over the arrays that it is given
    given = state, jax.random.key(0), stacked  # where calls leave them: else two are compiled
    state, key, stacked = on_all_devices(given, mesh_of(config))
    call = make_train_call(config, trained.model)
    flops = _flops_of(call.trace(state, key, stacked).jaxpr.jaxpr)
    states = [state]

    def run() -> None:
        states[0], _ = jax.block_until_ready(call(states[0], key, stacked))

    taken, first = _timed(run, seconds)
    return _told(row.size * CALL_STEPS, taken, first, flops) | {"nodes": nodes}


def sampling(row: Row, seconds: float) -> dict[str, Any]:
    """Samples from the peer: some of its steps, scaled to all."""
    import jax
    import jax.numpy as jnp
    import peer

    params = jax.tree.map(jnp.asarray, peer.draw_params())
    nodes, pairs = map(jnp.asarray, _graphs_of_peer(row.size))

    def one(state: Any, number: Any) -> tuple[Any, None]:
        keys = jax.random.split(jax.random.fold_in(jax.random.key(0), number))
        drawn = [jax.random.uniform(key, s.shape) for key, s in zip(keys, state, strict=True)]
        return peer.step(jnp, params, *state, number / peer.STEPS, drawn), None

    @jax.jit
    def steps(state: Any) -> Any:
        return jax.lax.scan(one, state, jnp.arange(PEER_STEPS))[0]

    flops = _flops_of(jax.make_jaxpr(steps)((nodes, pairs)).jaxpr)
    taken, first = _timed(lambda: jax.block_until_ready(steps((nodes, pairs))), seconds)
    scale = peer.STEPS / PEER_STEPS
    return _told(row.size, taken, first, flops, scale) | _size_of_peer()


def sampling_by_torch(row: Row, seconds: float) -> dict[str, Any]:
    """Samples likewise from the same network in PyTorch, which runs it operation by operation."""
    import peer

    torch: Any = import_module("torch")
    device = "cuda" if torch.cuda.is_available() else "cpu"
    params = {name: torch.as_tensor(a, device=device) for name, a in peer.draw_params().items()}
    start = [torch.as_tensor(array, device=device) for array in _graphs_of_peer(row.size)]

    def steps() -> None:
        state = start
        with torch.no_grad():
            for number in range(PEER_STEPS):
                drawn = [torch.rand_like(array) for array in state]
                state = peer.step(torch, params, *state, number / peer.STEPS, drawn)
        state[0].sum().item()  # waits for the device

    taken, first = _timed(steps, seconds)
    scale = peer.STEPS / PEER_STEPS
    told = _told(row.size, taken, first, None, scale)
    if device == "cuda":
        told["peak_gib"] = round(torch.cuda.max_memory_allocated() / 2**30, 3)
    return told | _size_of_peer() | {"torch": str(torch.__version__)}


def learning(row: Row, seconds: float) -> dict[str, Any]:
    """Trains the peer: a step of AdamW on the cross-entropy of nodes and pairs."""
    import jax
    import jax.numpy as jnp
    import optax
    import peer

    params = jax.tree.map(jnp.asarray, peer.draw_params())
    nodes, pairs = map(jnp.asarray, _graphs_of_peer(row.size))
    optimiser = optax.adamw(1e-4)

    def loss(params: Any) -> Any:
        logits = peer.predict(jnp, params, nodes, pairs, nodes[:, 0, :1])
        entropies = map(optax.softmax_cross_entropy, logits, (nodes, pairs))
        return sum(entropy.mean() for entropy in entropies)

    @jax.jit
    def step(params: Any, moments: Any) -> Any:
        changes, moments = optimiser.update(jax.grad(loss)(params), moments, params)
        return optax.apply_updates(params, changes), moments

    state = params, optimiser.init(params)
    flops = _flops_of(jax.make_jaxpr(step)(*state).jaxpr)
    taken, first = _timed(lambda: jax.block_until_ready(step(*state)), seconds)
    return _told(row.size, taken, first, flops) | _size_of_peer()


MEASURES: Final[dict[str, Callable[[Row, float], dict[str, Any]]]] = {
    "products": products,
    "growing": growing,
    "completing": completing,
    "training": training,
    "sampling": sampling,
    "sampling, PyTorch": sampling_by_torch,
    "learning": learning,
}


def _data_of(trained: Any) -> str:
    """Returns the first data set that weights were trained on which can be generated here."""
    from sg3d_jax.data import registry

    names = [part.name for part in trained.config.data.parts]
    for name in names:
        if registry.is_name(name) and registry.get(name).config is not None:
            return name
    problem = f"{trained.name} was trained on {' and '.join(names)}"
    raise ValueError(f"{problem}, expected a set that can be generated")


def _graphs_of_peer(count: int) -> tuple[Any, Any]:
    """Returns nodes and pairs of random graphs as large as those of S-F."""
    import numpy as np
    import peer

    rng = np.random.default_rng(0)
    labels = rng.integers(peer.CONCEPTS, size=(count, PEER_NODES))
    upper = np.triu(rng.integers(peer.RELATIONS, size=(count, PEER_NODES, PEER_NODES)), 1)
    edges = upper + upper.swapaxes(1, 2)
    one_hot = [np.eye(peer.CONCEPTS)[labels], np.eye(peer.RELATIONS)[edges]]
    return one_hot[0].astype(np.float32), one_hot[1].astype(np.float32)


def _timed(run: Callable[[], Any], seconds: float) -> tuple[float, float]:
    """Returns how long a call takes, on average over so many seconds, and how long the first."""
    began = time.perf_counter()
    run()
    first, count, began = time.perf_counter() - began, 0, time.perf_counter()
    while not count or time.perf_counter() - began < seconds:
        run()
        count += 1
    return (time.perf_counter() - began) / count, first


def _told(
    graphs: int, taken: float, first: float, flops: float | None, scale: float = 1.0
) -> dict[str, Any]:
    """Returns what a row says.

    Args:
      graphs: of a call.
      taken: seconds of a call.
      first: seconds of the first one.
      flops: of the products of a call; None if nobody has counted them.
      scale: how many such calls graphs take.
    """
    return {
        "graphs_a_second": round(graphs / taken / scale, 4),
        "compiling_seconds": round(first - taken, 2),
        "gflops": None if flops is None else round(1e-9 * flops / taken, 3),
        "peak_gib": round(_peak() / 2**30, 3),
    }


def _peak() -> int:
    """Returns the largest memory so far, bytes: of the device, or of the process on a CPU."""
    if "jax" in sys.modules:
        stats = sys.modules["jax"].devices()[0].memory_stats()
        if stats is not None:
            return stats["peak_bytes_in_use"]
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 2**10


def _size_of_peer() -> dict[str, int]:
    import peer

    count = sum(array.size for array in peer.draw_params().values())
    return {"nodes": PEER_NODES, "parameters": count, "steps": peer.STEPS}


def _flops_of(jaxpr: Any) -> int:
    """Returns the operations of all products in a traced program, of loops once unless they scan.

    Of branches the dearest is taken.
    """
    total = 0
    for equation in jaxpr.eqns:
        params = equation.params
        if equation.primitive.name == "dot_general":
            (summed, _), _ = params["dimension_numbers"]
            wide, out = equation.invars[0].aval.shape, equation.outvars[0].aval.shape
            total += 2 * math.prod(out) * math.prod(wide[axis] for axis in summed)
        elif equation.primitive.name == "cond":
            total += max(_flops_of(branch.jaxpr) for branch in params["branches"])
        else:
            inner = [getattr(value, "jaxpr", value) for value in params.values()]
            within = sum(_flops_of(each) for each in inner if hasattr(each, "eqns"))
            total += within * params.get("length", 1)
    return total


if __name__ == "__main__":
    main()
