"""Light on a terrain model."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fwclass.publish.params import PublishParams


def flat_light(params: PublishParams) -> float:
    """Light on level ground."""
    return math.sin(math.radians(params.sun_altitude))


def hillshade(dtm: NDArray[np.float32], cell: float, params: PublishParams) -> NDArray[np.float32]:
    """Light on the terrain, 0 to 1: the cosine between surface normal and sun (Horn 1981).

    A cell without height is lit as flat ground is.
    """
    flat = flat_light(params)
    if min(dtm.shape) < 2:
        return np.full(dtm.shape, flat, np.float32)
    north, east = np.gradient(dtm.astype(np.float64) * params.exaggeration, cell)
    azimuth, altitude = math.radians(params.sun_azimuth), math.radians(params.sun_altitude)
    sun = (math.sin(azimuth) * math.cos(altitude), math.cos(azimuth) * math.cos(altitude), math.sin(altitude))
    light = (-east * sun[0] - north * sun[1] + sun[2]) / np.sqrt(1 + east**2 + north**2)
    return np.where(np.isfinite(light), np.clip(light, 0, 1), flat).astype(np.float32)
