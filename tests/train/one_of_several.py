"""A process that trains `wide_run` with others and stops at a step; the second fails at first.

python -m tests.train.one_of_several DIRECTORY ADDRESS NUM_PROCESSES PROCESS_ID STEP
"""

import signal
import sys
import time
from pathlib import Path

STUCK = 300  # seconds after which it ends by itself


def stop():
    """Waits to be killed."""
    print("stopped", flush=True)
    time.sleep(STUCK)


def main():
    signal.alarm(STUCK)
    directory, address, *numbers = sys.argv[1:]
    num_processes, process_id, step = map(int, numbers)
    import jax

    import tests.conftest  # noqa: F401  JAX as the tests have it
    from sg3d_jax.distributed import initialise

    jax.config.update("jax_debug_key_reuse", False)  # as in the other tests here
    initialise(address, num_processes, process_id)
    from sg3d_jax.train.loop import train
    from sg3d_jax.train.processes import together
    from tests.train.wide_run import CONFIG, end_at, use

    try:
        with together():
            if process_id == 1:
                raise KeyError("here alone")
    except (KeyError, ValueError) as error:
        print(error)
    use(setattr)
    end_at(step, stop, setattr)
    train(CONFIG, Path(directory))


if __name__ == "__main__":
    main()
