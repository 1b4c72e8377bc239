"""`sg3d compile`: growth as one file, for programs that have JAX and not this package."""

from typing import Any, Final

from sg3d_jax.cli.arguments import (
    Code,
    Output,
    Positional,
    check_at_least,
    check_at_most,
    check_output,
    run_code,
)

ARCHIVES: Final = (".npz",)
MAX_SAMPLES: Final = 1024


def compile_growth(
    weights: Positional[str],
    output: Output,
    planes: int = 50,
    samples: int = 1,
    diffusion_steps: int | None = None,
    code: Code = (),
) -> None:
    """Write growing as one file that JAX runs without this package, on a CPU or a GPU.

    How it is called is in docs/devices.md, and in examples/run_compiled.py.

    Args:
      weights: weights by name, or an npz file.
      output: the npz file: the program, its parameters, and what goes in and comes out.
      planes: most planes of a scene.
      samples: graphs that are drawn of it in one call.
      diffusion_steps: sampling steps of the topology; fewer are faster.
      code: Python files to run first, which register the methods of your own weights.
    """
    import numpy as np

    from sg3d_jax.flagg.step import Flagg
    from sg3d_jax.infer.exported import export_growth
    from sg3d_jax.infer.lanes import MAX_OBSERVED
    from sg3d_jax.io.files import replacing
    from sg3d_jax.origin import commit
    from sg3d_jax.train.weights import load_weights, with_diffusion_steps

    check_at_least("--planes", planes, 2)
    check_at_most("--planes", planes, MAX_OBSERVED)
    check_at_least("--samples", samples, 1)
    check_at_most("--samples", samples, MAX_SAMPLES)
    check_output(output, ARCHIVES)
    run_code(code)
    trained = with_diffusion_steps(load_weights(weights), diffusion_steps)
    model = trained.model
    if not isinstance(model, Flagg):
        given = model.ontology.observed_plural
        raise ValueError(f"{weights} completes {given} alone, expected weights of what grows")
    about = {"weights": weights, "commit": commit()}
    arrays: Any = export_growth(model, trained.params, planes, samples, about)
    with replacing(output) as temporary:
        np.savez_compressed(temporary, **arrays)
    size = output.stat().st_size / 1e6
    print(f"{output}: growth of {planes} planes by {weights}, {samples} a call, {size:.1f} MB")
