"""A run of a thousand parameters, quickly compiled, which may end before its end."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from sg3d_jax import origin
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from sg3d_jax.train import loop
from sg3d_jax.train.config import OptimiserConfig
from sg3d_jax.train.loop import Run
from tests.tiny_run import read_config
from tests.two_rooms import on_device, two_rooms

CONFIG = dataclasses.replace(
    read_config("test"),
    optimiser=OptimiserConfig(learning_rate=0.1, warmup_steps=2),
    steps=12,
    steps_per_call=2,
    validate_every=4,
    batch=3,
    accumulate=4,
)


class Wide:
    """A model whose gradients differ so much that another order of adding them is found out."""

    ontology = PAPER_ONTOLOGY

    def init(self, key, graph):
        return jax.random.normal(key, (999,))

    def loss(self, params, key, graph):
        aim = jnp.sum(graph.nodes.width) + jax.random.normal(key, params.shape)
        return jnp.sum((params - aim) ** 4), {}


def use(setattr):
    """Lets `loop.train` train this model, and write bare parameters."""
    graphs = jax.tree.map(lambda leaf: jnp.stack([leaf] * 4), on_device(two_rooms()))
    run = Run(CONFIG, Wide(), None, [graphs], [], None, {"training": "", "validation": ""})
    setattr(loop, "prepare", lambda config: run)
    setattr(loop, "validate", lambda run, params: {"fgw": 1 / float(np.mean(params**2))})
    setattr(
        loop, "save_weights", lambda path, config, statistics, params, card: np.savez(path, params)
    )
    setattr(origin, "code", lambda: "as it is")


def end_at(step, end, setattr):
    """Ends the run before the call that would go on from a step."""

    def bucket_of_call(config, shares, call):
        if call * config.steps_per_call == step:
            end()
        return 0

    setattr(loop, "bucket_of_call", bucket_of_call)
