"""Roughness of the terrain: how far ground points spread about the plane that fits them best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.ground.raster.lattice import cells_of
from fwclass.kernel import kernel
from fwclass.units import QUANTUM

LEAST_POINTS = 6
"""In a cell and its eight neighbours; a plane takes three of them."""

FLATTEST = 0.01
"""Product over squared sum of the two variances in plan below which the points lie on a line, and no plane is sure."""


def roughness(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], window: Window
) -> NDArray[np.float32]:
    """Standard deviation of ground points about their plane, in a cell and its eight neighbours.

    A slope is therefore not rough (Hollaus et al. 2011, *Roughness mapping on various vertical scales based on
    full-waveform airborne laser scanning data*, eq. 1, on a square instead of a disk).

    Parameters
    ----------
    x, y, z : (n,) ground points [m], in any order, which does not matter; those beyond one cell around the window are
        left out. Sums are exact below 2^53: with 300 m between the window's lowest and highest point, as long as nine
        cells have at most 100 000; beyond, last bits may hang on the order.

    Returns
    -------
    float32 raster [m], row 0 in the south: the square root of the squared residuals of the plane by least squares
    over ``n - 3``; NaN where fewer than `LEAST_POINTS` lie, or all on a line.
    """
    mm = whole_millimetres(window.cell, "cell")
    cells, inside = cells_of(x, y, window.grown(1))
    px, py, pz = millimetres(x[inside]), millimetres(y[inside]), millimetres(z[inside])
    px, py, pz = px % mm, py % mm, pz - (pz.min() if len(pz) else 0)
    out = np.full(window.shape, np.nan, np.float32)
    _spread(_sums(cells, px, py, pz, window.grown(1).shape), float(mm), LEAST_POINTS, FLATTEST, QUANTUM, out)
    return out


@kernel
def _sums(cells, x, y, z, shape):  # type: ignore[no-untyped-def]
    """Number, sums and sums of products by cell, (rows, columns, 10); of whole numbers, so that the order of the points
    does not matter."""
    out = np.zeros((shape[0] * shape[1], 10))
    for i in range(len(cells)):
        px, py, pz = float(x[i]), float(y[i]), float(z[i])
        total = out[cells[i]]
        total[0] += 1.0
        total[1] += px
        total[2] += py
        total[3] += pz
        total[4] += px * px
        total[5] += px * py
        total[6] += py * py
        total[7] += px * pz
        total[8] += py * pz
        total[9] += pz * pz
    return out.reshape((shape[0], shape[1], 10))


@kernel
def _spread(sums, mm, least, flattest, quantum, out):  # type: ignore[no-untyped-def]
    """Spread [m] about the plane of a cell and its eight neighbours, whose plan coordinates count from the corner of
    that cell [mm]; `out` stays as it is where no plane is sure."""
    rows, cols = out.shape
    for r in range(rows):
        for c in range(cols):
            n, sx, sy, sz, xx, xy, yy, xz, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for row in range(3):
                for col in range(3):
                    s = sums[r + row, c + col]
                    if s[0] == 0.0:
                        continue
                    dx, dy = (col - 1) * mm, (row - 1) * mm
                    n += s[0]
                    sx += s[1] + dx * s[0]
                    sy += s[2] + dy * s[0]
                    sz += s[3]
                    xx += s[4] + 2.0 * dx * s[1] + dx * dx * s[0]
                    xy += s[5] + dx * s[2] + dy * s[1] + dx * dy * s[0]
                    yy += s[6] + 2.0 * dy * s[2] + dy * dy * s[0]
                    xz += s[7] + dx * s[3]
                    yz += s[8] + dy * s[3]
                    zz += s[9]
            if n < least:
                continue
            xx, xy, yy = xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n
            xz, yz, zz = xz - sx * sz / n, yz - sy * sz / n, zz - sz * sz / n
            spread = xx * yy - xy * xy
            if spread > 0.0 and spread >= flattest * (xx + yy) ** 2:
                rest = zz - (xz * xz * yy - 2.0 * xz * yz * xy + yz * yz * xx) / spread
                out[r, c] = np.sqrt(max(rest, 0.0) / (n - 3.0)) * quantum
