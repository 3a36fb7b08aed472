"""The coordinate reference system of a file: WKT record, or GeoTIFF keys; PulseWaves stores them as LAS does."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, Protocol

from pyproj import CRS
from pyproj.exceptions import CRSError

from fwclass.errors import visible
from fwclass.formats.epsg import another, epsg_of, projected_named, without_false_codes
from fwclass.formats.grid_files import without_paths
from fwclass.formats.las_header import Record

_USERS = ("LASF_Projection", "LAS_Projection", "liblas", "PulseWaves_Proj")
_WKT, _KEYS, _TEXTS = 2112, 34735, 34737
_GEOGRAPHIC, _PROJECTED, _VERTICAL, VERTICAL_UNITS = 2048, 3072, 4096, 4099
_UNITS = 3076
_USER_DEFINED = 32767
TWO_SYSTEMS = "the file names two coordinate systems"
_TOLD = {
    "none": "the CRS record names no code of EPSG ({}): its other words count",
    "another": TWO_SYSTEMS + ", {}: the words count",
}
FEET = {9002: ("foot", 0.3048), 9003: ("US survey foot", 1200.0 / 3937.0)}
"""Name and metres of the units that are no metres, by EPSG code."""
UNITS = {9001: ("metre", 1.0), **FEET}


class Records(Protocol):
    """A header with its records."""

    @property
    def global_encoding(self) -> int:
        """Bits of a LAS header that say what kind of system is named."""
        ...

    def records(self, number: int, users: tuple[str, ...]) -> list[Record]:
        """Records of a number, of any of `users`."""
        ...


def crs_of(header: Records, faults: list[str]) -> Any:
    """The file's CRS (`pyproj.CRS`) or None; what is wrong with it is appended to `faults`.

    The WKT record is believed first where the header's WKT bit is set or no usable GeoTIFF keys are there.
    """
    ways = [_from_keys, _from_wkt]
    if header.global_encoding & 16 or not header.records(_KEYS, _USERS):
        ways.reverse()
    crs = ways[0](header, faults)
    if crs is None:
        crs = ways[1](header, faults)
    elif (other := ways[1](header, [])) is not None and _elsewhere(crs, other):
        faults.append(f"{TWO_SYSTEMS}, {crs.name} and {other.name}: by its header the first counts")
    if crs is None:
        faults.append("no usable CRS: name one in the configuration")
    elif crs.is_geographic:
        faults.append("the CRS is in degrees: project the file to metres first")
    elif units := units_of(crs):
        faults.append(
            f"the CRS is in {', '.join(units)}: a survey brings them into metres by read.project_to (`fwclass init`)"
        )
    return crs


def doubtful_system(faults: Sequence[str]) -> str:
    """The one of a file's `faults` that says that it names two systems; "" where it names one."""
    return next((fault for fault in faults if fault.startswith(TWO_SYSTEMS)), "")


def _elsewhere(crs: CRS, other: CRS) -> bool:
    """Whether places are in two systems that are known by different codes; their heights may be told by one alone."""
    codes = [epsg_of(one.sub_crs_list[0] if one.is_compound else one) for one in (crs, other)]
    return None not in codes and codes[0] != codes[1]


def units_of(crs: CRS) -> list[str]:
    """Units of its axes that are no metres, sorted."""
    return sorted({a.unit_name for a in crs.axis_info if abs(a.unit_conversion_factor - 1.0) > 1e-9})


@lru_cache(maxsize=4)
def crs_of_wkt(text: str | None) -> CRS | None:
    """The coordinate system that `text` describes, in WKT or otherwise; None for none."""
    return CRS.from_user_input(text) if text else None


def describe_crs(crs: CRS | None) -> dict[str, Any] | None:
    """Its ``name``, ``epsg`` code and whether it is ``projected``, for JSON; None where there is none."""
    return {"name": crs.name, "epsg": epsg_of(crs), "projected": bool(crs.is_projected)} if crs else None


def _from_wkt(header: Records, faults: list[str]) -> CRS | None:
    for record in header.records(_WKT, _USERS):
        text = record.body.split(b"\0")[0].decode("utf-8", "replace").strip()
        if not text:
            continue
        try:
            stated = CRS.from_wkt(text)
        except CRSError:
            faults.append("the CRS record holds no valid WKT")
            continue
        try:
            crs, paths = without_paths(stated)
            if paths:
                faults.append(f"the CRS record names files, as {visible(paths[0])}: the shift by them is left out")
            crs, false = without_false_codes(crs)
            faults += code_faults(false)
            return _in_degrees(crs, faults)
        except CRSError as fault:
            faults.append(f"the CRS record is not used: {visible(str(fault))}")
    return None


