"""Growth that is written down draws what `complete` draws, wherever there is JAX."""

import json
import os
import runpy
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.infer import exported
from sg3d_jax.infer.complete import complete
from sg3d_jax.infer.exported import export_growth
from sg3d_jax.infer.lanes import growth_capacity
from sg3d_jax.scene.graph import PackedGraph, observed_of, parts_first, subgraph
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from sg3d_jax.scene.padding import pad
from tests.growing_rooms import MODEL, stop_at
from tests.tiny_run import ROOT
from tests.two_rooms import two_rooms

SCRIPT = ROOT / "examples" / "run_compiled.py"
ROOM, SAMPLES, SEED = 9, 3, 5
PLANES = observed_of(two_rooms())  # eight, in the bucket of nine


@pytest.fixture(scope="module", autouse=True)
def _no_check_of_key_reuse():
    """JAX takes a vmapped loop over keys for their reuse."""
    with jax.debug_key_reuse(False):
        yield


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("exported") / "growth.npz"
    arrays = export_growth(MODEL, stop_at(12), ROOM, SAMPLES, {"weights": "none"})
    np.savez(path, **arrays)
    return path


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(SCRIPT))


@pytest.fixture(scope="module")
def loaded(file, script):
    return script["load"](file)


def rows_of(graph):
    nodes = graph.nodes
    return np.concatenate([nodes.position, nodes.normal, nodes.width[:, None]], axis=1)


@pytest.mark.parametrize("count", [8, 6])
def test_script__draws_what_complete_draws_bit_for_bit(script, loaded, count):
    scene = subgraph(PLANES, np.arange(count))
    assert growth_capacity(count) == growth_capacity(ROOM)
    options = {"samples": SAMPLES, "candidates": 1, "cut": "never"}
    [expected] = complete(MODEL, stop_at(12), [scene], SEED, **options)
    grown = script["complete"](*loaded, rows_of(scene), SEED)
    assert len(grown) == SAMPLES
    for found, one in zip(grown, expected, strict=True):
        real = found["mask"]
        npt.assert_array_equal(found["label"][real], one.graph.nodes.label)
        npt.assert_array_equal(found["position"][real][count:], one.graph.nodes.position[count:])
        npt.assert_array_equal(
            np.argwhere(found["part_of"]), sorted(parts_first(one.graph).tolist())
        )
        assert loaded[0]["halt_reasons"][found["halt_reason"]] == one.halt_reason == "HALTED"
        assert found["steps"] == one.steps


def test_rows_that_count_become_a_scene_and_the_others_padding():
    capacity, count = growth_capacity(ROOM), 6
    scene, nodes = subgraph(PLANES, np.arange(count)), PLANES.nodes
    given = {name: getattr(nodes, name) for name in exported._inputs(8, PAPER_ONTOLOGY)}
    given = jax.tree.map(jnp.asarray, given)
    found = exported._packed(given, jnp.int32(count), capacity, PAPER_ONTOLOGY)
    assert isinstance(found, PackedGraph)
    expected = jax.tree.map(jnp.asarray, pad(observed_of(scene), capacity))
    jax.tree.map(npt.assert_array_equal, found, expected)


def test_header__says_what_goes_in_and_comes_out(loaded):
    header, run = loaded
    given = {name: np.zeros(one["shape"], one["type"]) for name, one in header["given"].items()}
    outputs = run(given, np.int32(2), np.uint32(SEED))
    described = {
        name: {"type": str(array.dtype), "shape": list(array.shape)}
        for name, array in outputs.items()
    }
    assert described == header["outputs"]
    reasons = [header["halt_reasons"][reason] for reason in outputs["halt_reason"]]
    assert reasons == ["CAPACITY"] * SAMPLES  # of ten rooms there is no place for all
    assert header["weights"] == "none"
    assert [one["name"] for one in header["ontology"]["concepts"]] == list(PAPER_ONTOLOGY.names)


def test_script__refuses_more_planes_than_there_is_room_for(script, loaded):
    with pytest.raises(ValueError, match="there are 10 planes, expected 9 at most"):
        script["complete"](*loaded, np.zeros((ROOM + 1, 7)))


def test_script__runs_without_this_package(file, loaded, script):
    """And prints every node and edge of what it grows."""
    program = "import sys; sys.modules['sg3d_jax'] = None; import runpy; sys.argv = sys.argv[1:]; "
    program += "runpy.run_path(sys.argv[0], run_name='__main__')"
    planes = file.with_name("planes.csv")
    header = "cx,cy,cz,nx,ny,nz,width"
    np.savetxt(planes, rows_of(PLANES), delimiter=",", header=header, fmt="%.17g")
    run = subprocess.run(
        [sys.executable, "-c", program, SCRIPT, file, planes, str(SEED)],
        env={**os.environ, "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"},
        cwd=file.parent,
        check=True,
        capture_output=True,
        text=True,
    )
    graph, *_ = script["complete"](*loaded, rows_of(PLANES), SEED)
    lines = run.stdout.splitlines()
    last = next(number for number, line in enumerate(lines) if line.startswith("part of:"))
    assert lines[0] == "HALTED"
    assert json.loads(lines[last].partition(":")[2]) == np.argwhere(graph["part_of"]).tolist()
    assert last == 1 + graph["mask"].sum()
    assert lines.count("HALTED") == SAMPLES
