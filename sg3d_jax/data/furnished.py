"""Concepts and settings of furnished scenes: the sets O-F and O-C, which are our own.

Beside planes a robot sees doors, stairs and objects; rooms are of a kind and make up units, which
are flats, departments of offices and schools, and what several of them share. `furnished_scene`
draws such scenes; this file does without shapely.
"""

from dataclasses import dataclass
from typing import Final

from sg3d_jax.data.wide import WideConfig
from sg3d_jax.scene.ontology import CITY, Concept, Ontology, Rule

OBJECT_KINDS: Final = (
    "bed",
    "table",
    "chair",
    "sofa",
    "desk",
    "cupboard",
    "shelf",
    "sink",
    "toilet",
    "bath",
    "stove",
    "fridge",
    "washer",
    "board",
)
ROOM_KINDS: Final = (
    "bedroom",
    "living room",
    "kitchen",
    "bathroom",
    "corridor",
    "storage",
    "balcony",
    "office",
    "meeting room",
    "classroom",
    "hall",
    "stairwell",
)
UNIT_KINDS: Final = ("flat", "department", "common")

# A door is part of the two rooms that it joins, or of one at an entrance; stairs are part of the
# stairwells of both storeys. Every room belongs to one unit: what several units share, such as
# stairwells and corridors, makes up a unit of its own.
FURNISHED_ONTOLOGY: Final = Ontology(
    concepts=(
        Concept("plane", "#1d4ed8", "p", "PLANES", observed=True, features=("normal", "width")),
        Concept("door", "#651c03", "d", "DOORS", observed=True, features=("width",)),
        Concept("stairs", "#510d6a", "s", "STAIRS", observed=True, features=("width",)),
        Concept(
            "object",
            "#ff0daf",
            "O",
            "OBJECTS",
            observed=True,
            features=("width", "kind"),
            kinds=OBJECT_KINDS,
        ),
        Concept("wall", "#fbbf24", "w", "WALLS", least_parts=2),
        Concept(
            "room", "#e6160b", "R", "ROOMS", features=("kind",), kinds=ROOM_KINDS, hears_kin=True
        ),
        Concept(
            "unit", "#4f5058", "U", "UNITS", features=("kind",), kinds=UNIT_KINDS, hears_kin=True
        ),
        Concept("floor", "#1a9961", "F", "FLOORS", hears_kin=True),
        Concept("building", "#00d8fd", "B", "BUILDINGS", above=True, hears_kin=True),
        Concept("city", "#111111", "C", "CITIES", above=True, hears_kin=True),
    ),
    rules=(
        Rule("plane", "wall", single=False),
        Rule("plane", "room"),
        Rule("door", "room", single=False),
        Rule("stairs", "room", single=False),
        Rule("object", "room"),
        Rule("room", "unit"),
        Rule("unit", "floor"),
        Rule("floor", "building"),
        Rule("building", "city"),
    ),
)


@dataclass(frozen=True)
class FurnishedConfig:
    """How furnished scenes are drawn.

    Attributes:
      scene: how the rooms, storeys and buildings are; its numbers of nodes are without furniture.
      furnished: share of the rooms that have furniture.
      max_objects: greatest number of objects of a room.
      inner_doors: probability of a door between rooms of a unit that are joined otherwise, too.
      stairwells: share of the graphs of one floor, of five rooms or more, that have a stairwell
        where one fits, as if cut out of a building; buildings of several storeys have one where it
        fits.

    Raises:
      ValueError: a share is none, or rooms can have no objects.
    """

    scene: WideConfig = WideConfig(size=(12, 210), max_nodes=270)
    furnished: float = 0.92
    max_objects: int = 8
    inner_doors: float = 0.12
    stairwells: float = 0.4

    def __post_init__(self) -> None:
        """Refuses settings that no scene can be drawn with."""
        for name in ("furnished", "inner_doors", "stairwells"):
            share = getattr(self, name)
            if not 0 <= share <= 1:
                raise ValueError(f"{name} is {share:g}, expected 0 to 1")
        if self.max_objects < 1:
            raise ValueError(f"max_objects is {self.max_objects}, expected one or more")


O_F: Final = FurnishedConfig()
O_C: Final = FurnishedConfig(
    WideConfig(top=CITY, size=(30, 330), max_nodes=360, buildings=(1, 6), storeys=(1, 6))
)
