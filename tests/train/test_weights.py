import dataclasses
import hashlib
import json

import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.flagg.step import Params
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from sg3d_jax.train import weights
from sg3d_jax.train.card import Card
from sg3d_jax.train.config import to_dict
from sg3d_jax.train.methods import METHODS, build_model
from sg3d_jax.train.weights import (
    load_weights,
    names,
    pack_weights,
    save_weights,
    with_diffusion_steps,
)
from tests.tiny_run import MODELS, STATISTICS, measured, read_config, untrained_weights

CONFIG = read_config("test")
PARAMS = Params(
    insert={"params": {"dense_0": {"kernel": jnp.arange(6.0).reshape(2, 3) / 7}}},
    fill={"encoder": {"params": {"scale": jnp.asarray(0.1)}}, "topology": {"a": jnp.ones(2)}},
    halt={"params": {"dense_0": {"bias": jnp.array([1e-30, -jnp.pi])}}},
)

PARAMETERS = {  # of the weights of the package: the first digits of a hash
    "fd4-s-f": "eada781187e708ad",
    "fd4-s-f-square": "9a3da228e8d9c491",
}


KNOWN_SHAPES = weights._shapes


@pytest.fixture(autouse=True)
def _made_up_parameters_are_those_of_their_models(monkeypatch):
    def shapes(model):
        params = PARAMS if hasattr(model, "insert") else PARAMS.fill
        return {name: leaf.shape for name, leaf in weights._flat(params, "params")}

    monkeypatch.setattr(weights, "_shapes", shapes)


@pytest.fixture
def path(tmp_path):
    return save_weights(tmp_path / "some.npz", CONFIG, STATISTICS, PARAMS)


def test_weights_read_back_bit_for_bit(path):
    loaded = load_weights(path)
    assert jax.tree.structure(loaded.params) == jax.tree.structure(PARAMS)
    for one, other in zip(*map(jax.tree.leaves, (loaded.params, PARAMS)), strict=True):
        assert one.dtype == other.dtype
        npt.assert_array_equal(one, other)
    for one, other in zip(loaded.statistics, STATISTICS, strict=True):
        npt.assert_array_equal(one, other)
    assert loaded.config == CONFIG
    assert loaded.name == str(path)
    assert loaded.model.config == CONFIG.flagg


def test_packed_weights_are_half_as_large_and_rounded_once(path, tmp_path):
    (tmp_path / "package").mkdir()
    (tmp_path / "again").mkdir()
    packed = pack_weights(path, tmp_path / "package")
    assert packed.name == f"fd4-{CONFIG.data.name}.npz"
    with np.load(packed) as content:
        kinds = {content[name].dtype for name in content.files if name.startswith("params/")}
    assert kinds == {np.dtype(np.float16)}
    loaded, again = load_weights(packed), load_weights(pack_weights(packed, tmp_path / "again"))
    assert loaded.config == CONFIG
    for one, exact in zip(*map(jax.tree.leaves, (loaded.params, PARAMS)), strict=True):
        assert one.dtype == jnp.float32
        npt.assert_allclose(one, exact, rtol=2.0**-11, atol=2.0**-25)
    for trees in ((again.params, loaded.params), (loaded.statistics, STATISTICS)):
        jax.tree.map(npt.assert_array_equal, *trees)


def test_packed_weights_name_their_data_set_not_its_file(tmp_path):
    data = dataclasses.replace(CONFIG.data, name=str(tmp_path / "p-f.npz"))
    config = dataclasses.replace(CONFIG, data=data)
    run = save_weights(tmp_path / "weights.npz", config, STATISTICS, PARAMS)
    packed = pack_weights(run, tmp_path)
    assert packed.name == "fd4-p-f.npz"
    assert load_weights(packed).config.data.name == "p-f"


def test_packed_weights_of_a_mixture_have_its_title(tmp_path):
    data = dataclasses.replace(CONFIG.data, name="s-f+p-f.npz@robot", title="general")
    config = dataclasses.replace(CONFIG, data=data)
    card = Card(3, {"number": (4.0, 9.0)}, (), "twice")
    packed = pack_weights(
        save_weights(tmp_path / "w.npz", config, STATISTICS, PARAMS, card), tmp_path
    )
    assert packed.name == "fd4-general.npz"
    assert load_weights(packed).config.data == data
    assert load_weights(packed).card == card


@pytest.mark.parametrize("method", METHODS)
def test_weights_of_every_method_read_back(method, tmp_path):
    spec = METHODS[method]
    flagg = CONFIG.flagg if spec.grows else None
    config = dataclasses.replace(CONFIG, model=MODELS[method], flagg=flagg)
    statistics = measured(method)
    params = PARAMS if spec.grows else PARAMS.fill
    loaded = load_weights(save_weights(tmp_path / "some.npz", config, statistics, params))
    assert loaded.config == config
    assert type(loaded.statistics) is type(statistics)
    assert jax.tree.structure(loaded.params) == jax.tree.structure(params)
    assert type(loaded.model) is type(build_model(config.model, flagg, statistics, PAPER_ONTOLOGY))


def test_the_file_tells_numpy_alone_what_it_is(path):
    with np.load(path, allow_pickle=False) as content:
        assert str(content["format"]) == "sg3d_jax weights 3"
        assert content["params/insert/params/dense_0/kernel"].shape == (2, 3)
        assert '"diffusion_steps": 500' in str(content["config"])


def test_writing_leaves_one_file(path):
    assert [file.name for file in path.parent.iterdir()] == ["some.npz"]