def code_faults(false: Sequence[tuple[str, str]]) -> list[str]:
    """Faults of codes that `without_false_codes` has left out."""
    return [_TOLD[kind].format(visible(text)) for kind, text in false]


def _in_degrees(crs: CRS, faults: list[str]) -> CRS:
    """`crs` with its angles in degrees where its writer gave them the unit of length, as some do: that of the prime
    meridian, or that of the projection's parameters alone (a RIEGL's), which PROJ takes for radians."""
    plain = crs.to_json_dict()
    if not _replace_angles(plain):
        return crs
    faults.append("the CRS record counts angles in metres; they are taken for degrees")
    return CRS.from_json_dict(plain)


def _replace_angles(node: Any) -> int:
    """Every angle below `node` that is counted in metres is counted in degrees; how many there are."""
    count = 0
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if not isinstance(value, dict | list):
            continue
        if isinstance(value, dict) and value.get("type") == "AngularUnit":
            if str(value.get("name")).lower() in ("metre", "meter"):
                node[key] = "degree"
                count += 1
        else:
            count += _replace_angles(value)
    return count


def _from_keys(header: Records, faults: list[str]) -> CRS | None:
    for keys in geo_keys(header):
        horizontal = keys.get(_PROJECTED) or keys.get(_GEOGRAPHIC)
        if not horizontal or horizontal == _USER_DEFINED:
            continue
        vertical = keys.get(_VERTICAL)
        codes = [f"EPSG:{horizontal}+{vertical}"] if vertical and vertical != _USER_DEFINED else []
        for code in [*codes, f"EPSG:{horizontal}"]:
            try:
                crs = _with_feet(CRS.from_user_input(code), keys.get(VERTICAL_UNITS, 0))
            except CRSError:
                continue
            if other := _other_keys(header, crs, keys.get(_UNITS, 0)):
                faults.append(f"{TWO_SYSTEMS}, {crs.name} by its code and {other}: the code counts")
            return crs
        faults.append(f"the GeoTIFF keys name an unknown CRS, EPSG:{horizontal}")
    return None


def _other_keys(header: Records, crs: CRS, unit: int) -> str:
    """What the key of the `unit` of x and y, or a citation that is the name of a system, says against `crs`, which the
    code names; "" for nothing."""
    if not crs.axis_info or not (crs.is_projected or crs.is_compound):
        return ""
    name, metres = UNITS.get(unit, ("", crs.axis_info[0].unit_conversion_factor))
    if abs(crs.axis_info[0].unit_conversion_factor / metres - 1.0) > 1e-9:
        return f"one in {name} by its key of units"
    texts = [text for record in header.records(_TEXTS, _USERS) for text in record.body.split(b"\0")[0].split(b"|")]
    named = {text: known for raw in texts if (known := projected_named(text := raw.decode("utf-8", "replace")))}
    return next((f"{text} by its citation" for text, known in named.items() if another(known, crs)), "")


def _with_feet(crs: CRS, unit: int) -> CRS:
    """`crs` with heights in the feet that the key of their unit names, where itself it counts them in metres.

    Writers name NAVD88 by EPSG:5703, which is in metres, or by nothing, and say by this key alone that heights are in
    feet.
    """
    heights = [a for a in crs.axis_info if a.direction == "up"] or [a for a in crs.axis_info if crs.is_projected]
    if unit not in FEET or not heights or abs(heights[0].unit_conversion_factor - 1.0) > 1e-9:
        return crs
    name, metres = FEET[unit]
    flat, above = (*crs.sub_crs_list, None)[:2] if crs.is_compound else (crs, None)
    axis = {"name": "Gravity-related height", "abbreviation": "H", "direction": "up"}
    datum = {"type": "VerticalReferenceFrame", "name": "unknown"}
    plain = above.to_json_dict() if above is not None else {"type": "VerticalCRS", "name": "height", "datum": datum}
    plain |= {"name": f"{plain['name']} ({name})"}
    plain["coordinate_system"] = {
        "subtype": "vertical",
        "axis": [axis | {"unit": {"type": "LinearUnit", "name": name, "conversion_factor": metres}}],
    }
    plain.pop("id", None)
    whole = f"{flat.name} + {plain['name']}"
    return CRS.from_json_dict({"type": "CompoundCRS", "name": whole, "components": [flat.to_json_dict(), plain]})


def geo_keys(header: Records) -> Iterator[dict[int, int]]:
    """Of every record of GeoTIFF keys those with their value in the directory itself (the codes); the first of a kind
    counts."""
    for record in header.records(_KEYS, _USERS):
        keys: dict[int, int] = {}
        for at in range(8, len(record.body) - 7, 8):
            key, place, _, value = struct.unpack_from("<4H", record.body, at)
            if place == 0:
                keys.setdefault(key, value)
        yield keys
