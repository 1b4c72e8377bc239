"""MiDi on S-F, grown one node a step."""

from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig

CONFIG = Config(
    data=DataConfig(name="s-f"),
    model=MiDiConfig(noise_levels=4),
    flagg=FlaggConfig(coins=(1,)),
    steps=12_000,
    validate_every=3_000,
)
