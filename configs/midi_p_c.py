"""MiDi on P-C: cities of real floors, from the weights of single ones."""

from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="p-c"),  # made of floor plans: --data.name p-c.npz
    flagg=FlaggConfig(coins=(1,), continuations=8),
    model=MiDiConfig(kin=8, noise_levels=1, sampling_steps=32),
    optimiser=OptimiserConfig(warmup_steps=200),
    initial="midi-p-f",
    steps=4_000,
    batch=8,
    batch_nodes=2048,
    steps_per_call=10,
    capacities=(192, 256, 320),
    validate_every=2_000,
    validation_graphs=24,
)
