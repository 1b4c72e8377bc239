"""MiDi on S-F-square, grown one node a step."""

from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig

CONFIG = Config(
    data=DataConfig(name="s-f-square"),
    model=MiDiConfig(noise_levels=4),
    flagg=FlaggConfig(coins=(1,)),
    steps=8_000,
    capacities=(24, 48, 136),  # one floor of 2,400 has 136 nodes
    validate_every=2_000,
)
