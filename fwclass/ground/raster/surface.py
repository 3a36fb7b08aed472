"""What several filters ask of a surface: its slope, what lies too far below it, and where it was surveyed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.ground.raster.opening import disk_opening
from fwclass.kernel import kernel


def low_limit(surface: NDArray[np.float64], cell: float, slope: float) -> NDArray[np.float64]:
    """Height [m] below which an echo is a low outlier: slope × cell under the closing with one cell's disk."""
    return -disk_opening(-surface, 1) - slope * cell


def gradient(surface: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Slope, rise over run, of a surface without NaN; 0 in a surface of a single row and column."""
    square = np.zeros(surface.shape)
    for axis, length in enumerate(surface.shape):
        if length > 1:
            square += np.gradient(surface, cell, axis=axis) ** 2
    return np.sqrt(square)


def domain(measured: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """The surveyed area: cells with an echo and the gaps between them, closed with a disk of `radius`
    [cells].

    Beyond it the openings see nothing, as beyond the edge of an image. Otherwise a building at the survey's
    border would be continued outwards and be too wide to be opened.
    """
    half_widths = _half_widths(radius, max(measured.shape))
    near = _within(measured, half_widths)
    if near.all():
        return near
    return ~_within(~near, half_widths) | measured


def _half_widths(radius: float, most: int) -> NDArray[np.int64]:
    """Half-widths [cells] of the rows 0, 1, … of a disk of any `radius` >= 0, none above `most`."""
    rows = np.arange(min(int(radius), most) + 1)
    return np.array([np.count_nonzero(np.sqrt(rows**2 + dy**2) <= radius) - 1 for dy in rows], np.int64)


@kernel
def _within(cells, half_widths):  # type: ignore[no-untyped-def]
    """Whether any of `cells` lies in the disk around a cell, (rows, columns) of bool.

    The nearest one of a column decides how far to both sides cells of a row are within reach.
    """
    nrows, ncols = cells.shape
    beyond = len(half_widths)
    distance = np.empty((nrows, ncols), np.int64)
    above = np.full(ncols, beyond, np.int64)
    for r in range(nrows - 1, -1, -1):
        for c in range(ncols):
            above[c] = 0 if cells[r, c] else min(above[c] + 1, beyond)
            distance[r, c] = above[c]
    below, begun = np.full(ncols, beyond, np.int64), np.empty(ncols + 1, np.int64)
    out = np.empty((nrows, ncols), np.bool_)
    for r in range(nrows):
        begun[:] = 0
        for c in range(ncols):
            below[c] = 0 if cells[r, c] else min(below[c] + 1, beyond)
            nearest = min(below[c], distance[r, c])
            if nearest < beyond:
                half = half_widths[nearest]
                begun[max(c - half, 0)] += 1
                begun[min(c + half + 1, ncols)] -= 1
        open_runs = 0
        for c in range(ncols):
            open_runs += begun[c]
            out[r, c] = open_runs > 0
    return out
