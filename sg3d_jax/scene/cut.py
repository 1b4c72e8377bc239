"""Cutting what is observed across several rooms into pieces, and joining the pieces again.

A robot keeps one plane for a whole line of wall, however many rooms lie along it. A model that was
trained on planes of one room each cannot tell these apart, so a plane is cut where walls meet its
front, and what is grown on the pieces is given back to the planes.

Seen from its front a plane is an axis. Another that comes to it ends a room there, on the side that
it looks to. Two that look away from each other are the faces of a wall: the strip between them is
of neither room and is left out, so that pieces are as wide as the rooms are; a wall of which one
face alone was seen has no such strip. The other may end a little before the plane, as what was
occluded does; not so if it ends at something else: a corner, or what stands in between. A plane may
also have been measured too wide, and go on behind its corner. So what is left at an end, if it is
short, is a piece only where something closes it: another there that looks back along it.

Published cities have storeys that were shrunk to fit the one below while their planes kept their
widths: these poke through the corners of their rooms into others, but do not run along them. Since
middles are where they should be, a plane goes as far beyond its room at either end, and the sides
that it crosses there go beyond by the same share of their widths; lines of wall do not. Where that
is so to the centimetre, widths are no evidence: what hangs together with it by planes that cross is
not cut, nor does it cut anything.

A map also holds some faces twice, where one that was seen again was not known for it. Such a plane
lies where one before it does, to a centimetre or two and to half a degree, and is left out: it is
of no room, as in S-Graphs, which makes its rooms of the earlier ones. What lies farther off is a
plane of its own, for two faces may be so close.

Source: the reasoning node of S-Graphs splits planes that serve several rooms before it infers, and
maps the result back.
Differs: the rules are ours. That the planes which face a plane end, or step back, is no reason for
a cut: where the wall between was not seen it was right less often than wrong.
"""

import dataclasses
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import (
    SceneGraph,
    features_of,
    make_graph,
    ontology_of,
    undirected_edges,
)
from sg3d_jax.scene.ontology import PART_OF


@dataclasses.dataclass(frozen=True)
class CutRules:
    """What counts as a wall that meets a plane.

    Attributes:
      lost: how far from a plane another may end and still meet it, as a share of the width that is
        seen of the other: two thirds where up to 40 % of a wall is hidden.
      gap: the same in metres, whichever is less;
      share: but this share of the width always. Long planes are hidden behind more than one thing.
      depth: how much of it must lie in front of the plane, metres; less is a jamb or a pillar.
      parallel: planes whose normals have a cosine beyond this, up to the sign, run alongside each
        other and do not meet.
      touch: one that ends no farther away meets the plane, whatever stands around, metres. One that
        is seen again ends no farther beyond what was seen before.
      slack: how far planes that meet in a corner may end apart, metres.
      storey: planes whose middles differ by more in height have nothing to do with each other,
        metres.
      thickness: of a wall at most, metres; a shaft between two rooms is one, too.
      least: width of a piece at least, metres.
      loose: what is left at an end that nothing closes is no piece if it is less than this share of
        the width, and than `gap`.
      heading: how sure the heading of the other is, radians. Times half its width, it must meet the
        plane by so much farther from its ends.
      even: how well the overhangs of planes agree that were shrunk but kept their widths, metres.
        What a robot measures does not agree so well.
      again: how far apart, in metres,
      skew: and by how much turned, in radians, planes may be that are one seen twice,
      drawn: if they do not agree to so many metres and radians. No two sightings do: who drew such
        planes meant two.
    """

    lost: float = 0.67
    gap: float = 1.0
    share: float = 0.2
    depth: float = 0.4
    parallel: float = 0.9
    touch: float = 0.15
    slack: float = 0.3
    storey: float = 1.5
    thickness: float = 1.0
    least: float = 0.25
    loose: float = 0.1
    heading: float = 0.03
    even: float = 0.01
    again: float = 0.02
    skew: float = 0.0087
    drawn: float = 1e-4


CUTS: Final = CutRules()


class Pieces(NamedTuple):
    """What the observed nodes are cut into; those of one lie side by side in their order.

    A node that shows what one before it does has none.
    """

    owner: np.ndarray  # int[k], row of the observed node that each is a piece of, nondecreasing
    position: np.ndarray  # float[k, 3], middle, metres
    width: np.ndarray  # float[k], metres


class _Planes(NamedTuple):
    """Vertical planes from above, where (x, y) is the number x + iy."""

    middle: np.ndarray  # complex[n], metres
    normal: np.ndarray  # complex[n]
    half: np.ndarray  # float[n], half the width, metres
    height: np.ndarray  # float[n], metres

    @property
    def along(self) -> np.ndarray:
        """complex[n], unit, the direction in which each runs."""
        return 1j * self.normal


