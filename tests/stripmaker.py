"""Surveys of several flight lines over a known surface, with lifts and tilts of the lines, for tests of quality."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import lasmaker
import numpy as np
from numpy.typing import NDArray

EAST, NORTH = 500_000.0, 5_400_000.0
WIDE, LONG = 100.0, 240.0
"""m, a line's width and length; lines run to the north 60 m apart, every second one back."""

Line = Mapping[str, NDArray]


def ground(x: NDArray, y: NDArray) -> NDArray:
    """Height of the terrain [m]."""
    return 200 + 0.03 * (x - EAST) + 2 * np.sin((y - NORTH) / 40)


def line(
    number: int, lift: tuple[float, float, float] = (0, 0, 0), density: float = 4.0, seed: int = 0, noise: float = 0.02
) -> Line:
    """Echoes ``x, y, z, t`` of a line whose height, right edge and far end are lifted by `lift` [m]."""
    rng = np.random.default_rng((seed, number))
    n = round(density * WIDE * LONG)
    u, v = rng.uniform(-1, 1, (2, n))
    order = np.argsort(v)
    u, v, back = u[order], v[order], -1 if number % 2 else 1
    x = np.round(EAST + 60 * number + WIDE / 2 * (1 + back * u), 3)
    y = np.round(NORTH + LONG / 2 * (1 + back * v), 3)
    z = ground(x, y) + lift[0] + lift[1] * u + lift[2] * v + rng.normal(0, noise, n)
    return {"x": x, "y": y, "z": z, "t": 1000 + 300 * number + LONG / 2 * (v + 1) / 60}


def write_lines(path: Path, lines: Sequence[Line], keep: NDArray | None = None, time: bool = True) -> Path:
    """One LAS file of `lines`, of which `keep` says which echoes stay."""
    joined = {n: np.concatenate([one[n] for one in lines]) for n in "xyzt"}
    some = slice(None) if keep is None else keep
    xyz = np.stack([joined[n][some] for n in "xyz"], axis=1)
    return lasmaker.write_las(path, xyz, point_format=6, gps_time=joined["t"][some] if time else 0.0)
