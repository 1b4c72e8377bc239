"""What pictures and pages share: colours, the view, and where nodes are drawn.

The concepts are lifted apart in z so that the hierarchy can be read, and the storeys of a building
are pulled apart so that each can be seen. Both are drawn; neither is part of the graph.

Nodes and edges are as faint as they are unsure, if a confidence is given: their colours are mixed
with the white of the ground, for the 3D scenes of plotly blend no points of different opacities.

Which concept is which is read from the ontology: a "floor" is the uppermost that does not stand
above its parts, a "building" whatever floors are part of, a "plane" what is observed with normal
and width.
"""

import functools
from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import Array, SceneGraph, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, Ontology


class Style(NamedTuple):
    """How one concept is drawn."""

    colour: str  # "#rrggbb"
    lift: float  # metres, up
    size: float  # diameter of the dot, points


OBSERVED_SIZE: Final = 4.0  # points
LEAST_SIZE, SIZE_STEP, GREATEST_SIZE = 5.0, 2.0, 12.0  # points, of the others from the lowest up
EDGE_COLOUR: Final = "#8b919c"
FAINTEST: Final = 0.1  # of its colour, what is not sure at all
INK: Final = "#1f2937"  # of names and scales
MISSING_COLOUR: Final = "#111111"  # of what is in a truth alone
CAPTION_COLOUR: Final = "#475467"
FAINT: Final = "faint: unsure"  # what legends say of it
ELEVATION, AZIMUTH = np.radians([32.0, -62.0])  # the camera; nearly that of the paper's pictures
CROWDED: Final = 60  # nodes; dots of larger graphs are smaller
STOREY_GAP: Final = 0.5  # drawn between storeys, in lengths of the largest floor
LARGE_FLOOR: Final = 25.0  # metres; the lifts of larger floors grow with them
SAME_STOREY: Final = 1.0  # metres; floors closer in z lie side by side


def faded(colour: str, confidence: Array) -> list[str]:
    """Returns a colour for each of some nodes or edges, the fainter the less sure they are.

    Args:
      colour: "#rrggbb", of what is sure.
      confidence: float[k], 0 to 1; what does not say, NaN, is drawn like what is sure.
    """
    sure = np.nan_to_num(np.asarray(confidence, np.float64), nan=1.0)
    share = FAINTEST + (1 - FAINTEST) * sure**2  # squared, or .7 and .9 would look alike
    white = np.full(3, 255.0)
    mixed = white + share[:, None] * (np.array([*bytes.fromhex(colour[1:])]) - white)
    return [f"#{bytes(row).hex()}" for row in np.round(mixed).astype(np.uint8)]


def check_confidence(
    graph: SceneGraph, node_confidence: Array | None, edge_confidence: Array | None
) -> None:
    """Refuses confidence of another number of nodes or part-of edges than a host graph has.

    Raises:
      ValueError: one sentence.
    """
    for name, given, count in (
        ("node_confidence", node_confidence, len(graph.nodes.label)),
        ("edge_confidence", edge_confidence, len(undirected_edges(graph, PART_OF))),
    ):
        if given is not None and np.shape(given) != (count,):
            raise ValueError(f"{name} has shape {[*np.shape(given)]}, expected [{count}]")


def styles_of(ontology: Ontology) -> tuple[Style, ...]:
    """Returns how each concept is drawn; what is not observed is higher and larger, one by one."""
    places = np.cumsum(~ontology.is_observed) - 1
    return tuple(
        Style(concept.colour, 0.0, OBSERVED_SIZE)
        if concept.observed
        else Style(concept.colour, 1.0 + place, min(GREATEST_SIZE, LEAST_SIZE + SIZE_STEP * place))
        for concept, place in zip(ontology.concepts, places.tolist(), strict=True)
    )


def are_segments(ontology: Ontology) -> np.ndarray:
    """Returns bool[C], the concepts whose nodes are drawn as segments, and not as dots alone."""
    return ontology.is_observed & ontology.has("normal") & ontology.has("width")


def lifted(graph: SceneGraph) -> np.ndarray:
    """Returns where the nodes of a host graph are drawn, float64[n, 3], metres."""
    label, length = np.asarray(graph.nodes.label), _largest_floor(graph)
    lifts = np.array([style.lift for style in styles_of(ontology_of(graph))])
    points = np.array(graph.nodes.position, np.float64)
    points[:, 2] += lifts[label] * drawn_metre(graph)
    points[:, 2] += _storey(graph) * length * STOREY_GAP
    return points


def drawn_metre(graph: SceneGraph) -> float:
    """Returns how long a metre of lift is drawn, metres: longer if floors are large."""
    return max(1.0, _largest_floor(graph) / LARGE_FLOOR)


def plane_segments(graph: SceneGraph, concept: int | None = None) -> np.ndarray:
    """Returns the two ends of the planes of a host graph as drawn, float64[planes, 2, 3].

    Args:
      graph: unpadded, metres.
      concept: the label of those that are wanted; None for all.
    """
    label = np.asarray(graph.nodes.label)
    chosen = are_segments(ontology_of(graph))[label]
    chosen &= True if concept is None else label == concept
    normal, width = graph.nodes.normal[chosen], graph.nodes.width[chosen]
    along = np.cross(np.array([0.0, 0.0, 1.0]), normal)
    half = along * width[:, None] / 2
    middle = lifted(graph)[chosen]
    return np.stack([middle - half, middle + half], axis=1)


