"""What the openings get wrong, put right: alleys that look like pits, edges of cliffs and banks.

Rasters of lowest points: heights [m] and, of the same points, the offsets east and north of the cell's centre [m].
"""

from __future__ import annotations

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.ground.raster.lattice import LowestPoints
from fwclass.kernel import kernel

DIRECTIONS = 8
"""Half planes, nearly, that a cell is looked at from."""

CONE = 0.35
"""Cosine of half the angle of each of them."""

SUPPORT = 6
"""So many of the nearest ground cells of a direction give its plane."""

LEAST_SUPPORT = 4
"""With fewer there is no plane."""

ROUGHEST = 0.3
"""Standard deviation [m] of these cells about their plane above which it tells nothing."""

STIFFNESS = 1.0
"""[m²] Pulls a plane through cells in a line, or close together, towards the horizontal."""

NEAREST = 200
"""So many measured cells around are looked at: of dense data a smaller circle."""

LEVEL = 0.5
"""[m] An object cell less than this below another belongs to the same thing."""

EMPTY, OBJECT, GROUND = np.uint8(0), np.uint8(1), np.uint8(2)
"""What a cell of a raster holds."""


def restore_edges(
    points: LowestPoints,
    ground: NDArray[np.bool_],
    cell: float,
    radius: float,
    tolerance: float,
    share: float,
    rounds: int,
) -> NDArray[np.bool_]:
    """`ground` and the cells that continue it on one side: crests of cliffs, banks and terraces.

    Such an edge stands out of the opened surface like an object, but on one side the terrain runs up to it. A
    measured cell is restored if a plane through the nearest ground cells of some direction, at most `radius` [m]
    away, passes within `tolerance` [m] of it, and if at most `share` of the measured cells in the circle are objects
    of its own height: the inside of a roof, which is level too, is surrounded by roof. What one of the `rounds` has
    restored is ground for the next.
    """
    reach = int(radius / cell)
    dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    square = dx * dx + dy * dy
    near = np.lexsort((dx, dy, square))
    near = near[(square[near] > 0) & (square[near] <= reach * reach)]
    # a margin that nothing was measured in, so that no cell around lies outside
    z, east, north = (np.pad(values, reach, constant_values=np.nan) for values in points)
    around = dy[near] * z.shape[1] + dx[near], dx[near] * cell, dy[near] * cell
    measured = np.isfinite(points.z)
    last, open_cells = ground, measured & ~ground
    for _ in range(rounds):
        out = last.copy()
        kind = np.pad(np.where(measured, np.where(last, GROUND, OBJECT), EMPTY), reach)
        _restore(
            z.ravel(), east.ravel(), north.ravel(), kind.ravel(), open_cells, reach, *around, tolerance, share, out
        )
        changed = out != last
        last = out
        if not changed.any():
            break
        # only near what has changed can the answer be another one
        open_cells = measured & ~out & _near(changed, reach)
    return last


