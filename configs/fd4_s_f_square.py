"""FD4 on S-F-square: rectangular rooms on one floor, turned by any angle."""

from sg3d_jax.fill.fd4 import FD4Config
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig

CONFIG = Config(
    data=DataConfig(name="s-f-square"),
    flagg=FlaggConfig(coins=(1,)),  # one node a step: see the README on block sizes
    model=FD4Config(noise_levels=4),
    steps=18_000,
    capacities=(24, 48, 136),  # one floor of 2,400 has 136 nodes
    validate_every=3_000,
)
