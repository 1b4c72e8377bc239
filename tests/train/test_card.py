"""Cards: what weights were trained on, in numbers that a scene can be held against."""

import numpy as np
import pytest

from sg3d_jax.data import registry
from sg3d_jax.io.planes import planes
from sg3d_jax.scene.graph import observed_of
from sg3d_jax.train.card import (
    Card,
    Score,
    card_from_json,
    card_of,
    card_to_json,
    described,
    measures_of,
    outside,
)


@pytest.fixture(scope="module")
def floors():
    return registry.make("s-f", 40)


@pytest.fixture(scope="module")
def card(floors):
    return card_of(floors)


def two_rooms_apart(gap):
    """Two rooms of 4 m x 3 m, a wall of a thickness between them; eight planes."""
    centres = np.array([[0.0, 0.0], [4.0 + gap, 0.0]])
    normal = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    middle = -normal * [2.0, 1.5]
    centroid = (centres[:, None] + middle).reshape(-1, 2)
    width = np.tile([3.0, 3.0, 4.0, 4.0], 2)
    pad = [(0, 0), (0, 1)]
    return planes(np.pad(centroid, pad), np.pad(np.tile(normal, (2, 1)), pad), width)


def test_measures__are_those_of_the_planes():
    found = measures_of(two_rooms_apart(0.25))
    assert found["number"] == 8
    assert found["width"] == 3.5
    np.testing.assert_allclose(found["extent"], 8.25)
    np.testing.assert_allclose(found["thickness"], 0.25)
    assert "thickness" not in measures_of(two_rooms_apart(3.0))


def test_scenes_of_the_training_set__are_inside_and_others_outside(floors, card):
    assert sum(outside(card, floor) is not None for floor in floors) <= 2
    assert outside(card, two_rooms_apart(0.09)) is None
    said = outside(card, two_rooms_apart(0.45))
    assert said.startswith("0.45 m back to back (0.0")
    assert said.endswith("in training)")
    large = registry.make("s-c", 1)[0]
    assert outside(card, observed_of(large)).split(" ")[1] == "planes"


def test_ranges__leave_rare_scenes_out_and_are_said_in_words(card):
    least, most = card.ranges["number"]
    assert 4 <= least < 8 < most < 60
    lines = described(card, "planes").split("\n")
    assert len(lines) == 4
    assert lines[1].endswith(" m across")


def test_scores__of_a_data_set_replace_those_that_were_there(card):
    first = card.with_score(Score("s-f", 10, 0.5, 0.1)).with_score(Score("s-c", 10, 0.4, 0.2))
    again = first.with_score(Score("s-f", 20, 0.3, 0.6))
    assert again.scores == (Score("s-c", 10, 0.4, 0.2), Score("s-f", 20, 0.3, 0.6))


def test_cards__come_back_from_json(card):
    full = Card(card.graphs, card.ranges, (Score("s-f", 10, 0.5, 0.1),), "a sentence")
    assert card_from_json(card_to_json(full)) == full
