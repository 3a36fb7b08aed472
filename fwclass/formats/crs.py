"""The coordinate reference system of a file: WKT record, or GeoTIFF keys; PulseWaves stores them as LAS does."""

from __future__ import annotations

import struct
from typing import Any, Protocol

from pyproj import CRS
from pyproj.exceptions import CRSError

from fwclass.errors import visible
from fwclass.formats.grid_files import without_paths
from fwclass.formats.las_header import Record

_USERS = ("LASF_Projection", "LAS_Projection", "liblas", "PulseWaves_Proj")
_WKT, _KEYS = 2112, 34735
_GEOGRAPHIC, _PROJECTED, _VERTICAL = 2048, 3072, 4096
_USER_DEFINED = 32767


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
    crs = None
    for way in ways:
        crs = crs or way(header, faults)
    if crs is None:
        faults.append("no usable CRS: name one in the configuration")
    elif crs.is_geographic:
        faults.append("the CRS is in degrees: project the file to metres first")
    return crs


def epsg_of(crs: CRS) -> int | None:
    """Its EPSG code; None where it has none, or its file gives one that is no number."""
    try:
        code = crs.to_epsg()
    except ValueError:
        return None
    return None if code is None else int(code)


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
            return _in_degrees(crs, faults)
        except CRSError as fault:
            faults.append(f"the CRS record is not used: {visible(str(fault))}")
    return None


def _in_degrees(crs: CRS, faults: list[str]) -> CRS:
    """`crs` with its angles in degrees where its writer gave them the unit of length, as some do."""
    meridian = crs.prime_meridian
    if meridian is None or meridian.unit_name.lower() not in ("metre", "meter"):
        return crs
    faults.append("the CRS record counts angles in metres; they are taken for degrees")
    plain = crs.to_json_dict()
    _replace_angles(plain)
    return CRS.from_json_dict(plain)


def _replace_angles(node: Any) -> None:
    """Every angular unit below `node` becomes the degree."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if isinstance(value, dict) and value.get("type") == "AngularUnit":
            node[key] = "degree"
        elif isinstance(value, dict | list):
            _replace_angles(value)


def _from_keys(header: Records, faults: list[str]) -> CRS | None:
    for record in header.records(_KEYS, _USERS):
        keys = _geo_keys(record.body)
        horizontal = keys.get(_PROJECTED) or keys.get(_GEOGRAPHIC)
        if not horizontal or horizontal == _USER_DEFINED:
            continue
        vertical = keys.get(_VERTICAL)
        codes = [f"EPSG:{horizontal}+{vertical}"] if vertical and vertical != _USER_DEFINED else []
        for code in [*codes, f"EPSG:{horizontal}"]:
            try:
                return CRS.from_user_input(code)
            except CRSError:
                continue
        faults.append(f"the GeoTIFF keys name an unknown CRS, EPSG:{horizontal}")
    return None


def _geo_keys(body: bytes) -> dict[int, int]:
    """Keys with their value in the directory itself (the codes); the first of a kind counts."""
    keys: dict[int, int] = {}
    for at in range(8, len(body) - 7, 8):
        key, place, _, value = struct.unpack_from("<4H", body, at)
        if place == 0:
            keys.setdefault(key, value)
    return keys
