"""FD4 on S-F-square: rectangular rooms, one floor."""

from sg3d_jax.train.config import Config, DataConfig

CONFIG = Config(data=DataConfig(name="s-f-square"))
