"""The class map: the class of the highest echo of every cell, how sure it is, and how many echoes there are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fwclass.grid import Window, millimetres, whole_millimetres
from fwclass.kernel import kernel

NO_CONFIDENCE = 255
"""Of a cell without an echo, or whose class has no confidence (NaN); else it is in percent."""

NOTHING = np.iinfo(np.int64).min
"""Height [mm] of a cell without an echo, which no echo of this height changes."""


class ClassRasters(NamedTuple):
    """Rasters of a window, row 0 in the south: class code (0 without an echo that is no noise), its confidence [%],
    number of echoes."""

    classes: NDArray[np.uint8]
    confidence: NDArray[np.uint8]
    echoes: NDArray[np.uint32]


def class_rasters(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    classification: NDArray[np.uint8],
    confidence: NDArray[np.float32],
    noise: NDArray[np.bool_],
    window: Window,
) -> ClassRasters:
    """Class and confidence of the highest echo in every cell that is no noise, as in the surface model, and the number
    of all of them.

    Among echoes of one height (to the millimetre) the smallest code wins, of one code the least sure one, so the rows'
    order does not count; echoes outside the window and those without a class (0) are left out.
    """
    mm = whole_millimetres(window.cell, "class_cell")
    col, row = millimetres(x) // mm - window.col, millimetres(y) // mm - window.row
    classes = np.zeros(window.shape, np.uint8)
    sure = np.full(window.shape, NO_CONFIDENCE, np.uint8)
    echoes = np.zeros(window.shape, np.uint32)
    top = np.full(window.shape, NOTHING)
    percent = np.rint(np.nan_to_num(100 * confidence.astype(np.float64), nan=NO_CONFIDENCE)).astype(np.uint8)
    code = np.ascontiguousarray(classification, np.uint8)
    height = np.where(noise, NOTHING, millimetres(z))
    _highest(col, row, height, code, percent, classes, sure, echoes, top)
    return ClassRasters(classes, sure, echoes)


@kernel
def _highest(col, row, z, code, percent, classes, sure, echoes, top):  # type: ignore[no-untyped-def]
    nrows, ncols = classes.shape
    for i in range(len(z)):
        r, c = row[i], col[i]
        if code[i] == 0 or r < 0 or c < 0 or r >= nrows or c >= ncols:
            continue
        echoes[r, c] += np.uint32(1)
        known = classes[r, c]
        same = z[i] == top[r, c]
        if z[i] > top[r, c] or (same and (code[i] < known or (code[i] == known and percent[i] < sure[r, c]))):
            top[r, c] = z[i]
            classes[r, c] = code[i]
            sure[r, c] = percent[i]
