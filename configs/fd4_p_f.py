"""FD4 on P-F: real floors of up to a thousand nodes, from the weights of synthetic ones."""

from sg3d_jax.fill.fd4 import FD4Config
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="p-f"),  # made of floor plans: --data.name p-f.npz
    flagg=FlaggConfig(coins=(1,), continuations=8),
    model=FD4Config(noise_levels=1, topology_steps=16),
    optimiser=OptimiserConfig(warmup_steps=200),
    initial="fd4-s-f",
    steps=9_000,
    batch=8,
    batch_nodes=2048,
    steps_per_call=10,
    capacities=(48, 64, 96, 128, 256, 512),
    validate_every=3_000,
    validation_graphs=48,
)
