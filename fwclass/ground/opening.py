"""Grey-value openings of a surface with disks; the cost per cell grows with the radius, not its square."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel


def disk(radius: int) -> NDArray[np.int64]:
    """Half-widths [cells] of the rows −radius … radius of a disk: row dy holds |dx| ≤ √(radius² − dy²)."""
    return np.array([math.isqrt(radius * radius - dy * dy) for dy in range(-radius, radius + 1)], np.int64)


def opened(surface: NDArray[np.float64], radius: int) -> NDArray[np.float64]:
    """Opening of `surface` with a disk of `radius` cells: the lowest, then the highest value in it.

    NaN cells and what lies beyond the array's edge take no part; NaN stays NaN. Radius 0 gives a copy.
    """
    if radius == 0 or surface.size == 0:
        return surface.copy()
    rows = disk(radius)
    outside = np.isnan(surface)
    low = _eroded(np.where(outside, np.inf, surface), rows)
    low[outside] = -np.inf
    out = -_eroded(-low, rows)
    out[outside] = np.nan
    return out


@kernel
def _eroded(surface, half_widths):  # type: ignore[no-untyped-def]
    """Minimum over the disk: each of its rows is two overlapping runs of 2^k cells from a table of minima."""
    nrows, ncols = surface.shape
    radius = len(half_widths) // 2
    levels = 1
    while (1 << levels) <= 2 * radius + 1:
        levels += 1
    wide = ncols + 2 * radius
    table = np.full((levels, nrows, wide), np.inf)
    table[0, :, radius : radius + ncols] = surface
    for k in range(1, levels):
        step = 1 << (k - 1)
        for r in range(nrows):
            shorter, longer = table[k - 1, r], table[k, r]
            for c in range(wide - step):
                a, b = shorter[c], shorter[c + step]
                longer[c] = a if a < b else b
    out = np.full((nrows, ncols), np.inf)
    for r in range(nrows):
        line = out[r]
        for dy in range(max(-radius, -r), min(radius, nrows - 1 - r) + 1):
            half = half_widths[dy + radius]
            k = 0
            while (2 << k) <= 2 * half + 1:
                k += 1
            left = radius - half
            right = radius + half + 1 - (1 << k)
            run = table[k, r + dy]
            first, second = run[left : left + ncols], run[right : right + ncols]
            for c in range(ncols):
                a = first[c] if first[c] < second[c] else second[c]
                line[c] = a if a < line[c] else line[c]
    return out
