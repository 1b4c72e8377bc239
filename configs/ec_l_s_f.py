"""EC-L on S-F, in a few minutes.

The original takes up to 299 epochs of 1,000 layouts, one graph a step, with Adam at 0.0015, and
stops 30 epochs after the best; here 18 epochs of 1,800 floors in batches of 8 floors suffice.
"""

from sg3d_jax.baselines.edge_classifier import ECLConfig
from sg3d_jax.train.config import Config, DataConfig, OptimiserConfig

CONFIG = Config(
    data=DataConfig(name="s-f"),
    flagg=None,
    model=ECLConfig(),
    optimiser=OptimiserConfig(learning_rate=1.5e-3, warmup_steps=200, ema_decay=0.995),
    steps=4_000,
    batch=8,
    validate_every=1_000,
)
