"""What is observed, as models know it: level, of length 1, each once; and what was wrong with it.

The one place where input is mended, whatever it was read from. Every kind of mending is one remark
that counts; what is right stays as it is, bit for bit.
"""

from typing import Final, NamedTuple

import numpy as np

from sg3d_jax.infer.plausible import (
    flipped_alone,
    layout,
    look_flipped,
    remark_on_size,
    remarks_on_widths,
)
from sg3d_jax.scene.graph import (
    SceneGraph,
    features_of,
    make_graph,
    ontology_of,
    undirected_edges,
)
from sg3d_jax.scene.ontology import PART_OF, Ontology
from sg3d_jax.scene.validate import UNIT_TOLERANCE, check_count

NORMALS: Final = ("check", "as-given")
MAX_LEAN: Final = 15  # degrees off the vertical; what S-Graphs takes for a wall leans less
DUPLICATE_DECIMALS: Final = 6  # micrometres


class Intake(NamedTuple):
    """What was taken in of a scene."""

    graph: SceneGraph  # host graph with part-of edges alone; normals horizontal, of length 1
    source: np.ndarray  # int[k], the row that each of its nodes has in the scene
    remarks: tuple[str, ...]  # one sentence each


class _Upright(NamedTuple):
    """Normals that are horizontal and of length 1, and what had to be done."""

    normal: np.ndarray  # float[n, 3]
    scaled: np.ndarray  # bool[n], was not of length 1
    levelled: np.ndarray  # bool[n], was not horizontal
    flat: np.ndarray  # bool[n], is too far from horizontal


def taken_in(
    scene: SceneGraph, where: str, normals: str = "check", may_be_few: bool = False
) -> Intake:
    """Mends the observed nodes of a host graph that `check_observed` lets through.

    - Planes that lean up to 15 degrees are levelled; those that lean more, such as floors and
      ceilings, are left out.
    - Normals are brought to length 1.
    - Exact repeats are merged into the first of them, with their part-of edges.
    - Normals that point out of rooms are turned, all over or one by one.

    Sizes and widths that are not plausible are said.

    Args:
      scene: float64, observed nodes or more; metres.
      where: what a refusal starts with, such as "planes.jsonl: scene 3".
      normals: one of `NORMALS`; "as-given" turns none.
      may_be_few: whether fewer than two observed nodes may be left.

    Returns:
      What is left, in its order.

    Raises:
      ValueError: fewer than two observed nodes are left, and may not be, or there is no such choice
        of normals.
    """
    if normals not in NORMALS:
        raise ValueError(f"normals is {normals!r:.40}, expected {' or '.join(NORMALS)}")
    ontology, nodes = ontology_of(scene), scene.nodes
    facing = nodes.observed & ontology.has("normal")[nodes.label]
    upright = _upright(nodes.normal, facing)
    mended = scene._replace(nodes=nodes._replace(normal=upright.normal))
    first = _first_alike(mended, nodes.observed & ~upright.flat)
    repeats = first != np.arange(len(first))
    rows = np.flatnonzero(~upright.flat & ~repeats)
    remarks = [
        done.format(_counted(int(chosen.sum()), ontology))
        for chosen, done in (
            (upright.scaled, "brought the normals of {} to length 1"),
            (upright.levelled, f"levelled {{}} (lean of up to {MAX_LEAN} degrees)"),
            (upright.flat, f"left out {{}} (lean of more than {MAX_LEAN} degrees)"),
            (repeats, "merged {} (exactly repeated)"),
        )
        if chosen.any()
    ]
    left = nodes.label[rows][nodes.observed[rows]]
    if not may_be_few:
        check_count(left, ontology, where, f", having {' and '.join(remarks)}" if remarks else "")
    graph = _reduced(mended, rows, first)
    turned, judged = _judged(graph, normals)
    return Intake(turned, rows, (*remarks, *judged))


