import dataclasses
import json
import math

import pytest

from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, OptimiserConfig, check, from_dict, to_dict, to_json
from tests.tiny_run import CONFIGS, MODELS, read_config

NAMES = sorted(path.stem for path in CONFIGS.glob("*.py"))


def changed(**fields):
    return dataclasses.replace(read_config("test"), **fields)


@pytest.mark.parametrize("name", NAMES)
def test_every_shipped_configuration_is_one_and_can_run(name):
    config = read_config(name)
    assert type(config) is Config
    check(config)


@pytest.mark.parametrize("name", NAMES)
def test_a_configuration_survives_json(name):
    config = read_config(name)
    assert from_dict(json.loads(to_json(config))) == config


def test_what_is_not_given_has_its_default():
    assert from_dict({"model": {"layers": 7}}) == dataclasses.replace(
        Config(), model=dataclasses.replace(Config().model, layers=7)
    )


@pytest.mark.parametrize("method", MODELS)
def test_json_says_which_method_it_is_of(method):
    config = dataclasses.replace(read_config("test"), model=MODELS[method], flagg=None)
    assert config.method == method
    again = from_dict(json.loads(to_json(config)))
    assert again == config
    assert type(again.model) is type(config.model)


def test_json_names_the_method_first():
    assert next(iter(to_dict(Config()).items())) == ("method", "fd4")


def test_an_unknown_method_is_refused_with_those_there_are():
    with pytest.raises(
        ValueError,
        match="unknown method 'fd5', expected one of ec-square, ec-l, midi-or, fd4, midi",
    ):
        from_dict({"method": "fd5"})


@pytest.mark.parametrize(
    ("path", "owner"),
    [
        ((), "Config"),
        (("data",), "DataConfig"),
        (("flagg",), "FlaggConfig"),
        (("flagg", "corruption"), "CorruptionConfig"),
        (("model",), "FD4Config"),
        (("optimiser",), "OptimiserConfig"),
    ],
)
@pytest.mark.parametrize("value", [3, {"deep": 3}])
def test_an_unknown_field_is_refused_with_the_fields_there_are(path, owner, value):
    values = to_dict(Config())
    place = values
    for name in path:
        place = place[name]
    first = next(name for name in place if name != "method")
    place["colour"] = value
    with pytest.raises(ValueError, match=f"unknown field 'colour' of {owner}, expected.*{first}"):
        from_dict(values)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (3, "the configuration is 3, expected an object"),
        ({"method": []}, r"unknown method \[\], expected one of"),
        ({"data": []}, r"DataConfig is \[\], expected an object"),
        ({"batch": "8"}, "Config.batch is '8', expected a whole number"),
        ({"batch": True}, "Config.batch is True, expected a whole number"),
        ({"initial": 3}, "Config.initial is 3, expected a text or None"),
        ({"flagg": {"ordering": "X"}}, "FlaggConfig.ordering is 'X', expected 'H' or 'HP'"),
        ({"flagg": {"continuations": "1"}}, "FlaggConfig.continuations is '1', expected a whole"),
        (
            {"optimiser": {"clip_norm": math.nan}},
            "OptimiserConfig.clip_norm is nan, expected a num",
        ),
        ({"optimiser": {"clip_norm": 10**400}}, "OptimiserConfig.clip_norm is 10*, expected a num"),
        ({"capacities": [24.5]}, r"Config.capacities is \(24.5,\), expected several, each a whole"),
    ],
)
def test_a_value_of_another_type_is_refused_by_its_field(values, sentence):
    with pytest.raises(ValueError, match=sentence):
        from_dict(values)


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"steps": 0}, "steps is 0, expected at least 1"),
        ({"batch": -1}, "batch is -1, expected at least 1"),
        ({"steps_per_call": 0}, "steps_per_call is 0, expected at least 1"),
        ({"validate_every": 0}, "validate_every is 0, expected at least 1"),
        ({"validation_graphs": 0}, "validation_graphs is 0, expected at least 1"),
        ({"steps": 9}, "steps is 9, expected a multiple of steps_per_call, 2"),
        ({"validate_every": 3}, "validate_every is 3, expected a multiple of steps_per_call, 2"),
        ({"fresh_every": 0}, "fresh_every is 0, expected at least 1"),
        ({"fresh_every": 3}, "fresh_every is 3, expected a multiple of steps_per_call, 2"),
        ({"steps": 2}, "optimiser.warmup_steps is 2, expected 0 to 1"),
        (
            {"optimiser": OptimiserConfig(warmup_steps=-1)},
            "warmup_steps is -1, expected at least 0",
        ),
        (
            {"optimiser": OptimiserConfig(ema_decay=1.5)},
            "optimiser.ema_decay is 1.5, expected at mo",
        ),
        ({"model": MiDiConfig(node_width=-8)}, "model.node_width is -8, expected at least 1"),
        ({"model": MiDiConfig(layers=10**6)}, "model.layers is 1000000, expected at most 100"),
        ({"flagg": FlaggConfig(coins=(1, 0))}, "flagg.coins is 0, expected at least 1"),
        ({"flagg": None}, "flagg of fd4 is None, expected how it grows"),
        ({"model": MODELS["ec-l"]}, "flagg of ec-l is FlaggConfig.*, expected None, because it"),
        ({"capacities": ()}, r"capacities is \[\], expected increasing node counts"),
        ({"capacities": (48, 24)}, r"capacities is \[48, 24\], expected increasing"),
        ({"capacities": (24, 24)}, r"capacities is \[24, 24\], expected increasing"),
    ],
)
def test_what_no_run_can_follow_is_refused(fields, sentence):
    with pytest.raises(ValueError, match=sentence):
        check(changed(**fields))
