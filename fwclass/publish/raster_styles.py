"""How each delivered raster is drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as Xml

import numpy as np
from numpy.typing import NDArray

from fwclass.publish.qgis_style import HEIGHTS, MANY, SURE, class_raster_style, grey_raster_style, ramp_raster_style

STYLED = (
    *("classes", "confidence", "density"),
    *("dtm", "dsm", "ndsm"),
    *("hillshade", "slope", "roughness", "dtm_mask", "dtm_distance"),
)

MASK = {1: "measured", 2: "interpolated", 3: "extrapolated", 4: "water, flattened", 5: "breakline"}
"""Values of `dtm_mask`."""

STEEP = 60.0
"""Slope that the colours reach [deg]; steeper land is rock."""

DEVIATIONS = 2.0
"""Standard deviations around the mean that colours are spread over: a crane or a pit takes none away."""


class Spread:
    """Count, ends, mean and variance of values that come piece by piece."""

    def __init__(self) -> None:
        self.count, self.total, self.squares = 0, 0.0, 0.0
        self.low, self.high = math.inf, -math.inf

    def add(self, values: NDArray[np.floating]) -> None:
        """Take in `values`; NaN is none."""
        some = values[np.isfinite(values)].astype(np.float64)
        if len(some):
            self.count += len(some)
            self.total += float(some.sum())
            self.squares += float((some**2).sum())
            self.low, self.high = min(self.low, float(some.min())), max(self.high, float(some.max()))

    def shown(self) -> list[float]:
        """The two values that colours are spread between, 0 and 1 where there is no value."""
        if not self.count:
            return [0.0, 1.0]
        mean = self.total / self.count
        around = DEVIATIONS * math.sqrt(max(0.0, self.squares / self.count - mean**2))
        low, high = max(self.low, mean - around), min(self.high, mean + around)
        return [round(low, 2), round(max(high, low + 0.01), 2)]


def raster_style(
    name: str, ranges: Mapping[str, Sequence[float]], names: Mapping[int, str], multiply: bool = False
) -> list[Xml.Element]:
    """Style of a raster of `STYLED`.

    `ranges`: low and high value of every raster of heights and densities. `names`: of classes by code. `multiply`:
    darkened by what lies below, which is the relief in a project.
    """
    if name == "classes":
        return class_raster_style(names, multiply)
    if name == "dtm_mask":
        return class_raster_style(MASK, multiply)
    if name == "hillshade":
        return grey_raster_style(1, 255)
    if name == "confidence":
        return ramp_raster_style(SURE, 0, 100, "%", multiply)
    low, high = ranges[name]
    if name == "density":
        return ramp_raster_style(MANY, low, high, "echoes/m²", multiply)
    if name == "slope":
        return ramp_raster_style(MANY, 0, STEEP, "°", multiply)
    return ramp_raster_style(MANY if name == "roughness" else HEIGHTS, low, high, "m", multiply)
