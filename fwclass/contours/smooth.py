"""Smoothing of the terrain's heights before contour lines are drawn, with a bound on how far any height may move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fwclass.contours.params import STEP, ContourParams

PASSES = 3
"""Of a moving mean; together they are nearly a Gaussian."""

NO_HEIGHT = np.iinfo(np.int64).min
"""A node without terrain."""


def half_width(params: ContourParams, cell: float) -> int:
    """Number of cells, of edge `cell` [m], on each side that one pass takes: so many that all passes together have the
    standard deviation `params.smooth` [m], as near as whole cells come."""
    return round((np.sqrt(12.0 * (params.smooth / cell) ** 2 / PASSES + 1.0) - 1.0) / 2.0)


def margin(params: ContourParams, cell: float) -> int:
    """Number of cells, of edge `cell` [m], around a window that its smoothed heights depend on."""
    return PASSES * half_width(params, cell)


def smooth_terrain(dtm: NDArray[np.float32], cell: float, params: ContourParams) -> NDArray[np.int64]:
    """Heights that contours are drawn of, in units of `STEP`; `NO_HEIGHT` where there is no terrain.

    The mean of the terrain around, by weights near a Gaussian's, and nowhere more than ``most * interval`` (and half a
    `STEP`) from the terrain. Sums are of whole numbers: a node has the same height in every window that holds it.

    Parameters
    ----------
    dtm : (n, m) heights [m] of a window and `margin` cells around it; NaN where there is no terrain.

    Returns
    -------
    int64, the window without the margin.
    """
    half, edge = half_width(params, cell), margin(params, cell)
    known = np.isfinite(dtm)
    height = np.rint(np.where(known, dtm, 0.0).astype(np.float64) / STEP).astype(np.int64)
    total, weight = height.copy(), known.astype(np.int64)
    for _ in range(PASSES):
        for axis in (0, 1):
            total, weight = _sums(total, half, axis), _sums(weight, half, axis)
    inner = (slice(edge, dtm.shape[0] - edge), slice(edge, dtm.shape[1] - edge))
    mean = np.rint(total / np.maximum(weight, 1)).astype(np.int64)
    most = int(params.most * params.steps)
    return np.where(known[inner], np.clip(mean, height[inner] - most, height[inner] + most), NO_HEIGHT)


def _sums(values: NDArray[np.int64], half: int, axis: int) -> NDArray[np.int64]:
    """Of each value and `half` neighbours on both sides along an axis, where there are all."""
    count = values.shape[axis] - 2 * half
    total = np.cumsum(np.insert(values, 0, 0, axis=axis), axis=axis)
    return np.take(total, np.arange(2 * half + 1, 2 * half + 1 + count), axis) - np.take(total, np.arange(count), axis)
