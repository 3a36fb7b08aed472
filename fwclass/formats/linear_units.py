"""Lengths of a coordinate system in metres: x and y, and z, which may be counted in another unit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from fwclass.errors import InputError
from fwclass.formats.crs import UNITS, VERTICAL_UNITS, Records, geo_keys
from fwclass.formats.flat import DEGREES, GEOCENTRIC, words


@dataclass(frozen=True)
class LinearUnits:
    """What a unit of the coordinates is.

    `xy`, `z`: metres in one unit. `source`: in words, where these come from.
    """

    xy: float
    z: float
    source: str

    @property
    def metres(self) -> bool:
        """All coordinates are metres."""
        return self.xy == 1.0 and self.z == 1.0


def linear_units(crs: Any, header: Records | None, where: object) -> LinearUnits:
    """Units of a file's coordinates.

    `crs`: `pyproj.CRS`, or None: metres are assumed. `header`: may say the unit of heights (GeoTIFF key 4099) where the
    CRS has no vertical axis.

    `InputError`: degrees, or coordinates that count from the middle of the earth.
    """
    if crs is None:
        return LinearUnits(1.0, 1.0, "no coordinate system: metres are assumed")
    if crs.is_geographic or crs.is_geocentric:
        raise InputError(
            words(DEGREES if crs.is_geographic else GEOCENTRIC, crs),
            where=where,
            expected="a projected coordinate system: every distance here is a length",
            got=crs.name,
            do="reproject the file first (for example with PDAL's filters.reprojection or las2las)",
        )
    axes = [a for part in (crs.sub_crs_list or [crs]) for a in part.axis_info]
    flat = [a for a in axes if a.direction.lower() not in ("up", "down")]
    up = [a for a in axes if a.direction.lower() in ("up", "down")]
    across = _unit(flat[0]) if flat else ("metre", 1.0)
    named = _vertical_key(header) if header is not None else None
    high = _unit(up[0]) if up else named or across
    name = f"{crs.name}, in {across[0]}" if across == high else f"{crs.name}, x and y in {across[0]}, z in {high[0]}"
    if not up and named is None and across[1] != 1.0:
        name += " (no vertical unit is named: z taken to be in the same)"
    return LinearUnits(across[1], high[1], name)


def _unit(axis: Any) -> tuple[str, float]:
    factor = float(axis.unit_conversion_factor)
    return (axis.unit_name, factor) if math.isfinite(factor) and factor > 0 else ("metre", 1.0)


def _vertical_key(header: Records) -> tuple[str, float] | None:
    """The unit of heights that the GeoTIFF keys name."""
    units = (keys.get(VERTICAL_UNITS) for keys in geo_keys(header))
    return next((UNITS[unit] for unit in units if unit in UNITS), None)
