"""Complete graphs that a robot sees, for the tests of what it sees of them."""

import pytest

from sg3d_jax.data import synthetic
from tests.seen_rooms import S_C, S_F


@pytest.fixture(scope="module")
def floors():
    return [synthetic.make_scene(S_F, 0, index) for index in range(20)]


@pytest.fixture(scope="module")
def cities():
    return [synthetic.make_scene(S_C, 0, index) for index in range(6)]
