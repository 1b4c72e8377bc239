"""MiDi on P-F: real floors of up to a thousand nodes, from the weights of synthetic ones."""

from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="p-f"),  # made of floor plans: --data.name p-f.npz
    flagg=FlaggConfig(coins=(1,), continuations=8),
    model=MiDiConfig(kin=8, noise_levels=1, sampling_steps=32),
    optimiser=OptimiserConfig(warmup_steps=200),
    initial="midi-s-f",
    steps=4_000,
    batch=8,
    batch_nodes=2048,
    steps_per_call=10,
    capacities=(64, 96, 256, 512),
    validate_every=2_000,
    validation_graphs=24,
)
