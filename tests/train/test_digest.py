import numpy as np
import pytest

from sg3d_jax.train.digest import digest_of
from tests.tiny_run import small_floors


def test_a_digest_is_the_same_for_the_same_graphs_only():
    graphs = small_floors()[:3]
    assert digest_of(graphs) == digest_of([*graphs])
    moved = graphs[1].nodes.position.copy()
    moved[0, 0] = np.nextafter(moved[0, 0], np.inf)
    changed = graphs[1]._replace(nodes=graphs[1].nodes._replace(position=moved))
    assert digest_of(graphs) != digest_of([graphs[0], changed, graphs[2]])
    assert digest_of(graphs) != digest_of(graphs[::-1])


@pytest.mark.parametrize("other", [np.zeros(4, np.int64), np.zeros((2, 2)), np.zeros(4) - 0.0])
def test_a_digest_tells_types_and_shapes(other):
    same = other.dtype == float and other.shape == (4,)
    assert (digest_of([np.zeros(4)]) == digest_of([other])) == same
