"""Whether a file of polygons is what its name says, before GDAL sees it."""

from __future__ import annotations

import glob
import json
import os
import re
import sqlite3
import struct
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from fwclass.errors import InputError, visible
from fwclass.formats.checks import cut_off
from fwclass.formats.extents import read_extents
from fwclass.formats.grid_files import names_file, paths_named
from fwclass.formats.sqlite_files import SIGNATURE, open_sqlite, page_fault, schema_fault
from fwclass.paths import open_regular, open_sized, strange_kind

GEOPACKAGE = (b"GPKG", b"GP10", b"GP11")
"""Application ids of SQLite files: OGC 12-128, requirement 2, of all versions."""

SHAPEFILE = (9994).to_bytes(4, "big")
JSON_TYPES = {
    b"Feature",
    b"FeatureCollection",
    b"Point",
    b"MultiPoint",
    b"LineString",
    b"MultiLineString",
    b"Polygon",
    b"MultiPolygon",
    b"GeometryCollection",
}
"""RFC 7946, section 1.4."""

_JSON_MEMBERS = {b"features", b"geometry", b"geometries", b"coordinates"}
"""Members of such an object; its type may come after them."""

HEAD = 65536
"""Bytes of a JSON file in which its type, or a member that tells it, must be found."""

MOST_NAMES = 20
"""Coordinate systems that a GeoJSON text names, of which one is used."""

_TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*"|[{}\[\]:,]|[^\s"{}\[\]:,]+')
_PLAIN = re.compile(rb"""(?:[^"'/]++|"(?:[^"\\]++|\\.)*+")*+""", re.DOTALL)
"""JSON as far as its texts stand in double quotes and it has no comments: GDAL reads others too."""

_SYSTEM = re.compile(
    rb'"(?:c|\\u00[46]3)(?:r|\\u00[57]2)(?:s|\\u00[57]3)(?:(?:\\u0000|\0)(?:[^"\\]|\\.)*+)?"\s*:\s*(?=\{)',
    re.IGNORECASE,
)
"""The member crs, its letters as they are or as escapes; to GDAL a name ends where it has a zero."""


