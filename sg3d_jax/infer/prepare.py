"""The way in: what a user gives is checked here, once, and brought to where float32 is fine.

And the way back: what was given leaves as it came, bit for bit, with what was grown behind it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sg3d_jax.scene.graph import SceneGraph, extended, observed_of, ontology_of, undirected_edges
from sg3d_jax.scene.ontology import PART_OF, Ontology
from sg3d_jax.scene.padding import centre_of_observed, moved_by
from sg3d_jax.scene.validate import checked_observed, validate_graph


class Scene(NamedTuple):
    """A scene that may be completed."""

    where: str  # what a refusal calls it
    given: SceneGraph  # host graph without proximity edges, in the user's frame
    centred: SceneGraph  # the same around the mean of what is observed
    centre: np.ndarray  # float64[3], metres
    num_missing: int  # nodes that the user's graph has and `given` has not; for an oracle


def prepare(
    scenes: Any, ontology: Ontology, keep: bool, names: Sequence[str] | None = None
) -> list[Scene]:
    """Checks host graphs and takes of each what is given.

    Args:
      scenes: host graphs, observed nodes or more; not yet trusted.
      ontology: the concepts that the model knows.
      keep: whether everything in a scene is given, such as known rooms, or its observed nodes only.
      names: what a refusal calls each scene; "scene 0", "scene 1" and so on by default.

    Raises:
      ValueError: one sentence that names the scene, the node, the field and what was expected.
    """
    if isinstance(scenes, SceneGraph) or not isinstance(scenes, Sequence):
        raise ValueError(f"scenes is a {type(scenes).__name__}, expected a list of host graphs")
    names = [f"scene {index}" for index in range(len(scenes))] if names is None else names
    pairs = zip(scenes, names, strict=True)
    return [_prepared(scene, ontology, keep, where) for scene, where in pairs]


def _prepared(scene: Any, ontology: Ontology, keep: bool, where: str) -> Scene:
    if not isinstance(scene, SceneGraph):
        expected = "a host graph, as of sg.planes or sg.read_graphs"
        raise ValueError(f"{where}: is a {type(scene).__name__}, expected {expected}")
    if ontology_of(scene) != ontology:
        held, known = (", ".join(each.names) for each in (ontology_of(scene), ontology))
        raise ValueError(f"{where}: its concepts are {held}, expected {known}, as of the model")
    scene = checked_observed(_on_host(scene), where)
    if keep:
        validate_graph(scene, where, rules=False)
    given = _without_proximity(scene) if keep else observed_of(scene)
    centre = centre_of_observed(given)
    num_missing = len(scene.nodes.label) - len(given.nodes.label)
    return Scene(where, given, moved_by(given, -centre), centre, num_missing)


def finished(scene: Scene, grown: SceneGraph) -> SceneGraph:
    """Returns the given part of a scene, untouched, with what was grown behind it.

    Args:
      scene: of `prepare`.
      grown: host graph whose first nodes are those of `scene.centred`.
    """
    num_given = len(scene.given.nodes.label)
    pairs = undirected_edges(grown, PART_OF)
    return extended(
        scene.given,
        np.asarray(grown.nodes.label)[num_given:],
        np.asarray(grown.nodes.position, np.float64)[num_given:] + scene.centre,
        pairs[(pairs >= num_given).any(axis=-1)],
    )


def _without_proximity(graph: SceneGraph) -> SceneGraph:
    """Returns a host graph without its proximity edges: they are made anew."""
    bare = graph._replace(edges=graph.edges._replace(mask=graph.edges.relation == PART_OF))
    return extended(bare, [], np.zeros((0, 3)), np.zeros((0, 2)))


def _on_host(graph: SceneGraph) -> SceneGraph:
    """Returns a graph in numpy, numbers in float64; its shapes are not checked yet."""

    def host(array: Any) -> np.ndarray:
        array = np.asarray(array)
        return array.astype(np.float64) if np.issubdtype(array.dtype, np.floating) else array

    nodes = graph.nodes._replace(
        position=host(graph.nodes.position),
        normal=host(graph.nodes.normal),
        width=host(graph.nodes.width),
    )
    return graph._replace(nodes=nodes)