def _near(cells: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Cells within a square of 2 `reach` + 1 cells of one of `cells`."""
    return scipy.ndimage.maximum_filter(cells, 2 * reach + 1, mode="constant", cval=False)


def without_company(
    heights: NDArray[np.float64], low: NDArray[np.bool_], radius: int, level: float, companions: int
) -> NDArray[np.bool_]:
    """Those of the `low` cells that have fewer than `companions` cells within `radius` [cells] as low as they are.

    As low: at most `level` [m] higher. An alley between high roofs is a pit, too, but a long one.
    """
    out = low.copy()
    _without_company(heights, radius, level, companions, out)
    return out


@kernel
def _without_company(heights, radius, level, companions, low):  # type: ignore[no-untyped-def]
    nrows, ncols = heights.shape
    for r in range(nrows):
        for c in range(ncols):
            if not low[r, c]:
                continue
            n = -1  # the cell itself
            for i in range(max(0, r - radius), min(nrows, r + radius + 1)):
                for j in range(max(0, c - radius), min(ncols, c + radius + 1)):
                    near = (i - r) ** 2 + (j - c) ** 2 <= radius * radius
                    if near and heights[i, j] <= heights[r, c] + level:
                        n += 1
            low[r, c] = n < companions


@kernel
def _restore(z, east, north, kind, asked, reach, step, dx, dy, tolerance, share, out):  # type: ignore[no-untyped-def]
    """Fill `out` (rows, columns) where `asked`. The rasters are flat, with a margin of `reach` cells; a cell around
    lies `step` places on, `dx` and `dy` [m] away."""
    nrows, ncols = asked.shape
    angle = 2.0 * np.pi / DIRECTIONS
    toward_x, toward_y = np.empty(DIRECTIONS), np.empty(DIRECTIONS)
    for d in range(DIRECTIONS):
        toward_x[d], toward_y[d] = np.cos(d * angle), np.sin(d * angle)
    sums = np.empty((DIRECTIONS, 9))
    count = np.empty(DIRECTIONS, np.int64)
    for r in range(nrows):
        for c in range(ncols):
            if not asked[r, c]:
                continue
            here = (r + reach) * (ncols + 2 * reach) + c + reach
            _gather(z, east, north, kind, here, step, dx, dy, toward_x, toward_y, sums, count)
            for d in range(DIRECTIONS):
                if count[d] >= LEAST_SUPPORT and _continues(sums[d], count[d], tolerance):
                    out[r, c] = _objects_around(z, kind, here, step) <= share
                    break


@kernel
def _gather(z, east, north, kind, here, step, dx, dy, toward_x, toward_y, sums, count):  # type: ignore[no-untyped-def]
    """Moments of the nearest ground cells of every direction: x, y, z, xx, xy, yy, xz, yz, zz about the cell."""
    sums[:] = 0.0
    count[:] = 0
    full, seen = 0, 0
    for k in range(len(step)):
        at = np.uint64(here + step[k])
        if kind[at] == EMPTY:
            continue
        seen += 1
        if seen > NEAREST:
            return
        if kind[at] == OBJECT:
            continue
        x = dx[k] + east[at] - east[here]
        y = dy[k] + north[at] - north[here]
        h = z[at] - z[here]
        least = CONE * np.sqrt(x * x + y * y)
        for d in range(DIRECTIONS):
            if count[d] == SUPPORT or x * toward_x[d] + y * toward_y[d] < least:
                continue
            count[d] += 1
            full += count[d] == SUPPORT
            s = sums[d]
            s[0] += x
            s[1] += y
            s[2] += h
            s[3] += x * x
            s[4] += x * y
            s[5] += y * y
            s[6] += x * h
            s[7] += y * h
            s[8] += h * h
        if full == DIRECTIONS:
            return


@kernel
def _continues(s, n, tolerance):  # type: ignore[no-untyped-def]
    """Whether the plane of one direction's cells is smooth and passes within `tolerance` of the cell."""
    mx, my, mz = s[0] / n, s[1] / n, s[2] / n
    xx, xy, yy = s[3] - n * mx * mx + STIFFNESS, s[4] - n * mx * my, s[5] - n * my * my + STIFFNESS
    xz, yz, zz = s[6] - n * mx * mz, s[7] - n * my * mz, s[8] - n * mz * mz
    det = xx * yy - xy * xy
    a, b = (xz * yy - xy * yz) / det, (xx * yz - xy * xz) / det
    if abs(mz - a * mx - b * my) > tolerance:
        return False
    # residuals of a fit with stiffness: zz − 2 g·v + g·M g, without the stiffness in M
    left = zz - 2.0 * (a * xz + b * yz) + a * a * (xx - STIFFNESS) + 2.0 * a * b * xy + b * b * (yy - STIFFNESS)
    return left <= n * ROUGHEST * ROUGHEST


@kernel
def _objects_around(z, kind, here, step):  # type: ignore[no-untyped-def]
    """Share of object cells about as high as this one, or higher, among these and the ground cells around."""
    objects, all_around, seen = 1, 1, 0  # the cell itself
    for k in range(len(step)):
        at = np.uint64(here + step[k])
        if kind[at] == EMPTY:
            continue
        seen += 1
        if seen > NEAREST:
            break
        if kind[at] == GROUND:
            all_around += 1
        elif z[at] > z[here] - LEVEL:
            objects += 1
            all_around += 1
    return objects / all_around
