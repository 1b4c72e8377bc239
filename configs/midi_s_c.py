"""MiDi on S-C: cities of two buildings, from the weights of single floors."""

from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="s-c"),
    flagg=FlaggConfig(coins=(1,), continuations=8),
    model=MiDiConfig(kin=8, noise_levels=1, sampling_steps=32),
    optimiser=OptimiserConfig(warmup_steps=200),
    initial="midi-s-f",
    steps=5_000,
    batch=8,
    batch_nodes=2048,
    steps_per_call=10,
    capacities=(96, 128, 192, 256),
    validate_every=2_500,
    validation_graphs=24,
)
