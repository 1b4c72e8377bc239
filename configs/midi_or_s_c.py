"""MiDi+Or on S-C: all high-level nodes at once, from the weights of synthetic floors."""

from sg3d_jax.baselines.midi_oracle import MiDiOracleConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="s-c"),
    model=MiDiOracleConfig(pair_width=32, noise_levels=1),
    flagg=None,
    optimiser=OptimiserConfig(learning_rate=5e-4, warmup_steps=100),
    initial="midi-or-s-f",
    steps=4_000,
    batch=4,
    batch_nodes=256,  # a graph of N nodes has N / 2 x 3 N / 2 pairs
    steps_per_call=10,
    capacities=(64, 96, 128, 192, 256),
    validate_every=4_000,
    validation_graphs=12,
)
