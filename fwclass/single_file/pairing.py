"""Which points of two clouds are the same: by their order, or by their places."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.neighbours import Points, nearest_within

SAME_POINT = 0.002
"""Two clouds are in the same order if no pair of points is further apart than this [m]."""


def pairs(mine: Points, others: Points, limit: float) -> NDArray[np.int64]:
    """Row of `others` for every row of `mine`, -1 if none; points without coordinates have none.

    Point by point where both are in the same order, otherwise the nearest point within `limit` [m].
    """
    rows = len(mine[0])
    if rows == len(others[0]) and all(_close(a, b) for a, b in zip(mine, others, strict=True)):
        return np.arange(rows)
    out = np.full(rows, -1, np.int64)
    placed, among = (np.flatnonzero(np.isfinite(x + y + z)) for x, y, z in (mine, others))
    if len(placed) and len(among):
        nearest, _ = nearest_within(_of(mine, placed), _of(others, among), limit)
        out[placed] = np.where(nearest >= 0, among[nearest], -1)
    return out


def _of(places: Points, rows: NDArray[np.int64]) -> Points:
    x, y, z = places
    return x[rows], y[rows], z[rows]


def _close(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """The same numbers, but for rounding, and none in the same places."""
    both = np.isfinite(a) & np.isfinite(b)
    same = np.isfinite(a) == np.isfinite(b)
    return bool(same.all() and (np.abs(a[both] - b[both]) <= SAME_POINT).all())
