"""Whether what is observed can be what it says: normals, units and widths against one another.

Planes that bound rooms face each other across these, and stand back to back across walls. That
tells normals that are flipped; how long planes are tells a unit that is no metre; planes that pass
through each other tell widths that are no widths. Nothing is refused here: a robot may be right.
"""

from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, ontology_of

# Measured on 300 of S-F-square, S-F and S-B each, 100 of S-C, 1,338 of P-F and three recordings.
ALIKE: Final = 0.966  # cosine: 15 degrees
PARALLEL: Final = 0.3  # sine, up to which planes do not cross
STOREY: Final = 1.5  # metres: beyond, centroids are not of one storey
OVERLAP: Final = 0.2  # metres
THICK: Final = 0.6  # metres: no wall is thicker, hardly a room narrower
TOUCHING: Final = 0.02  # metres: nearer than that, who is in front is noise
LEAST_VOTES: Final = 3  # and twice as many as against: of right scenes 0.13 as many vote wrong, and
# 0.67 where 30 % of the planes were missed; of flipped ones all are found, then nine of ten
DOLLS_HOUSE: Final = 0.8  # metres: half of the length is in narrower planes; least there is 0.94
TOWN: Final = 30.0  # metres: half of the length is in wider planes; the most there is 13.6
TOWN_HOUSE: Final = 12.0  # metres: likewise, of planes that show no wall as thin as walls are
LEAST_WALLED: Final = 8  # planes, fewer of which may well show no wall: two rooms have eight
CROSSING: Final = 0.3  # metres beyond which one plane passes through another
CROSSED: Final = 0.5  # share of planes; the most there is 0.42, and widths times 1.5 make 0.52
LEAST_EQUAL: Final = 5  # planes of one width: a square room has four
SQUARE: Final = 0.2  # share by which a room is off square

# Chosen on 80 validation scenes of each set, and of what a robot sees of some (RESULTS.md).
CORNER: Final = 0.35  # metres from the end of one plane to that of the next, at most
MARGINS: Final = (2, 1, 1)  # by which votes must say that a plane is flipped, round after round


class Layout(NamedTuple):
    """Planes seen from above, where (x, y) is the number x + iy."""

    row: np.ndarray  # int[n], that each has in the graph
    place: np.ndarray  # complex[n], middle as seen from the first, metres
    height: np.ndarray  # float[n], metres
    normal: np.ndarray  # complex[n], unit
    width: np.ndarray  # float[n], metres
    front: np.ndarray  # float[n], how far before each is the nearest opposite it; or infinity
    back: np.ndarray  # float[n], how far behind it
    alike_front: np.ndarray  # float[n], how far before each is the nearest that looks as it does
    alike_back: np.ndarray  # float[n], how far behind it
    touched: np.ndarray  # bool[n], whether one opposite it stands where it does


def layout(graph: SceneGraph) -> Layout:
    """Returns the observed nodes of a host graph that have a normal and a width.

    Args:
      graph: unpadded; normals horizontal and of unit length, metres.
    """
    nodes, ontology = graph.nodes, ontology_of(graph)
    rows = nodes.observed & (ontology.has("normal") & ontology.has("width"))[nodes.label]
    (x, y, height), width = nodes.position[rows].T, nodes.width[rows]
    place, normal = x + 1j * y, nodes.normal[rows, 0] + 1j * nodes.normal[rows, 1]
    return _layout(np.flatnonzero(rows), place - place[:1], height, normal, width)


def _layout(
    row: np.ndarray, place: np.ndarray, height: np.ndarray, normal: np.ndarray, width: np.ndarray
) -> Layout:
    """Measures how far before and behind each plane others are."""
    cosine = np.outer(normal.real, normal.real) + np.outer(normal.imag, normal.imag)
    plane, other = np.nonzero((np.abs(cosine) > ALIKE) & _of_one_storey(height))
    seen = normal[plane].conj() * (place[other] - place[plane])
    overlap = (width[plane] + width[other]) / 2 - np.abs(seen.imag)
    nearest = []
    for looks in (cosine[plane, other] < 0, cosine[plane, other] > 0):
        for distance in (seen.real, -seen.real):
            chosen = looks & (overlap > OVERLAP) & (distance > TOUCHING)
            of_each = np.full(len(width), np.inf)
            np.minimum.at(of_each, plane[chosen], distance[chosen])
            nearest.append(of_each)
    touching = (cosine[plane, other] < 0) & (overlap > OVERLAP) & (np.abs(seen.real) <= TOUCHING)
    touched = np.isin(np.arange(len(width)), plane[touching])
    return Layout(row, place, height, normal, width, *nearest, touched)


def look_flipped(planes: Layout) -> tuple[int, int] | None:
    """Decides whether normals point out of rooms, not into them.

    A plane that bounds a room has another opposite, across the room, and behind it nothing, or the
    other face of a wall. If its normal is flipped it is the reverse: nothing or a wall's face in
    front, a room behind. What has rooms on both sides, or on none, has no vote.

    Returns:
      How many planes say so, and how many the contrary, if those are so many more; else None.
    """

    def num_into_rooms(front: np.ndarray, back: np.ndarray) -> int:
        bounds = np.isinf(back) | (back <= THICK)
        return int(np.sum(bounds & np.isfinite(front) & (front > THICK)))

    votes = num_into_rooms(planes.back, planes.front)
    against = num_into_rooms(planes.front, planes.back)
    return (votes, against) if votes >= max(LEAST_VOTES, 2 * against) else None


