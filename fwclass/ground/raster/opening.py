"""Grey-value openings of a surface with disks; the cost per cell grows with the radius, not its square."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fwclass.kernel import kernel

Real = TypeVar("Real", np.float32, np.float64)

STRIP = 256
"""[cells] Width of what is worked on at a time."""


def disk(radius: int) -> NDArray[np.int64]:
    """Half-widths [cells] of the rows −radius … radius of a disk: row dy holds |dx| ≤ √(radius² − dy²)."""
    return np.array([math.isqrt(radius * radius - dy * dy) for dy in range(-radius, radius + 1)], np.int64)


def disk_opening(surface: NDArray[Real], radius: int) -> NDArray[Real]:
    """Opening of `surface` with a disk of `radius` cells: the lowest, then the highest value in it.

    NaN cells and what lies beyond the array's edge take no part; NaN stays NaN. Radius 0 gives a copy.
    """
    if radius == 0 or surface.size == 0:
        return surface.copy()
    rows = disk(radius)
    outside = np.isnan(surface)
    low = _erode_by_disk(np.where(outside, surface.dtype.type(np.inf), surface), rows)
    low[outside] = -np.inf
    out = _erode_by_disk(np.negative(low, out=low), rows)
    out[outside] = np.nan
    return np.negative(out, out=out)


def _erode_by_disk(surface: NDArray[Real], half_widths: NDArray[np.int64]) -> NDArray[Real]:
    """Minimum over the disk, strip by strip and row by row, so that the table stays in the processor's cache; infinite
    cells have no part in it, and whatever the minimum around them."""
    radius, (nrows, ncols) = len(half_widths) // 2, surface.shape
    out = np.empty((nrows, ncols), surface.dtype)
    levels = (2 * radius + 1).bit_length()
    table = np.empty((levels, min(2 * radius + 1, nrows), min(STRIP, ncols) + 2 * radius), surface.dtype)
    _erode(surface, half_widths, min(STRIP, ncols), table, out)
    return out


@kernel
def _any_below_infinity(values):  # type: ignore[no-untyped-def]
    for value in values:
        if value < np.inf:
            return True
    return False


@kernel
def _erode(surface, half_widths, strip, table, out):  # type: ignore[no-untyped-def]
    """Each row of the disk is two overlapping runs of 2^k cells from a table of minima, which holds the rows that the
    disk reaches, row ``r`` at ``r`` modulo their number. A row without a finite cell takes no part, and stays infinite:
    sparse surveys have next to no others."""
    nrows, ncols = surface.shape
    radius = len(half_widths) // 2
    levels, held = len(table), table.shape[1]
    used = np.empty(nrows, np.bool_)
    for start in range(0, ncols, strip):
        count = min(strip, ncols - start)
        wide = count + 2 * radius
        first_in, last_in = max(start - radius, 0), min(start + count + radius, ncols)
        begin = first_in - (start - radius)
        entered = 0
        for r in range(nrows):
            used[r] = _any_below_infinity(surface[r, first_in:last_in])
        for r in range(nrows):
            while entered <= min(r + radius, nrows - 1):
                if not used[entered]:
                    entered += 1
                    continue
                base = table[0, entered % held]
                base[:begin] = np.inf
                for c in range(last_in - first_in):
                    base[begin + c] = surface[entered, first_in + c]
                base[begin + last_in - first_in : wide] = np.inf
                for k in range(1, levels):
                    step = 1 << (k - 1)
                    shorter, longer = table[k - 1, entered % held], table[k, entered % held]
                    for c in range(wide - 2 * step + 1):
                        a, b = shorter[c], shorter[c + step]
                        longer[c] = a if a < b else b
                entered += 1
            line = out[r, start : start + count]
            line[:] = np.inf
            if not used[r]:
                continue
            for dy in range(max(-radius, -r), min(radius, nrows - 1 - r) + 1):
                if not used[r + dy]:
                    continue
                half = half_widths[dy + radius]
                k = 0
                while (2 << k) <= 2 * half + 1:
                    k += 1
                left = radius - half
                right = radius + half + 1 - (1 << k)
                run = table[k, (r + dy) % held]
                first, second = run[left : left + count], run[right : right + count]
                for c in range(count):
                    a = first[c] if first[c] < second[c] else second[c]
                    line[c] = a if a < line[c] else line[c]