def _upright(normal: np.ndarray, facing: np.ndarray) -> _Upright:
    """Brings normals to the horizontal and to length 1; those of other nodes stay."""
    largest = np.abs(normal).max(axis=-1, keepdims=True, initial=0)
    scaled = normal / np.where(largest > 0, largest, 1)  # whose squares are no longer too large
    unit = scaled / np.maximum(np.linalg.norm(scaled, axis=-1, keepdims=True), 1)
    with np.errstate(over="ignore"):
        off = facing & (np.abs(np.linalg.norm(normal, axis=-1) - 1) > UNIT_TOLERANCE)
    lean = facing & (np.abs(unit[:, 2]) > UNIT_TOLERANCE)
    flat = lean & (np.abs(unit[:, 2]) > np.sin(np.radians(MAX_LEAN)))
    levelled = lean & ~flat
    level = unit * [1.0, 1.0, 0.0]
    level /= np.maximum(np.linalg.norm(level, axis=-1, keepdims=True), np.finfo(float).tiny)
    result = np.where(levelled[:, None], level, np.where(off[:, None], unit, normal))
    return _Upright(result, off & ~flat, levelled, flat)


def _first_alike(graph: SceneGraph, chosen: np.ndarray) -> np.ndarray:
    """Returns int[n], for each chosen node the first that it repeats, for any other itself."""
    columns = [graph.nodes.label, graph.nodes.position, *features_of(graph).values()]
    rows = np.flatnonzero(chosen)
    table = np.column_stack([np.asarray(column)[rows] for column in columns])
    rounded = np.round(table, DUPLICATE_DECIMALS) + 0.0  # as that is 0.0 of -0.0
    alike, first = np.arange(len(chosen)), {}
    for row, values in zip(rows.tolist(), rounded, strict=True):
        alike[row] = first.setdefault(values.tobytes(), row)
    return alike


def _reduced(graph: SceneGraph, rows: np.ndarray, first: np.ndarray) -> SceneGraph:
    """Returns the graph of some nodes; part-of edges of repeats are those of the first."""
    place = np.full(len(first), -1)
    place[rows] = np.arange(len(rows))
    pairs = np.sort(place[first[undirected_edges(graph, PART_OF)]], axis=1)
    return make_graph(
        graph.nodes.label[rows],
        graph.nodes.position[rows],
        **{name: array[rows] for name, array in features_of(graph).items()},
        part_of=np.unique(pairs[(pairs >= 0).all(axis=1)], axis=0),
        ontology=ontology_of(graph),
    )


def _judged(graph: SceneGraph, normals: str) -> tuple[SceneGraph, list[str]]:
    """Turns normals that are flipped, and says what else is not plausible."""
    plural, planes = ontology_of(graph).observed_plural, layout(graph)
    if remark := remark_on_size(planes, plural):
        return graph, [remark]  # what is seen of normals and widths is seen by sizes
    remarks = remarks_on_widths(planes, plural)
    if votes := look_flipped(planes):
        backs, faces = votes
        flipped, which = np.ones(len(planes.row), bool), "all normals"
        why = f"{backs} {plural} have others behind them and none in front, {faces} the reverse"
    elif (flipped := flipped_alone(planes)).any():
        which = f"the normals of {_counted(int(flipped.sum()), ontology_of(graph))}"
        why = "they look away from what they bound"
    else:
        return graph, remarks
    if normals == "as-given":
        return graph, [f"kept {which} as given, though {why}", *remarks]
    normal = np.array(graph.nodes.normal)
    normal[planes.row[flipped]] = 0.0 - normal[planes.row[flipped]]
    said = f"turned {which}, since {why} (normals as-given keeps them)"
    return graph._replace(nodes=graph.nodes._replace(normal=normal)), [said, *remarks]


def _counted(count: int, ontology: Ontology) -> str:
    """Returns a number of observed nodes, such as "1 plane" or "3 planes"."""
    singular = " or ".join(concept.name for concept in ontology.concepts if concept.observed)
    return f"{count} {singular if count == 1 else ontology.observed_plural}"