class _Views(NamedTuple):
    """Planes, second, as seen from others, first: float of one shape all, lengths in metres."""

    front: np.ndarray  # how far the middle of the second lies before the first
    along: np.ndarray  # how far along it
    cosine: np.ndarray  # of the angle between them
    slope: np.ndarray  # how fast one gets away from the first going along the second

    @property
    def at(self) -> np.ndarray:
        """Where the lines of both cross, metres from the middle along the first."""
        return self.along - self.front * self.cosine / self.slope


class _Meetings(NamedTuple):
    """Where planes are met at their front."""

    plane: np.ndarray  # int[m], the one that is met
    other: np.ndarray  # int[m], the one that meets it
    at: np.ndarray  # float[m], where their lines cross, metres from the middle of `plane` along it
    rest: np.ndarray  # float[m], how far before it the other ends, metres; less than zero beyond it


class _Cuts(NamedTuple):
    """Stretches of planes that are in no piece, sorted by plane, then along it."""

    plane: np.ndarray  # int[c]
    start: np.ndarray  # float[c], metres from the middle of the plane along it
    stop: np.ndarray  # float[c], not before `start`


def cut_observed(graph: SceneGraph, rules: CutRules = CUTS) -> Pieces:
    """Cuts the observed nodes of a host graph where walls meet their front.

    Args:
      graph: normals horizontal, of unit length. Observed nodes without normal or width stay whole,
        and so do those that have part-of edges.
      rules: what counts as a wall that meets a plane.

    Returns:
      Of a node that is not cut one piece, its position and width bit for bit; of others more, and
      none of planes that are seen a second time.
    """
    nodes, ontology = graph.nodes, ontology_of(graph)
    observed = np.flatnonzero(nodes.observed)
    is_plane = ontology.has("normal") & ontology.has("width")
    rows = observed[is_plane[nodes.label[observed]]]
    x, y, height = nodes.position[rows].T
    normal = nodes.normal[rows, 0] + 1j * nodes.normal[rows, 1]
    planes = _Planes(x + 1j * y, normal, nodes.width[rows] / 2, height)
    free = ~np.isin(rows, undirected_edges(graph, PART_OF))
    again = free & _seen_again(planes, nodes.label[rows], rules)
    observed = np.setdiff1d(observed, rows[again])
    rows, free, planes = rows[~again], free[~again], _Planes(*(field[~again] for field in planes))
    cuts = _cuts(planes, free, rules)
    owner = np.sort(np.concatenate([observed, rows[cuts.plane]]))
    position, width = nodes.position[owner], nodes.width[owner]
    is_cut = np.isin(owner, rows[cuts.plane])
    start, stop = _between(cuts, planes.half)
    along = planes.along[np.searchsorted(rows, owner[is_cut])]
    moved = (start + stop) / 2 * along
    position[is_cut, :2] += np.stack([moved.real, moved.imag], axis=1)
    width[is_cut] = stop - start
    return Pieces(owner, position, width)


def of_pieces(graph: SceneGraph, pieces: Pieces) -> SceneGraph:
    """Returns a host graph whose observed nodes are replaced by their pieces.

    Args:
      graph: unpadded.
      pieces: of `cut_observed(graph)`.

    Returns:
      The pieces, in all but position and width like their owners, then all other nodes in their
      order. Part-of edges stay; proximity edges are left out, since neighbours are others now.
    """
    rows = _rows_of(graph, pieces)
    features = {name: array[rows] for name, array in features_of(graph).items()}
    features["width"][: len(pieces.owner)] = pieces.width
    position = graph.nodes.position[rows]
    position[: len(pieces.owner)] = pieces.position
    place = np.zeros(len(graph.nodes.label), int)
    place[rows] = np.arange(len(rows))  # what has edges is neither cut nor left out
    return make_graph(
        graph.nodes.label[rows],
        position,
        **features,
        part_of=place[undirected_edges(graph, PART_OF)],
        ontology=ontology_of(graph),
    )


def joined(graph: SceneGraph, pieces: Pieces, given: SceneGraph) -> SceneGraph:
    """Gives what was grown on pieces to the nodes that they are pieces of.

    Args:
      graph: host graph whose first nodes are those of `of_pieces(given, pieces)`.
      pieces: of `cut_observed(given)`.
      given: the host graph that was cut.

    Returns:
      The nodes of `given`, bit for bit, then the further ones of `graph`. An edge of a piece is an
      edge of its owner, each once: a plane may be part of several rooms. No proximity edges.
    """
    rows = _rows_of(given, pieces)
    num_given, num_grown = len(given.nodes.label), len(graph.nodes.label) - len(rows)
    owner = np.concatenate([rows, num_given + np.arange(num_grown)])
    pairs = owner[undirected_edges(graph, PART_OF)]

    def both(of_given: np.ndarray, of_graph: np.ndarray) -> np.ndarray:
        return np.concatenate([of_given, of_graph[len(rows) :]])

    features = features_of(graph)
    return make_graph(
        both(given.nodes.label, graph.nodes.label),
        both(given.nodes.position, graph.nodes.position),
        **{name: both(array, features[name]) for name, array in features_of(given).items()},
        part_of=np.unique(pairs, axis=0),
        ontology=ontology_of(given),
    )


