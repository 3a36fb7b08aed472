"""Python's tracker of semaphores, kept quiet where it is killed and started again."""

from __future__ import annotations

import os
from contextlib import suppress
from multiprocessing import resource_tracker
from typing import Any


def settle_tracker() -> None:
    """Let the tracker of this process hear of those semaphores alone that it was told of.

    One that was killed is started again, and prints a traceback for every name that only the first one knew.
    """
    tracker: Any = resource_tracker._resource_tracker
    if "_send" in vars(tracker):  # done before
        return
    known = set[tuple[object, ...]]()

    def send_known(command: str, name: str, kind: str) -> None:
        tracker.ensure_running()
        thing = (tracker._pid, name, kind)
        if command == "REGISTER":
            known.add(thing)
        elif thing not in known:
            return
        else:
            known.remove(thing)
        with suppress(OSError):  # it was killed since; Python's own `_send` would tell the next one of this name
            os.write(tracker._fd, f"{command}:{name}:{kind}\n".encode("ascii"))

    tracker._send = send_known