def test_an_unknown_name_is_refused_with_the_names_and_the_closest_one(monkeypatch):
    monkeypatch.setattr(weights, "names", lambda: ["fd4-s-f", "fd4-s-f-square"])
    with pytest.raises(
        ValueError, match=r"unknown weights 'fd4-sf'.* fd4-s-f, fd4-s-f-square; did"
    ):
        load_weights("fd4-sf")
    with pytest.raises(ValueError, match="did you mean 'fd4-s-f-square'"):
        load_weights("FD4-s-f-sqare")
    with pytest.raises(ValueError, match=r"unknown weights 'runs/x\.npz'") as caught:
        load_weights("runs/x.npz")
    assert "did you mean" not in str(caught.value)


def without(path, key):
    with np.load(path) as content:
        kept = {name: content[name] for name in content.files if name != key}
    np.savez(path, **kept)


def replace_format(path):
    without(path, "format")
    with np.load(path) as content:
        np.savez(path, format="sg3d_jax weights 1", **content)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("no zip file"),
        lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
        lambda path: without(path, "format"),
        lambda path: without(path, "config"),
        lambda path: without(path, "statistics/label"),
        lambda path: changed(path, card="{}"),
        replace_format,
        lambda path: np.savez(path, format=np.array([{}], object)),
    ],
)
def test_a_broken_file_is_refused_in_one_sentence(path, spoil):
    spoil(path)
    with pytest.raises(ValueError, match=r"some\.npz: not (a weights|an npz) file") as caught:
        load_weights(path)
    assert "\n" not in str(caught.value)


def changed(path, **arrays):
    """Puts arrays in the place of those that a file has; two underscores stand for a slash."""
    with np.load(path) as content:
        named = {name.replace("__", "/"): array for name, array in arrays.items()}
        np.savez(path, **{**content, **named})


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (
            {"params__gat__x": np.zeros(2, "f")},
            "parameter params/gat/x is unknown, expected none of its configuration",
        ),
        (
            {"params__room__params__edge_0__bias": np.zeros(5, "f")},
            r"parameter params/room/params/edge_0/bias is float32\[5\], expected .*\[4\]",
        ),
        (
            {"params__room__params__edge_0__bias": np.zeros(4, int)},
            r"edge_0/bias is int64\[4\], expected float32\[4\]",
        ),
        (
            {"params__room__params__edge_0__bias": np.full(4, np.nan, "f")},
            "edge_0/bias is not finite, expected finite numbers",
        ),
        ({"statistics__width_min": np.nan}, "statistics/width_min is nan, expected a number"),
        ({"extra": np.zeros(3)}, "holds 'extra.npy', which is unknown, expected known"),
    ],
)
def test_what_a_model_cannot_have_is_refused_by_name(monkeypatch, tmp_path, damage, sentence):
    monkeypatch.setattr(weights, "_shapes", KNOWN_SHAPES)
    path = untrained_weights(tmp_path, "ec-square")
    changed(path, **damage)
    with pytest.raises(ValueError, match=rf"ec-square\.npz: .*{sentence}"):
        load_weights(path)


def test_a_parameter_that_is_missing_is_refused_by_name(path):
    without(path, "params/halt/params/dense_0/bias")
    sentence = r"some\.npz: parameter params/halt/params/dense_0/bias is missing, expected"
    with pytest.raises(ValueError, match=sentence):
        load_weights(path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"model": {"layers": "3"}}, "FD4Config.layers is '3', expected a whole number"),
        ({"model": {"node_width": -8}}, "model.node_width is -8, expected at least 1"),
        ({"model": {"heads": 0}}, "model.heads is 0, expected at least 1"),
        ({"model": {"pair_width": 10**12}}, "model.pair_width is 10{12}, expected at most 10000"),
        ({"model": 3}, "FD4Config is 3, expected an object"),
        ({"flagg": None}, "flagg of fd4 is None, expected how it grows"),
    ],
)
def test_a_configuration_of_no_model_is_refused_by_its_field(path, change, sentence):
    changed(path, config=json.dumps(to_dict(CONFIG) | change))
    with pytest.raises(ValueError, match=rf"some\.npz: {sentence}"):
        load_weights(path)


@pytest.mark.parametrize("steps", [1, 20, 500])
def test_the_number_of_sampling_steps_can_be_any_of_the_schedule(path, steps):
    loaded = load_weights(path)
    other = with_diffusion_steps(loaded, steps)
    assert other.config.model.topology_steps == steps
    assert other.params is loaded.params
    assert other.config.model.diffusion_steps == 500


@pytest.mark.parametrize("steps", [-1, 0, 501])
def test_a_number_of_sampling_steps_beyond_the_schedule_is_refused(path, steps):
    with pytest.raises(ValueError, match=rf"diffusion steps must be in 1\.\.500, got {steps}"):
        with_diffusion_steps(load_weights(path), steps)


@pytest.mark.parametrize("name", names())
def test_the_weights_of_the_package_load_and_are_finite(name):
    loaded = load_weights(name)
    leaves = jax.tree.leaves((loaded.params, loaded.statistics))
    assert all(np.isfinite(leaf).all() for leaf in leaves)
    assert f"{loaded.config.method}-{loaded.config.data.label}" == name
    known = {ontology: ontology.to_dict() for ontology in (PAPER_ONTOLOGY, FURNISHED_ONTOLOGY)}
    assert loaded.config.ontology.to_dict() == known[loaded.config.ontology]  # colours, too


@pytest.mark.parametrize(("name", "expected"), sorted(PARAMETERS.items()))
def test_the_parameters_of_the_package_are_those_that_were_trained(name, expected):
    digest = hashlib.sha256()
    for path, leaf in jax.tree.leaves_with_path(load_weights(name).params):
        digest.update(jax.tree_util.keystr(path).encode() + np.asarray(leaf).tobytes())
    assert digest.hexdigest()[:16] == expected
