"""The command line as tests use it: run in this process, on files of the working directory."""

import contextlib
import dataclasses
import json
import os
from typing import Final

import pytest

from sg3d_jax import cli
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.io.planes import COLUMNS, planes_to_dict
from sg3d_jax.train.methods import METHODS, build_model
from sg3d_jax.train.weights import save_weights
from tests import at_random
from tests.tiny_run import STATISTICS, shortest_run, small_floors
from tests.two_rooms import on_device, random_params, two_rooms

SCENES: Final = [planes_to_dict(graph) for graph in small_floors()[:3]]


def as_csv(scene):
    rows = [[*p["centroid"], *p["normal"], p["width"]] for p in scene["planes"]]
    return "\n".join([",".join(COLUMNS), *(",".join(map(repr, row)) for row in rows)]) + "\n"


def write(name, content):
    with open(name, "w") as file:
        file.write(content if isinstance(content, str) else json.dumps(content))
    return name


def write_lines(name, scenes):
    return write(name, "".join(json.dumps(scene) + "\n" for scene in scenes))


def run(*arguments):
    cli.main([str(argument) for argument in arguments])


def refusal(capsys, *arguments):
    """Returns the one line of a refusal, and checks that it is one and nothing is written."""
    before = sorted(os.listdir("."))
    with pytest.raises(SystemExit) as caught:
        run(*arguments)
    assert caught.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("sg3d: ")
    assert captured.err.count("\n") == 1
    assert captured.err.endswith("\n")
    assert sorted(os.listdir(".")) == before
    return captured.err.removeprefix("sg3d: ").strip()


def documents(name):
    with open(name) as file:
        return [json.loads(line) for line in file]


def observed(document):
    """Returns the planes of a grown document as the input had them."""
    planes = [node for node in document["nodes"] if node["label"] == "plane"]
    names = (("centroid", "position"), ("normal", "normal"), ("width", "width"))
    return {"planes": [{theirs: plane[ours] for theirs, ours in names} for plane in planes]}


@contextlib.contextmanager
def weights_at_random(folder):
    """Registers `at_random` and writes weights of it, which end a graph as soon as they may."""
    at_random.register()
    config = dataclasses.replace(
        shortest_run(folder, "fd4"),
        model=at_random.AtRandomConfig(),
        flagg=FlaggConfig(coins=(1,), width=4, depth=1),
    )
    model = build_model(config.model, config.flagg, STATISTICS, config.ontology)
    params = random_params(model.init, on_device(two_rooms()))
    params.halt["params"]["logits"]["bias"] += 1e6
    yield save_weights(folder / f"{at_random.NAME}.npz", config, STATISTICS, params)
    del METHODS[at_random.NAME]
