"""Files in feet, by the length of their beam vectors."""

from __future__ import annotations

from typing import Any

from fwclass.formats.crs import units_of
from fwclass.formats.projected import metric_twin

FEET = (2.8, 3.4)
"""Lengths, in light's way there and back, of vectors in feet, or whose heights alone are, up to 30 degrees off the
plumb line."""


def in_metres(length: float, otherwise: str, source: Any = None) -> str:
    """What to do where beam vectors are `length` times as long as light's way, which no sane one is, in a `source` or a
    table; `otherwise` where they are in metres by `read.project_to` already."""
    if not FEET[0] <= length <= FEET[1] or (source is not None and source.target is not None):
        return otherwise
    of_source = "" if source is None else setting_for(source)
    return of_source or "bring the file into metres first: its heights, or x, y and z, look like feet"


def setting_for(source: Any) -> str:
    """The setting that brings `source` into metres; "" where it is in metres, or in degrees, or brought already."""
    crs = source.crs
    if source.target is not None or crs is None or not crs.is_projected or not units_of(crs):
        return ""
    return f"--set read.project_to={metric_twin(crs) or 'EPSG:<code>'} brings the file into metres as it is read"
