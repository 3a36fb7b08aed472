"""The moving surface filter: a polynomial surface follows the lowest points, from coarse cells to fine ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.ground.methods.params import MovingSurfaceParams
from fwclass.ground.methods.quadratic_fit import choose_seeds, fit_surfaces
from fwclass.ground.raster.bilinear import bilinear
from fwclass.ground.raster.fill import fill_gaps
from fwclass.ground.raster.lattice import cells_of, window_over
from fwclass.ground.raster.surface import gradient

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
        fit_surfaces(u, v, low, params.neighbours, params.threshold + params.slope * cell, ROUNDS, STIFFNESS, surface)
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
    choose_seeds(flat, x, y, z, seed.reshape(-1))
    return seed


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