def _rows_of(graph: SceneGraph, pieces: Pieces) -> np.ndarray:
    """Returns the row of a graph from which each node of its graph of pieces is."""
    return np.concatenate([pieces.owner, np.flatnonzero(~graph.nodes.observed)])


def _seen_again(planes: _Planes, label: np.ndarray, rules: CutRules) -> np.ndarray:
    """Returns bool[n], which planes show nothing but what one before them does."""
    lies = planes.half + rules.touch
    first, later = np.nonzero(np.triu(_near(planes, lies[:, None], rules), 1))
    views = _views(planes, first, later)
    aside, skew = np.abs(views.front), np.abs(views.slope)
    agree = (views.cosine > 0) & (aside <= rules.again) & (skew <= rules.skew)
    measured = np.maximum(aside, skew) > rules.drawn
    within = np.abs(views.along) + planes.half[later] <= lies[first]
    alike = label[first] == label[later]
    return np.isin(np.arange(len(label)), later[agree & measured & within & alike])


def _cuts(planes: _Planes, free: np.ndarray, rules: CutRules) -> _Cuts:
    """Returns where planes are cut, of those that are free to be."""
    met = _meetings(planes, free, rules)
    plane, at = met.plane, met.at
    ahead = (planes.along[plane].conj() * planes.normal[met.other]).real > 0
    order = np.lexsort((ahead, at, plane))
    plane, at, ahead = plane[order], at[order], ahead[order]
    # What follows closely is one wall: two faces that look away from each other, as thick as walls
    # are; anything else only if no piece fits between.
    step = np.diff(at)
    is_wall = ~ahead[:-1] & ahead[1:] & (step <= rules.thickness)
    linked = (np.diff(plane) == 0) & (is_wall | (step < rules.least))
    first = np.flatnonzero(np.append(len(at) > 0, ~linked))
    last = np.append(first[1:], len(at))[: len(first)] - 1
    return _Cuts(plane[first], at[first], at[last])


def _meetings(planes: _Planes, free: np.ndarray, rules: CutRules) -> _Meetings:
    """Returns where planes that are free to be cut are met at their front."""
    plane, other = _crossing(planes, rules)
    views = _views(planes, plane, other)
    sound = ~_overhanging(planes, plane, other, rules)
    reach = planes.half[other] * np.abs(views.slope)
    near, at, width = views.front - reach, views.at, 2 * planes.half[other]
    comes = near <= np.maximum(np.minimum(rules.gap, rules.lost * width), rules.share * width)
    reaches = views.front + reach - np.maximum(near, 0) >= rules.depth
    room = planes.half[plane] - rules.least - rules.heading * planes.half[other]
    within = (free & sound)[plane] & sound[other] & comes & reaches & (np.abs(at) <= room)
    within &= ~_loose(planes, plane, views, comes & (views.front + reach >= 0), rules)
    met = _Meetings(plane[within], other[within], at[within], near[within])
    doubtful = np.flatnonzero(met.rest > rules.touch)
    some = _Meetings(*(field[doubtful] for field in met))
    level = np.abs(planes.height[some.plane, None] - planes.height) <= rules.storey
    ends = _screened(planes, some, rules) | _turned(planes, some, rules)
    refuted = np.any(ends & level, axis=1)
    return _Meetings(*(np.delete(field, doubtful[refuted]) for field in met))


def _crossing(planes: _Planes, rules: CutRules) -> tuple[np.ndarray, np.ndarray]:
    """Returns int[m] each, the pairs of planes of one storey that may meet and are not parallel.

    Most are too far apart for anything else to be asked of them.
    """
    widest = np.maximum(rules.gap, 2 * rules.share * planes.half)
    reach = planes.half + widest / np.sqrt(1 - rules.parallel**2)
    plane, other = np.nonzero(_near(planes, reach[:, None] + reach, rules))
    crosses = np.abs(_views(planes, plane, other).cosine) < rules.parallel
    return plane[crosses], other[crosses]


def _near(planes: _Planes, reach: np.ndarray, rules: CutRules) -> np.ndarray:
    """Returns bool[n, n], which planes of one storey have middles no farther apart than `reach`.

    Along x and along y, each on its own.
    """
    is_near = np.abs(planes.height[:, None] - planes.height) <= rules.storey
    for axis in (planes.middle.real, planes.middle.imag):
        is_near &= np.abs(axis[:, None] - axis) <= reach
    return is_near


