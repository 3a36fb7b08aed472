"""The kernel of lines: whether sure echoes of a class lie on a straight line through an echo."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel

CELL = 1000
"""mm, cells along a line."""

BESIDE = 500
"""mm along a line on either side of the echo that count for nothing."""

NEAREST = 3000
"""mm, a nearer echo gives no direction: its noise would turn it."""

DIRECTIONS = 128
"""Directions that are tried of one echo, at most: with more echoes every second, third, … of them."""


@kernel
def on_line(
    place: NDArray[np.int64],
    need: NDArray[np.float64],
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    z: NDArray[np.int64],
    reach: int,
    tolerance: float,
    sag: float,
    slope: float,
    most: int,
    crowded: bool,
) -> NDArray[np.bool_]:
    """bool (echoes,): whether at least `need` cells of a line through `place` (echoes, 3) [mm] hold a sure echo.

    `x`, `y`, `z` [mm] are the sure echoes, sorted by x. A line goes through the echo and one of them, between `NEAREST`
    and `reach` [mm] away in plan and no steeper than `slope`. Those within `reach` along it and `tolerance` [mm] beside
    it count; in height a distance of ``tolerance + sag · |s| · |s − d|`` [mm], s the way to it and d to the one that
    gives the direction: a parabola through both. With more than `most` sure echoes in reach the answer is `crowded`.
    """
    answer = np.zeros(len(place), np.bool_)
    dx, dy, dz = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.int64)
    for i in range(len(place)):
        begin = np.searchsorted(x, place[i, 0] - reach)
        n = 0
        for j in range(begin, len(x)):
            u = x[j] - place[i, 0]
            if u > reach:
                break
            v = y[j] - place[i, 1]
            if u * u + v * v > reach * reach:
                continue
            if n == most:
                n += 1
                break
            dx[n], dy[n], dz[n] = u, v, z[j] - place[i, 2]
            n += 1
        if n > most:
            answer[i] = crowded
        if n > most or n < need[i]:
            continue
        step = (n + DIRECTIONS - 1) // DIRECTIONS
        for a in range(0, n, step):
            d = math.sqrt(float(dx[a] * dx[a] + dy[a] * dy[a]))
            if d < NEAREST or abs(dz[a]) > slope * d:
                continue
            if _cells(dx, dy, dz, n, a, d, tolerance, sag) >= need[i]:
                answer[i] = True
                break
    return answer


@kernel
def _cells(
    dx: NDArray[np.int64],
    dy: NDArray[np.int64],
    dz: NDArray[np.int64],
    n: int,
    a: int,
    d: float,
    tolerance: float,
    sag: float,
) -> int:
    """Cells that the first `n` echoes, relative to one, occupy on the line to number `a`, `d` [mm] away in plan."""
    behind, ahead = np.uint64(0), np.uint64(0)
    rise = dz[a] / d
    for b in range(n):
        along = (dx[b] * dx[a] + dy[b] * dy[a]) / d
        if abs(along) < BESIDE or abs(dx[b] * dy[a] - dy[b] * dx[a]) > tolerance * d:
            continue
        if abs(dz[b] - rise * along) > tolerance + sag * abs(along) * abs(along - d):
            continue
        bit = np.uint64(1) << np.uint64(int(abs(along)) // CELL)
        if along > 0:
            ahead |= bit
        else:
            behind |= bit
    count = 0
    while behind:
        behind &= behind - np.uint64(1)
        count += 1
    while ahead:
        ahead &= ahead - np.uint64(1)
        count += 1
    return count
