"""What workers do in tests of faults. Every worker that starts loads this file, so it imports nothing that workers do
without."""

from __future__ import annotations

import os
import signal
import struct
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.run.cluster import Cluster
from fwclass.run.part import Task

HELD = 500 << 20
"""Bytes that a part of `greedy` and `hopeless` holds."""


def set_back(root: Path, ahead: Path) -> None:
    """Ten parts on two workers of this process, whose clock is set back all the time; `clock.c` reads `ahead`."""
    over = threading.Event()

    def back() -> None:
        with ahead.open("r+b", buffering=0) as stream:  # in place: it is mapped
            seconds = 0
            while not over.wait(0.005):
                seconds -= 100
                os.pwrite(stream.fileno(), struct.pack("q", seconds), 0)

    with Cluster(None, 2, 1.0, 100) as cluster:
        thread = threading.Thread(target=back, daemon=True)
        thread.start()
        for outcome in cluster.run(root, [Task("simple", f"a{k}", 1, {}, simple) for k in range(10)]):
            assert outcome.status == "computed", outcome
        over.set()
        thread.join()


def simple(inputs: Any, directory: Path) -> dict[str, Any]:
    """A part that takes a moment."""
    time.sleep(0.2)
    (directory / "made").write_text(directory.name)
    return {}


def greedy(inputs: Any, directory: Path) -> dict[str, Any]:
    """A part that holds much memory, and less in pieces."""
    return _holding(HELD // inputs.split**2, directory)


def hopeless(inputs: Any, directory: Path) -> dict[str, Any]:
    """A part that holds much memory, in pieces too."""
    return _holding(HELD, directory)


def crashing(inputs: Any, directory: Path) -> dict[str, Any]:
    """A part that crashes its process."""
    signal.raise_signal(signal.SIGSEGV)
    return {}


def _holding(size: int, directory: Path) -> dict[str, Any]:
    held = np.ones(size, np.uint8)
    time.sleep(1.5)
    (directory / "made").write_text(str(held[-1]))
    return {}
