"""The class map: the class of the highest echo of every cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.kernel import kernel


def class_raster(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    classification: NDArray[np.uint8],
    window: Window,
) -> NDArray[np.uint8]:
    """Class of the highest echo in every cell, `window.shape`, row 0 in the south; 0 where there is none.

    Among echoes of one height (to the millimetre) the smallest code wins, so the rows' order does not count;
    echoes outside the window and those without a class (0) are left out.
    """
    mm = whole_millimetres(window.cell, "class_cell")
    col, row = millimetres(x) // mm - window.col, millimetres(y) // mm - window.row
    out = np.zeros(window.shape, np.uint8)
    top = np.full(window.shape, np.iinfo(np.int64).min)
    _highest(col, row, millimetres(z), np.ascontiguousarray(classification, np.uint8), out, top)
    return out


@kernel
def _highest(col, row, z, code, out, top):  # type: ignore[no-untyped-def]
    nrows, ncols = out.shape
    for i in range(len(z)):
        r, c = row[i], col[i]
        if code[i] == 0 or r < 0 or c < 0 or r >= nrows or c >= ncols:
            continue
        if z[i] > top[r, c] or (z[i] == top[r, c] and code[i] < out[r, c]):
            top[r, c] = z[i]
            out[r, c] = code[i]
