"""Completes planes by a file of `sg3d compile`: needs jax, numpy and flatbuffers, and no sg3d_jax.

Run: sg3d compile midi-general --planes 50 -o growth.npz
     python examples/run_compiled.py growth.npz examples/planes.csv [SEED]
"""

import json
import sys
from collections.abc import Callable

import jax
import numpy as np
from jax import export


def load(path: str) -> tuple[dict, Callable]:
    """Returns what a file says of itself, and its program; the first call compiles it."""
    with np.load(path) as file:
        header = json.loads(str(file["header"]))
        exported = export.deserialize(bytearray(file["program"]))
        parameters = [jax.device_put(file[name]) for name in header["parameters"]]
    options = header["compiler_options"].get(jax.default_backend())
    run = jax.jit(exported.call, compiler_options=options)
    return header, lambda *inputs: jax.device_get(run(parameters, *inputs))


def complete(header: dict, run: Callable, planes: np.ndarray, seed: int = 0) -> list[dict]:
    """Returns grown graphs of planes: centroid, normal and width a row, metres, float64[n, 7]."""
    room, centre = header["given"]["label"]["shape"][0], planes[:, :3].mean(axis=0)
    if len(planes) > room:
        raise ValueError(f"there are {len(planes)} planes, expected {room} at most")
    rows = np.zeros((room, 7))
    rows[: len(planes)] = planes - np.pad(centre, (0, 4))
    position, normal, width = np.split(rows.astype(np.float32), [3, 6], axis=1)
    given = {"position": position, "normal": normal, "width": width[:, 0]}
    given["label"] = np.zeros(room, np.int32)  # the first concept of the ontology
    outputs = run(given, np.int32(len(planes)), np.uint32(seed))
    outputs["position"] = outputs["position"] + centre
    samples = range(len(outputs["steps"]))
    return [{name: array[number] for name, array in outputs.items()} for number in samples]


if __name__ == "__main__":
    header, run = load(sys.argv[1])
    planes = np.loadtxt(sys.argv[2], delimiter=",", skiprows=1)
    names = [concept["name"] for concept in header["ontology"]["concepts"]]
    for graph in complete(header, run, planes, int(*sys.argv[3:])):
        print(header["halt_reasons"][graph["halt_reason"]])
        for node in np.flatnonzero(graph["mask"]):
            print(node, names[graph["label"][node]], graph["position"][node].round(3).tolist())
        print("part of:", np.argwhere(graph["part_of"]).tolist())
