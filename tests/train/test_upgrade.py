"""Weights of format 2, whose layers were numbered, give the model and parameters of today."""

import json
import re

import jax
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.train import weights
from sg3d_jax.train.config import to_dict
from sg3d_jax.train.upgrade import FORMAT_2
from sg3d_jax.train.weights import load_weights
from tests.tiny_run import untrained_weights


def path_of_format_2(path, number):
    """Returns what an array of one layer was called."""
    module, inside = path.split("/layers/")
    if module.endswith("topology/params"):
        return f"{module}/layer_{number}/{inside}"
    if inside.startswith("rectangle/"):
        return f"{module}/layer_{number}/{inside.removeprefix('rectangle/')}"
    name, rest = inside.split("/", 1)
    return f"{module}/{name}_{number}/{rest}"


def write_format_2(path, layers=3):
    """Rewrites a weights file as it was, with several different layers in place of each stack."""
    rng = np.random.default_rng(0)
    with np.load(path) as content:
        arrays = {name: content[name] for name in content.files}
    config = to_dict(load_weights(path).config)
    del config["ontology"]
    if config["flagg"]:
        config["flagg"]["corruption"]["max_added"] = 8
    expected, old = {}, {}
    for name, array in arrays.items():
        if "/layers/" in name:
            expected[name] = rng.normal(size=(layers, *array.shape[1:])).astype("f")
            old |= {path_of_format_2(name, i): expected[name][i] for i in range(layers)}
        else:
            old[name] = array
    np.savez(path, **old | {"format": FORMAT_2, "config": json.dumps(config)})
    return expected


@pytest.mark.parametrize("method", ["fd4", "midi", "midi-or", "ec-l", "ec-square"])
def test_numbered_layers_are_stacked(method, tmp_path, monkeypatch):
    # The configuration says one layer, so that there is little to compile.
    monkeypatch.setattr(weights, "_check_params", lambda *_: None)
    path = untrained_weights(tmp_path, method)
    today = load_weights(path)
    expected = write_format_2(path)
    assert (method in ("fd4", "midi", "midi-or")) == bool(expected)
    loaded = load_weights(path)
    assert loaded.config == today.config
    assert loaded.model == today.model
    assert jax.tree.structure(loaded.params) == jax.tree.structure(today.params)
    found = {
        re.sub(r"[\[\]'.]+", "/", jax.tree_util.keystr(place)).strip("/"): leaf
        for place, leaf in jax.tree.leaves_with_path(loaded.params)
    }
    for name, array in expected.items():
        npt.assert_array_equal(found[name.removeprefix("params/")], array)
