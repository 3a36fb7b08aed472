"""Roughness of the terrain: how far ground points spread about the plane that fits them best."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.ground.raster.lattice import cells_of
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
    n, sx, sy, sz, xx, xy, yy, xz, yz, zz = _around(_sums(cells, px, py, pz, window.grown(1)), mm)
    with np.errstate(invalid="ignore", divide="ignore"):
        xx, xy, yy = xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n
        xz, yz, zz = xz - sx * sz / n, yz - sy * sz / n, zz - sz * sz / n
        spread = xx * yy - xy * xy
        rest = zz - (xz * xz * yy - 2.0 * xz * yz * xy + yz * yz * xx) / spread
        out = np.sqrt(np.maximum(rest, 0.0) / (n - 3.0)) * QUANTUM
        sure = (n >= LEAST_POINTS) & (spread >= FLATTEST * (xx + yy) ** 2) & (spread > 0.0)
    return np.where(sure, out, np.nan).astype(np.float32)


def _sums(
    cells: NDArray[np.int64], x: NDArray[np.int64], y: NDArray[np.int64], z: NDArray[np.int64], window: Window
) -> list[NDArray[np.float64]]:
    """Number, sums and sums of products by cell; of whole numbers, so that the order of the points does not matter."""
    px, py, pz = (v.astype(np.float64) for v in (x, y, z))
    size = math.prod(window.shape)
    number = np.bincount(cells, minlength=size).astype(np.float64)
    products = (px, py, pz, px * px, px * py, py * py, px * pz, py * pz, pz * pz)
    sums = [np.bincount(cells, weights=v, minlength=size) for v in products]
    return [np.asarray(v, np.float64).reshape(window.shape) for v in (number, *sums)]


def _around(sums: list[NDArray[np.float64]], mm: int) -> list[NDArray[np.float64]]:
    """The sums of a cell and its eight neighbours, plan coordinates from the corner of that cell [mm]."""
    rows, cols = sums[0].shape
    out = [np.zeros((rows - 2, cols - 2)) for _ in sums]
    for row in range(3):
        for col in range(3):
            n, sx, sy, sz, xx, xy, yy, xz, yz, zz = (v[row : row + rows - 2, col : col + cols - 2] for v in sums)
            dx, dy = float((col - 1) * mm), float((row - 1) * mm)
            moved = (
                n,
                sx + dx * n,
                sy + dy * n,
                sz,
                xx + 2.0 * dx * sx + dx * dx * n,
                xy + dx * sy + dy * sx + dx * dy * n,
                yy + 2.0 * dy * sy + dy * dy * n,
                xz + dx * sz,
                yz + dy * sz,
                zz,
            )
            for total, value in zip(out, moved, strict=True):
                total += value
    return out
