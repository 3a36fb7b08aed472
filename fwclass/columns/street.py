"""Features of a return of a vehicle's 2-D scanner (Li 2018), in a sphere over frames and beams.

d is the number of returns in the sphere, the return itself included; y the depth (away from the road, the same sign on
both sides), z the height; l1 >= l2 >= l3 the eigenvalues of the covariance of the coordinates, divided by d.
"""

from __future__ import annotations

from typing import Any

from fwclass.columns.record import Column, measured_column

_LI, _DEMANTKE = "Li 2018, 2.2", "Li 2018, eq. 7; Demantke 2011"


def _feature(name: str, unit: str, meaning: str, source: str = _LI, **more: Any) -> Column:
    return measured_column(f"street_{name}", unit, meaning, scales="r", source=source, **more)


STREET = (
    _feature("height_mean", "m", "mean z, above the scanner"),
    _feature("height_variance", "m2", "variance of z", low=0),
    _feature("height_range", "m", "max z - min z", low=0),
    _feature("depth_mean", "m", "mean y, away from the scanner's track"),
    _feature("depth_variance", "m2", "variance of y", low=0),
    _feature("depth_range", "m", "max y - min y", low=0),
    _feature("count", "", "d", low=1),
    _feature("omnivariance", "m2", "(l1 l2 l3)^(1/3)", _DEMANTKE, low=0),
    _feature("linearity", "", "(sqrt l1 - sqrt l2) / sqrt l1", _DEMANTKE, low=0, high=1),
    _feature("planarity", "", "(sqrt l2 - sqrt l3) / sqrt l1", _DEMANTKE, low=0, high=1),
    _feature("sphericity", "", "sqrt l3 / sqrt l1", _DEMANTKE, low=0, high=1),
    _feature("road_height_mean", "m", "mean z, above the road beside the vehicle", "Li 2018, 2.2, from the road"),
    _feature("intensity_mean", "", "mean intensity, share of street.intensity", "fwclass", low=0, high=1),
    _feature("intensity_deviation", "", "standard deviation of the intensities, likewise", "fwclass", low=0, high=0.5),
)
"""The eleven features of the paper in its order, what stands for the first where heights count from the road, and those
of scanners that tell how strong a return is."""
