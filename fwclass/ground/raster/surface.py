"""What several filters ask of a surface: its slope, what lies too far below it, and where it was surveyed."""

from __future__ import annotations

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from fwclass.ground.raster.opening import disk_opening


def low_limit(surface: NDArray[np.float64], cell: float, slope: float) -> NDArray[np.float64]:
    """Height [m] below which an echo is a low outlier: slope × cell under the closing with one cell's disk."""
    return -disk_opening(-surface, 1) - slope * cell


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
    near = scipy.ndimage.distance_transform_edt(~measured) <= radius
    if near.all():
        return near
    return (scipy.ndimage.distance_transform_edt(near) > radius) | measured
