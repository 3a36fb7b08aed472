"""Places and beams from degrees, or from the middle of the earth, into a projected system."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.crs import GeographicCRS
from pyproj.crs.coordinate_system import Ellipsoidal3DCS
from pyproj.exceptions import CRSError, ProjError

from fwclass.errors import InputError
from fwclass.units import METRES_PER_NS

Floats = NDArray[np.float64]

REACH = 100.0
"""Time along a beam [ns] that is projected: 15 m, over which no plane curves away by more than 0.02 mm."""

LONGER = 1.5
"""From so many times light's way in air on, a beam is none."""

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
    source : geographic (longitude, latitude [degrees], height [m]), geocentric [m], or projected.
    target : projected, in metres. What it says of heights is not followed: they stay as they are, and of geocentric
        places they are those above the source's own ellipsoid.
    places : those that are not finite stay so.
    where : named in errors.

    `InputError`: `target` is not projected or not in metres, there is no way from one to the other, or a place is
    beyond it.
    """
    points = np.asarray(places, np.float64).reshape(-1, 3)
    x, y, z = points.T
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
