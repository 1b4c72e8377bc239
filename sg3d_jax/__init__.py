"""From the planes that a robot sees to the complete 3D scene graph, by autoregressive diffusion."""

from sg3d_jax.data.registry import make as make_dataset
from sg3d_jax.data.splits import split
from sg3d_jax.flagg.sample import Completion, Grown, complete, grow_from_planes
from sg3d_jax.interop.json import read_graphs, write_graph
from sg3d_jax.interop.planes import read_planes
from sg3d_jax.metrics.fgw import FGW, fgw, fgw_pairs
from sg3d_jax.metrics.report import score
from sg3d_jax.scene.graph import SceneGraph, make_graph, planes_of
from sg3d_jax.scene.padding import pad, stack, unpad
from sg3d_jax.train.weights import load_weights

__version__ = "0.1.0"
__all__ = [
    "FGW",
    "Completion",
    "Grown",
    "SceneGraph",
    "complete",
    "fgw",
    "fgw_pairs",
    "grow_from_planes",
    "load_weights",
    "make_dataset",
    "make_graph",
    "pad",
    "planes_of",
    "read_graphs",
    "read_planes",
    "score",
    "split",
    "stack",
    "unpad",
    "write_graph",
]
