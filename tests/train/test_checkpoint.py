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
        checkpoints = checkpoint.open_checkpoints(tmp_path)
        for step, fgw in scores:
            checkpoint.save(checkpoints, state_at(step), fgw)
        checkpoint.close(checkpoints)
        return reopened(tmp_path)

    return save_all


def reopened(folder):
    checkpoints = checkpoint.open_checkpoints(folder)
    kept = checkpoint.steps(checkpoints)
    checkpoint.close(checkpoints)
    return kept


@pytest.mark.parametrize(
    ("scores", "kept"),
    [
        ([0.3], [(1, 0.3)]),
        ([0.3, 0.1, 0.2, 0.4], [(2, 0.1), (4, 0.4)]),
        ([0.3, 0.2, 0.1], [(3, 0.1)]),
        ([np.inf, 0.5, np.inf], [(2, 0.5), (3, np.inf)]),
    ],
)
def test_the_latest_and_the_best_are_kept(save, scores, kept):
    assert save(list(enumerate(scores, 1))) == kept


def test_a_state_is_restored_bit_for_bit(save, tmp_path):
    save([(3, 0.2), (7, 0.1)])
    checkpoints = checkpoint.open_checkpoints(tmp_path)
    restored = checkpoint.restore(checkpoints, state_at(0), 7)
    checkpoint.close(checkpoints)
    assert jax.tree.structure(restored) == jax.tree.structure(state_at(7))
    for one, other in zip(*map(jax.tree.leaves, (restored, state_at(7))), strict=True):
        assert one.dtype == other.dtype
        npt.assert_array_equal(one, other)


def test_a_new_directory_has_none(tmp_path):
    assert reopened(tmp_path / "new") == []