def check_format(path: Path) -> None:
    """`InputError` where the file is not regular, cut short, or holds something else than the ending of its name says.

    GDAL would read what is left of a short one, and open anything else by whatever driver knows it.
    """
    ending = path.suffix.lower()
    for beside in path.parent.glob(f"{glob.escape(path.stem)}.*"):  # GDAL opens those that belong to a file as it does
        if kind := strange_kind(beside):
            raise _other(path, f"{kind} beside it, {beside.name}", "remove it")
    file, size = open_sized(path)
    with file:
        head = file.read(HEAD)
    promised = 0
    if ending == ".shp":
        fault = "" if head.startswith(SHAPEFILE) else "no Shapefile begins so"
        promised = 2 * int.from_bytes(head[24:28], "big") if len(head) >= 32 else 0
    elif ending == ".gpkg":
        fault = "" if head.startswith(SIGNATURE) and head[68:72] in GEOPACKAGE else "no GeoPackage begins so"
        page = int.from_bytes(head[16:18], "big")
        promised = (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
    else:
        fault = _json_fault(head)
    if fault:
        raise _other(path, fault)
    if promised > size:
        raise InputError(
            "the polygon file is cut short",
            where=path,
            expected=f"{promised} bytes",
            got=f"{size} bytes",
            do="copy the file again",
        )
    if ending == ".gpkg":
        _check_tables(path, _looks(path), _looks(Path(f"{path}-wal")))
    elif ending == ".shp":
        _check_beside(path)
    else:
        names_of_systems(path)


def _other(path: Path, got: str, do: str = "convert it, for example with ogr2ogr") -> InputError:
    return InputError(
        "the polygon file is not what its name says",
        where=path,
        expected="GeoPackage (.gpkg), GeoJSON (.geojson, .json) or Shapefile (.shp)",
        got=got,
        do=do,
    )


def _json_fault(head: bytes) -> str:
    """Why `head` is not the beginning of a GeoJSON text; "" if it is."""
    depth, key, value_next = 0, b"", False
    for at, token in enumerate(_TOKEN.findall(head.removeprefix(b"\xef\xbb\xbf"))):
        if at == 0 and token != b"{":
            return "no JSON object"
        if depth == 1 and token == b":":
            value_next = True
            if key in _JSON_MEMBERS:
                return ""
        elif depth == 1 and value_next:
            value_next = False
            if key == b"type":
                kind = token.strip(b'"')
                return "" if kind in JSON_TYPES else f"a JSON object of type {kind[:40].decode(errors='replace')}"
        elif depth == 1:
            key = token.strip(b'"')
        depth += (token in (b"{", b"[")) - (token in (b"}", b"]"))
        if depth == 0:
            break
    return "a JSON object without a type of GeoJSON"


def names_of_systems(path: Path) -> tuple[str, ...]:
    """Names of the coordinate systems in a GeoJSON text, in its order, each once, at most `MOST_NAMES`.

    `InputError` where one is an address, which GDAL would fetch; without it, it takes degrees.
    """
    return _names_of_systems(path, _looks(path))


@lru_cache(maxsize=16)  # all of the file is read, and each layer of it asks
def _names_of_systems(path: Path, *_: tuple[int, ...]) -> tuple[str, ...]:
    text = _text_of(path)
    plain = _PLAIN.match(text)
    if plain is not None and plain.end() < len(text):
        raise _other(path, f'what JSON has not at byte {plain.end()}: a comment, or a text in other quotes than "')
    names: dict[str, None] = {}
    for members in _systems_in(path, text):
        for key, value in members:
            if key in ("href", "url") or (key == "type" and value in ("link", "url")):
                raise _other(
                    path,
                    "a coordinate system that is to be fetched from an address",
                    "export it with a coordinate system that is named, such as EPSG:25832",
                )
            named = names_file(value) if key == "name" else next(iter(paths_named(value)), "")
            _refuse_file(path, named)
        if ("type", "name") in members and len(names) < MOST_NAMES:
            names |= dict.fromkeys(value for key, value in members if key == "name")
    return tuple(names)[:MOST_NAMES]


def _text_of(path: Path) -> bytes:
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        text = file.read(size)  # not mapped: where it is cut off meanwhile, the process would end by a signal
    if len(text) < size:
        raise cut_off(path, size, len(text))
    return text


def _systems_in(path: Path, text: bytes) -> Iterator[list[tuple[str, str]]]:
    """Every name with a text in each of the objects that are called crs."""
    for key in _SYSTEM.finditer(text):
        yield _members(path, text[key.end() : key.end() + HEAD].decode("utf-8", "replace"))


def _members(path: Path, text: str) -> list[tuple[str, str]]:
    """Every name with a text, in the JSON object that `text` begins with, those of objects in it too."""
    members: list[tuple[str, str]] = []

    def note(pairs: list[tuple[str, Any]]) -> None:
        members.extend((key.partition("\0")[0].lower(), value) for key, value in pairs if isinstance(value, str))
        members.extend(("", v) for _, value in pairs if isinstance(value, list) for v in value if isinstance(v, str))

    try:
        json.JSONDecoder(object_pairs_hook=note, strict=False).raw_decode(text)
    except (ValueError, RecursionError) as error:
        raise _other(
            path,
            f"a coordinate system that is no JSON object of at most {HEAD} bytes ({error})",
            "export it with a coordinate system that is named, such as EPSG:25832",
        ) from error
    return members


def _check_beside(path: Path) -> None:
    """`InputError` where the coordinate system beside a Shapefile names a file by its path, which GDAL would open, or
    its index leads to more than there is, or index and attributes are of another number of records than it."""
    counts = {}
    for beside in path.parent.glob(f"{glob.escape(path.stem)}.*"):
        if beside.suffix.lower() == ".shx":
            counts[beside.name] = _check_index(path, beside)
        if beside.suffix.lower() == ".dbf":
            with open_regular(beside) as file:
                counts[beside.name] = int.from_bytes(file.read(8)[4:], "little")
        if beside.suffix.lower() == ".prj":
            with open_regular(beside) as file:
                text = file.read(HEAD + 1)
            if len(text) > HEAD:
                raise _other(path, f"a coordinate system of more than {HEAD} bytes, {beside.name}")
            _refuse_file(path, next(iter(paths_named(text.decode("utf-8", "replace"))), ""))
    if len(set(counts.values())) > 1:
        raise _other_records(path, " and ".join(f"{n} in {name}" for name, n in sorted(counts.items())))


def _other_records(path: Path, got: str) -> InputError:
    return InputError(
        "the parts of the Shapefile do not belong together",
        where=path,
        expected="as many records in .shp, .shx and .dbf",
        got=got,
        do="copy all of its files again, or export the polygons again",
    )


def _check_index(path: Path, index: Path) -> int:
    """Records of the index of a Shapefile; `InputError` where it leads to them over and over, as each would be held as
    often, or where another record follows the last that it leads to."""
    with open_regular(index) as file:
        entries = file.read()[100:]
    places = 2 * np.frombuffer(entries, ">i4", len(entries) // 8 * 2)[::2].astype(np.int64)
    size = path.stat().st_size
    inside = places[(places >= 0) & (places + 8 <= size)]
    lengths = read_extents(path, inside + 4, inside + 8, size)
    words = lengths.data[lengths.place[:, None] + np.arange(4)].view(">i4").astype(np.int64)
    total = int(2 * words.clip(0).sum()) + 8 * len(inside)
    if total > size:
        raise _other(path, f"an index of {total} bytes of records, {index.name}", "export the polygons again")
    count = len(places)
    end = int((inside + 8 + 2 * words.clip(0)).max(initial=100))
    if end + 12 <= size:
        following = read_extents(path, np.array([end]), np.array([end + 12]), size).data.tobytes()
        number, length, _ = struct.unpack(">iii", following)
        if number == count + 1 and length >= 2 and end + 8 + 2 * length <= size:
            raise _other_records(path, f"{count} in {index.name}, and more behind them in {path.name}")
    return count


def _refuse_file(path: Path, named: str) -> None:
    """`InputError` where a coordinate system names a file, "" for none."""
    if named:
        raise _other(
            path,
            f"a coordinate system that names the file {visible(named)}",
            "export it with a coordinate system that is named, such as EPSG:25832",
        )


def _looks(path: Path) -> tuple[int, ...]:
    """What tells without reading whether a file is another one, () where there is none."""
    try:
        facts = path.stat()
    except OSError:
        return ()
    return facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


@lru_cache(maxsize=16)  # all of the file is read, and each layer of it asks
def _check_tables(path: Path, *_: tuple[int, ...]) -> None:
    """`InputError` for tables that read other files (virtual ones, but for the indices of the format itself), and for
    what is computed while it is read, for as long as its maker likes: views and generated columns."""
    try:
        opened = open_sqlite(path, Path(f"{path}-wal").exists())
        try:
            asked = (_virtual, schema_fault, page_fault, _misnamed, _miscounted)
            fault = next((said for question in asked if (said := question(opened))), "")
            systems = [] if fault else _systems(opened)
        finally:
            opened.close()
    except (sqlite3.Error, UnicodeDecodeError) as error:  # SQLite quotes damaged names in its messages
        raise _other(path, f"a GeoPackage that cannot be read: {error}", "export the polygons again") from error
    if fault:
        raise _other(path, fault, "export the polygons alone, as a table (ogr2ogr does)")
    for text in systems:
        _refuse_file(path, next(iter(paths_named(text)), ""))


def _systems(opened: sqlite3.Connection) -> list[str]:
    """Texts of the coordinate systems that the file defines."""
    name = "gpkg_spatial_ref_sys"
    columns = [str(row[1]) for row in opened.execute(f"PRAGMA table_info({name})")]
    texts = [column for column in columns if column.lower().startswith("definition")]
    rows = opened.execute(f"SELECT {', '.join(texts)} FROM {name}") if texts else ()  # noqa: S608 (names of two columns)
    return [str(text) for row in rows for text in row if text]


def _misnamed(opened: sqlite3.Connection) -> str:
    """The fault of a layer whose name is no text, which GDAL takes for one; "" without one."""
    for name in ("gpkg_contents", "gpkg_geometry_columns", "gpkg_ogr_contents"):
        if opened.execute("SELECT 1 FROM sqlite_master WHERE lower(name) = ?", (name,)).fetchone():
            for (kind,) in opened.execute(f"SELECT typeof(table_name) FROM {name}"):  # noqa: S608 (one of three)
                if kind != "text":
                    return f"a layer in {name} whose name is {kind}, not text"
    return ""


def _miscounted(opened: sqlite3.Connection) -> str:
    """The fault of a layer that says another number of rows than it has: memory is taken for what it says."""
    if not opened.execute("SELECT 1 FROM sqlite_master WHERE lower(name) = 'gpkg_ogr_contents'").fetchone():
        return ""
    tables = {str(name).lower() for (name,) in opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for name, count in opened.execute("SELECT table_name, feature_count FROM gpkg_ogr_contents").fetchall():
        if count is not None and name.lower() in tables:
            quoted = '"' + str(name).replace('"', '""') + '"'
            rows = opened.execute(f"SELECT count(*) FROM {quoted}").fetchone()[0]  # noqa: S608 (quoted)
            if rows != count:
                return f"a layer {visible(str(name))} that says it has {count} rows, and has {rows}"
    return ""


def _virtual(opened: sqlite3.Connection) -> str:
    """The fault of a virtual table, "" without one."""
    for (text,) in opened.execute("SELECT sql FROM sqlite_master WHERE sql LIKE '%virtual%'"):
        kind = re.search(r"create\s+virtual\s+table.*?\busing\s+[\"'`\[]?(\w+)", str(text), re.IGNORECASE | re.DOTALL)
        if kind and kind[1].lower() not in ("rtree", "fts3", "fts4", "fts5"):
            return f"a table that reads other files ({kind[1]})"
    return ""
