"""MiDi+Or on S-F-square: all high-level nodes at once."""

from sg3d_jax.baselines.midi_oracle import MiDiOracleConfig
from sg3d_jax.train.config import Config, DataConfig

CONFIG = Config(
    data=DataConfig(name="s-f-square"),
    model=MiDiOracleConfig(pair_width=32, noise_levels=1),
    flagg=None,
    steps=8_000,
    batch=16,
    capacities=(24, 32, 48, 136),  # one floor of 2,400 has 136 nodes
    validate_every=2_000,
)
