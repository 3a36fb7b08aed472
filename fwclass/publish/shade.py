"""Light on a terrain model, and its slope."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.publish.params import PublishParams

AT_ONCE = 1 << 18
"""Cells that are lit together."""


def flat_light(params: PublishParams) -> float:
    """Light on level ground."""
    return math.sin(math.radians(params.sun_altitude))


def hillshade(dtm: NDArray[np.float32], cell: float, params: PublishParams) -> NDArray[np.float32]:
    """Light on the terrain, 0 to 1: the cosine between surface normal and sun (Horn 1981).

    A cell without height is lit as flat ground is. At the border of the terrain the slope is that towards the
    neighbour that has a height. Beside the two rasters there is memory for a strip of rows alone.
    """
    light = np.empty(dtm.shape, np.float32)
    rows = max(1, AT_ONCE // max(1, dtm.shape[1]))
    for row in range(0, len(dtm), rows):
        first = max(0, row - 1)
        light[row : row + rows] = _light(dtm[first : row + rows + 1], cell, params)[row - first :][:rows]
    return light


def _light(dtm: NDArray[np.float32], cell: float, params: PublishParams) -> NDArray[np.float32]:
    heights = dtm.astype(np.float64) * params.exaggeration
    north, east = slope_along(heights, 0) / cell, slope_along(heights, 1) / cell
    azimuth, altitude = math.radians(params.sun_azimuth), math.radians(params.sun_altitude)
    sun = (math.sin(azimuth) * math.cos(altitude), math.cos(azimuth) * math.cos(altitude), math.sin(altitude))
    light = (-east * sun[0] - north * sun[1] + sun[2]) / np.sqrt(1 + east**2 + north**2)
    return np.where(np.isfinite(dtm), np.clip(light, 0, 1), flat_light(params)).astype(np.float32)


def slope(dtm: NDArray[np.float32], cell: float) -> NDArray[np.float32]:
    """Angle of the terrain against the level [deg] (Horn 1981: the eight neighbours, those along the axes doubly).

    `dtm`: (n + 2, m + 2) heights [m] of the raster and one cell around.

    Returns (n, m); NaN where one of the nine heights is missing, as `gdaldem slope` has it.
    """
    z = dtm.astype(np.float64)
    across, along = z[:-2] + 2.0 * z[1:-1] + z[2:], z[:, :-2] + 2.0 * z[:, 1:-1] + z[:, 2:]
    east, north = across[:, 2:] - across[:, :-2], along[2:] - along[:-2]
    known = np.isfinite(z[1:-1, 1:-1])  # which its own slope does not ask for
    return np.where(known, np.degrees(np.arctan(np.hypot(east, north) / (8.0 * cell))), np.nan).astype(np.float32)


def slope_along(heights: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Mean rise per cell to the two neighbours along an axis; to the only one that has a height; 0 without any."""
    rise = np.diff(heights, axis=axis)
    known = np.isfinite(rise)
    rise[~known] = 0.0
    ends = [(1, 1) if k == axis else (0, 0) for k in range(heights.ndim)]
    total, number = np.pad(rise, ends), np.pad(known.astype(np.uint8), ends)
    before, after = (
        tuple(s if k == axis else slice(None) for k in range(2)) for s in (slice(None, -1), slice(1, None))
    )
    return (total[before] + total[after]) / np.maximum(number[before] + number[after], 1)
