"""MiDi on P-B: buildings of two real storeys, from the weights of cities."""

from sg3d_jax.fill.midi import MiDiConfig
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="p-b"),  # made of floor plans: --data.name p-b.npz
    flagg=FlaggConfig(coins=(1,), continuations=8),
    model=MiDiConfig(kin=8, noise_levels=1, sampling_steps=32),
    optimiser=OptimiserConfig(warmup_steps=200),
    initial="midi-p-c",
    steps=2_000,
    batch=8,
    batch_nodes=2048,
    steps_per_call=10,
    capacities=(128, 192, 256),
    validate_every=2_000,
    validation_graphs=24,
)
