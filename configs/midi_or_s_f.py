"""MiDi+Or on S-F: all high-level nodes at once."""

from sg3d_jax.baselines.midi_oracle import MiDiOracleConfig
from sg3d_jax.train.config import Config, DataConfig

CONFIG = Config(
    data=DataConfig(name="s-f"),
    model=MiDiOracleConfig(pair_width=32, noise_levels=1),
    flagg=None,
    steps=12_000,
    batch=16,
    capacities=(24, 32, 48, 96),
    validate_every=3_000,
)
