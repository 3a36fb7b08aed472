"""Grid files that a coordinate system names: whoever makes it, PROJ and GDAL open what lies under the name.

Names of PROJ's own grids (``us_noaa_conus.tif``) are looked for where it keeps them. A path leads anywhere, to a pipe
that never answers for example, so no system that comes from a file is used with one; nor with a name that lies in
the current directory, where PROJ looks too.
"""

from __future__ import annotations

import os
import re
from typing import Any

from pyproj import CRS
from pyproj.exceptions import CRSError

_NAMED = re.compile(
    r"""
    PROJ4_GRIDS ["']? \s* , \s* ["'] ([^"']*)                        # WKT 1, GDAL's extension
    | PARAMETERFILE \s* [\[(] \s* "[^"]*" \s* , \s* "([^"]*)         # WKT 2
    | (?:grids|file|catalog|tinshift|model) \s* = \s* ["']? ([^\s"'+]+)    # PROJ's words: nadgrids, xy_grids …
    | init \s* = \s* (?!["']?(?:epsg|esri|ignf)\s*:) ["']? ([^\s"'+]+)     # a file of definitions
    | init \s* = \s* ["']? (epsg|esri|ignf) \s* :                  # PROJ's own, which it looks for as a file first
    | "value" \s* : \s* "((?:[^"\\]|\\.)*)                           # PROJJSON: other values are numbers
    """,
    re.IGNORECASE | re.VERBOSE,
)


_SPELT = re.compile(
    r"""
    (?:urn:(?:x-)?ogc:def:crs:)? (?!dict:) [A-Z][\w.]* (?::[\w.]*){1,2} (?:\+\d+)?    # EPSG:25832 and as a URN
    | urn:ogc:def:crs(?:,crs:[A-Z]+:[\w.]*:\w+)+                                        # of several systems
    | https?://(?:www\.)?opengis\.net/(?:def/crs|gml/srs)/[\w./#-]+
    | \s* [A-Z][A-Z_0-9]* \s* [\[(] .*                                                # WKT
    | \s* \{ .* | \s* \+ .*                                                          # PROJJSON, PROJ's words
    | (?!\.) (?!.*\.\.) [^:/\\,] [^:\\,]{0,99}                                        # a name: WGS 84 / UTM zone 33N
    """,
    re.IGNORECASE | re.VERBOSE | re.DOTALL,
)


_MARKS = "/\\:"


def names_file(text: str) -> str:
    """What in the text of a coordinate system GDAL or PROJ would open as a file; "" for a code, a name, WKT and PROJ's
    words without any."""
    if paths := paths_named(text):
        return paths[0]
    return "" if _SPELT.fullmatch(text) else text


def paths_named(text: str) -> list[str]:
    """Grid files that a text of a coordinate system (WKT, PROJJSON, PROJ's words) names by a path."""
    names = (name for groups in _NAMED.findall(text) for name in groups)
    return [one.strip().lstrip("@") for name in names for one in name.split(",") if is_path(one)]


def is_path(name: str) -> bool:
    """A name that is not looked for among PROJ's own files alone: PROJ looks in the current directory too."""
    plain = name.strip().lstrip("@")
    if plain.startswith(("~", ".")) or any(mark in plain for mark in _MARKS):
        return True
    return plain != "null" and os.path.lexists(plain)


def without_paths(crs: CRS) -> tuple[CRS, list[str]]:
    """`crs` without the shifts of its datum that need a file by its path, and these files.

    `CRSError` where the system itself is made by such a file, or PROJ reads it and makes no other of it.
    """
    paths: list[str] = []
    try:
        plain = _unbound(crs.to_json_dict(), paths)
        left = _files(plain)
    except RecursionError as fault:
        raise CRSError("a coordinate system nested too deep") from fault
    if left:
        raise CRSError(f"a coordinate system made by the file {left[0]}")
    system = CRS.from_json_dict(plain) if paths else crs
    system.to_2d()
    return system, paths


def _unbound(node: Any, paths: list[str]) -> Any:
    """`node` of a PROJJSON with the source in place of every system that is bound by a file; `paths` gets the files."""
    if isinstance(node, list):
        return [_unbound(one, paths) for one in node]
    if not isinstance(node, dict):
        return node
    if node.get("type") == "BoundCRS" and (files := _files(node.get("transformation"))):
        paths += files
        return _unbound(node["source_crs"], paths)
    return {key: _unbound(value, paths) for key, value in node.items()}


def _files(node: Any) -> list[str]:
    """Files that parameters and methods below `node` of a PROJJSON name by a path: PROJ takes a method's name for its
    own words where it says so (``PROJ-based operation method: +proj=tinshift +file=...``)."""
    if isinstance(node, list):
        return [name for one in node for name in _files(one)]
    if not isinstance(node, dict):
        return []
    value, method = node.get("value"), node.get("method")
    words = str(method.get("name", "")) if isinstance(method, dict) else ""
    own = [value] if isinstance(value, str) and is_path(value) else []
    if "=" in words:
        values = [word.partition("=")[2].strip("\"'") for word in words.split()]
        own += [words] if any(mark in words for mark in _MARKS[:2]) else [v for v in values if is_path(v)]
    return [*own, *(name for one in node.values() for name in _files(one))]
