"""Places and beams from degrees, from feet, or from the middle of the earth, into a projected system in metres."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.crs import GeographicCRS
from pyproj.crs.coordinate_system import Ellipsoidal3DCS
from pyproj.exceptions import CRSError, ProjError

from fwclass.errors import InputError
from fwclass.formats.crs import units_of
from fwclass.units import METRES_PER_NS

Floats = NDArray[np.float64]

REACH = 100.0
"""Time along a beam [ns] that is projected: 15 m, over which no plane curves away by more than 0.02 mm."""

LONGER = 1.5
"""From so many times light's way in air on, a beam is none."""

LIKE = 20
"""Percent, PROJ's confidence in a code whose name differs; unit and datum are looked at again."""

NORTH_END, SOUTH_END = 84.0, -80.0
"""Latitudes [degrees] beyond which there are no UTM zones but the polar systems."""


def utm_of(longitude: Floats, latitude: Floats) -> CRS:
    """WGS 84 / UTM of the zone in which the median place [degrees] lies; beyond the zones the polar system (UPS)."""
    east = np.asarray(longitude, np.float64) % 360.0
    if np.ptp(east) > 180.0:  # around Greenwich
        east = (east + 180.0) % 360.0 - 180.0
    lon, lat = float(np.median(east) + 180.0) % 360.0, float(np.median(latitude))
    if lat > NORTH_END or lat < SOUTH_END:
        return CRS.from_epsg(32661 if lat > 0.0 else 32761)
    return CRS.from_epsg((32600 if lat >= 0.0 else 32700) + int(lon // 6.0) + 1)


def project(source: CRS, target: CRS, places: Floats, where: object = "") -> Floats:
    """`places` (n, 3) of `source` in the projected system `target`: x east, y north [m].

    Parameters
    ----------
    source : geographic (longitude, latitude [degrees]), geocentric [m], or projected. Heights are in the unit that it
        names for them, else in that of a projected system's x and y, else in metres.
    target : projected, in metres. What it says of heights is not followed: they become metres and stay what they are,
        and of geocentric places they are those above the source's own ellipsoid.
    places : those that are not finite stay so.
    where : named in errors.

    `InputError`: `target` is not projected or not in metres, there is no way from one to the other, or a place is
    beyond it.
    """
    points = np.asarray(places, np.float64).reshape(-1, 3)
    x, y, z = points.T
    z = z * height_unit(source)
    try:
        flat = target.to_2d()
        if not flat.is_projected or any(abs(a.unit_conversion_factor - 1.0) > 1e-9 for a in flat.axis_info):
            raise InputError(
                "the coordinate system is not one of metres on a plane",
                where=where,
                expected="a projected system, for example EPSG:25832",
                got=target.name,
            )
        if source.is_geocentric:
            above = CRS.from_wkt(
                GeographicCRS(datum=source.datum.to_json_dict(), ellipsoidal_cs=Ellipsoidal3DCS()).to_wkt()
            )
            x, y, z = Transformer.from_crs(source, above, always_xy=True).transform(x, y, z, errcheck=False)
            source = above
        x, y = Transformer.from_crs(source.to_2d(), flat, always_xy=True).transform(x, y, errcheck=False)
    except (CRSError, ProjError) as fault:
        raise InputError(
            "there is no way from one coordinate system to the other",
            where=where,
            expected=f"from {source.name} to {target.name}",
            got=str(fault),
        ) from None
    there = np.stack([x, y, z], axis=1)
    lost = int((~np.isfinite(there).all(axis=1) & np.isfinite(points).all(axis=1)).sum())
    if lost:
        raise InputError(
            "places lie where the coordinate system does not reach",
            where=where,
            expected=f"{source.name} within the reach of {target.name}",
            got=f"{lost} of {len(points)} places beyond it",
            do="name the system of this area",
        )
    return there


def height_unit(crs: CRS) -> float:
    """Metres in a unit of the heights of `crs`."""
    axes = [a for a in crs.axis_info if a.direction == "up"] or (crs.axis_info if crs.is_projected else [])
    return float(axes[0].unit_conversion_factor) if axes else 1.0


def metric_twin(crs: CRS) -> str:
    """The same projection, of the same datum, in metres, with heights of the same zero where these have a code:
    ``EPSG:32118+5703``; "" where no code is known for it."""
    parts = [CRS(part) for part in crs.sub_crs_list] if crs.is_compound else [crs]
    if not parts[0].is_projected:
        return ""
    codes = [_metric_code(part) for part in parts]
    return "EPSG:" + "+".join(str(code) for code in codes if code is not None) if codes[0] is not None else ""


def _metric_code(crs: CRS) -> int | None:
    """The code of `crs` with lengths in metres."""
    plain = crs.to_json_dict()
    if "coordinate_system" not in plain:  # bound to another by its writer's shift: no code has that
        return None
    for axis in plain["coordinate_system"]["axis"]:
        axis["unit"] = "metre"
    for one in plain.get("conversion", {}).get("parameters", ()):
        unit = one.get("unit")
        if isinstance(unit, dict) and unit.get("type") == "LinearUnit":
            one |= {"value": one["value"] * unit["conversion_factor"], "unit": "metre"}
    for named in (plain, plain.get("conversion", {})):
        named.pop("id", None)
        named["name"] = re.sub(r" \((ft|ftUS|foot|US [Ss]urvey f(ee|oo)t)\)", "", named.get("name", ""))
    code = CRS.from_json_dict(plain).to_epsg(LIKE)
    metric = None if code is None else CRS.from_epsg(code)
    same = metric is not None and not units_of(metric) and str(metric.datum) == str(crs.datum)
    return code if same else None


def project_beams(source: CRS, target: CRS, places: Floats, steps: Floats, where: object = "") -> tuple[Floats, Floats]:
    """`places` (n, 3) and the `steps` (n, 3) of beams through them, in units of `source` a nanosecond, in `target`.

    Both ends of `REACH` along the beam are projected, so that it is turned by the convergence of the meridians and has
    the plane's own scale. A place should lie near what the beam hits: from the sensor on, the earth curves.
    `InputError` as `project`, and where half of the beams are no longer as long as light's way, for they were in other
    units than their places.
    """
    ends = project(source, target, np.concatenate([places, places + REACH * steps]), where)
    here, there = ends[: len(places)], ends[len(places) :]
    turned = (there - here) / REACH
    length = np.linalg.norm(turned, axis=1) / METRES_PER_NS
    length = length[np.isfinite(length)]
    if len(length) and (middle := float(np.median(length))) > LONGER:
        raise InputError(
            "the beams are not in the units of their places",
            where=where,
            expected=f"vectors along x, y and z in the units of {source.name} a picosecond or sample",
            got=f"beams that are {middle:.3g} times as long as light's way when they are read so (median)",
            do="export the file in a projected system",
        )
    return here, turned
