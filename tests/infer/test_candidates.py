import numpy as np
import pytest

from sg3d_jax.infer.candidates import medoids
from sg3d_jax.metrics.fgw import fgw_pairs
from tests.two_rooms import NUM_PLANES, two_rooms

SCENE = two_rooms()


def shifted(metres):
    """The scene with everything but its planes moved."""
    position = SCENE.nodes.position + metres * (np.arange(12) >= NUM_PLANES)[:, None]
    return SCENE._replace(nodes=SCENE.nodes._replace(position=position))


def test_the_medoid_is_the_candidate_of_least_mean_distance():
    rng = np.random.default_rng(0)
    candidates = [[shifted(metres) for metres in rng.normal(size=count)] for count in (5, 3, 4)]
    chosen = medoids(candidates)
    for graphs, index in zip(candidates, chosen, strict=True):
        means = [np.mean(fgw_pairs([one] * len(graphs), graphs).value) for one in graphs]
        assert means[index] <= min(means) + 1e-6


def test_an_outlier_is_never_chosen():
    graphs = [shifted(5.0), shifted(0.0), shifted(0.01)]
    for turn in range(3):
        turned = graphs[turn:] + graphs[:turn]
        assert turned[medoids([turned])[0]] is not graphs[0]


def test_the_first_is_chosen_where_there_is_no_choice():
    assert medoids([[SCENE], [SCENE, shifted(1.0)], [SCENE] * 3]) == [0, 0, 0]
    assert medoids([]) == []


def test_a_scene_without_candidates_is_refused():
    with pytest.raises(ValueError, match="scene 1 has no candidates, expected at least one"):
        medoids([[SCENE], []])