def view_of(graph: SceneGraph) -> float:
    """Returns the azimuth from which a host graph is seen, radians: its buildings side by side."""
    ontology = ontology_of(graph)
    are_buildings = ontology.may_be_part[floor_concept(ontology)][np.asarray(graph.nodes.label)]
    buildings = np.asarray(graph.nodes.position)[are_buildings]
    if len(buildings) < 2:
        return float(AZIMUTH)
    turns = np.radians(np.arange(-90.0, 90.0))
    views = AZIMUTH + turns[np.argsort(np.abs(turns), kind="stable")]  # the usual one, if as good
    across = np.stack([np.sort(project(buildings, view)[:, 0]) for view in views])
    return float(views[np.argmax(np.diff(across, axis=1).min(axis=1))])


def project(points: np.ndarray, azimuth: float = AZIMUTH) -> np.ndarray:
    """Returns the parallel projection of points [..., 3] on the picture [..., 2]: right and up."""
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    away = np.array([np.cos(azimuth), np.sin(azimuth)]) * -np.sin(ELEVATION)
    return points @ np.array([right, [*away, np.cos(ELEVATION)]]).T


def crowding(graph: SceneGraph) -> float:
    """Returns by how much the dots and lines of a host graph shrink, so that they keep apart."""
    return min(1.0, float(CROWDED / len(graph.nodes.label)) ** 0.4)


def floor_concept(ontology: Ontology) -> int:
    """Returns the uppermost concept that does not stand above its parts; -1, no label, if all do.

    The last row of a table of concepts, at -1, is that of the uppermost, which is part of nothing.
    """
    amid = np.flatnonzero(~ontology.is_observed & ~ontology.is_above)
    return int(amid[-1]) if len(amid) else -1


def floor_of(graph: SceneGraph) -> np.ndarray:
    """Returns the floor that each node of a host graph is drawn on.

    Args:
      graph: unpadded. It may break the hierarchy: what hangs on no floor is drawn on the nearest.

    Returns:
      int64[n], the row of a floor; -1 for what is above floors, and where there is no floor.
    """
    label, position = np.asarray(graph.nodes.label), np.asarray(graph.nodes.position)
    concept = floor_concept(ontology_of(graph))
    floors = np.flatnonzero(label == concept)
    found = np.full(len(label), -1)
    if not len(floors):
        return found
    found[floors] = floors
    for known, reached in _spreading(ontology_of(graph), concept):
        there, here = _pairs(graph, known, reached)
        found[here] = found[there]
    lost = np.flatnonzero((found < 0) & (label < concept))
    # Storeys lie above one another: a metre in z says more than several in x and y.
    apart = (position[lost, None] - position[None, floors]) * np.array([[[1.0, 1.0, 10.0]]])
    found[lost] = floors[np.argmin(np.linalg.norm(apart, axis=-1), axis=-1)]
    return found


@functools.lru_cache
def _spreading(ontology: Ontology, floor: int) -> tuple[tuple[int, int], ...]:
    """Returns along which part-of edges floors spread: pairs of labels, from the known to the next.

    First down, from wholes to parts; then up, to what is part of no floor but has parts that are.
    """
    reached, steps = {floor}, []
    for label in reversed(range(floor)):
        wholes = reached & {*np.flatnonzero(ontology.may_be_part[label]).tolist()}
        steps += [(whole, label) for whole in sorted(wholes)]
        reached |= {label} if wholes else set()
    for label in range(floor):
        if label not in reached:
            parts = reached & {*np.flatnonzero(ontology.may_be_part[:, label]).tolist()}
            steps += [(part, label) for part in sorted(parts)]
            reached |= {label} if parts else set()
    return tuple(steps)


def _storey(graph: SceneGraph) -> np.ndarray:
    """Returns the storey of each node, int[n]; what is above floors has that of its top."""
    label, height = np.asarray(graph.nodes.label), np.asarray(graph.nodes.position)[:, 2]
    ontology, concept = ontology_of(graph), floor_concept(ontology_of(graph))
    floor, parent = floor_of(graph), np.full(len(label), -1)
    for upper in np.flatnonzero(ontology.may_be_part[concept]).tolist():
        buildings, children = _pairs(graph, upper, concept)
        parent[children] = buildings
    floors = np.flatnonzero(label == concept)
    lower = height[floors, None] - height[None, floors] > SAME_STOREY
    beside = parent[floors, None] == parent[None, floors]
    storey = np.zeros(len(label), np.int64)
    storey[floors] = np.sum(lower & beside, axis=1)
    storey = np.where(floor >= 0, storey[floor], 0)
    for part, whole in np.argwhere(ontology.may_be_part).tolist():  # bottom-up
        if part >= concept:
            wholes, parts = _pairs(graph, whole, part)
            np.maximum.at(storey, wholes, storey[parts])
    return storey


def _largest_floor(graph: SceneGraph) -> float:
    """Returns the longest extent in x or y of what is observed of a floor, metres; else 0."""
    observed = np.asarray(graph.nodes.observed)
    points, floor = np.asarray(graph.nodes.position)[observed, :2], floor_of(graph)[observed]
    extents = [np.ptp(points[floor == row], axis=0).max() for row in np.unique(floor[floor >= 0])]
    return float(max(extents, default=0.0))


def _pairs(graph: SceneGraph, upper: int, lower: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the rows of the upper and of the lower nodes of the part-of edges between two."""
    label, pairs = np.asarray(graph.nodes.label), undirected_edges(graph, PART_OF)
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    ends = ends[(label[ends[:, 0]] == upper) & (label[ends[:, 1]] == lower)]
    return ends[:, 0], ends[:, 1]


def called(concept: str, name: int | str) -> str:
    """Returns what a node is called: its concept and name, or the name alone if that says both."""
    return str(name) if str(name).startswith(f"{concept}-") else f"{concept} {name}"
