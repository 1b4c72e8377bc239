"""From the planes that a robot sees to the complete 3D scene graph, by autoregressive diffusion."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sg3d_jax.io.formats import read_graphs, read_planes, write_graphs
    from sg3d_jax.data.registry import make as make_dataset
    from sg3d_jax.data.splits import split
    from sg3d_jax.flagg.grow import Completion, Grown, grow_from_planes
    from sg3d_jax.io.networkx import from_networkx, to_networkx
    from sg3d_jax.metrics.entropic import entropic_fgw
    from sg3d_jax.metrics.fgw import FGW, fgw, fgw_pairs
    from sg3d_jax.metrics.fgw_loss import fgw_loss
    from sg3d_jax.metrics.mmd import mmd_scores
    from sg3d_jax.metrics.report import score
    from sg3d_jax.scene.graph import SceneGraph, make_graph, observed_of
    from sg3d_jax.scene.padding import pad, stack, unpad
    from sg3d_jax.train.methods import complete
    from sg3d_jax.train.weights import load_weights

__version__ = "0.1.0"
__all__ = [
    "FGW",
    "Completion",
    "Grown",
    "SceneGraph",
    "complete",
    "entropic_fgw",
    "fgw",
    "fgw_loss",
    "fgw_pairs",
    "from_networkx",
    "grow_from_planes",
    "load_weights",
    "make_dataset",
    "make_graph",
    "mmd_scores",
    "pad",
    "observed_of",
    "read_graphs",
    "read_planes",
    "score",
    "split",
    "stack",
    "to_networkx",
    "unpad",
    "write_graphs",
]

# The imports above, made at run time when a name is first used: `sg3d --help` needs none of them,
# and JAX takes seconds to load.
_NAMES = {
    "data.formats": ("read_graphs", "read_planes", "write_graphs"),
    "data.registry": ("make_dataset",),
    "data.splits": ("split",),
    "flagg.sample": ("Completion", "Grown", "grow_from_planes"),
    "interop.networkx": ("from_networkx", "to_networkx"),
    "metrics.entropic": ("entropic_fgw",),
    "metrics.fgw": ("FGW", "fgw", "fgw_pairs"),
    "metrics.fgw_loss": ("fgw_loss",),
    "metrics.mmd": ("mmd_scores",),
    "metrics.report": ("score",),
    "scene.graph": ("SceneGraph", "make_graph", "observed_of"),
    "scene.padding": ("pad", "stack", "unpad"),
    "train.models": ("complete",),
    "train.weights": ("load_weights",),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Imports a public name on its first use."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{_MODULE_OF[name]}")
    value = getattr(module, "make" if name == "make_dataset" else name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Lists the public names."""
    return sorted(globals().keys() | set(__all__))
