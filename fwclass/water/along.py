"""Places along lines, at equal steps of every edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError

MOST = 10_000_000
"""Places along the lines of a file; every 0.5 m they are 5000 km."""


def edges(ring_start: NDArray[np.int64], points: int) -> NDArray[np.int64]:
    """The points from which an edge leads to the next point of the same line; `ring_start`: points of every line."""
    last = np.zeros(points, bool)
    last[ring_start[1:] - 1] = True
    return np.flatnonzero(~last)


def divide(length: NDArray[np.float64], step: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Places at the beginning of every edge and `step` at most apart on it: the number of its edge, and the share of
    its length that lies before the place.

    `InputError` where these are more than `MOST`.
    """
    whole = np.maximum(1, np.ceil(length / step))
    if not whole.sum() <= MOST:
        raise InputError(
            "lines are too long",
            where="water.file or breaklines.file",
            expected=f"at most {MOST * step / 1000:,.0f} km, with a place every {step:g} m (terrain.thin)",
            got=f"{length.sum() / 1000:.3g} km",
            do="check the file and its coordinate system, or leave out what is outside the survey",
        )
    number = whole.astype(np.int64)
    edge = np.repeat(np.arange(len(length)), number)
    return edge, (np.arange(len(edge)) - np.repeat(np.cumsum(number) - number, number)) / number[edge]


def knots_along(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], ring_start: NDArray[np.int64], step: float
) -> tuple[NDArray[np.float64], ...]:
    """x, y, z [m] of places every `step` [m] at most along lines, their last points among them, with heights between
    those of the points."""
    at = edges(ring_start, len(x))
    edge, share = divide(np.hypot(x[at + 1] - x[at], y[at + 1] - y[at]), step)
    a, ends = at[edge], ring_start[1:] - 1
    return tuple(np.append(v[a] + share * (v[a + 1] - v[a]), v[ends]) for v in (x, y, z))
