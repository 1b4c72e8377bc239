"""The way in: what a user gives is checked here, once, and brought to where float32 is fine.

And the way back: what was given leaves as it came, bit for bit, with what was grown behind it.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from sg3d_jax.infer.intake import taken_in
from sg3d_jax.scene.cut import Pieces, cut_observed, joined, of_pieces
from sg3d_jax.scene.graph import SceneGraph, extended, observed_of, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, Ontology
from sg3d_jax.scene.padding import centre_of_observed, moved_by
from sg3d_jax.scene.validate import check_observed, validate_graph

CUT: Final = ("auto", "never")


class Scene(NamedTuple):
    """A scene that may be completed."""

    where: str  # what a refusal calls it
    given: SceneGraph  # host graph without proximity edges, in the user's frame
    source: np.ndarray  # int[n], row that each of its nodes has in the user's graph
    pieces: Pieces | None  # what its observed nodes are cut into; None if all are whole
    in_pieces: SceneGraph  # the same graph, its observed nodes in pieces
    centred: SceneGraph  # that around the mean of what is observed
    centre: np.ndarray  # float64[3], metres
    num_missing: int  # nodes that the user's graph has beside what is observed; for an oracle
    remarks: tuple[str, ...]  # what was mended, cut, or is not plausible; one sentence each

    @property
    def num_in_pieces(self) -> int:
        """How many nodes are given once what is observed is cut."""
        return len(self.in_pieces.nodes.label)

    @property
    def num_given(self) -> int:
        """How many nodes are given."""
        return len(self.source)

    @property
    def num_pieces(self) -> np.ndarray:
        """int[observed], into how many pieces each observed node is cut; 1 if it is whole.

        0 if it shows again what another one does, and is not grown from.
        """
        observed = np.asarray(self.given.nodes.observed)
        if self.pieces is None:
            return np.ones(int(observed.sum()), int)
        return np.bincount(self.pieces.owner, minlength=len(observed))[observed]

    @property
    def set_aside(self) -> np.ndarray:
        """int[s], the rows of `given` that are observed and not grown from."""
        return np.flatnonzero(self.given.nodes.observed)[self.num_pieces == 0]


def prepare(
    scenes: Any,
    ontology: Ontology,
    keep: bool,
    names: Sequence[str] | None = None,
    normals: str = "check",
    cut: str = "auto",
) -> list[Scene]:
    """Checks host graphs and takes of each what is given, mended and in pieces.

    Args:
      scenes: host graphs, observed nodes or more; not yet trusted.
      ontology: the concepts that the model knows.
      keep: whether everything in a scene is given, such as known rooms, or its observed nodes only.
      names: what a refusal calls each scene; "scene 0", "scene 1" and so on by default.
      normals: "check" to turn those that are flipped, "as-given" to turn none.
      cut: "auto" to cut planes where other walls abut and to set aside what was seen again, "never"
        to take all as they are.

    Raises:
      ValueError: one sentence that names the scene, the node, the field and what was expected.
    """
    if isinstance(scenes, SceneGraph) or not isinstance(scenes, Sequence):
        raise ValueError(f"scenes is a {type(scenes).__name__}, expected a list of host graphs")
    if cut not in CUT:
        raise ValueError(f"cut is {cut!r:.40}, expected {' or '.join(CUT)}")
    names = [f"scene {index}" for index in range(len(scenes))] if names is None else names
    if len(names) != len(scenes):
        raise ValueError(f"there are {len(names)} names of {len(scenes)} scenes, expected as many")
    pairs = zip(scenes, names, strict=True)
    return [_prepared(scene, ontology, keep, where, normals, cut) for scene, where in pairs]


def _prepared(
    scene: Any, ontology: Ontology, keep: bool, where: str, normals: str, cut: str
) -> Scene:
    if not isinstance(scene, SceneGraph):
        expected = "a host graph, as of sg.planes or sg.read_graphs"
        raise ValueError(f"{where}: is a {type(scene).__name__}, expected {expected}")
    if ontology_of(scene) != ontology:
        held, known = (", ".join(each.names) for each in (ontology_of(scene), ontology))
        raise ValueError(f"{where}: its concepts are {held}, expected {known}, as of the model")
    scene = _on_host(scene)
    check_observed(scene, where)
    if keep:
        validate_graph(scene, where, rules=False)
    observed = np.asarray(scene.nodes.observed)
    rows = np.arange(len(observed)) if keep else np.flatnonzero(observed)
    given, source, remarks = taken_in(scene if keep else observed_of(scene), where, normals)
    pieces = _pieces(given) if cut == "auto" else None
    if pieces is not None:
        remarks = (*remarks, *_remarks(pieces, given))
    in_pieces = given if pieces is None else of_pieces(given, pieces)
    centre = centre_of_observed(in_pieces)
    return Scene(
        where,
        given,
        rows[source],
        pieces,
        in_pieces,
        moved_by(in_pieces, -centre),
        centre,
        num_missing=0 if keep else int(np.sum(~observed)),
        remarks=remarks,
    )


def _pieces(given: SceneGraph) -> Pieces | None:
    """Returns what observed nodes are cut into, or None if each is a piece, and whole."""
    pieces = cut_observed(given)
    return None if np.array_equal(pieces.owner, np.flatnonzero(given.nodes.observed)) else pieces


def _remarks(pieces: Pieces, given: SceneGraph) -> Iterator[str]:
    """Yields what was done to the observed nodes of a scene, one sentence each."""
    counts = np.bincount(pieces.owner, minlength=len(given.nodes.label))[given.nodes.observed]
    out_of = f"of {len(counts)} {ontology_of(given).observed_plural}"
    if again := int(np.sum(counts == 0)):
        yield f"left {again} {out_of} alone, which show again what one before them does"
    if cut := int(np.sum(counts > 1)):
        yield f"cut {cut} {out_of} where others abut on them, and joined them again"


def in_place(scene: Scene, grown: SceneGraph) -> SceneGraph:
    """Returns the given part of a scene, in pieces, with what was grown behind it, where it stands.

    Args:
      scene: of `prepare`.
      grown: host graph whose first nodes are those of `scene.centred`.
    """
    num_given = scene.num_in_pieces
    pairs = undirected_edges(grown, PART_OF)
    return extended(
        scene.in_pieces,
        np.asarray(grown.nodes.label)[num_given:],
        np.asarray(grown.nodes.position, np.float64)[num_given:] + scene.centre,
        pairs[(pairs >= num_given).any(axis=-1)],
    )


def whole_again(scene: Scene, graph: SceneGraph) -> SceneGraph:
    """Returns a graph of `in_place` with what is observed as it was given, untouched."""
    return graph if scene.pieces is None else joined(graph, scene.pieces, scene.given)


def _on_host(graph: SceneGraph) -> SceneGraph:
    """Returns a graph in numpy, numbers in float64; its shapes are not checked yet."""

    def host(array: Any) -> np.ndarray:
        array = np.asarray(array)
        return array.astype(np.float64) if np.issubdtype(array.dtype, np.floating) else array

    nodes = graph.nodes._replace(
        position=host(graph.nodes.position),
        normal=host(graph.nodes.normal),
        width=host(graph.nodes.width),
        kind=host(graph.nodes.kind),
    )
    return graph._replace(nodes=nodes)
