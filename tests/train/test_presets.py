"""Names of methods on data sets, and the configurations behind them."""

import dataclasses
from pathlib import Path

import pytest

from sg3d_jax.data.registry import DATASETS
from sg3d_jax.train import presets
from sg3d_jax.train.config import Config, DataConfig, check
from sg3d_jax.train.methods import METHODS
from sg3d_jax.train.presets import BASELINES, find_config, parse
from sg3d_jax.train.weights import names
from tests.tiny_run import CONFIGS, read_config


@pytest.mark.parametrize("method", [*BASELINES, *METHODS])
def test_a_name_is_a_method_and_a_data_set(method):
    for data in DATASETS:
        assert parse(f"{method}-{data}") == (method, data)
    for name in (method, f"{method}-", f"{method}-s-g", f"x{method}-s-f", f"{method}_s_f"):
        assert parse(name) is None


@pytest.mark.parametrize("method", METHODS)
def test_every_method_has_a_configuration_for_every_data_set(method):
    for data in DATASETS:
        config = find_config(f"{method}-{data}")
        assert (config.method, config.data.name) == (method, data)
        check(config)


def test_a_run_starts_from_weights_that_come_with_the_package_or_of_another_configuration():
    for path in CONFIGS.glob("*.py"):
        config = read_config(path.stem)
        start = config.initial
        if start is None:
            continue
        if start.endswith(".npz"):
            named = parse(Path(start).parent.name)
            assert start == f"runs/{'-'.join(named)}/weights.npz"
            assert (CONFIGS / f"{'_'.join(named)}.py".replace("-", "_")).is_file()
            method = named.method
        else:
            assert start in names()
            method = find_config(start).method
        assert method == config.method


def test_a_configuration_of_that_name_comes_first_else_it_is_that_of_the_home():
    assert find_config("fd4-s-f-square") == read_config("fd4_s_f_square")
    assert find_config("midi-general") == read_config("midi_general")  # no data set, but a mixture
    expected = dataclasses.replace(read_config("fd4_s_f"), data=DataConfig("large"))
    assert find_config("fd4-large") == expected
    home = read_config("ec_square_s_f_square")
    assert find_config("ec-square-s-f") == dataclasses.replace(home, data=DataConfig("s-f"))


def test_a_file_is_read():
    assert find_config(str(CONFIGS / "test.py")) == read_config("test")


def test_an_installed_package_has_its_own_configurations(tmp_path, monkeypatch):
    (tmp_path / "configs").mkdir()
    own = "from sg3d_jax.train.config import Config\nCONFIG = Config(steps=50)\n"
    (tmp_path / "configs" / "fd4_s_f.py").write_text(own)
    monkeypatch.setattr(presets, "PACKAGE", tmp_path)
    assert find_config("fd4-s-f") == Config(steps=50)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("rand-s-f", "rand has nothing to train, it is fitted by `sg3d evaluate rand-s-f`"),
        ("rand-sized-s-f", "rand-sized has nothing to train"),
        ("fd5-s-f", "fd5-s-f: neither a configuration file nor METHOD-DATASET, expected .* fd4"),
        ("fd4-s-g", "fd4-s-g: neither a configuration file nor METHOD-DATASET"),
        ("nothing.py", "nothing.py: no such configuration file"),
    ],
)
def test_what_is_no_configuration_is_refused(name, sentence):
    with pytest.raises(ValueError, match=sentence):
        find_config(name)
