"""Cutting what is observed across several rooms into pieces, and joining the pieces again.

A robot keeps one plane for a whole line of wall, however many rooms lie along it. A model that was
trained on planes of one room each cannot tell these apart, so a plane is cut where walls meet its
front, and what is grown on the pieces is given back to the planes.

Seen from its front a plane is an axis. Another that comes to it ends a room there, on the side that
it looks to. Two that look away from each other are the faces of a wall: the strip between them is
of neither room and is left out, so that pieces are as wide as the rooms are; a wall of which one
face alone was seen has no such strip. The other may end a little before the plane, as what was
occluded does; not so if it ends at something else: a corner, or what stands in between.

Published cities have storeys that were shrunk to fit the one below while their planes kept their
widths: these poke through the corners of their rooms into others, but do not run along them. Since
middles are where they should be, a plane goes as far beyond its room at either end, and the sides
that it crosses there go beyond by the same share of their widths; lines of wall do not. Where that
is so to the centimetre, widths are no evidence: what hangs together with it by planes that cross is
not cut, nor does it cut anything.

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
      touch: one that ends no farther away meets the plane, whatever stands around, metres.
      slack: how far planes that meet in a corner may end apart, metres.
      storey: planes whose middles differ by more in height have nothing to do with each other,
        metres.
      thickness: of a wall at most, metres; a shaft between two rooms is one, too.
      least: width of a piece at least, metres.
      heading: how sure the heading of the other is, radians. Times half its width, it must meet the
        plane by so much farther from its ends.
      even: how well the overhangs of planes agree that were shrunk but kept their widths, metres.
        What a robot measures does not agree so well.
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
    heading: float = 0.03
    even: float = 0.01


CUTS: Final = CutRules()


class Pieces(NamedTuple):
    """What the observed nodes are cut into; those of one lie side by side in their order."""

    owner: np.ndarray  # int[k], row of the observed node that each is a piece of, nondecreasing
    position: np.ndarray  # float[k, 3], middle, metres
    width: np.ndarray  # float[k], metres


class _Planes(NamedTuple):
    """Vertical planes from above."""

    middle: np.ndarray  # float[n, 2], metres
    normal: np.ndarray  # float[n, 2]
    half: np.ndarray  # float[n], half the width, metres
    height: np.ndarray  # float[n], metres

    @property
    def along(self) -> np.ndarray:
        """float[n, 2], unit, the direction in which each runs."""
        return np.stack([-self.normal[:, 1], self.normal[:, 0]], axis=-1)


class _Views(NamedTuple):
    """Each plane, second, as seen from each, first: float[n, n] all, lengths in metres."""

    front: np.ndarray  # how far the middle of the second lies before the first
    along: np.ndarray  # how far along it
    cosine: np.ndarray  # of the angle between them
    slope: np.ndarray  # how fast one gets away from the first going along the second

    def at(self, pairs: tuple[np.ndarray, ...]) -> np.ndarray:
        """float[m], where the lines of m pairs cross, metres from the middle along the first."""
        return self.along[pairs] - self.front[pairs] * self.cosine[pairs] / self.slope[pairs]


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
      Of a node that is not cut one piece, its position and width bit for bit; of others more.
    """
    nodes, ontology = graph.nodes, ontology_of(graph)
    observed = np.flatnonzero(nodes.observed)
    is_plane = ontology.has("normal") & ontology.has("width")
    rows = observed[is_plane[nodes.label[observed]]]
    position, normal = nodes.position[rows], nodes.normal[rows, :2]
    planes = _Planes(position[:, :2], normal, nodes.width[rows] / 2, position[:, 2])
    free = ~np.isin(rows, undirected_edges(graph, PART_OF))
    cuts = _cuts(planes, free, rules)
    owner = np.sort(np.concatenate([observed, rows[cuts.plane]]))
    position, width = nodes.position[owner], nodes.width[owner]
    is_cut = np.isin(owner, rows[cuts.plane])
    start, stop = _between(cuts, planes.half)
    along = planes.along[np.searchsorted(rows, owner[is_cut])]
    position[is_cut, :2] += ((start + stop) / 2)[:, None] * along
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
    place[rows] = np.arange(len(rows))  # what has edges is not cut
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


