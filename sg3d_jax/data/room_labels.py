"""What real floor plans call their rooms, as kinds of rooms of furnished scenes.

The labels are those of the plans that `floorplan` reads: Japanese flats (source "r2v"), whose rooms
may have several joined by "+", and floors of schools and offices ("aislab-...").

Source: art-programmer/FloorplanTransformation and goldleaf3i/generativeCMLgraphs, in whose files
the labels stand. What they are called here is our reading of them: a room to live, cook and sleep
in is a living room, as in the scenes that we draw; shafts and service rooms are storage; a lift, or
a room of which only the size is stated, is of no kind.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from sg3d_jax.data.furnished_objects import NO_OBJECTS
from sg3d_jax.data.furnished_rooms import Zones
from sg3d_jax.data.furnished_scene import Furniture, furnished
from sg3d_jax.scene.graph import SceneGraph, parts_first
from sg3d_jax.scene.ontology import FLOOR

# Of a room with several labels the first of these counts.
_FLAT: Final[Mapping[str, str]] = MappingProxyType(
    {
        "living_room": "living room",
        "bedroom": "bedroom",
        "kitchen": "kitchen",
        "bathroom": "bathroom",
        "restroom": "bathroom",
        "corridor": "corridor",
        "entrance": "corridor",
        "stairs": "stairwell",
        "washing_room": "bathroom",
        "closet": "storage",
        "ps": "storage",
        "balcony": "balcony",
    }
)
_WORKPLACE: Final[Mapping[str, str]] = MappingProxyType(
    {
        "classroom": "classroom",
        "lab": "classroom",
        "office": "office",
        "shared office": "office",
        "executive office": "office",
        "cubicule": "office",
        "openspace": "office",
        "reception": "office",
        "small administrative": "office",
        "medium administrative": "office",
        "big administrative": "office",
        "conference": "meeting room",
        "conference room": "meeting room",
        "corridor": "corridor",
        "entrance": "corridor",
        "hall": "hall",
        "lobby": "hall",
        "gym": "hall",
        "canteen": "hall",
        "cafeteria": "hall",
        "library": "hall",
        "conference hall": "hall",
        "kitchen": "kitchen",
        "bathroom": "bathroom",
        "washroom": "bathroom",
        "closet": "storage",
        "convenience store": "storage",
        "small service": "storage",
        "medium service": "storage",
        "big service": "storage",
        "collective service room": "storage",
        "stairs": "stairwell",
    }
)


def kind_of(label: str) -> str:
    """Returns the kind of a room by its label, in upper or lower case; "" if it has none."""
    label = label.lower()
    parts = label.split("+")
    if {"bedroom", "kitchen"} <= {*parts}:
        return "living room"
    known = (kind for name, kind in _FLAT.items() if name in parts)
    return _WORKPLACE.get(label) or next(known, "")


def labelled(graph: SceneGraph, names: Mapping[int, str]) -> SceneGraph:
    """Returns a graph of a real plan as one of a furnished scene, for the kinds of its rooms.

    Args:
      graph: of the paper's concepts, as `levels` makes them of floor plans.
      names: what its nodes are called, by row; of rooms it is their label.

    Returns:
      A graph of `FURNISHED_ONTOLOGY` without doors, stairs and objects. Every floor is one unit: a
      flat if its rooms are labelled as those of flats are. Else its units are not known, and the
      one that is there is of no kind.
    """
    floors = np.flatnonzero(graph.nodes.label == FLOOR)
    part, whole = parts_first(graph).T
    furniture = []
    for floor in floors:
        called = [names.get(room, "") for room in np.sort(part[whole == floor]).tolist()]
        is_flat = any(each in _FLAT for label in called for each in label.split("+"))
        zones = Zones(
            [kind_of(label) for label in called],
            [0] * len(called),
            ["flat" if is_flat else ""],
            None,
        )
        furniture.append(Furniture(zones, [], NO_OBJECTS))
    return furnished(graph, graph.nodes.position[floors, 2].tolist(), furniture, [])
