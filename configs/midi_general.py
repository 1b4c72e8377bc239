"""MiDi on everything: drawn and real floors, buildings and cities, whole and as robots see them.

The P- sets come of floor plans: `sg3d data import p-f FILE -o p-f.npz`, likewise p-b and p-c.
On a GPU, for as long as there is, with larger batches and graphs that are drawn anew:
`benchmarks/train_minutes.py` (RESULTS.md has the command of the last time).
"""

from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.corrupt import CorruptionConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

# Whole sets, and what weighs more: real floors, and floors as wide as the world.
SETS = (
    "s-f-square",
    "s-f",
    "s-f-thick",
    "s-b:1500",
    "s-c:1500",
    "large",
    "g-f:4000",
    "g-b:1000",
    "g-c:1000",
    *["p-f.npz"] * 3,
    *["p-b.npz"] * 2,
    "p-c.npz",
)

CONFIG = Config(
    data=DataConfig(
        name="+".join([*SETS, *(f"{name}@robot" for name in SETS)]), title="general", views=3
    ),
    flagg=FlaggConfig(
        coins=(1,),
        continuations=8,
        any_cuts=0.15,
        upper="floor",
        placement=(48, 8, 4),
        corruption=CorruptionConfig(p_add=0.0, added_per_node=0.01),
    ),
    model=MiDiConfig(
        encoder_layers=4,
        layers=6,
        kin=8,
        contacts=6,
        scene_scale=True,
        noise_levels=1,
        sampling_steps=8,
    ),
    optimiser=OptimiserConfig(warmup_steps=500),
    steps=30_000,
    batch=64,
    batch_nodes=2048,
    steps_per_call=10,
    capacities=(64, 128, 256, 512, 1024),
    validate_every=5_000,
    validation_graphs=40,
)
