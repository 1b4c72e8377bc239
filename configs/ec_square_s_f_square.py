"""EC-square on S-F-square, in a few minutes.

The original takes 99 epochs of 1,000 layouts in batches of 128 edges with Adam at 0.01, and keeps
the last epoch; here 33 epochs of 1,440 floors in batches of 16 floors suffice.
"""

from sg3d_jax.baselines.edge_classifier import ECSquareConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="s-f-square"),
    flagg=None,
    model=ECSquareConfig(),
    optimiser=OptimiserConfig(learning_rate=3e-3, warmup_steps=200, ema_decay=0.99),
    steps=3_000,
    batch=16,
    capacities=(24, 48, 136),
    validate_every=1_000,
)
