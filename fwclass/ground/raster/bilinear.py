"""Values of a raster of heights at points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.kernel import kernel


def bilinear(
    raster: NDArray[np.floating], window: Window, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Values of `raster` (rows, columns; cell centres of `window`) at points (points,) [m].

    A point in a NaN cell, or outside the window, gets NaN. Otherwise neighbour cells that are NaN or outside take no
    part, the weights of the others are scaled up.
    """
    if raster.shape != window.shape:
        raise ValueError(f"raster of shape {raster.shape} for a window of shape {window.shape}")
    mm = whole_millimetres(window.cell, "cell")
    out = np.full(len(x), np.nan)
    _bilinear(
        np.ascontiguousarray(raster, np.float64),
        millimetres(x) - window.col * mm,
        millimetres(y) - window.row * mm,
        mm,
        out,
    )
    return out


@kernel
def _bilinear(raster, x, y, cell, out):  # type: ignore[no-untyped-def]
    nrows, ncols = raster.shape
    for i in range(len(x)):
        c, r = x[i] // cell, y[i] // cell
        if c < 0 or r < 0 or c >= ncols or r >= nrows or np.isnan(raster[r, c]):
            continue
        # twice the offset from the cell's centre, an exact integer
        u, v = 2 * (x[i] - c * cell) - cell, 2 * (y[i] - r * cell) - cell
        fx, fy = abs(u) / (2.0 * cell), abs(v) / (2.0 * cell)
        side_c = c + 1 if u >= 0 else c - 1
        side_r = r + 1 if v >= 0 else r - 1
        total, weight = raster[r, c] * (1.0 - fx) * (1.0 - fy), (1.0 - fx) * (1.0 - fy)
        if 0 <= side_c < ncols and not np.isnan(raster[r, side_c]):
            total += raster[r, side_c] * fx * (1.0 - fy)
            weight += fx * (1.0 - fy)
        if 0 <= side_r < nrows and not np.isnan(raster[side_r, c]):
            total += raster[side_r, c] * (1.0 - fx) * fy
            weight += (1.0 - fx) * fy
        if 0 <= side_c < ncols and 0 <= side_r < nrows and not np.isnan(raster[side_r, side_c]):
            total += raster[side_r, side_c] * fx * fy
            weight += fx * fy
        out[i] = total / weight


@kernel
def near_terrain(x, y, z, heights, slopes, row, col, cell, threshold, scalar, near):  # type: ignore[no-untyped-def]
    """Fills in `near` bool (points,): z is within threshold + scalar × slope [m] of the terrain, both bilinear between
    cell centres; x, y, z (points,) [m], `heights` [m] and `slopes` (rows, columns) of cells of `cell` [m] from (row,
    col) on."""
    last_r, last_c = heights.shape[0] - 1, heights.shape[1] - 1
    for i in range(len(x)):
        u, v = x[i] / cell - 0.5, y[i] / cell - 0.5
        c, r = np.floor(u), np.floor(v)
        fx, fy = u - c, v - r
        left, low = np.int64(c) - col, np.int64(r) - row
        c0, c1 = min(max(left, 0), last_c), min(max(left + 1, 0), last_c)
        r0, r1 = min(max(low, 0), last_r), min(max(low + 1, 0), last_r)
        a, b, d, e = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
        height = a * heights[r0, c0] + b * heights[r0, c1] + d * heights[r1, c0] + e * heights[r1, c1]
        slope = a * slopes[r0, c0] + b * slopes[r0, c1] + d * slopes[r1, c0] + e * slopes[r1, c1]
        near[i] = abs(z[i] - height) <= threshold + scalar * slope
