"""A process of two that evaluate the same weights, on two devices and on four.

python -m tests.one_of_two ARGUMENTS --process-id NUMBER
"""

import sys

import jax
import numpy as np
from jax.sharding import Mesh

from sg3d_jax import cli
from sg3d_jax.infer import lanes
from sg3d_jax.metrics import report
from tests import (
    at_random,
    conftest,  # noqa: F401  JAX as the tests have it
)


def total(made, truth, pieces):
    """Stands for scores, which take long to compile: what they are made of, summed up."""
    value = float(np.sum([graph.nodes.position.sum() for graph in (*made, *truth)]))
    tables = {name: {} for name in ("precision", "recall", "failures")}
    return {"fgw": value, "node_count_error": {"absolute": {}}, **tables}


def main(arguments):
    jax.config.update("jax_debug_key_reuse", False)
    jax.config.update("jax_num_cpu_devices", 2 + 2 * int(arguments[-1]))
    at_random.register()
    report.score = total
    lanes.lane_mesh = lambda: Mesh(np.array(jax.local_devices()), ("lanes",))
    cli.main(arguments)


if __name__ == "__main__":
    main(sys.argv[1:])
