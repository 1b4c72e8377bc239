"""What the rooms of a storey are for."""

import numpy as np
import pytest

from sg3d_jax.data.floorplan import storey_of_rooms
from sg3d_jax.data.furnished_plan import layout_of
from sg3d_jax.data.furnished_rooms import find_stairwells

HALL = [(0, 0), (8, 0), (8, 6), (0, 6)]


def layout(*boxes):
    """A hall of 8 x 6 m, and rooms beside it."""
    rooms = [HALL, *([(a, b), (c, b), (c, d), (a, d)] for a, b, c, d in boxes)]
    return layout_of(storey_of_rooms([np.array(room, float) for room in rooms]))


@pytest.mark.parametrize(
    ("above", "room"),
    [
        ((8.2, 0, 11.2, 3), 1),  # as below
        ((8.2, 0.4, 11.2, 3), 1),  # nearly so
        ((8.2, 0, 12.2, 6), None),  # another room, of which the one below is a part
        ((8.2, 3.2, 11.2, 6), None),  # beside it
    ],
)
def test_stairs_are_where_storeys_have_rooms_above_one_another(above, room):
    below = layout((8.2, 0, 11.2, 3))
    assert find_stairwells([below, layout(above)], np.random.default_rng(0)) == [1, room]


def test_there_are_no_stairs_in_the_largest_room_or_a_cupboard():
    assert find_stairwells([layout((8.2, 0, 9.4, 6))], np.random.default_rng(0)) == [None]
