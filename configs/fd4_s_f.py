"""FD4 on S-F: rooms of four to seven planes on one floor, some widths stale."""

from sg3d_jax.fill.fd4 import FD4Config
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig

CONFIG = Config(
    data=DataConfig(name="s-f"),
    flagg=FlaggConfig(coins=(1,)),  # one node a step: see the README on block sizes
    model=FD4Config(noise_levels=4),
    steps=18_000,
    validate_every=3_000,
)
