"""What a robot sees of a graph: views of any complete graph, and what of its truth they still show.

A view is drawn in the order in which a map comes about: the robot has been in some of the rooms;
it misses planes and sees others in part; what lies on one line it takes for one plane; doors and
cupboards cut planes in two; some it maps twice; furniture is taken for walls; nothing is exactly
where it seems. A view is what intake makes of the planes, so they are level; `raw_planes` lean.

The truth of a view, by three rules. A *surface* is what is seen of one plane, or of several that
are taken for one, in however many parts.

- A wall or a room stays if two surfaces of it are seen (one cannot tell of it; nor can several
  parts of one plane), anything above it if one of its parts stays. A room that had only one
  plane stays with that one. A wall that has two sides stays if both are seen: planes along one line
  that look the same way may as well be the outside of a building.
- What is observed and no plane, such as doors and objects (`robot_things`), is seen where a plane
  of its room is, and belongs to what stays of what it belongs to.
- What stays is where it is in the complete graph, at the height that it has there: a room does not
  move because a cupboard hides its corner. Only floors, and what stands above them, move with the
  middle of their parts when rooms go.

Source: measurements on ten recordings of S-Graphs that its authors published
(snt-arg/graph_matching): points scatter by 2.3 to 2.7 cm about their plane, heights of planes in a
storey differ by 0.06 to 0.23 m, 35 of 249 planes lean by more than 3 degrees, rooms drawn by hand
have two to seven planes. `MILD` and `STRONG` are degrees of damage that weights were measured at.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.data.robot_effects import (
    EFFECTS,
    RobotConfig,
    SeenPlanes,
    Stretches,
    along,
    matches,
    room_label,
    seen_whole,
)
from sg3d_jax.data.robot_things import NO_THINGS, SeenThings, ThingsConfig, is_surface, seen_things
from sg3d_jax.scene.cut import cut_observed
from sg3d_jax.scene.graph import (
    SceneGraph,
    make_graph,
    observed_of,
    ontology_of,
    parts_first,
    subgraph,
)

LEAST_SIDES: Final = 2  # surfaces that tell of a wall or a room
LEANING: Final = 0.15  # share of the raw planes that lean,
LEAN: Final = (2.0, 15.0)  # degrees, and by how much
TRIES: Final = 100  # views without a room that are drawn again
# The fields of a `RobotConfig` that a mixture draws.
STRENGTHS: Final = (
    "unvisited",
    "missing",
    "shortened",
    "merged",
    "split",
    "doubled",
    "position_noise",
    "heading_noise",
    "height_noise",
    "clutter",
)
# The fields of a `ThingsConfig` that it draws.
THING_STRENGTHS: Final = ("missing", "doubled", "position_noise", "width_noise", "mistaken")
NOTHING: Final = ThingsConfig(missing=1.0)  # of things is seen
_TAG: Final = 14  # keeps our random numbers apart from those of the generators


@dataclass(frozen=True)
class RobotMixture:
    """Views from clean to strong: each has a severity, the root of a uniform number.

    An effect is on with the chance of the severity, those of `seldom` with half of it; its share or
    noise is then that of `strongest` times another such root.

    Attributes:
      strongest: the greatest shares and noise (`STRENGTHS`); all else of it is that of every view.
      seldom: those that are on half as often.
      bare: share of the views in which no things are seen at all.
    """

    strongest: RobotConfig
    seldom: tuple[str, ...] = ()
    bare: float = 0.0

    def draw(self, rng: np.random.Generator) -> RobotConfig:
        """Returns what one view is drawn with."""
        severity = np.sqrt(rng.random())
        chance = [severity / 2 if name in self.seldom else severity for name in STRENGTHS]
        share = (rng.random(len(chance)) < chance) * np.sqrt(rng.random(len(chance)))
        drawn = {
            name: getattr(self.strongest, name) * each
            for name, each in zip(STRENGTHS, share.tolist(), strict=True)
        }
        return replace(self.strongest, **drawn)

    def draw_things(self, rng: np.random.Generator) -> ThingsConfig:
        """Returns what the things of one view are drawn with, whatever its planes are."""
        is_bare, severity = rng.random() < self.bare, np.sqrt(rng.random())
        share = (rng.random(len(THING_STRENGTHS)) < severity) * np.sqrt(
            rng.random(len(THING_STRENGTHS))
        )
        strongest = self.strongest.things
        drawn = {
            name: getattr(strongest, name) * each
            for name, each in zip(THING_STRENGTHS, share.tolist(), strict=True)
        }
        return NOTHING if is_bare else replace(strongest, **drawn)


MILD: Final = RobotConfig(
    missing=0.05,
    shortened=1.0,
    shortened_by=(0.05, 0.15),
    split=0.05,
    position_noise=0.02,
    heading_noise=1.0,
    height_noise=0.1,
    things=ThingsConfig(missing=0.05, position_noise=0.05, width_noise=0.05, mistaken=0.03),
)
STRONG: Final = RobotConfig(
    missing=0.1,
    shortened=1.0,
    split=0.1,
    position_noise=0.05,
    heading_noise=3.0,
    height_noise=0.3,
    things=ThingsConfig(
        missing=0.2, doubled=0.05, position_noise=0.15, width_noise=0.15, mistaken=0.1
    ),
)
TRAINING: Final = RobotMixture(
    RobotConfig(
        unvisited=0.7,
        missing=0.25,
        shortened=1.0,
        shortened_by=(0.05, 0.45),
        both_ends=0.3,
        merged=1.0,
        merged_gap=2.0,  # of planes whose ends are not seen
        split=0.25,
        doubled=0.15,
        position_noise=0.07,
        heading_noise=4.0,
        height_noise=0.4,
        clutter=0.3,
        things=ThingsConfig(
            missing=0.6, doubled=0.15, position_noise=0.3, width_noise=0.3, mistaken=0.3
        ),
    ),
    seldom=("unvisited", "doubled", "clutter"),
    bare=0.2,
)

# Views by name; NAME@VIEW is a data set of `registry`.
VIEWS: Final[Mapping[str, RobotConfig | RobotMixture]] = MappingProxyType(
    {
        "robot": TRAINING,
        "mild": MILD,
        "strong": STRONG,
        "clean": RobotConfig(),
        "path": RobotConfig(unvisited=0.4),
        "missing": RobotConfig(missing=0.2),
        "shortened": RobotConfig(shortened=1.0),
        "merged": RobotConfig(merged=1.0),
        "split": RobotConfig(split=0.2),
        "doubled": RobotConfig(doubled=0.15),
        "position": RobotConfig(position_noise=0.05),
        "heading": RobotConfig(heading_noise=3.0),
        "height": RobotConfig(height_noise=0.3),
        "clutter": RobotConfig(clutter=0.2),
        # The same planes as in the views of these names, and nothing else that is observed.
        "bare": RobotConfig(things=NOTHING),
        "robot_bare": replace(TRAINING, bare=1.0),
        "mild_bare": replace(MILD, things=NOTHING),
        "strong_bare": replace(STRONG, things=NOTHING),
    }
)


class View(NamedTuple):
    """A graph as a robot sees it."""

    graph: SceneGraph  # host graph: seen planes, in front, and what of the truth stays
    complete: SceneGraph  # what it is a view of
    stretches: Stretches  # where the planes of the latter are seen; clutter has none
    things: SeenThings  # what else is seen, behind the planes


def view(
    graph: SceneGraph,
    config: RobotConfig | RobotMixture,
    seed: int,
    index: int,
    number: int = 0,
) -> View:
    """Draws what a robot sees of a complete graph.

    Args:
      graph: unpadded host graph, the lowest of whose concepts is that of planes, each in one room;
        its proximity edges are not looked at.
      config: what is seen otherwise than it is.
      seed: names the data set.
      index: names the graph in it.
      number: names the view of the graph: the same (config, seed, index, number) gives the same.

    Returns:
      Seen planes in the order of those that they are of, parts of one beside one another and
      clutter last; then what else is seen; then walls, rooms and the rest that stays, in order.
      Part-of edges only; a plane that is several planes of the graph has the edges of all of them.
      A view without a room, or of one plane, is drawn again.

    Raises:
      ValueError: the graph has other concepts, or nothing is left of it in a hundred views.
    """
    try:
        room_label(ontology_of(graph))
    except ValueError as error:
        raise ValueError(f"graph {index}: {error}") from error
    rng = np.random.default_rng([seed, index, number, _TAG])
    rng_things = np.random.default_rng([seed, index, number, _TAG + 3])
    for _ in range(TRIES):
        chosen, of_things = _chosen(config, rng, rng_things)
        planes = seen_whole(graph)
        for effect in EFFECTS:
            planes = effect(planes, chosen, graph, rng)
        things = seen_things(graph, planes.stretches.plane, of_things, rng_things)
        surfaces = surfaces_of(planes.stretches, len(planes.width))
        seen, _ = truth_of(graph, planes, planes.stretches, surfaces, things)
        if len(planes.width) >= LEAST_SIDES and seen.nodes.label.max() == graph.nodes.label.max():
            return View(seen, graph, planes.stretches, things)
    raise ValueError(f"graph {index}: nothing is left of it in {TRIES} views, expected a room")


def _chosen(
    config: RobotConfig | RobotMixture, rng: np.random.Generator, rng_things: np.random.Generator
) -> tuple[RobotConfig, ThingsConfig]:
    """Returns what the planes and the things of a view are drawn with."""
    if isinstance(config, RobotMixture):
        return config.draw(rng), config.draw_things(rng_things)
    return config, config.things


def in_pieces(view: View) -> SceneGraph:
    """Returns the truth of a view over the pieces that its planes are cut into before growing.

    Every piece has the walls and rooms of the plane of the complete graph that it lies on most, and
    the truth follows by the rules of the module; a plane that shares its piece with another one is
    lost to its room. Training learns from these graphs.

    Args:
      view: of `view`.
    """
    seen = subgraph(view.graph, is_surface(view.graph), edges=False)
    owner, position, width = cut_observed(seen)
    normal = seen.nodes.normal[owner, :2]
    offset = position[:, :2] - seen.nodes.position[owner, :2]
    middle = np.sum(offset * along(normal), axis=1)
    piece, at = matches(view.stretches.seen, owner)
    low = np.maximum(view.stretches.low[at], (middle - width / 2)[piece])
    high = np.minimum(view.stretches.high[at], (middle + width / 2)[piece])
    order = np.lexsort((low - high, piece))
    order = order[(high >= low)[order]]
    piece, most = np.unique(piece[order], return_index=True)
    lies_on = Stretches(piece, *(f[order][most] for f in (view.stretches.plane[at], low, high)))
    surface = surfaces_of(view.stretches, len(seen.nodes.label))[owner]
    pieces = SeenPlanes(position, normal, width, lies_on)
    return truth_of(view.complete, pieces, lies_on, surface, view.things)[0]


def raw_planes(graph: SceneGraph, seed: int, index: int, number: int = 0) -> SceneGraph:
    """Returns what is seen in a view as a robot has it before intake: a share of the planes leans.

    Args:
      graph: of a `View`.
      seed: names the data set, as for `view`; likewise the others.
      index: names the graph in it.
      number: names the view of the graph.
    """
    rng = np.random.default_rng([seed, index, number, _TAG + 1])
    planes = observed_of(graph)
    lean = np.radians(rng.uniform(*LEAN, size=len(planes.nodes.label)))
    lean *= rng.choice([-1, 1], size=len(lean)) * (rng.random(len(lean)) < LEANING)
    lean *= is_surface(planes)
    normal = planes.nodes.normal * np.cos(lean)[:, None]
    normal[:, 2] += np.sin(lean)
    return planes._replace(nodes=planes.nodes._replace(normal=normal))


def surfaces_of(stretches: Stretches, num_seen: int) -> np.ndarray:
    """Returns the surface of each seen plane, int[k]: the first plane of the graph that is of it.

    Seen planes that show one plane of the graph are of one surface, and so on from these.
    """
    first = np.arange(stretches.plane.max(initial=-1) + 1)
    while True:
        surface = np.full(num_seen, len(first))  # clutter stays so
        np.minimum.at(surface, stretches.seen, first[stretches.plane])
        before = first.copy()
        np.minimum.at(first, stretches.plane, surface[stretches.seen])
        if np.array_equal(first, before):
            return surface


def truth_of(
    graph: SceneGraph,
    planes: SeenPlanes,
    stretches: Stretches,
    surface: np.ndarray,
    things: SeenThings = NO_THINGS,
) -> tuple[SceneGraph, np.ndarray]:
    """Returns what is seen with what of the complete graph it still shows, and which of it stays.

    Args:
      graph: complete.
      planes: k that are seen.
      stretches: what is seen on them.
      surface: int[k], which surface each is part of.
      things: t that are seen.

    Returns:
      The host graph, planes first, then things, and of each node behind these its row in the
      complete graph.
    """
    num_nodes, num_seen = len(graph.nodes.label), len(planes.width)
    pairs = parts_first(graph)
    of_planes = is_surface(graph)[pairs[:, 0]]
    above = pairs[~graph.nodes.observed[pairs[:, 0]]]
    part, whole = pairs[of_planes][np.argsort(pairs[of_planes, 0], kind="stable")].T
    which, at = matches(part, stretches.plane)
    seen, of = stretches.seen[which], whole[at]
    sides = np.unique(surface[seen] * num_nodes + of) % num_nodes
    num_parts = np.bincount(whole, minlength=num_nodes)
    stays = np.bincount(sides, minlength=num_nodes) >= np.clip(num_parts, 1, LEAST_SIDES)
    shared = ~ontology_of(graph).has_one_whole[0, graph.nodes.label]
    front = np.zeros((num_nodes, 3))
    front[whole] = graph.nodes.normal[part]  # of any of its planes
    both, both_seen = (
        _faces_both_ways(graph.nodes.normal[planes], front, of_wall)
        for planes, of_wall in ((part, whole), (part[at], of))
    )
    stays &= ~(shared & both) | both_seen
    stays, position = _above(graph, above, stays)
    kept = np.flatnonzero(stays)
    num_observed = num_seen + len(things.node)
    place = np.full(num_nodes, -1)
    place[kept] = num_observed + np.arange(len(kept))
    seen, of = np.divmod(np.unique(seen * num_nodes + of), num_nodes)
    part, whole = pairs[np.argsort(pairs[:, 0], kind="stable")].T
    which, at = matches(part, things.node)
    edges = [
        np.column_stack([seen, place[of]]),
        np.column_stack([num_seen + which, place[whole[at]]]),
        place[above],
    ]
    edges = np.concatenate(edges)
    behind = len(things.node) + len(kept)
    nodes = graph.nodes
    truth = make_graph(
        np.concatenate([np.zeros(num_seen, int), nodes.label[things.node], nodes.label[kept]]),
        np.concatenate([planes.position, things.position, position[kept]]),
        normal=np.pad(planes.normal, [(0, behind), (0, 1)]),
        width=np.concatenate([planes.width, things.width, nodes.width[kept]]),
        kind=np.concatenate([np.zeros(num_seen), things.kind, nodes.kind[kept]]),
        part_of=edges[(edges >= 0).all(axis=1)],
        ontology=ontology_of(graph),
    )
    return truth, kept


def _faces_both_ways(normal: np.ndarray, front: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Returns which wholes have planes on either side, bool[n].

    Args:
      normal: float[p, 3], of planes.
      front: float[n, 3], a normal that each whole is looked at along.
      whole: int[p], of which whole each plane is.
    """
    ahead = np.sum(normal * front[whole], axis=1) > 0
    counts = (np.bincount(whole[side], minlength=len(front)) for side in (ahead, ~ahead))
    return np.all([count > 0 for count in counts], axis=0)


