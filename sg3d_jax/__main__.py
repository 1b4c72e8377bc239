"""How `sg3d` starts, and `python -m sg3d_jax`: from its first line on it can be stopped cleanly."""

import os
import signal
import sys
from contextlib import suppress
from types import FrameType
from typing import Final

ENDINGS: Final = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class Terminated(BaseException):
    """What SIGTERM raises, as Ctrl-C a KeyboardInterrupt: files are put in order on its way."""


def main() -> None:
    """Runs the command line; after Ctrl-C it exits with 130, after SIGTERM with 143."""
    received: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        # An import swallows exceptions, or makes others of them, and has nothing to put in order.
        if received or _is_importing(frame):
            _end(number)
        received.append(number)
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated

    for number in ENDINGS:
        signal.signal(number, stop)
    try:
        from sg3d_jax import cli

        cli.main()
    except SystemExit as error:  # the command line has said why
        if received:
            _end(received[0], said=error.code == 128 + received[0])
        raise
    except BaseException:
        if received:  # whatever has become of it on its way
            _end(received[0])
        raise


def _is_importing(frame: FrameType | None) -> bool:
    """Returns whether a module is being imported."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _end(number: int, said: bool = False) -> None:
    """Ends the process at once: threads that compile would hold it up for half a minute."""
    if not said:
        os.write(2, f"sg3d: {ENDINGS[signal.Signals(number)]}\n".encode())
    with suppress(Exception):  # closed, or being written to
        sys.stdout.flush()
    os._exit(128 + number)


if __name__ == "__main__":
    main()
