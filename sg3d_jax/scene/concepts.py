"""The concepts of a 3D scene graph, bottom-up, and which of them may be part of which.

Source: paper, Sec. "Problem definition". Labels are small integers in insertion order, so that
`label[i] < label[j]` means that concept i is inserted before concept j.
"""

from typing import Final

CONCEPTS: Final = ("plane", "wall", "room", "floor", "building", "city")
PLANE, WALL, ROOM, FLOOR, BUILDING, CITY = range(len(CONCEPTS))
NUM_CONCEPTS: Final = len(CONCEPTS)

RELATIONS: Final = ("proximity", "part_of")
PROXIMITY, PART_OF = range(len(RELATIONS))
NUM_RELATIONS: Final = len(RELATIONS)

# (child, parent). Walls have no parent: the one exception to the strict hierarchy.
PART_OF_RULES: Final = frozenset(
    {(PLANE, WALL), (PLANE, ROOM), (ROOM, FLOOR), (FLOOR, BUILDING), (BUILDING, CITY)}
)

# (child, parent) where a part has one whole. A plane may bound a room and several walls.
SINGLE_PARENT: Final = ((PLANE, ROOM), (ROOM, FLOOR), (FLOOR, BUILDING), (BUILDING, CITY))