def flipped_alone(planes: Layout) -> np.ndarray:
    """Decides which normals are flipped where those around them are not.

    A plane that is flipped has a room behind it, and before it a wall, or nothing. That is so, too,
    of one behind which a wall's other face was not seen, and across from which nothing was. So two
    more must say so than say the contrary, of: the corners at its ends, and a wall before it, the
    face of which looks as it does, not into its eyes. Where one is flipped others may be: of these
    one must, and it is asked again, as one that is flipped misleads those around it.

    Returns:
      bool[n], which.
    """
    flipped = np.zeros(len(planes.width), bool)
    for least in MARGINS:
        found = _look_into_walls(planes) >= least
        if not found.any():
            break
        flipped ^= found
        normal = np.where(found, -planes.normal, planes.normal)
        planes = _layout(planes.row, planes.place, planes.height, normal, planes.width)
    return flipped


def _look_into_walls(planes: Layout) -> np.ndarray:
    """Returns int[n], how many things more say that a plane is flipped than say the contrary.

    Zero unless it has a room behind it, and a wall or nothing before it.
    """
    before = np.minimum(planes.front, planes.alike_front)
    behind = np.minimum(planes.back, planes.alike_back)
    is_wall = before <= THICK
    may_be = np.isfinite(behind) & (behind > THICK) & (is_wall | np.isinf(before))
    may_be &= ~planes.touched  # one face seen twice, once in place of the wall's other face
    faces_away = np.where(planes.alike_front < planes.front, 1, -1)
    return np.where(may_be, is_wall * faces_away - _corner_votes(planes), 0)


def _corner_votes(planes: Layout) -> np.ndarray:
    """Returns int[n], at how many of its two ends each plane goes with the next, less the others.

    Who walks along a room, with its planes to the right, comes from the end of one to the beginning
    of the next. Two beginnings, or two ends, in one corner belong to planes that do not both look
    into a room.
    """
    crosses = np.abs((planes.normal[:, None].conj() * planes.normal).imag) > PARALLEL
    crosses &= _of_one_storey(planes.height)
    along = 0.5j * planes.normal * planes.width
    ends = planes.place - along, planes.place + along
    votes = np.zeros(len(planes.width), int)
    for one, other in (ends, ends[::-1]):
        same, next_ = (
            np.where(crosses, np.abs(one[:, None] - end), np.inf).min(axis=1, initial=np.inf)
            for end in (one, other)
        )
        meets = np.minimum(same, next_) < np.minimum(CORNER, planes.width / 2)
        votes += meets * np.where(same < next_, -1, 1)
    return votes


def remark_on_size(planes: Layout, plural: str) -> str | None:
    """Returns what to say of planes that are as wide as those of a doll's house, or of a town."""
    if not planes.width.any():
        return None
    width = np.sort(planes.width)
    length = np.cumsum(width)
    usual = width[np.searchsorted(length, length[-1] / 2)]
    walled = len(width) < LEAST_WALLED or np.min([planes.front, planes.back]) <= THICK
    if usual < DOLLS_HOUSE:
        size = "a doll's house"
    elif usual > TOWN or (usual > TOWN_HOUSE and not walled):
        size = "a town"
    else:
        return None
    return (
        f"the {plural} have the size of {size}, with widths of about {usual:.2g}: centroids and "
        "widths should be in metres"
    )


def remarks_on_widths(planes: Layout, plural: str) -> list[str]:
    """Returns what to say of widths that cannot be the extents of planes."""
    remarks, count = [], len(planes.width)
    if zero := int(np.sum(planes.width == 0)):
        remarks.append(f"{zero} of {count} {plural} have the width 0, which is no extent")
    elif _are_one_number(planes):
        held = f"{planes.width[0]:.6g}"
        remarks.append(f"all {count} {plural} have the width {held}, as if it were not known")
    if (crossed := _num_crossed(planes)) > CROSSED * count:
        remarks.append(
            f"{crossed} of {count} {plural} pass through others, as if their widths were too large"
        )
    return remarks


def _are_one_number(planes: Layout) -> bool:
    """Returns whether all widths are equal, though the rooms are not as square as that."""
    width = planes.width
    if len(width) < LEAST_EQUAL or np.ptp(width) > 1e-9 * width[0]:
        return False
    square = np.abs(planes.front - width) <= SQUARE * width
    return bool(np.mean(square) < 0.5)


def _num_crossed(planes: Layout) -> int:
    """Returns how many planes pass through another, by more than noise on all four sides."""
    reach = planes.width / 2 - CROSSING
    both = reach[:, None] + reach
    is_near = _of_one_storey(planes.height)
    for axis in (planes.place.real, planes.place.imag):
        is_near &= np.abs(axis[:, None] - axis) < both
    plane, other = np.nonzero(is_near)
    facing = planes.normal[plane].conj()
    turned = facing * planes.normal[other]
    crosses = np.abs(turned.imag) > PARALLEL
    plane, other, facing, turned = (each[crosses] for each in (plane, other, facing, turned))
    seen = facing * (planes.place[other] - planes.place[plane])
    on_other = np.abs(seen.real / turned.imag) < reach[other]
    on_one = np.abs(seen.imag - seen.real * turned.real / turned.imag) < reach[plane]
    return len(np.unique(plane[on_other & on_one]))


def _of_one_storey(height: np.ndarray) -> np.ndarray:
    """Returns bool[n, n], which planes are of one storey."""
    return np.abs(height - height[:, None]) < STOREY
