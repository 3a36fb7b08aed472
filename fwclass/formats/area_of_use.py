"""Whether places lie where their coordinate system is used, at heights where land is, and times are times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from pyproj import Proj, Transformer
from pyproj.exceptions import CRSError, ProjError

from fwclass.errors import InputError
from fwclass.formats.crs import Records, doubtful_system
from fwclass.formats.epsg import epsg_of
from fwclass.formats.linear_units import linear_units
from fwclass.units import ADJUSTED, GPS_WEEK, LAND

LEAST_MARGIN, MOST_MARGIN = 1.0, 10.0
"""Degrees around the area of a system, between these: its own width beside it, as whole countries keep one UTM zone
far into the next ones (Bornholm lies half a zone away from Denmark's), and half of its height above and below."""

ROUNDED = 0.05
"""Degrees, 5 km, by which bounds of areas of use are rounded: no difference between two systems."""

STRETCHED = 0.05
"""Logarithm of the ratio of lengths: below 0.002 in systems of surveys, up to 0.03 in those of a continent, 0.37 in Web
Mercator at 46 degrees."""

LATEST_GPS = 1e10
"""s, 300 years: no GPS time, of a week or of an epoch, is larger."""


def place_faults(crs: Any, low: Sequence[float], high: Sequence[float], header: Records | None = None) -> list[str]:
    """What is odd about places within `low` and `high` (x, y, z in units of `crs`).

    `crs`: `pyproj.CRS`, or None, of which only heights are looked at, as metres. `header`: may say the unit of heights,
    as `linear_units` takes it.

    Returns a sentence for places outside of the area that the system is used in, one for heights where no
    land is; none of numbers that are NaN, and of a system without such an area.
    """
    faults = [outside_of_area(crs, low, high) or stretched_words(crs, low, high)]
    unit = _metres_of_height(crs, header)
    lowest, highest = low[2] * unit, high[2] * unit
    if lowest < LAND[0] or highest > LAND[1]:
        faults.append(
            f"heights from {lowest:,.1f} to {highest:,.1f} m reach where no land is, below {LAND[0]:g} m or above "
            f"{LAND[1]:g} m: look at their unit"
        )
    return [fault for fault in faults if fault]


def elsewhere(crs: Any, low: Sequence[float], high: Sequence[float], header: Records | None = None) -> bool:
    """No place within `low` and `high` can be where `crs` and z say, or lengths are none there: what `place_faults`
    says holds for all."""
    unit = _metres_of_height(crs, header)
    return (
        bool(outside_of_area(crs, low, high) or stretched_words(crs, low, high))
        or high[2] * unit < LAND[0]
        or low[2] * unit > LAND[1]
    )


def place_facts(
    crs: Any,
    low: Sequence[float],
    high: Sequence[float],
    header: Records | None = None,
    own: Any = None,
    of_file: Sequence[str] = (),
) -> dict[str, Any]:
    """``remarks`` (`place_faults`, `overruled_words`, `doubtful_system`) and ``elsewhere``, as
    `report.facts.judge_place` takes them; `own`: the system that the file names, where a user names `crs`; `of_file`:
    the faults of its header."""
    faults, away = place_faults(crs, low, high, header), elsewhere(crs, low, high, header)
    worse = "" if away else overruled_words(crs, own, low, high)
    doubt = doubtful_system(of_file) if crs is own else ""
    return {"remarks": [text for text in (worse, doubt) if text] + faults, "elsewhere": away or bool(worse)}


def overruled_words(crs: Any, own: Any, low: Sequence[float], high: Sequence[float]) -> str:
    """The sentence for a box that lies further outside of the area of `crs`, which a user names, than of that of its
    file's `own` system; "" for none."""
    if own is None or crs is own:
        return ""
    used, named = (place_in_area(one, low, high) for one in (crs, own))
    if used is None or named is None or used[0] <= named[0] + ROUNDED:
        return ""
    inside = f"{named[0]:.1f}° outside of its area" if named[0] else "in its area"
    return (
        f"{used[1]}, {used[0]:.1f}° outside of the area that {crs.name} is used in; by {own.name}, which the file "
        f"names, {named[1]}, {inside}"
    )


def outside_of_area(crs: Any, low: Sequence[float], high: Sequence[float]) -> str:
    """The sentence for a box of which neither the middle nor a corner lies near the system's area; "" for none.

    `low`, `high`: least and largest x and y in units of `crs`; further numbers are not looked at.
    """
    in_degrees = _in_degrees(crs, low, high)
    if in_degrees is None:
        return ""
    name, bounds, lons, lats = in_degrees
    if any(_near(bounds, lon, lat) for lon, lat in zip(lons, lats, strict=True)):
        return ""
    xs, ys = _five(low, high)
    west, south, east, north = bounds
    return (
        f"x {xs[4]:.0f}, y {ys[4]:.0f} is {_place(lons[4], lats[4])} in {name}, which is used from "
        f"{_degrees(south, 'NS')} {_degrees(west, 'EW')} to {_degrees(north, 'NS')} {_degrees(east, 'EW')}: are x and "
        "y swapped, or is it another system?"
    )


def away_from_area(crs: Any, x: Sequence[float], y: Sequence[float]) -> list[bool]:
    """Whether each of some finite places (in units of `crs`) lies not even near the area that its system is used in;
    none does where nothing tells."""
    flat = _horizontal(crs) if crs is not None else None
    if flat is None or flat.area_of_use is None or not flat.is_projected:
        return [False] * len(x)
    try:
        lons, lats = Transformer.from_crs(flat, flat.geodetic_crs, always_xy=True).transform(list(x), list(y))
    except (CRSError, ProjError):
        return [False] * len(x)
    return [not _near(flat.area_of_use.bounds, lon, lat) for lon, lat in zip(lons, lats, strict=True)]


def place_in_area(crs: Any, low: Sequence[float], high: Sequence[float]) -> tuple[float, str] | None:
    """How far a box lies outside of the area that its system is used in [degrees], by the nearest of its middle and
    corners, 0 within; and where its middle is, in words. None where nothing tells.

    `low`, `high`: least and largest x and y in units of `crs`; further numbers are not looked at.
    """
    in_degrees = _in_degrees(crs, low, high)
    if in_degrees is None:
        return None
    _, bounds, lons, lats = in_degrees
    away = min(_beyond(bounds, lon, lat) for lon, lat in zip(lons, lats, strict=True))
    return away, _place(lons[4], lats[4])


def _in_degrees(
    crs: Any, low: Sequence[float], high: Sequence[float]
) -> tuple[str, tuple[float, ...], list[float], list[float]] | None:
    """Name and area of a system, and longitudes and latitudes of `_five`; None where one of them is not known."""
    if crs is None or not all(map(math.isfinite, (*low[:2], *high[:2]))):
        return None
    flat = _horizontal(crs)
    area = flat.area_of_use
    if area is None or not flat.is_projected:
        return None
    try:
        lons, lats = Transformer.from_crs(flat, flat.geodetic_crs, always_xy=True).transform(*_five(low, high))
    except (CRSError, ProjError):
        return None
    return flat.name, area.bounds, lons, lats


def _five(low: Sequence[float], high: Sequence[float]) -> tuple[list[float], list[float]]:
    """x and y of the corners of a box and, last, of its middle."""
    (west, south), (east, north) = low[:2], high[:2]
    middle = (west + east) / 2.0, (south + north) / 2.0
    return [west, west, east, east, middle[0]], [south, north, south, north, middle[1]]


def stretched_words(crs: Any, low: Sequence[float], high: Sequence[float]) -> str:
    """The sentence for a system whose lengths are off those on the ground by more than `STRETCHED` in the middle and in
    all corners of a box, as those of Web Mercator are away from the equator; "" for none.

    `low`, `high`: least and largest x and y in units of `crs`; further numbers are not looked at.
    """
    if crs is None or not all(map(math.isfinite, (*low[:2], *high[:2]))):
        return ""
    flat = _horizontal(crs)
    if not flat.is_projected:
        return ""
    try:
        lons, lats = Transformer.from_crs(flat, flat.geodetic_crs, always_xy=True).transform(*_five(low, high))
        scales = Proj(flat).get_factors(lons, lats, errcheck=False)
        with np.errstate(all="ignore"):  # places beyond the system's reach
            ratio = np.abs(np.log([scales.tissot_semimajor, scales.tissot_semiminor]))
    except (CRSError, ProjError, ValueError):
        return ""
    if not (np.isfinite(ratio).all() and (ratio.max(axis=0) > STRETCHED).all()):
        return ""
    axes = (scales.tissot_semimajor[-1], scales.tissot_semiminor[-1])
    off = max(axes, key=lambda scale: abs(math.log(scale)))
    return (
        f"a length of 1 on the ground is one of {off:.2f} in {flat.name} there: distances, areas, densities and slopes "
        "are off by as much; bring the files into a system that is made for the place (UTM, or the country's own)"
    )


def time_faults(first: float, last: float) -> list[str]:
    """A sentence for GPS times [s] that are none; none for those that are, or not finite."""
    most = max(abs(first), abs(last))
    if not most > LATEST_GPS or not (math.isfinite(first) and math.isfinite(last)):
        return []
    years = most / 3.156e7
    return [f"GPS times reach {most:.3g} s, {years:{',.0f' if years < 1e9 else '.3g'}} years: they are not in seconds"]


def dates(first: float, last: float) -> bool:
    """Whether GPS times [s] that are called adjusted standard time are it: neither those of a week nor of another
    epoch, which would be dates in September 2011 and beyond 2043."""
    return -ADJUSTED <= first <= last < ADJUSTED and not 0.0 <= first <= last <= GPS_WEEK


def kind_faults(first: float, last: float, standard: bool) -> list[str]:
    """A sentence for GPS times [s] that are not of the kind that their file says: adjusted `standard` time, or seconds
    of the week; none for times that are, or not finite."""
    if not (math.isfinite(first) and math.isfinite(last)) or first == last:
        return []
    span = f"GPS times are {first:,.0f} to {last:,.0f} s,"
    if standard and not dates(first, last):
        other = "seconds of the week" if last <= GPS_WEEK else "seconds of another epoch (1970, 1980)"
        return [f"{span} {other}, though they are called adjusted standard time: they tell no date"]
    if not standard and (first < 0.0 or last > 2.0 * GPS_WEEK):  # seconds of a week run on where a flight does
        return [f"{span} though they are called seconds of the week: adjusted standard time?"]
    return []


def _metres_of_height(crs: Any, header: Records | None) -> float:
    try:
        return linear_units(crs, header, "").z
    except InputError:  # degrees beside heights, which are told elsewhere
        return 1.0


def _horizontal(crs: Any) -> Any:
    """The part of `crs` that x and y are of; with the area that its code has where its own words name none."""
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    if flat.area_of_use is None and (code := epsg_of(flat)) is not None:
        flat = type(crs).from_epsg(code)
    return flat


def _near(bounds: Sequence[float], lon: float, lat: float) -> bool:
    west, south, east, north = bounds
    wide = (east - west) % 360.0 or 360.0
    beside, above = (min(MOST_MARGIN, max(LEAST_MARGIN, size)) for size in (wide, (north - south) / 2.0))
    return south - above <= lat <= north + above and (lon - west + beside) % 360.0 <= wide + 2.0 * beside


def _beyond(bounds: Sequence[float], lon: float, lat: float) -> float:
    """Degrees, of latitude or longitude, that a place lies outside of an area; infinite where it is nowhere."""
    west, south, east, north = bounds
    if not math.isfinite(lon + lat):
        return math.inf
    wide, along = (east - west) % 360.0 or 360.0, (lon - west) % 360.0
    beside = 0.0 if along <= wide else min(along - wide, 360.0 - along)
    return max(beside, south - lat, lat - north)


def _place(lon: float, lat: float) -> str:
    return f"{_degrees(lat, 'NS')} {_degrees(lon, 'EW')}" if math.isfinite(lon + lat) else "nowhere on earth"


def _degrees(angle: float, sides: str) -> str:
    return f"{abs(angle):.1f}° {sides[angle < 0.0]}"
