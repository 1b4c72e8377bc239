"""Scene graphs as GraphML, the XML that networkx, Gephi and yEd read: one graph a file.

GraphML has scalars only, so that vectors are spread: nodes have `concept`, `x`, `y`, `z` and, if
planes, `normal_x`, `normal_y`, `normal_z`, `width`; edges have `kind`; the graph has `ontology`, as
JSON, if its concepts are not the paper's. Numbers survive exactly.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sg3d_jax.io.files import parsed, replacing
from sg3d_jax.io.networkx import from_networkx, to_networkx
from sg3d_jax.scene.graph import SceneGraph
from sg3d_jax.scene.ontology import FEATURES
from sg3d_jax.scene.validate import validate_graph

VECTORS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {"pos": ("x", "y", "z")}
    | {
        name: tuple(f"{name}_{axis}" for axis in ("xyz" if shape == (3,) else range(*shape)))
        for name, shape in FEATURES.items()
        if shape
    }
)


def write_graphml(path: str | Path, graph: SceneGraph) -> None:
    """Writes a host graph as a GraphML file.

    Args:
      path: the file to write.
      graph: unpadded, metres.

    Raises:
      ValueError: the graph breaks the data model, or the file cannot be written.
    """
    import networkx

    validate_graph(graph, f"{path}", rules=False)
    made = to_networkx(graph)
    if "ontology" in made.graph:
        made.graph["ontology"] = json.dumps(made.graph["ontology"])
    for attributes in made.nodes.values():
        for vector, scalars in VECTORS.items():
            if vector in attributes:
                attributes.update(zip(scalars, attributes.pop(vector), strict=True))
    with replacing(path) as temporary, temporary.open("wb") as file:
        networkx.write_graphml_xml(made, file)


def read_graphml(path: str | Path) -> SceneGraph:
    """Returns the host graph of a GraphML file.

    Raises:
      ValueError: one sentence that names the file, the node or edge and the field.
    """
    import networkx

    try:
        with Path(path).open("rb") as file:
            made = networkx.read_graphml(file)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}, expected a file to read") from error
    except Exception as error:  # networkx lets through whatever its parser meets with
        raise ValueError(f"{path}: not GraphML that can be read ({error!r:.80})") from error
    if "ontology" in made.graph:
        made.graph["ontology"] = parsed(f"{made.graph['ontology']}", f"{path}: ontology")
    for name, attributes in made.nodes.items():
        _gather(attributes, f"{path}: node {name!r:.40}")
    return from_networkx(made, f"{path}")


def _gather(attributes: dict[str, Any], where: str) -> None:
    """Puts vectors in the place of their scalars."""
    for vector, scalars in VECTORS.items():
        missing = [scalar for scalar in scalars if scalar not in attributes]
        if 0 < len(missing) < len(scalars):
            raise ValueError(f"{where} lacks {missing[0]!r}, expected {', '.join(scalars)}")
        if not missing:
            attributes[vector] = [attributes[scalar] for scalar in scalars]
