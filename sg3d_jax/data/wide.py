"""Settings of scenes as wide as the world: the sets G-F, G-B and G-C, which are our own.

`wide_scene` draws them, `wide_rooms` and `wide_plan` the floors; this file does without shapely.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from sg3d_jax.data.wide_rooms import FOOTPRINTS
from sg3d_jax.scene.ontology import BUILDING, CITY, FLOOR, PAPER_ONTOLOGY


@dataclass(frozen=True)
class WideConfig:
    """How scenes are drawn.

    Attributes:
      top: highest concept of the graph: `FLOOR`, `BUILDING` or `CITY`.
      size: least and greatest number of nodes that are aimed at; most scenes are small.
      max_nodes: a building that would exceed so many nodes is left out.
      buildings: least and greatest number of buildings of a city.
      storeys: least and greatest number of storeys of a building.
      kinds: how often each kind of `FOOTPRINTS` is drawn where it can have as many rooms.
      thickness: range of the thickness of walls, metres, uniform in its logarithm. A building has
        one for most of its walls and a greater one for the others.
      thick_walls: share of the lines of walls that have the greater thickness.
      lined: share of the sides of rooms that have a lining, of 2 to 7 cm: on its other side a wall
        may be straight where it is not on this one.
      storey_height: range of the metres from floor to floor, one draw a building.
      tall_ground: probability that a ground floor has a height of its own.
      alike: probability that a storey is like the one below.
      askew: probability that the walls of a building do not meet at right angles: lines in a fan or
        askew, or a building that bends up to five times.
      cut_floors: probability that a storey has rooms that are cut off at an angle.
      unevenness: greatest height of a building above or below the first, metres.

    Raises:
      ValueError: a range is empty, or a share is none.
    """

    top: int = FLOOR
    size: tuple[int, int] = (8, 450)
    max_nodes: int = 1000
    buildings: tuple[int, int] = (1, 1)
    storeys: tuple[int, int] = (1, 1)
    kinds: tuple[float, ...] = (0.12, 0.4, 0.28, 0.08, 0.12)
    thickness: tuple[float, float] = (0.05, 0.45)
    thick_walls: float = 0.3
    lined: float = 0.03
    storey_height: tuple[float, float] = (2.4, 5.0)
    tall_ground: float = 0.3
    alike: float = 0.5
    askew: float = 0.3
    cut_floors: float = 0.25
    unevenness: float = 4.0

    def __post_init__(self) -> None:
        """Refuses settings that no scene can be drawn with."""
        for name in ("size", "buildings", "storeys", "thickness", "storey_height"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise ValueError(f"{name} is ({low:g}, {high:g}), expected 0 < least <= greatest")
        for name in ("thick_walls", "lined", "tall_ground", "alike", "askew", "cut_floors"):
            share = getattr(self, name)
            if not 0 <= share <= 1:
                raise ValueError(f"{name} is {share:g}, expected 0 to 1")
        if len(self.kinds) != len(FOOTPRINTS) or not sum(self.kinds) > 0 or min(self.kinds) < 0:
            raise ValueError(f"kinds is {self.kinds}, expected a share of each of {[*FOOTPRINTS]}")
        if self.top not in (FLOOR, BUILDING, CITY):
            raise ValueError(f"top is {self.top}, expected {FLOOR}, {BUILDING} or {CITY}")
        for name, lowest in (("storeys", BUILDING), ("buildings", CITY)):
            most = getattr(self, name)[1]
            if self.top < lowest and most > 1:
                raise ValueError(
                    f"{name} reaches {most} below a {PAPER_ONTOLOGY.names[lowest]}, expected 1"
                )
        if not 0 <= self.unevenness < np.inf:
            raise ValueError(f"unevenness is {self.unevenness:g}, expected 0 m or more")


G_F: Final = WideConfig()
G_B: Final = WideConfig(top=BUILDING, size=(20, 600), storeys=(1, 6))
G_C: Final = WideConfig(top=CITY, size=(30, 700), buildings=(1, 6), storeys=(1, 6))
