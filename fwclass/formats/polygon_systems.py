"""The coordinate system of a polygon file by all that names it: words, codes, and what GDAL makes of them.

GDAL goes by codes and names: it calls words of UTM zone 33 EPSG:25832 where that code stands beside them.
"""

from __future__ import annotations

import contextlib
import glob
import re
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from pyproj import CRS
from pyproj.exceptions import CRSError, ProjError

from fwclass.errors import visible
from fwclass.formats.crs import TWO_SYSTEMS, code_faults, crs_of_wkt
from fwclass.formats.epsg import another, without_false_codes
from fwclass.formats.polygon_magic import HEAD, names_of_systems
from fwclass.formats.sqlite_files import open_sqlite
from fwclass.paths import open_regular

MOST_ROWS = 20
"""Rows of a GeoPackage that name a layer's system, of which it should have one."""


def system_named(path: Path, layer: str, answer: str | None) -> tuple[CRS | None, tuple[str, ...]]:
    """The system of a layer, None for none, and what is wrong with how its file names it; `answer` is GDAL's.

    Where the file names two, words count more than codes.
    """
    known = _system(answer)
    if path.suffix.lower() not in (".shp", ".gpkg"):
        return _of_json(path, known)
    words, codes = _of_table(path, layer) if path.suffix.lower() == ".gpkg" else (_of_prj(path), set[str]())
    if words is None:
        return known, ()
    try:
        crs, false = without_false_codes(words)
        if false:
            return crs, tuple(code_faults(false))
        for code in sorted(codes | ({answer} if answer and answer.startswith("EPSG:") else set())):
            other = _system(code)
            if other is not None and another(crs, other):
                return crs, tuple(code_faults([("another", f"{crs.name} by its words and {other.name} by {code}")]))
    except (CRSError, ProjError, RecursionError):  # words of which PROJ makes no other system, nor numbers
        return known, ()
    return known or crs, ()


def _of_prj(path: Path) -> CRS | None:
    """What stands beside a Shapefile."""
    for beside in path.parent.glob(f"{glob.escape(path.stem)}.*"):
        if beside.suffix.lower() == ".prj":
            with open_regular(beside) as file:
                return _words(file.read(HEAD).decode("utf-8-sig", "replace"))
    return None


def _of_table(path: Path, layer: str) -> tuple[CRS | None, set[str]]:
    """What the definition of a layer's system describes, and the codes beside it, and of what else it is called; of
    tables without the columns of a GeoPackage nothing."""
    rows: list[tuple[Any, ...]] = []
    with closing(open_sqlite(path, Path(f"{path}-wal").exists())) as opened, contextlib.suppress(sqlite3.Error):
        columns = [str(row[1]) for row in opened.execute("PRAGMA table_info(gpkg_spatial_ref_sys)")]
        texts = [column for column in ("definition", "definition_12_063") if column in columns]
        asked = ", ".join(["organization", "organization_coordsys_id", *texts])
        for listed in ("gpkg_geometry_columns", "gpkg_contents"):
            mine = f"(SELECT srs_id FROM {listed} WHERE lower(table_name) = lower(?))"  # noqa: S608 (names of tables)
            named = opened.execute(f"SELECT {asked} FROM gpkg_spatial_ref_sys WHERE srs_id IN {mine}", (layer,))  # noqa: S608
            rows += named.fetchmany(MOST_ROWS)
    described = [crs for _, _, *definitions in rows for text in definitions if (crs := _words(text)) is not None]
    names = [crs.to_json_dict().get("id", {}) for crs in described[1:]]
    codes = {f"{name.get('authority')}:{name.get('code')}".upper() for name in names}
    codes |= {f"{organization}:{code}".upper() for organization, code, *_ in rows}
    return (described[0] if described else None), {code for code in codes if re.fullmatch(r"EPSG:\d{1,9}", code)}


def _of_json(path: Path, answer: CRS | None) -> tuple[CRS | None, tuple[str, ...]]:
    """By the names in its text: GDAL takes degrees of WGS 84 for one that it does not know, and the last of several."""
    names = [name for name in names_of_systems(path) if not name.endswith("CRS84")]
    known = [crs for name in names if (crs := _system(name)) is not None]
    degrees = answer is None or not another(answer, CRS.from_epsg(4326))
    if degrees and len(known) < len(names):
        unknown = next(name for name in names if _system(name) is None)
        return None, (f"the file names a coordinate system that is not known, {visible(unknown)}",)
    for crs in known[:-1]:
        if not crs.equals(known[-1], ignore_axis_order=True):
            return known[-1], (f"{TWO_SYSTEMS}, {crs.name} and {known[-1].name}: the last counts",)
    return (known[-1] if known and degrees else answer), ()


def _words(text: object) -> CRS | None:
    """The system that a text in WKT describes."""
    try:
        return _sound(CRS.from_wkt(str(text).strip("\0 \r\n\t")))
    except CRSError:
        return None


def _system(text: str | None) -> CRS | None:
    """The system that a text describes or names."""
    try:
        return _sound(crs_of_wkt(text))
    except CRSError:
        return None


def _sound(crs: CRS | None) -> CRS | None:
    """None for the systems by which GeoPackages say that they have none (OGC 12-128, requirement 11; GDAL)."""
    if crs is not None:
        crs.to_2d()  # what PROJ reads, it need not be able to make another of
    return None if crs is None or crs.name.startswith("Undefined ") else crs
