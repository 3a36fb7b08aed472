"""The command `fwclass`, also as ``python -m fwclass``: what Python itself loads before it knows this is safe only with
``python -P -m fwclass``."""

import os
import signal
from types import FrameType

from fwclass.isolation import isolate

isolate()


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(130)  # nothing has begun; Python would show where in its imports it was


def main() -> None:
    """Entry point of the command; Ctrl-C ends it quietly while it is being loaded."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)
    from fwclass.cli import main as command  # after the import path is clean

    command()


if __name__ == "__main__":
    main()
