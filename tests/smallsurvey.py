"""A survey of 6 000 points with classes and no waveforms, which runs in seconds, for tests of commands."""

from __future__ import annotations

from pathlib import Path

import lasmaker
import numpy as np
from commandline import fwclass

CONFIG = """survey:
  name: small
  directory: .
  sources: [a.las]
  reference: {kind: source}
  features: [zc, height_range_c100]
  classes: [{name: ground, code: 2, codes: [2]}, {name: bush, code: 5, codes: [5]}]
areas: {train: [[500000, 5400000, 500030, 5400040]], gap: 1}
tile: {size: 50}
train: {trees: 5}
publish: {figure_pixels: 200}
assess: {block: 5}
"""


def small_survey(place: Path, stray: tuple[float, float] | None = None, tile: int = 50) -> Path:
    """``a.las``, a slope of 80 m × 40 m with bushes, and ``s.yaml`` beside it, which is returned.

    `stray`: one point more lies so far [m] to the east of all, and so high above the slope's foot. `tile`: edge of the
    tiles [m]; two of 50 m run a third faster than eight of 25 m.
    """
    rng = np.random.default_rng(0)
    x, y, bush = *rng.uniform(0, 1, (2, 6000)) * [[80], [40]], rng.random(6000) < 0.3
    xyz = np.c_[500_000 + x, 5_400_000 + y, 200 + 0.05 * x + bush * rng.uniform(0.5, 6, 6000)]
    classes = np.where(bush, 5, 2)
    intensity = rng.integers(1, 9, 6000)
    if stray is not None:
        xyz = np.r_[xyz, [[500_080 + stray[0], 5_400_000, 200 + stray[1]]]]
        classes, intensity = np.append(classes, 2), np.append(intensity, 1)
    lasmaker.write_las(place / "a.las", xyz, point_format=6, classification=classes, intensity=intensity)
    path = place / "s.yaml"
    path.write_text(CONFIG.replace("size: 50", f"size: {tile}"))
    return path


def deliver(place: Path, *settings: str) -> None:
    """Run the survey of a directory into ``run`` beside it."""
    words = [w for s in settings for w in ("--set", s)]
    made = fwclass("run", place / "s.yaml", "--out", place / "run", "--workers", 0, *words)
    assert made.returncode == 0, made.stderr