def _above(
    graph: SceneGraph, pairs: np.ndarray, stays: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns which nodes stay, bool[n], and where all of them are, float[n, 3].

    What has a part that stays does, and moves as the middle of its parts has moved: their mean in
    x and y, the highest in z.

    Args:
      graph: complete.
      pairs: int[e, 2], its part-of edges between nodes that are not seen, the part first.
      stays: bool[n], which walls and rooms do.
    """
    stays, position = stays.copy(), graph.nodes.position.copy()
    kind = graph.nodes.label[pairs[:, 1]]
    for each in np.unique(kind):
        part, whole = pairs[kind == each].T
        staying = stays[part]
        before, _ = _middles(graph.nodes.position[part], whole, len(stays))
        after, found = _middles(position[part][staying], whole[staying], len(stays))
        position[found] += after[found] - before[found]
        stays |= found
    return stays, position


def _middles(
    points: np.ndarray, group: np.ndarray, num_groups: int
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the middle of each group of points, float[g, 3], and which have any, bool[g]."""
    count = np.bincount(group, minlength=num_groups)
    x, y = (np.bincount(group, axis, num_groups) / np.maximum(count, 1) for axis in points[:, :2].T)
    z = np.full(num_groups, -np.inf)
    np.maximum.at(z, group, points[:, 2])
    return np.column_stack([x, y, np.where(count, z, 0)]), count > 0