def _views(planes: _Planes, plane: np.ndarray, other: np.ndarray) -> _Views:
    """Returns some planes as seen from others; rows that broadcast against each other."""
    facing = planes.normal[plane].conj()
    seen = facing * (planes.middle[other] - planes.middle[plane])
    turned = facing * planes.normal[other]
    return _Views(seen.real, seen.imag, turned.real, -turned.imag)


def _overhanging(
    planes: _Planes, plane: np.ndarray, other: np.ndarray, rules: CutRules
) -> np.ndarray:
    """Returns which planes are of storeys that were shrunk but kept their widths, bool[n].

    Args:
      planes: n of them.
      plane: int[m], of the pairs that cross on one storey, and
      other: int[m], what crosses it.
      rules: how well overhangs agree.
    """
    views, back = _views(planes, plane, other), _views(planes, other, plane)
    at, half, half_other = views.at, planes.half[plane], planes.half[other]
    beyond, beyond_other = half - np.abs(at), half_other - np.abs(back.at)
    # One that ends at another is as wide as it seems: a line of wall of a regular building.
    ends = (np.abs(beyond) <= rules.even) & (beyond_other >= -rules.even)
    has_end = np.isin(np.arange(len(planes.half)), plane[ends])
    through = np.minimum(beyond, beyond_other) > rules.even
    inward = at * views.slope > 0
    is_even = np.abs(beyond * half_other - beyond_other * half) <= rules.even * half
    corner = np.flatnonzero(through & inward & is_even & ~has_end[plane])
    corner = corner[np.lexsort((np.abs(at[corner]), plane[corner]))]
    one, next_one = corner[:-1], corner[1:]
    both = (plane[one] == plane[next_one]) & (np.abs(at[one] + at[next_one]) <= rules.even)
    found = np.isin(np.arange(len(planes.half)), plane[one[both]])
    plane, other = plane[through], other[through]
    while not found[reached := other[found[plane]]].all():
        found[reached] = True
    return found


def _loose(
    planes: _Planes, plane: np.ndarray, views: _Views, comes: np.ndarray, rules: CutRules
) -> np.ndarray:
    """Returns bool[m], where so little of a plane is left at an end that something has to close it.

    Args:
      planes: n of them.
      plane: int[m], those that others cross on their storey.
      views: of the m others.
      comes: bool[m], whether these come to the front.
      rules: what is little, and how near to the end it is closed.
    """
    at, left = views.at, planes.half[plane] - np.abs(views.at)
    end = np.where(at > 0, plane, ~plane)  # which plane, and which of its ends is nearer
    inward = at * views.slope > 0
    closed = end[comes & inward & (np.abs(left) <= rules.slack)]
    little = left < np.minimum(rules.gap, rules.loose * 2 * planes.half[plane])
    return little & ~np.isin(end, closed)


def _screened(planes: _Planes, met: _Meetings, rules: CutRules) -> np.ndarray:
    """Returns bool[m, n], which planes run alongside the one that is met, before where it is."""
    views = _views(planes, met.plane[:, None], np.arange(len(planes.half)))
    covers = np.abs(met.at[:, None] - views.along) <= planes.half + rules.slack
    # What looks the same way may be the plane itself, seen twice.
    nearest = np.where(views.cosine < 0, rules.touch, rules.slack)
    between = (views.front > nearest) & (views.front <= met.rest[:, None] + rules.slack)
    return (np.abs(views.cosine) > rules.parallel) & covers & between


def _turned(planes: _Planes, met: _Meetings, rules: CutRules) -> np.ndarray:
    """Returns bool[m, n], which planes make a corner with the one that meets, where it ends."""
    slope = _views(planes, met.plane, met.other).slope
    end = planes.middle[met.other]
    end -= np.sign(slope) * planes.half[met.other] * planes.along[met.other]
    seen = planes.normal.conj() * (end[:, None] - planes.middle)
    cosine = (planes.normal.conj() * planes.normal[met.other, None]).real
    distance = np.hypot(np.abs(seen.imag) - planes.half, seen.real)  # to the nearer end of each
    return (distance <= rules.slack) & (np.abs(cosine) < rules.parallel)


def _between(cuts: _Cuts, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns where the pieces of cut planes start and stop, float[k] each, sorted as cuts are."""
    cut = np.unique(cuts.plane)
    plane = np.concatenate([cuts.plane, cut])
    start = np.concatenate([cuts.stop, -half[cut]])
    stop = np.concatenate([cuts.start, half[cut]])
    return start[np.lexsort((start, plane))], stop[np.lexsort((stop, plane))]
