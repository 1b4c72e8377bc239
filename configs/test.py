"""The smallest run that exercises everything; about a minute. For tests, not for results."""

from sg3d_jax.fill.fd4 import FD4Config
from sg3d_jax.flagg.step import FlaggConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="s-f-square", num_graphs=40),
    flagg=FlaggConfig(width=8, depth=1),
    model=FD4Config(
        encoder_width=8,
        encoder_layers=1,
        gates=2,
        node_width=8,
        pair_width=8,
        layers=1,
        heads=2,
        distance_width=8,
        distance_layers=1,
        noise_levels=2,
        topology_steps=3,
        distance_steps=2,
    ),
    optimiser=OptimiserConfig(warmup_steps=2),
    steps=8,
    batch=4,
    steps_per_call=2,
    capacities=(96,),
    validate_every=4,
    validation_graphs=2,
)