def _cuts(planes: _Planes, free: np.ndarray, rules: CutRules) -> _Cuts:
    """Returns where planes are cut, of those that are free to be."""
    met = _meetings(planes, free, rules)
    plane, at = met.plane, met.at
    ahead = np.sum(planes.along[plane] * planes.normal[met.other], axis=1) > 0
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
    views = _views(planes)
    crosses = np.abs(views.cosine) < rules.parallel
    level = np.abs(planes.height[:, None] - planes.height) <= rules.storey
    sound = ~_overhanging(planes, views, crosses & level, rules)
    reach = planes.half * np.abs(views.slope)
    near = views.front - reach
    width = 2 * planes.half
    comes = near <= np.maximum(np.minimum(rules.gap, rules.lost * width), rules.share * width)
    reaches = views.front + reach - np.maximum(near, 0) >= rules.depth
    pairs = np.nonzero((free & sound)[:, None] & sound & crosses & level & comes & reaches)
    at, (plane, other) = views.at(pairs), pairs
    room = planes.half[plane] - rules.least - rules.heading * planes.half[other]
    within = np.abs(at) <= room
    met = _Meetings(plane[within], other[within], at[within], near[pairs][within])
    doubtful = np.flatnonzero(met.rest > rules.touch)
    some = _Meetings(*(field[doubtful] for field in met))
    ends = _screened(planes, views, some, rules) | _turned(planes, views, some, rules)
    refuted = np.any(ends & level[some.plane], axis=1)
    return _Meetings(*(np.delete(field, doubtful[refuted]) for field in met))


def _views(planes: _Planes) -> _Views:
    """Returns each plane as seen from each."""
    own_front = np.sum(planes.middle * planes.normal, axis=1)
    own_along = np.sum(planes.middle * planes.along, axis=1)
    return _Views(
        front=planes.normal @ planes.middle.T - own_front[:, None],
        along=planes.along @ planes.middle.T - own_along[:, None],
        cosine=planes.normal @ planes.normal.T,
        slope=planes.normal @ planes.along.T,
    )


def _overhanging(
    planes: _Planes, views: _Views, crosses: np.ndarray, rules: CutRules
) -> np.ndarray:
    """Returns which planes are of storeys that were shrunk but kept their widths, bool[n].

    Args:
      planes: n of them.
      views: of the planes.
      crosses: bool[n, n], which are of one storey and not parallel.
      rules: how well overhangs agree.
    """
    plane, other = pairs = np.nonzero(crosses)
    at, half, half_other = views.at(pairs), planes.half[plane], planes.half[other]
    beyond, beyond_other = half - np.abs(at), half_other - np.abs(views.at(pairs[::-1]))
    # One that ends at another is as wide as it seems: a line of wall of a regular building.
    ends = (np.abs(beyond) <= rules.even) & (beyond_other >= -rules.even)
    has_end = np.isin(np.arange(len(planes.half)), plane[ends])
    through = np.minimum(beyond, beyond_other) > rules.even
    inward = at * views.slope[pairs] > 0
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


def _screened(planes: _Planes, views: _Views, met: _Meetings, rules: CutRules) -> np.ndarray:
    """Returns bool[m, n], which planes run alongside the one that is met, before where it is."""
    front, cosine = views.front[met.plane], views.cosine[met.plane]
    covers = np.abs(met.at[:, None] - views.along[met.plane]) <= planes.half + rules.slack
    # What looks the same way may be the plane itself, seen twice.
    nearest = np.where(cosine < 0, rules.touch, rules.slack)
    between = (front > nearest) & (front <= met.rest[:, None] + rules.slack)
    return (np.abs(cosine) > rules.parallel) & covers & between


def _turned(planes: _Planes, views: _Views, met: _Meetings, rules: CutRules) -> np.ndarray:
    """Returns bool[m, n], which planes make a corner with the one that meets, where it ends."""
    toward = -np.sign(views.slope[met.plane, met.other]) * planes.half[met.other]
    end = planes.middle[met.other] + toward[:, None] * planes.along[met.other]
    along = end @ planes.along.T - np.sum(planes.middle * planes.along, axis=1)
    front = end @ planes.normal.T - np.sum(planes.middle * planes.normal, axis=1)
    distance = np.hypot(np.abs(along) - planes.half, front)  # to the nearer end of each
    return (distance <= rules.slack) & (np.abs(views.cosine[met.other]) < rules.parallel)


def _between(cuts: _Cuts, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns where the pieces of cut planes start and stop, float[k] each, sorted as cuts are."""
    cut = np.unique(cuts.plane)
    plane = np.concatenate([cuts.plane, cut])
    start = np.concatenate([cuts.stop, -half[cut]])
    stop = np.concatenate([cuts.start, half[cut]])
    return start[np.lexsort((start, plane))], stop[np.lexsort((stop, plane))]
