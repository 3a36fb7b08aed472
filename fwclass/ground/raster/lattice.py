"""The raster that a filter lays under its points: checked before it is allocated, and filled with lowest heights."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import InputError
from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.kernel import kernel
from fwclass.units import QUANTUM

MAX_NODES = 1 << 26
"""Cells of one filter's raster, or particles of its cloth: 0.5 GiB an array of float64."""


class LowestPoints(NamedTuple):
    """The lowest point of every cell, of several equally low ones the westernmost, then the southernmost.

    Attributes
    ----------
    z : its height [m], NaN where no point lies.
    east, north : its offsets from the cell's centre [m], 0 where no point lies.
    """

    z: NDArray[np.float64]
    east: NDArray[np.float64]
    north: NDArray[np.float64]


def window_over(x: NDArray[np.float64], y: NDArray[np.float64], cell: float, setting: str, margin: int = 0) -> Window:
    """The smallest window of the global raster of `cell` [m] that holds all points (x, y) [m], at least one, grown by
    `margin` cells.

    `InputError` naming `setting` where the window would have more than `MAX_NODES` cells.
    """
    mm = whole_millimetres(cell, setting)
    edges = [int(millimetres(np.array([bound]))[0]) // mm for bound in (x.min(), y.min(), x.max(), y.max())]
    col, row = edges[0] - margin, edges[1] - margin
    window = Window(cell, col, row, edges[2] + margin + 1 - col, edges[3] + margin + 1 - row)
    nodes = math.prod(window.shape)
    if nodes > MAX_NODES:
        raise InputError(
            "the filter's raster would be too large",
            where=setting,
            expected=f"at most {MAX_NODES:,} cells",
            got=f"{window.ncols:,} x {window.nrows:,} cells of {cell:g} m",
            do=f"choose a larger {setting}, or look for stray points with `fwclass info` and remove them",
        )
    return window


def lowest(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], window: Window
) -> NDArray[np.float64]:
    """Lowest z [m] by cell of `window`, NaN where no point lies; points outside the window are left out."""
    return lowest_points(x, y, z, window).z


def lowest_points(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    window: Window,
    floor: NDArray[np.float64] | None = None,
) -> LowestPoints:
    """The lowest point by cell of `window`, of those not below the `floor` [m] of their cell where one is given.

    Points outside the window are left out.
    """
    mm = whole_millimetres(window.cell, "cell")
    out = LowestPoints(np.full(window.shape, np.inf), np.zeros(window.shape), np.zeros(window.shape))
    floors = np.full((1, 1), -np.inf) if floor is None else floor
    heights = np.ascontiguousarray(z, np.float64)
    _lowest_points(
        np.ascontiguousarray(x), np.ascontiguousarray(y), heights, window.col, window.row, mm, QUANTUM, floors, *out
    )
    out.z[np.isinf(out.z)] = np.nan
    return out


@kernel
def _lowest_points(x, y, z, col, row, mm, quantum, floors, low, east, north):  # type: ignore[no-untyped-def]
    nrows, ncols = low.shape
    floored = floors.size > 1
    half = 0.5 * mm
    for i in range(len(x)):
        # whole numbers in float64; their quotients are rounded down exactly, and faster than integers are divided
        px, py = np.rint(x[i] / quantum), np.rint(y[i] / quantum)
        c, r = np.int64(np.floor(px / mm)) - col, np.int64(np.floor(py / mm)) - row
        if c < 0 or r < 0 or c >= ncols or r >= nrows or z[i] > low[r, c] or (floored and z[i] < floors[r, c]):
            continue
        e = (px - (c + col) * mm - half) * quantum
        n = (py - (r + row) * mm - half) * quantum
        if z[i] < low[r, c] or e < east[r, c] or (e == east[r, c] and n < north[r, c]):
            low[r, c], east[r, c], north[r, c] = z[i], e, n


def cells_of(
    x: NDArray[np.float64], y: NDArray[np.float64], window: Window
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """int64 (points inside,): flat cell index of the points (x, y) [m] inside `window`; bool (points,): which these
    are."""
    mm = whole_millimetres(window.cell, "cell")
    col = millimetres(x) // mm - window.col
    row = millimetres(y) // mm - window.row
    inside = (col >= 0) & (col < window.ncols) & (row >= 0) & (row < window.nrows)
    return (row * window.ncols + col)[inside], inside
