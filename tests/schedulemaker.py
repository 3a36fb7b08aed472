"""Small surveys for schedules, and waiting for what a process is to do."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import laspy
import numpy as np

FAILS_AT_ONCE = """
survey:
  name: small
  directory: data
  sources: ["strips/*.las"]
  reference: {kind: source}
  crs: none
  features: [zc, height_range_c100]
  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 6, codes: [6]}]
areas: {train: [[0, 0, 5, 10]], gap: 0.5}
tile: {size: 5.0}
train: {trees: 5}
plausibility: {accept: true}
run: {workers: 0}
schedule: {look: 0.2, settle: 1.0, webhook_pause: 0.1, webhook_timeout: 2.0}
"""
"""No strip is there: a run ends with exit code 1 as soon as it looks."""

NOWHERE = "areas.train=[[900,900,905,910]]"
"""No strip reaches there: a run ends as soon as it has looked at the headers."""


def strip(path: Path, seed: int = 0) -> Path:
    """A strip of 400 points."""
    r = np.random.default_rng(seed)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales = [0.001] * 3
    las.x, las.y, las.z = r.uniform(0, 10, (3, 400))
    las.classification = r.choice([2, 6], 400)
    las.write(path)
    return path


def until(found: Callable[[], object], seconds: float = 240.0):
    """Wait for what a process is to do."""
    ends = time.monotonic() + seconds
    while not (result := found()):
        assert time.monotonic() < ends, "it did not come"
        time.sleep(0.05)
    return result


@contextmanager
def under_way(line: Sequence[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The process of `line`, ended at the end; its standard error is in the file `log`."""
    with log.open("w") as told:
        process = subprocess.Popen(line, stderr=told, stdout=subprocess.DEVNULL)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
