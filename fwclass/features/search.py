"""The k nearest echoes of a point, exactly, over a grid of vertical columns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.features.quickselect import lowest_first
from fwclass.kernel import inlined, kernel
from fwclass.neighbours import CellIndex

ROWS = 29
"""Bits of a row in a key; the squared distance [mm2] stands above them, so keys order by distance, then by row."""

ROUNDING = 1.000002
"""Squares of exact integers in float32 are off by less."""

EXACT = 1 << 23
"""Whole millimetres up to here, and their differences, are exact in float32."""

WIDER_FIRST = 1.15
"""The first look is this much wider than the last point's k-th distance."""

WIDER_NEXT = 1.5
"""Each further look is this much wider."""


@dataclass(frozen=True)
class Columns:
    """Points sorted by square columns, ready to be searched.

    Attributes
    ----------
    index : the points by columns.
    x, y, z : coordinates [mm] for the first, rough comparison: float32, float64 where that is not exact.
    """

    index: CellIndex
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    z: NDArray[np.floating]

    @classmethod
    def build(
        cls, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], k: int, reach: float
    ) -> Columns:
        """Columns of points (points,) [m] that hold about `k` of them, at most `reach` [m] wide; their size changes no
        result.

        `InputError` for more points than a row number can tell apart.
        """
        if len(x) >= 1 << ROWS:
            raise InputError("too many points in one part", expected=f"fewer than {1 << ROWS:,}", got=f"{len(x):,}")
        index = CellIndex.build(x, y, z, cell=_edge(x, y, k, reach))
        far = max((int(a.max()) for a in (index.x, index.y, index.z) if len(a)), default=0)
        kind = np.float32 if far < EXACT else np.float64
        return cls(index, index.x.astype(kind), index.y.astype(kind), index.z.astype(kind))


def _edge(x: NDArray[np.float64], y: NDArray[np.float64], k: int, reach: float) -> float:
    """Edge of a square [m] that holds about k / 2 points where there are any; at most `reach`."""
    if len(x) == 0:
        return reach
    col, row = np.floor(x / reach).astype(np.int64), np.floor(y / reach).astype(np.int64)
    occupied = len(np.unique((row - row.min()) * (col.max() - col.min() + 1) + (col - col.min())))
    return min(reach, max(0.05, math.sqrt(0.5 * k * occupied * reach * reach / len(x))))


@kernel
def nearest(fx, fy, fz, x, y, z, order, start, ncols, nrows, cell, wanted, k, reach, near, keys, neighbours, count):  # type: ignore[no-untyped-def]
    """The `k` nearest points of each of `wanted`, itself first.

    Parameters
    ----------
    fx, fy, fz, x, y, z, order, start, ncols, nrows, cell : `Columns` and their `CellIndex`.
    wanted : int64, sorted points to look from.
    k, reach : how many, and how far [mm] at most.
    near, keys : int64 (n,), room to work in.
    neighbours : int64 (wanted, k), keys ``(distance² + 1) << ROWS | row`` of the others and `row` of the point itself,
        rising: by distance, then by input row.
    count : int64 (wanted), how many there are.
    """
    look = float(cell)
    for w in range(len(wanted)):
        i = wanted[w]
        while True:
            look = min(look, float(reach))
            n = _within(fx, fy, fz, start, ncols, nrows, cell, i, look, near)
            n = _keys(x, y, z, order, i, look, near, n, keys)
            if n >= k or look >= reach:
                break
            look *= WIDER_NEXT
        m = _lowest(keys, n, k, neighbours[w])
        count[w] = m
        if m == k and k > 1:
            look = WIDER_FIRST * math.sqrt(float((neighbours[w, m - 1] >> ROWS) - 1)) + 1.0
        look = max(look, 0.25 * cell)


@inlined
def _within(fx, fy, fz, start, ncols, nrows, cell, i, look, near):  # type: ignore[no-untyped-def]
    """Rows no further than about `look` from point i into `near`; how many. No branch on the distance."""
    px, py, pz = fx[i], fy[i], fz[i]
    limit = type(px)(look * look * ROUNDING + 4.0)
    west, east = max(int((px - look) // cell), 0), min(int((px + look) // cell), ncols - 1)
    south, north = max(int((py - look) // cell), 0), min(int((py + look) // cell), nrows - 1)
    n = 0
    for row in range(south, north + 1):
        for j in range(start[row * ncols + west], start[row * ncols + east + 1]):
            dx, dy, dz = fx[j] - px, fy[j] - py, fz[j] - pz
            near[n] = j
            n += dx * dx + dy * dy + dz * dz <= limit
    return n


@inlined
def _keys(x, y, z, order, i, look, near, n, keys):  # type: ignore[no-untyped-def]
    """Keys of those of `near` that are exactly within `look` of point i; how many."""
    limit, m = np.int64(math.floor(look * look)), 0
    for e in range(n):
        j = near[e]
        dx, dy, dz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
        d = dx * dx + dy * dy + dz * dz
        keys[m] = (d + 1) << ROWS | order[j] if j != i else order[j]
        m += d <= limit
    return m


@inlined
def _lowest(keys, n, k, out):  # type: ignore[no-untyped-def]
    """The `k` lowest of `n` keys, rising, into `out`; how many. Keys differ."""
    if n > 4 * k:
        lowest_first(keys, n, k)
        n = k
    m = min(n, k)
    for a in range(n):
        key, rank = keys[a], 0
        for b in range(n):
            rank += keys[b] < key
        if rank < k:
            out[rank] = key
    return m
