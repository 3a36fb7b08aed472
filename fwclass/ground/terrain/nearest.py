"""Height above the nearest ground point. Shi et al. 2019."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.kernel import kernel
from fwclass.neighbours import sort_by_cell

Points = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def nearest_height(ground: Points, asked: Points, window: Window, max_gap: float) -> NDArray[np.float64]:
    """z of the points `asked` minus z of the ground point that is nearest in plan [m].

    Among ground points at one distance (to the millimetre) the lowest counts.

    Parameters
    ----------
    ground : x, y, z [m] of ground points inside `window`, in any order.
    asked : x, y, z [m] of points in cells whose middle is within `max_gap` [m] of that of a cell with a ground
        point; NaN further away.
    """
    mm = whole_millimetres(window.cell, "cell")
    gx, gy = millimetres(ground[0]) - window.col * mm, millimetres(ground[1]) - window.row * mm
    px, py = millimetres(asked[0]) - window.col * mm, millimetres(asked[1]) - window.row * mm
    order, start = sort_by_cell((gy // mm) * window.ncols + gx // mm, window.nrows * window.ncols)
    # a ground point is anywhere in its cell, and so is the point that asks
    rings = math.ceil(max_gap / window.cell + math.sqrt(2.0)) + 1
    floor = np.empty(len(px))
    _nearest(gx[order], gy[order], ground[2][order], start, window.ncols, window.nrows, mm, rings, px, py, floor)
    return asked[2] - floor


@kernel
def _best_of(x, y, z, first, last, px, py, best, height):  # type: ignore[no-untyped-def]
    """The nearer of the nearest so far and the points first to last, and its z."""
    for j in range(first, last):
        d = (x[j] - px) ** 2 + (y[j] - py) ** 2
        if d < best or (d == best and z[j] < height):
            best, height = d, z[j]
    return best, height


@kernel
def _nearest(x, y, z, start, ncols, nrows, cell, rings, px, py, out):  # type: ignore[no-untyped-def]
    """z of the nearest point, found in growing squares of cells."""
    for i in range(len(px)):
        c, r = px[i] // cell, py[i] // cell
        rim = min(min(px[i] - c * cell, (c + 1) * cell - px[i]), min(py[i] - r * cell, (r + 1) * cell - py[i]))
        best, height = np.int64(1) << 62, np.nan
        for ring in range(rings + 1):
            # nothing in this ring is nearer than its inner edge
            inner = rim + (ring - 1) * cell
            if ring > 0 and inner > 0 and inner * inner > best:
                break
            for row in range(max(r - ring, 0), min(r + ring + 1, nrows)):
                left, right = max(c - ring, 0), min(c + ring, ncols - 1)
                if abs(row - r) == ring:
                    best, height = _best_of(
                        x, y, z, start[row * ncols + left], start[row * ncols + right + 1], px[i], py[i], best, height
                    )
                    continue
                for col in (c - ring, c + ring):
                    if 0 <= col < ncols:
                        k = row * ncols + col
                        best, height = _best_of(x, y, z, start[k], start[k + 1], px[i], py[i], best, height)
        out[i] = height
