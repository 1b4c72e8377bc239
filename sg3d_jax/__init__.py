"""From the planes that a robot sees to the complete 3D scene graph, by autoregressive diffusion."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sg3d_jax import runtime
from sg3d_jax.origin import VERSION

if TYPE_CHECKING:
    from sg3d_jax.data.registry import make as make_dataset
    from sg3d_jax.data.splits import split
    from sg3d_jax.fill.constraints import Rules
    from sg3d_jax.fill.protocol import Fill, Statistics
    from sg3d_jax.flagg.grow import Grown, grow
    from sg3d_jax.infer.complete import Completion, complete, complete_each
    from sg3d_jax.io.formats import (
        read_graphs,
        read_planes,
        read_with_attributes,
        write_graphs,
    )
    from sg3d_jax.io.networkx import from_networkx, to_networkx
    from sg3d_jax.io.planes import planes
    from sg3d_jax.metrics.entropic import entropic_fgw
    from sg3d_jax.metrics.fgw import FGW, fgw, fgw_pairs
    from sg3d_jax.metrics.fgw_loss import fgw_loss
    from sg3d_jax.metrics.mmd import mmd_scores
    from sg3d_jax.metrics.report import score
    from sg3d_jax.scene.graph import (
        Nodes,
        PackedGraph,
        SceneGraph,
        make_graph,
        observed_of,
        ontology_of,
        subgraph,
    )
    from sg3d_jax.scene.ontology import PAPER_ONTOLOGY, Concept, Ontology, Rule
    from sg3d_jax.scene.padding import (
        NODE_CAPACITIES,
        Block,
        Capacity,
        bucket,
        pack,
        pad,
        stack,
        unpad,
    )
    from sg3d_jax.scene.restrict import restricted
    from sg3d_jax.scene.validate import validate_graph
    from sg3d_jax.train.methods import register_fill
    from sg3d_jax.train.weights import load_weights
    from sg3d_jax.train.weights import names as weight_names
    from sg3d_jax.viz.figure import draw_graph, save_picture
    from sg3d_jax.viz.page import save_page

runtime.configure()

__version__ = VERSION
__all__ = [
    "FGW",
    "NODE_CAPACITIES",
    "PAPER_ONTOLOGY",
    "Block",
    "Capacity",
    "Completion",
    "Concept",
    "Fill",
    "Grown",
    "Nodes",
    "Ontology",
    "PackedGraph",
    "Rule",
    "Rules",
    "SceneGraph",
    "Statistics",
    "bucket",
    "complete",
    "complete_each",
    "draw_graph",
    "entropic_fgw",
    "fgw",
    "fgw_loss",
    "fgw_pairs",
    "from_networkx",
    "grow",
    "load_weights",
    "make_dataset",
    "make_graph",
    "mmd_scores",
    "observed_of",
    "ontology_of",
    "pack",
    "pad",
    "planes",
    "read_graphs",
    "read_planes",
    "read_with_attributes",
    "register_fill",
    "restricted",
    "save_page",
    "save_picture",
    "score",
    "split",
    "stack",
    "subgraph",
    "to_networkx",
    "unpad",
    "validate_graph",
    "weight_names",
    "write_graphs",
]

# The imports above, made at run time when a name is first used: `sg3d --help` needs none of them,
# and JAX takes seconds to load.
_NAMES = {
    "data.splits": ("split",),
    "fill.constraints": ("Rules",),
    "fill.protocol": ("Fill", "Statistics"),
    "flagg.grow": ("Grown", "grow"),
    "infer.complete": ("Completion", "complete", "complete_each"),
    "io.formats": ("read_graphs", "read_planes", "read_with_attributes", "write_graphs"),
    "io.networkx": ("from_networkx", "to_networkx"),
    "io.planes": ("planes",),
    "metrics.entropic": ("entropic_fgw",),
    "metrics.fgw": ("FGW", "fgw", "fgw_pairs"),
    "metrics.fgw_loss": ("fgw_loss",),
    "metrics.mmd": ("mmd_scores",),
    "metrics.report": ("score",),
    "scene.graph": (
        "Nodes",
        "PackedGraph",
        "SceneGraph",
        "make_graph",
        "observed_of",
        "ontology_of",
        "subgraph",
    ),
    "scene.ontology": ("PAPER_ONTOLOGY", "Concept", "Ontology", "Rule"),
    "scene.padding": (
        "NODE_CAPACITIES",
        "Block",
        "Capacity",
        "bucket",
        "pack",
        "pad",
        "stack",
        "unpad",
    ),
    "scene.restrict": ("restricted",),
    "scene.validate": ("validate_graph",),
    "train.methods": ("register_fill",),
    "train.weights": ("load_weights",),
    "viz.figure": ("draw_graph", "save_picture"),
    "viz.page": ("save_page",),
}
_PLACES = {name: (module, name) for module, names in _NAMES.items() for name in names} | {
    "make_dataset": ("data.registry", "make"),
    "weight_names": ("train.weights", "names"),
}
__all__ = sorted(_PLACES)


def __getattr__(name: str) -> Any:
    """Imports a public name on its first use."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, own_name = _PLACES[name]
    value = getattr(import_module(f"{__name__}.{module}"), own_name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Lists the public names."""
    return sorted(globals().keys() | set(__all__))
