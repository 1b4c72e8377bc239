"""FD4 on S-F: rooms of four to seven planes, one floor, some widths stale."""

from sg3d_jax.train.config import Config, DataConfig

CONFIG = Config(data=DataConfig(name="s-f"))
