"""The simple morphological filter (SMRF) on a raster of lowest heights. Pingel, Clarke & McBride 2013."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fwclass.ground.fill import filled
from fwclass.ground.opening import opened


def objects(surface: NDArray[np.float64], cell: float, slope: float, window: float) -> NDArray[np.bool_]:
    """Cells that stand out of `surface` (NaN beyond the surveyed area): buildings, trees, vehicles.

    The surface is opened with disks of 1, 2, … ⌈window / cell⌉ cells; a cell that one opening lowers by
    more than slope × radius is an object. `cell` and `window` [m], `slope` rise over run.
    """
    found = np.zeros(surface.shape, bool)
    last = surface
    for radius in range(1, math.ceil(window / cell) + 1):
        this = opened(last, radius)
        found |= last - this > slope * cell * radius
        last = this
    return found


def low_limit(surface: NDArray[np.float64], cell: float, slope: float) -> NDArray[np.float64]:
    """Height [m] below which an echo is a low outlier: slope × cell under the closing with one cell's disk."""
    return -opened(-surface, 1) - slope * cell


def gradient(surface: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Slope, rise over run, of a surface without NaN; 0 in a surface of a single row and column."""
    square = np.zeros(surface.shape)
    for axis, length in enumerate(surface.shape):
        if length > 1:
            square += np.gradient(surface, cell, axis=axis) ** 2
    return np.sqrt(square)


def domain(measured: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """The surveyed area: cells with an echo and the gaps between them, closed with a disk of `radius`
    [cells].

    Beyond it the openings see nothing, as beyond the edge of an image. Otherwise a building at the survey's
    border would be continued outwards and be too wide to be opened.
    """
    near = ndimage.distance_transform_edt(~measured) <= radius
    if near.all():
        return near
    return (ndimage.distance_transform_edt(near) > radius) | measured


def terrain(
    lowest: NDArray[np.float64], cell: float, slope: float, window: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Terrain heights of all cells and the mask of those that were measured on the ground.

    `lowest` is the lowest height by cell, NaN where there is no echo. Object cells and empty cells are
    filled by a membrane. Without any measured cell the heights are NaN.
    """
    measured = np.isfinite(lowest)
    if not measured.any():
        return lowest.copy(), measured
    surveyed = np.where(domain(measured, window / cell), filled(lowest), np.nan)
    ground = measured & ~objects(surveyed, cell, slope, window)
    return filled(np.where(ground, lowest, np.nan)), ground
