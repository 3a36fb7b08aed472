"""The surface model: the highest echo of every cell, and small gaps between such cells bridged."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window
from fwclass.kernel import kernel
from fwclass.sorting import sort_few


def highest(cells: NDArray[np.int64], z: NDArray[np.float64], window: Window) -> NDArray[np.float64]:
    """Highest z [m] by cell of `window`, NaN where no point lies; `cells` are flat cell numbers of the points."""
    out = np.full(window.shape, np.nan)
    _raise(cells, z, out.reshape(-1))
    return out


def without_pepper(surface: NDArray[np.float64], gap: float) -> NDArray[np.float64]:
    """`surface` with gaps of at most `gap` [cells] in width filled from the cells around, other gaps left NaN.

    The cells that are filled are those that a disk of diameter `gap` cannot reach between cells with a value, so
    nothing is added outside or in wide gaps. A filled cell takes the lower median of the nearest ring of cells
    that has values, so that no height arises that is neither roof nor ground.
    """
    out = surface.copy()
    radius = gap / 2.0
    if radius >= 1.0:
        steps = np.array(disk(radius), np.int64)
        _bridge(surface, _near(surface, steps), steps, math.ceil(2.0 * radius), out)
    return out


def disk(radius: float) -> list[tuple[int, int]]:
    """Steps (rows, columns) to the cells whose middle lies within `radius` [cells]."""
    reach = range(-int(radius), int(radius) + 1)
    return [(r, c) for r in reach for c in reach if r * r + c * c <= radius * radius]


@kernel
def _raise(cells, z, out):  # type: ignore[no-untyped-def]
    for i in range(len(cells)):
        if not z[i] <= out[cells[i]]:
            out[cells[i]] = z[i]


@kernel
def _near(surface, steps):  # type: ignore[no-untyped-def]
    """Cells with a value within a step of them."""
    nrows, ncols = surface.shape
    out = np.zeros((nrows, ncols), np.bool_)
    for r in range(nrows):
        for c in range(ncols):
            out[r, c] = not np.isnan(surface[r, c])
            for k in range(len(steps)):
                if out[r, c]:
                    break
                i, j = r + steps[k, 0], c + steps[k, 1]
                out[r, c] = 0 <= i < nrows and 0 <= j < ncols and not np.isnan(surface[i, j])
    return out


@kernel
def _is_enclosed(near, steps, r, c):  # type: ignore[no-untyped-def]
    """True where all cells within a step are near a value; those beyond the array are not."""
    for k in range(len(steps)):
        i, j = r + steps[k, 0], c + steps[k, 1]
        if i < 0 or j < 0 or i >= near.shape[0] or j >= near.shape[1] or not near[i, j]:
            return False
    return True


@kernel
def _bridge(surface, near, steps, most, out):  # type: ignore[no-untyped-def]
    nrows, ncols = surface.shape
    around = np.empty((2 * most + 1) ** 2)
    for r in range(nrows):
        for c in range(ncols):
            if not np.isnan(surface[r, c]) or not near[r, c] or not _is_enclosed(near, steps, r, c):
                continue
            n = 0
            for reach in range(1, most + 1):
                for i in range(max(r - reach, 0), min(r + reach + 1, nrows)):
                    for j in range(max(c - reach, 0), min(c + reach + 1, ncols)):
                        if not np.isnan(surface[i, j]):
                            around[n] = surface[i, j]
                            n += 1
                if n > 0:
                    break
            sort_few(around[:n])
            out[r, c] = around[(n - 1) // 2]
