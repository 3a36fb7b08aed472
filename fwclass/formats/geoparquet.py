"""GeoParquet 1.x: the header, and the rows of a field with geometries as well-known binary."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyproj import CRS
from pyproj.exceptions import CRSError

from fwclass.errors import InputError, first_line
from fwclass.formats.crs import code_faults
from fwclass.formats.epsg import without_false_codes
from fwclass.formats.grid_files import without_paths
from fwclass.formats.parquet_footer import SPARE, check_unpacked
from fwclass.formats.vector import Header
from fwclass.lazy_module import LazyModule
from fwclass.paths import open_regular

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq
else:
    pa, pc, pq = LazyModule("pyarrow"), LazyModule("pyarrow.compute"), LazyModule("pyarrow.parquet")

_CODE = re.compile(r"[A-Za-z]+:[A-Za-z0-9]+")
"""Authority and code."""

EACH = 200
"""Bytes that one of a file unpacks to, at most."""

ROW = 100
"""Bytes that a feature takes beside what it holds."""

WITHOUT_CRS = "OGC:CRS84"
"""What a column that does not speak of its CRS is in (GeoParquet 1.1)."""


def header(path: Path) -> Header:
    """What the file holds; ``column`` names the geometry beside the keys of `vector.header`.

    `InputError`: no Parquet, no GeoParquet, or another encoding than well-known binary.
    """
    try:
        return _header(path)
    except (KeyError, TypeError, AttributeError, RecursionError) as fault:
        raise _foreign(path, "metadata of another shape") from fault


def _header(path: Path) -> Header:
    with _opened(path) as file:
        schema, features = file.schema_arrow, file.metadata.num_rows
    if len(set(schema.names)) < len(schema.names):
        raise _foreign(path, "a column that is there twice")
    about = _geo(path, schema)
    column = about.get("primary_column")
    columns = about.get("columns")
    if not isinstance(columns, dict) or not isinstance(columns.get(column), dict) or column not in schema.names:
        raise _foreign(path, "metadata that names no geometry column")
    own = columns[column]
    binary = pa.types.is_binary(schema.field(column).type) or pa.types.is_large_binary(schema.field(column).type)
    if own.get("encoding") != "WKB" or not binary:
        raise InputError(
            "the geometries are encoded in a way that is not read",
            where=f"{path}: column {column}",
            expected="encoding WKB",
            got=own.get("encoding"),
            do="write the file again with WKB geometries (geopandas: geometry_encoding='WKB')",
        )
    boxes = {_root(path) for path in (own.get("covering") or {}).get("bbox", {}).values()}
    fields = {f.name: str(f.type) for f in schema if f.name != column and f.name not in boxes}
    kinds = own.get("geometry_types") or []
    crs, faults = _crs(path, own)
    return {
        "layer": path.stem,
        "fields": fields,
        "crs": crs,
        "faults": faults,
        "features": int(features),
        "geometry": ", ".join(map(str, kinds)) or "unknown",
        "column": column,
    }


def rows(path: Path, geometry: str, field: str | None) -> tuple[list[Any], list[bytes | None]]:
    """As `vector.rows`, for the column `geometry`."""
    return columns(path, [field])[field] if field else [], columns(path, [geometry])[geometry]


def columns(path: Path, names: Sequence[str]) -> dict[str, list[Any]]:
    """Values of columns, in the file's order; what all of them take is checked before they are written out."""
    name, held = "", dict[str, list[Any]]()
    try:
        left = SPARE + EACH * path.stat().st_size
        with _opened(path, names) as file:
            for name in names:
                _check_rows(file.metadata, left)
                values = file.read([name]).column(name)
                left -= _check_size(values, left)
                held[name] = [value for chunk in values.chunks for value in _plain(chunk).to_pylist()]
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, OverflowError) as fault:
        raise _foreign(path, f"column {name}: {fault}") from fault
    return held


def _check_rows(footer: Any, most: int) -> None:
    """`ValueError` where a column of all rows takes more bytes: Arrow makes them whatever the file holds of them."""
    rows = [footer.num_rows, sum(footer.row_group(g).num_rows for g in range(footer.num_row_groups))]
    if ROW * max(rows) > most:
        raise ValueError(f"{max(rows):,} rows, which take more than {most:,} bytes")


def _check_size(values: Any, most: int) -> int:
    """Bytes that values take, written out; `ValueError` for more than `most`."""
    total = ROW * len(values)
    for chunk in values.chunks:
        if pa.types.is_dictionary(chunk.type):
            total += pc.sum(pc.binary_length(chunk.dictionary).cast(pa.int64()).take(chunk.indices)).as_py() or 0
    if total > most:
        raise ValueError(f"values that take more than {most:,} bytes")
    return total


def _plain(chunk: Any) -> Any:
    return chunk.dictionary_decode() if pa.types.is_dictionary(chunk.type) else chunk


def _opened(path: Path, names: Sequence[str] = ()) -> Any:
    """The file; texts and bytes of the columns `names` are read as often as they are written."""
    try:
        with open_regular(path) as stream:  # Arrow would wait for a pipe
            check_unpacked(stream, path.stat().st_size, EACH)
        return pq.ParquetFile(path, read_dictionary=list(names) or None)
    except (pa.ArrowException, OSError, ValueError) as fault:
        raise _foreign(path, first_line(fault)) from fault


def _geo(path: Path, schema: Any) -> dict[str, Any]:
    text = (schema.metadata or {}).get(b"geo")
    if text is None:
        raise _foreign(path, "Parquet without geographic metadata")
    try:
        about = json.loads(text)
    except ValueError as fault:
        raise _foreign(path, "metadata that is no JSON") from fault
    if not isinstance(about, dict):
        raise _foreign(path, "metadata that is no object")
    return about


def _root(path: Any) -> str:
    return str(path[0]) if isinstance(path, list) and path else ""


def _crs(path: Path, own: dict[str, Any]) -> tuple[CRS | None, tuple[str, ...]]:
    """PROJJSON of the column, and what is wrong with its codes; longitude and latitude where it says nothing, None
    where it says null."""
    stated = own.get("crs", WITHOUT_CRS)
    if isinstance(stated, str) and not _CODE.fullmatch(stated):  # PROJ's own words could name files
        raise _foreign(path, "a coordinate system that is neither PROJJSON nor a code")
    if stated is None:
        return None, ()
    try:
        crs = CRS.from_user_input(stated)
        if without_paths(crs)[1]:
            raise _foreign(path, "a coordinate system that names a file by its path")
        crs, false = without_false_codes(crs)
        return crs, tuple(code_faults(false))
    except (CRSError, TypeError) as fault:
        raise _foreign(path, "a coordinate system that cannot be understood") from fault


def _foreign(path: Path, got: str) -> InputError:
    return InputError(
        "this is no GeoParquet file that can be read",
        where=path,
        expected="GeoParquet 1.0 or 1.1",
        got=got,
        do="write it again, for example with geopandas or GDAL",
    )
