import json
import resource
import shutil
import signal

import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import pytest

from sg3d_jax.train import checkpoint
from sg3d_jax.train.step import TrainState


def state_at(step):
    params = {"a": jnp.array([jnp.pi, 1e-30]) * step, "b": jnp.ones(2, jnp.int32) * step}
    return TrainState(params, jax.tree.map(lambda leaf: 2 * leaf, params), (), jnp.asarray(step))


@pytest.fixture
def save(tmp_path):
    """Saves states with scores, and returns what is kept."""

    def save_all(scores):
        checkpoints = checkpoint.open_checkpoints(tmp_path / "checkpoints")
        for step, fgw in scores:
            checkpoint.save(checkpoints, state_at(step), fgw)
        return reopened(tmp_path / "checkpoints")

    return save_all


def reopened(folder):
    return checkpoint.steps(checkpoint.open_checkpoints(folder))


@pytest.mark.parametrize(
    ("scores", "kept"),
    [
        ([0.3], [(1, 0.3)]),
        ([0.3, 0.1, 0.2, 0.4], [(2, 0.1), (3, 0.2), (4, 0.4)]),
        ([0.3, 0.2, 0.1], [(2, 0.2), (3, 0.1)]),
        ([np.inf, 0.5, np.nan, np.inf], [(2, 0.5), (3, np.inf), (4, np.inf)]),
    ],
)
def test_the_latest_two_and_the_best_are_kept(save, scores, kept):
    assert save(list(enumerate(scores, 1))) == kept


def test_a_state_is_restored_bit_for_bit(save, tmp_path):
    save([(3, 0.2), (7, 0.1)])
    checkpoints = checkpoint.open_checkpoints(tmp_path / "checkpoints")
    restored = checkpoint.restore(checkpoints, state_at(0), 7)
    assert jax.tree.structure(restored) == jax.tree.structure(state_at(7))
    for one, other in zip(*map(jax.tree.leaves, (restored, state_at(7))), strict=True):
        assert one.dtype == other.dtype
        npt.assert_array_equal(one, other)


def largest_file(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return max(files, key=lambda path: path.stat().st_size)


def cut(folder):
    path = largest_file(folder)
    path.write_bytes(path.read_bytes()[:-9])


def flip(folder):
    path = largest_file(folder)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def empty(folder):
    shutil.rmtree(folder)
    folder.mkdir()


def set_metric(value, folder, of_an_earlier_version=True):
    if of_an_earlier_version:
        (folder / "digest").unlink()
    (folder / "metrics" / "metrics").write_text(json.dumps({"fgw": value}))


DAMAGES = {
    "empty folder": empty,
    "cut file": cut,
    "flipped bit": flip,
    "no metrics": lambda folder: shutil.rmtree(folder / "metrics"),
    "not a number": lambda folder: set_metric(float("nan"), folder),
    "another metric": lambda folder: set_metric(0.01, folder, of_an_earlier_version=False),
    "no number": lambda folder: set_metric(None, folder),
    "stray number": lambda folder: folder.with_name("9").mkdir(),
    "number of another step": lambda folder: shutil.copytree(folder, folder.with_name("9")),
}


@pytest.fixture(scope="module")
def three_saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("three") / "checkpoints"
    checkpoints = checkpoint.open_checkpoints(folder)
    for step, fgw in ((1, 0.3), (2, 0.2), (3, 0.1)):
        checkpoint.save(checkpoints, state_at(step), fgw)
    return folder


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_checkpoint_is_set_aside_and_the_one_before_it_is_the_latest(
    three_saved, tmp_path, capfd, damage
):
    folder = shutil.copytree(three_saved, tmp_path / "checkpoints")
    DAMAGES[damage](folder / "3")
    name, kept = ("9", [(2, 0.2), (3, 0.1)]) if (folder / "9").exists() else ("3", [(2, 0.2)])
    capfd.readouterr()
    checkpoints = checkpoint.open_checkpoints(folder)
    assert checkpoints.damaged == (name,)
    assert checkpoint.steps(checkpoints) == kept
    assert [path.name for path in (tmp_path / "damaged").iterdir()] == [f"{name}-1"]
    assert capfd.readouterr() == ("", "")


def test_what_was_set_aside_is_made_again_and_may_be_set_aside_again(three_saved, tmp_path):
    folder = shutil.copytree(three_saved, tmp_path / "checkpoints")
    for _ in range(2):
        cut(folder / "3")
        checkpoints = checkpoint.open_checkpoints(folder)
        checkpoint.save(checkpoints, state_at(3), 0.1)
        assert checkpoint.steps(checkpoints) == [(2, 0.2), (3, 0.1)]
    assert sorted(path.name for path in (tmp_path / "damaged").iterdir()) == ["3-1", "3-2"]


def test_what_a_killed_process_left_unfinished_is_removed_and_hinders_nothing(save, tmp_path):
    save([(1, 0.3)])
    names = "2.unfinished", "2.unfinished.orbax-checkpoint-tmp"
    for name in names:
        (tmp_path / "checkpoints" / name).mkdir()
    (tmp_path / "checkpoints" / "1" / "digest").unlink()  # killed just before it was written
    assert reopened(tmp_path / "checkpoints") == [(1, 0.3)]
    assert not any((tmp_path / "checkpoints" / name).exists() for name in names)


def test_a_full_disk_is_one_sentence_and_harms_no_checkpoint_before(save, tmp_path, capfd):
    save([(1, 0.3)])
    capfd.readouterr()
    checkpoints = checkpoint.open_checkpoints(tmp_path / "checkpoints")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    previous = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        with pytest.raises(OSError, match=r"checkpoints/2: the checkpoint could not") as caught:
            checkpoint.save(checkpoints, state_at(2), 0.2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, previous)
    assert "File too large" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")
    assert reopened(tmp_path / "checkpoints") == [(1, 0.3)]


def test_a_new_directory_has_none(tmp_path):
    assert reopened(tmp_path / "new") == []
