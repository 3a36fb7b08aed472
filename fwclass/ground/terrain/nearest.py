"""Height above the nearest ground point. Shi et al. 2019."""

from __future__ import annotations

import math

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.kernel import kernel
from fwclass.neighbours import CROWDED, Points, sort_by_cell

AT_A_TIME = 10_000
"""Points that one call looks from: between two calls an interrupt is heeded."""

TIES = 8
"""So many of the nearest are looked at for those at one distance; where all of them are, for all."""


def nearest_height(ground: Points, places: Points, window: Window, max_gap: float) -> NDArray[np.float64]:
    """z of the points `places` minus z of the ground point that is nearest in plan [m].

    Among ground points at one distance (to the millimetre) the lowest counts.

    Parameters
    ----------
    ground : x, y, z [m] of ground points inside `window`, in any order.
    places : x, y, z [m] of points in cells whose middle is within `max_gap` [m] of that of a cell with a ground
        point; NaN further away.
    """
    mm = whole_millimetres(window.cell, "cell")
    gx, gy = millimetres(ground[0]) - window.col * mm, millimetres(ground[1]) - window.row * mm
    px, py = millimetres(places[0]) - window.col * mm, millimetres(places[1]) - window.row * mm
    order, start = sort_by_cell((gy // mm) * window.ncols + gx // mm, window.nrows * window.ncols)
    # a ground point is anywhere in its cell, and so is the point that asks
    rings = math.ceil(max_gap / window.cell + math.sqrt(2.0)) + 1
    floor = np.empty(len(px))
    if np.diff(start).max(initial=0) > CROWDED:
        _among_crowds(gx, gy, ground[2], px, py, rings, mm, floor)
    else:
        gx, gy, gz = gx[order], gy[order], ground[2][order]
        for first in range(0, len(px), AT_A_TIME):
            part = slice(first, first + AT_A_TIME)
            _nearest(gx, gy, gz, start, window.ncols, window.nrows, mm, rings, px[part], py[part], floor[part])
    return places[2] - floor


def _among_crowds(
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    z: NDArray[np.float64],
    px: NDArray[np.int64],
    py: NDArray[np.int64],
    rings: int,
    cell: int,
    out: NDArray[np.float64],
) -> None:
    """As `_nearest` where cells hold many points: of those at one place the lowest, in a tree. Squares of distances are
    whole numbers, so that what is equally near is known exactly."""
    order = np.lexsort((z, y, x))
    new = np.append(True, (np.diff(x[order]) != 0) | (np.diff(y[order]) != 0))
    x, y, z = (values[order[new]] for values in (x, y, z))
    tree = scipy.spatial.cKDTree(np.stack([x, y], axis=1).astype(np.float64))
    most = min(TIES, len(x))
    for first in range(0, len(px), AT_A_TIME):
        qx, qy = px[first : first + AT_A_TIME], py[first : first + AT_A_TIME]
        _, indices = tree.query(np.stack([qx, qy], axis=1).astype(np.float64), k=list(range(1, most + 1)))
        near = np.asarray(indices)
        square = (x[near] - qx[:, None]) ** 2 + (y[near] - qy[:, None]) ** 2
        best = square.min(axis=1)
        height = np.where(square == best[:, None], z[near], np.inf).min(axis=1)
        for i in np.flatnonzero(square.max(axis=1) == best) if most < len(x) else ():
            some = np.array(tree.query_ball_point((qx[i], qy[i]), math.sqrt(best[i]) + 0.5))
            equal = (x[some] - qx[i]) ** 2 + (y[some] - qy[i]) ** 2 == best[i]
            height[i] = z[some[equal]].min()
        at = near[:, 0]
        away = np.maximum(np.abs(x[at] // cell - qx // cell), np.abs(y[at] // cell - qy // cell))
        out[first : first + AT_A_TIME] = np.where(away <= rings, height, np.nan)


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
