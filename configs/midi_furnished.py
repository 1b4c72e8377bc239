"""MiDi on furnished floors and cities: objects, doors and stairs observed; kinds and units grown.

It starts from the general weights: what they know of planes, walls, rooms and all above them is
carried over by the names of the concepts. On a clock: `benchmarks/train_minutes.py`. The weights
that come with the package then went on from there, `--initial midi-furnished`, with other views:
`--views 1 --data o-f:2500+o-c:700+o-f:2500@robot+o-c:700@robot+o-f:1500@robot_bare`; their kinds,
of real floors too, with `--only kinds`; units and what is above them with `--only upper`; and where
nodes stand with `--only placement` (RESULTS.md has the commands).
"""

import dataclasses

from sg3d_jax.data.furnished import FURNISHED_ONTOLOGY
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig
from sg3d_jax.train.presets import find_config

GENERAL = find_config("midi-general")
SETS = ("o-f:2500", "o-c:700")

CONFIG: Config = dataclasses.replace(
    GENERAL,
    data=DataConfig(
        name="+".join([*SETS, *(f"{name}@robot" for name in SETS)]), title="furnished", views=2
    ),
    ontology=FURNISHED_ONTOLOGY,
    flagg=dataclasses.replace(GENERAL.flagg or FlaggConfig(), upper="unit"),
    initial="midi-general",
    optimiser=OptimiserConfig(learning_rate=5e-4, warmup_steps=200),
    steps=10_000,
    batch=16,
    batch_nodes=1024,
    capacities=(96, 192, 320, 512),
)
