"""The moving surface filter: a polynomial surface follows the lowest points, from coarse cells to fine ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.ground.params import MovingSurfaceParams
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import cells_of, window_over
from fwclass.ground.raster.surface import gradient
from fwclass.kernel import kernel

ROUNDS = 4
"""Fits of a surface; each weighs the seeds by what the one before left."""

STIFFNESS = 0.1
"""What holds a quadratic term at zero, in seeds: few seeds on a line then give no wild surface."""


def moving_surface(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], params: MovingSurfaceParams
) -> NDArray[np.bool_]:
    """Ground among points: those at most threshold + scalar × slope [m] above the finest surface.

    From cells of about `max_cell` down to `cell`, each half the one before: the lowest point of every cell is a
    seed unless it lies further above the coarser surface than threshold + slope × the coarser cell. Around every
    cell a quadratic surface is fitted to the seeds of (2 × neighbours + 1)² cells, near ones counting more and those
    off the surface, above it above all, less with every round; its height at the cell's middle is the finer surface.
    A cell with too few seeds around it keeps the coarser surface, at the start the lowest points themselves.

    Parameters
    ----------
    x, y, z : (n,) finite coordinates [m], in any order.
    params : sized.

    Source: the family that He 2023 compares, after Zhu et al. 2018 (coarse to fine, thresholds that follow the
    cell); lopsided weights as Kraus and Pfeifer 1998 have them.
    """
    coarse, over = np.empty((0, 0)), window_over(x, y, params.cell, "moving_surface.cell", margin=2)
    for cell in cells(params):
        window = window_over(x, y, cell, "moving_surface.cell", margin=2)
        seed = _seeds(x, y, z, window)
        low = np.where(seed < 0, np.nan, z[seed])
        if not coarse.size:
            surface = fill_gaps(low)
        else:
            surface = bilinear(coarse, over, *_middles(window)).reshape(window.shape)
            above = low - bilinear(coarse, over, x[seed].ravel(), y[seed].ravel()).reshape(window.shape)
            low[above > params.threshold + params.slope * over.cell] = np.nan
        u, v = _from_middles(x[seed], y[seed], window)
        _fit(u, v, low, params.neighbours, params.threshold + params.slope * cell, ROUNDS, STIFFNESS, surface)
        coarse, over = fill_gaps(surface), window
    allowed = params.threshold + params.scalar * bilinear(gradient(coarse, over.cell), over, x, y)
    return z - bilinear(coarse, over, x, y) <= allowed


def cells(params: MovingSurfaceParams) -> list[float]:
    """Edges [m] of the cells, coarse to fine: `cell` doubled as long as it is not larger than `max_cell`."""
    edges = [params.cell]
    while 2.0 * edges[-1] <= (params.max_cell or 0.0):
        edges.append(2.0 * edges[-1])
    return edges[::-1]


def _seeds(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], window: Window) -> NDArray[np.int64]:
    """Row of the lowest point of every cell, of several the most western, then southern one; -1 without any."""
    flat, _ = cells_of(x, y, window)
    seed = np.full(window.shape, -1)
    _choose(flat, x, y, z, seed.reshape(-1))
    return seed


@kernel
def _choose(flat, x, y, z, seed):  # type: ignore[no-untyped-def]
    for i in range(len(flat)):
        j = seed[flat[i]]
        if j < 0 or z[i] < z[j] or (z[i] == z[j] and (x[i] < x[j] or (x[i] == x[j] and y[i] < y[j]))):
            seed[flat[i]] = i


def _middles(window: Window) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates [m] of the middles of all cells, flat."""
    x = (window.col + np.arange(window.ncols) + 0.5) * window.cell
    y = (window.row + np.arange(window.nrows) + 0.5) * window.cell
    return np.tile(x, window.nrows), np.repeat(y, window.ncols)


def _from_middles(
    x: NDArray[np.float64], y: NDArray[np.float64], window: Window
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Offsets [cells] of one point in every cell from the cell's middle."""
    mm = whole_millimetres(window.cell, "moving_surface.cell")
    col = window.col + np.arange(window.ncols)
    row = window.row + np.arange(window.nrows)[:, None]
    return (millimetres(x) - col * mm) / mm - 0.5, (millimetres(y) - row * mm) / mm - 0.5


@kernel
def _fit(u, v, low, neighbours, limit, rounds, stiffness, surface):  # type: ignore[no-untyped-def]
    """Height in the middle of every cell of the surface through the seeds around; cells without enough stay.

    A seed r above the surface weighs 1 / (1 + (2 r / limit)²)², one r below it as one r / 4 above it; all of them
    times (1 − d² / D²)² for the distance d [cells] from the middle, D = neighbours + 1.
    """
    nrows, ncols = low.shape
    most = (2 * neighbours + 1) ** 2
    basis, height, near = np.empty((most, 6)), np.empty(most), np.empty(most)
    normal, right, terms = np.empty((6, 6)), np.empty(6), np.empty(6)
    for r in range(nrows):
        for c in range(ncols):
            n = 0
            for row in range(max(r - neighbours, 0), min(r + neighbours + 1, nrows)):
                for col in range(max(c - neighbours, 0), min(c + neighbours + 1, ncols)):
                    a, b = u[row, col] + (col - c), v[row, col] + (row - r)
                    weight = 1.0 - (a * a + b * b) / (neighbours + 1.0) ** 2
                    if np.isnan(low[row, col]) or weight <= 0.0:
                        continue
                    basis[n, 0], basis[n, 1], basis[n, 2] = 1.0, a, b
                    basis[n, 3], basis[n, 4], basis[n, 5] = a * a, a * b, b * b
                    height[n], near[n] = low[row, col], weight * weight
                    n += 1
            if n < 4:
                continue
            base = height[:n].min()
            for k in range(rounds):
                normal[:] = 0.0
                right[:] = 0.0
                for i in range(n):
                    weight = near[i]
                    if k > 0:
                        rest = height[i] - base
                        for p in range(6):
                            rest -= basis[i, p] * terms[p]
                        scale = 2.0 * rest / limit if rest > 0.0 else 0.5 * rest / limit
                        weight /= (1.0 + scale * scale) ** 2
                    for p in range(6):
                        for q in range(p + 1):
                            normal[p, q] += weight * basis[i, p] * basis[i, q]
                        right[p] += weight * basis[i, p] * (height[i] - base)
                for p in range(1, 6):
                    normal[p, p] += stiffness if p > 2 else 0.01 * stiffness
                _solve(normal, right, terms)
            surface[r, c] = base + terms[0]


@kernel
def _solve(a, b, x):  # type: ignore[no-untyped-def]
    """Solution of a x = b for a positive definite matrix given by its lower triangle, which is overwritten."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            a[i, j] = np.sqrt(s) if i == j else s / a[j, j]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * x[k]
        x[i] = s / a[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= a[k, i] * x[k]
        x[i] = s / a[i, i]
