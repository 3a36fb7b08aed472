"""Ground echoes thinned to one mean echo per small cell: less noise, and a TIN whose size density does not set."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.errors import ConfigError
from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.ground.raster.lattice import MAX_NODES
from fwclass.kernel import kernel
from fwclass.units import QUANTUM

FRACTIONS = 1 << 20
"""Heights are added up as whole fractions of a metre, so that the sum does not depend on the order of the points."""


def thin_points(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], window: Window, thin: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Mean height at the mean place of the points in each cell of edge `thin` [m] of the global grid.

    Parameters
    ----------
    x, y, z : (n,) points inside `window` [m], in any order.
    thin : [m]; a cell with one point keeps it as it is.

    Returns
    -------
    x, y on whole millimetres and z to a millionth of a metre, by cell from the south-west, row by row.
    """
    mm = whole_millimetres(thin, "terrain.thin")
    col, row, ncols, nrows = _cells_under(window, mm)
    px, py, pz = millimetres(x) - col * mm, millimetres(y) - row * mm, np.rint(z * FRACTIONS).astype(np.int64)
    mx, my, mz = _means((py // mm) * ncols + px // mm, px, py, pz, ncols * nrows)
    return (mx + col * mm) * QUANTUM, (my + row * mm) * QUANTUM, mz / FRACTIONS


def _cells_under(window: Window, mm: int) -> tuple[int, int, int, int]:
    """First column and row, columns and rows of the cells of edge `mm` that cover the window."""
    cell = whole_millimetres(window.cell, "cell")
    col, row = window.col * cell // mm, window.row * cell // mm
    ncols = -((window.col + window.ncols) * cell // -mm) - col
    nrows = -((window.row + window.nrows) * cell // -mm) - row
    if math.prod((ncols, nrows)) > MAX_NODES:
        raise ConfigError(
            "the cells that ground echoes are thinned by are too many",
            where="terrain.thin",
            expected=f"at most {MAX_NODES:,} cells in a block and its halo",
            got=f"{ncols:,} x {nrows:,} cells of {mm * QUANTUM:g} m",
            do="choose a larger terrain.thin or smaller blocks",
        )
    return col, row, ncols, nrows


@kernel
def _means(cell, x, y, z, n_cells):  # type: ignore[no-untyped-def]
    """Means by cell: x, y to the nearest whole number, z as it is."""
    place, count = np.full(n_cells, -1, np.int32), 0
    for k in cell:
        place[k] = 0
    for k in range(n_cells):
        if place[k] == 0:
            place[k] = count
            count += 1
    sums = np.zeros((count, 4), np.int64)
    for i in range(len(x)):
        j = place[cell[i]]
        sums[j, 0] += x[i]
        sums[j, 1] += y[i]
        sums[j, 2] += z[i]
        sums[j, 3] += 1
    mean_x, mean_y, mean_z = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    for j in range(count):
        n = sums[j, 3]
        mean_x[j], mean_y[j] = (2 * sums[j, 0] + n) // (2 * n), (2 * sums[j, 1] + n) // (2 * n)
        mean_z[j] = sums[j, 2] / n
    return mean_x, mean_y, mean_z
