"""Codes of EPSG that a coordinate system has beside its words, and that are none or another system's.

PROJ goes by the words, GDAL by the code: maps would lie in another system than the echoes, in silence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.database import query_crs_info
from pyproj.enums import PJType
from pyproj.exceptions import CRSError, ProjError

APART = 0.01
"""Metres between places, and between axes of ellipsoids, that rounded numbers explain: EPSG's own systems as WKT 1, of
GDAL and of ESRI, come back to less."""
_AXIS, _TURN = 1e-9, 1e-8
"""Share by which a unit may differ, and radians by which a prime meridian may."""


def epsg_of(crs: CRS) -> int | None:
    """Its EPSG code; None where it has none, or its file gives one that is no number."""
    try:
        code = crs.to_epsg()
    except ValueError:
        return None
    return None if code is None else int(code)


@lru_cache(maxsize=16)
def without_false_codes(crs: CRS) -> tuple[CRS, tuple[tuple[str, str], ...]]:
    """`crs` without the codes of systems that EPSG does not have (a RIEGL's is 0), or has for another system than its
    words describe, and of each of these ``none`` or ``another`` and what it is."""
    plain = crs.to_json_dict()
    faults = [(node, fault) for node in _systems(plain) if (fault := _fault(node))]
    for node, _ in faults:
        del node["id"]
    return (CRS.from_json_dict(plain) if faults else crs), tuple(dict.fromkeys(fault for _, fault in faults))


def without_old_codes(crs: CRS) -> CRS:
    """`crs` without the codes that EPSG has withdrawn: of a GeoTIFF GDAL reads the system that took their place."""
    plain = crs.to_json_dict()
    old = [node for node in _systems(plain) if (known := _known_of(node)) is not None and known.is_deprecated]
    for node in old:
        del node["id"]
    return CRS.from_json_dict(plain) if old else crs


def _known_of(node: Mapping[str, Any]) -> CRS | None:
    """The system of EPSG whose code `node` has."""
    name = node.get("id", {})
    return _known(f"EPSG:{name.get('code')}") if str(name.get("authority")).upper() == "EPSG" else None


def _systems(node: Any, kind: str = "") -> Iterator[dict[str, Any]]:
    """`node` and what lies below it, where that is a coordinate system; `kind` for one that does not say its own."""
    if isinstance(node, dict) and (kind or str(node.get("type", "")).endswith("CRS")):
        node.setdefault("type", kind)
        yield node
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from _systems(value, "GeographicCRS" if key == "base_crs" and "datum" in str(list(value)) else "")


def _fault(node: Mapping[str, Any]) -> tuple[str, str] | None:
    """What is false about the code of EPSG that `node` has; None for nothing, and where it has none."""
    name = node.get("id", {})
    if str(name.get("authority")).upper() != "EPSG":
        return None
    code = f"EPSG:{name.get('code')}"
    known = _known(code)
    if known is None:
        return "none", code
    words = CRS.from_json_dict({key: value for key, value in node.items() if key != "id"})
    return ("another", f"{words.name} by its words and {known.name} by {code}") if another(words, known) else None


@lru_cache(maxsize=64)
def _known(code: str) -> CRS | None:
    """The system that PROJ knows by this code: files of a survey name the same one or two."""
    try:
        return CRS.from_user_input(code)
    except CRSError:
        return None


@lru_cache(maxsize=64)
def projected_named(text: str) -> CRS | None:
    """The projected system that EPSG calls so; None for none."""
    code = _projected_codes().get(text)
    return CRS.from_epsg(int(code)) if code is not None else None


@lru_cache(maxsize=1)
def _projected_codes() -> Mapping[str, str]:
    """Code by name, the first of those that share one: PROJ takes a tenth of a second to list all of them."""
    return {info.name: info.code for info in reversed(query_crs_info("EPSG", PJType.PROJECTED_CRS))}


def another(words: CRS, known: CRS) -> bool:
    """Whether `words` describe another system than the `known` one: another datum, unit or projection, not another
    order of axes or another spelling. Heights count where both tell them."""
    if words.equals(known, ignore_axis_order=True):
        return False
    (plane, heights), (known_plane, known_heights) = _parts(words), _parts(known)
    if heights is not None and known_heights is not None and _other_heights(heights, known_heights):
        return True
    if plane is None or known_plane is None:
        return (plane is None) != (known_plane is None)
    return _other_plane(plane, known_plane)


def _parts(crs: CRS) -> tuple[CRS | None, CRS | None]:
    """Its plane and its heights; None for what it does not tell."""
    parts = [part.source_crs if part.is_bound else part for part in (crs.sub_crs_list or [crs])]
    plane, heights = ([part for part in parts if part.is_vertical == up] for up in (False, True))
    return (plane[0] if plane else None), (heights[0] if heights else None)


def _other_heights(words: CRS, known: CRS) -> bool:
    if words.equals(known):
        return False
    own, axes = epsg_of(words), [crs.axis_info[0] for crs in (words, known)]
    unlike = abs(axes[0].unit_conversion_factor / axes[1].unit_conversion_factor - 1.0) > _AXIS
    return unlike or axes[0].direction != axes[1].direction or (own is not None and _other_datum(own, known))


def _other_datum(own: int, known: CRS) -> bool:
    """Whether the system of the code `own`, by which words are known, has another datum than `known`."""
    datums = [crs.datum for crs in (CRS.from_epsg(own), known)]
    return None not in datums and datums[0].name != datums[1].name


def _other_plane(words: CRS, known: CRS) -> bool:
    bases = words.geodetic_crs, known.geodetic_crs
    if None in bases:
        return True  # of no earth
    if not bases[0].to_2d().equals(bases[1].to_2d(), ignore_axis_order=True):
        one, two = (crs.ellipsoid for crs in bases)
        axes = [(e.semi_major_metre, e.semi_minor_metre) for e in (one, two)]
        turns = [crs.prime_meridian.longitude * crs.prime_meridian.unit_conversion_factor for crs in bases]
        if np.abs(np.subtract(axes[0], axes[1])).max() > APART or abs(turns[0] - turns[1]) > _TURN:
            return True
        own = epsg_of(bases[0].to_2d())
        if own is not None and _other_datum(own, bases[1]):
            return True
    if not (words.is_projected and known.is_projected):
        units = [crs.axis_info[0].unit_conversion_factor if crs.axis_info else 0.0 for crs in (words, known)]
        kinds = [(crs.is_projected, crs.is_geocentric) for crs in (words, known)]
        return kinds[0] != kinds[1] or abs(units[0] - units[1]) > _AXIS * units[1]
    try:
        here, there = (_numbers(crs, known) for crs in (words, known))
    except ProjError:  # of axes that it does not turn; parameters need not be spelled alike
        numbers = [[p.value for p in crs.coordinate_operation.params] for crs in (words, known)]
        return len(numbers[0]) != len(numbers[1]) or not np.allclose(numbers[0], numbers[1], rtol=_AXIS, atol=0.0)
    sound = np.isfinite(there).all(axis=0)
    here, there = here[:, sound], there[:, sound]
    unit = known.axis_info[0].unit_conversion_factor
    return not np.isfinite(here).all() or bool((np.abs(here - there) * unit > APART).any())


def _numbers(crs: CRS, known: CRS) -> NDArray:
    """x and y that `crs` gives nine places of the area of the `known` system, by its own longitudes and latitudes."""
    west, south, east, north = known.area_of_use.bounds
    lon, lat = np.meshgrid(np.linspace(west, east + 360.0 * (east < west), 5)[1:4], np.linspace(south, north, 5)[1:4])
    move = Transformer.from_crs(crs.geodetic_crs.to_2d(), crs.to_2d(), always_xy=True)
    return np.array(move.transform(lon.ravel(), lat.ravel()))
