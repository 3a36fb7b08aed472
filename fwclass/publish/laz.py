"""Echoes as LAS 1.4, point format 6, compressed where the name does not end in ``.las``."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from numpy.typing import NDArray

from fwclass.cost import counted
from fwclass.errors import InputError
from fwclass.formats.extra_bytes import ExtraByte, descriptor, extra_bytes, extra_size, pack_columns, published_columns
from fwclass.formats.las_bytes import EXTRA_BYTES, HEADER_SIZE, POINT_SIZE, WKT
from fwclass.formats.laz_writer import assemble, point_writer, record
from fwclass.grid import millimetres
from fwclass.publish.files import written_whole
from fwclass.publish.params import PublishParams
from fwclass.schema import Table, require
from fwclass.units import QUANTUM
from fwclass.waveforms import IMPLAUSIBLE

NEEDED = ("strip", "echo_number", "number_of_echoes", "x", "y", "z", "classification")
STANDARD_GPS_TIME = 1
WITHHELD = 4
"""Classification flag of point format 6: not to be used for anything; other programs leave such points out."""
OFFSET_STEP = 1_000_000
"""The stored coordinates count from a whole kilometre [mm]."""
PER_METRE = 1000
"""Dividing by it rounds once; 0.001 is no binary fraction, and multiplying by it rounds twice."""

POINT6 = np.dtype(
    [
        ("X", "<i4"),
        ("Y", "<i4"),
        ("Z", "<i4"),
        ("intensity", "<u2"),
        ("returns", "u1"),
        ("flags", "u1"),
        ("classification", "u1"),
        ("user_data", "u1"),
        ("scan_angle", "<i2"),
        ("source", "<u2"),
        ("gps_time", "<f8"),
    ]
)


def without(table: Table, names: Iterable[str]) -> Table:
    """`table` less the columns `names` that it has."""
    left = {*names}
    return table.select([name for name in table if name not in left])


@counted("writing")
def write_tile_laz(
    table: Table, path: Path, crs: pyproj.CRS | None, params: PublishParams, *, standard_time: bool = False
) -> dict[str, Any]:
    """Write the echoes of a tile, in the table's row order; the same rows give the same bytes.

    Coordinates are exact millimetres. The point source is the strip's number, as in every other output; the return
    number is the echo number (15 at most, as the format holds four bits). Every column with a LAS name becomes an extra
    byte, in the type and scale that the schema gives it: a whole type holds the nearest number, or the nearest end of
    its range (counted), and its no-data number where the value is NaN; in floating-point types NaN stays NaN.
    A missing `gps_time` is written as 0. The creation date is 0: nothing of the day or the machine is in the file.

    `table`: at least `NEEDED`; `intensity` and `gps_time` if they are there. `crs`: None leaves the file without one.
    `standard_time`: `gps_time` is adjusted standard GPS time, not seconds of the week.

    Returns a dict with ``path, points, extra_bytes (names), beyond (values outside their extra byte's range, by name),
    clipped (echo numbers above 15), without_time, bytes``.

    `InputError`: a column is missing, or coordinates do not fit the format's 32 bits.
    """
    require(table, NEEDED, path)
    extras = extra_bytes(published_columns(table), table)
    offset, whole_mm = local_millimetres(table, path)
    points, counts = point_records(table, whole_mm)
    head = assemble(header_block(extras, points, offset, standard_time), header_records(extras, crs))
    rows = points.view(np.uint8).reshape(len(points), POINT6.itemsize)
    rows = np.concatenate([rows, pack_columns(extras, table)], axis=1) if extras else rows
    with written_whole(path) as beside:
        with beside.open("w+b") as file:
            writer = point_writer(path, file, head)
            for first in range(0, len(rows), params.chunk_points):
                writer.write(rows[first : first + params.chunk_points])
            writer.finish()
        size = beside.stat().st_size
    return {
        "path": str(path),
        "points": table.rows,
        "extra_bytes": [e.las for e in extras],
        "beyond": {e.las: e.beyond for e in extras if e.beyond},
        "bytes": size,
        **counts,
    }


def local_millimetres(table: Table, path: Path) -> tuple[NDArray[np.int64], list[NDArray[np.int64]]]:
    """The offset [mm] and the coordinates from it."""
    axes = [millimetres(table[a]) for a in ("x", "y", "z")]
    low = [int(a.min()) // OFFSET_STEP * OFFSET_STEP if len(a) else 0 for a in axes[:2]]
    offset = np.array([*low, 0], np.int64)
    local = [a - o for a, o in zip(axes, offset, strict=True)]
    for name, values in zip("xyz", local, strict=True):
        if len(values) and (values.min() < -(2**31) or values.max() >= 2**31):
            raise InputError(
                f"coordinate {name} does not fit a LAS file",
                where=path,
                expected="a spread below 2147 km at steps of 1 mm",
                got=f"{table[name].min()} to {table[name].max()}",
                do="remove the outlying points, or correct the CRS",
            )
    return offset, local


def point_records(table: Table, local: list[NDArray[np.int64]]) -> tuple[NDArray, dict[str, int]]:
    """Records of point format 6."""
    out = np.zeros(table.rows, POINT6)
    out["X"], out["Y"], out["Z"] = local
    number, count = table["echo_number"], table["number_of_echoes"]
    out["returns"] = np.minimum(number, 15) | (np.minimum(count, 15) << 4)
    out["classification"] = table["classification"]
    out["source"] = table["strip"]
    if "fit_flags" in table:
        out["flags"] = np.where(table["fit_flags"] & IMPLAUSIBLE, WITHHELD, 0)
    if "intensity" in table:
        out["intensity"] = table["intensity"]
    time = table["gps_time"] if "gps_time" in table else np.full(table.rows, np.nan)
    known = np.isfinite(time)
    out["gps_time"] = np.where(known, time, 0.0)
    return out, {"clipped": int(np.count_nonzero(count > 15)), "without_time": int(np.count_nonzero(~known))}


def header_block(
    extras: tuple[ExtraByte, ...], points: NDArray, offset: NDArray[np.int64], standard_time: bool
) -> bytes:
    """The public header block of the uncompressed file."""
    block = bytearray(HEADER_SIZE[4])
    block[:4], block[24], block[25] = b"LASF", 1, 4
    struct.pack_into("<H", block, 6, WKT | (STANDARD_GPS_TIME if standard_time else 0))
    struct.pack_into("<32s32s", block, 26, b"fwclass", b"fwclass")
    struct.pack_into("<HHH", block, 90, 0, 0, HEADER_SIZE[4])
    struct.pack_into("<BH", block, 104, 6, POINT_SIZE[6] + extra_size(extras))
    struct.pack_into("<6d", block, 131, QUANTUM, QUANTUM, QUANTUM, *(offset / PER_METRE))
    struct.pack_into("<6d", block, 179, *_bounds(points, offset))
    struct.pack_into("<Q", block, 247, len(points))
    by_return = np.bincount(points["returns"] & 15, minlength=16)[1:16]
    struct.pack_into("<15Q", block, 255, *(int(n) for n in by_return))
    return bytes(block)


def header_records(extras: tuple[ExtraByte, ...], crs: pyproj.CRS | None) -> list[bytes]:
    """Variable length records: the CRS, and what the extra bytes are."""
    records = []
    if crs is not None:
        records.append(record("LASF_Projection", 2112, "OGC WKT", wkt(crs).encode() + b"\0"))
    if extras:
        records.append(record(*EXTRA_BYTES, "Extra Bytes Record", b"".join(map(descriptor, extras))))
    return records


def _bounds(points: NDArray, offset: NDArray[np.int64]) -> list[float]:
    """Highest and lowest x, y, z [m], as the stored integers give them."""
    if not len(points):
        return [0.0] * 6
    out = []
    for name, start in zip("XYZ", offset, strict=True):
        out += [(int(points[name].max()) + int(start)) / PER_METRE, (int(points[name].min()) + int(start)) / PER_METRE]
    return out


_last: list[tuple[pyproj.CRS, str]] = []
"""The system that was asked for last, and its text: all tiles have one."""


def wkt(crs: pyproj.CRS) -> str:
    """WKT 1 as LAS 1.4 asks for, or WKT 2 for what only that can say."""
    for known, text in _last:
        if known is crs:
            return text
    try:
        text = str(crs.to_wkt("WKT1_GDAL"))
    except pyproj.exceptions.CRSError:
        text = str(crs.to_wkt("WKT2_2019"))
    _last[:] = [(crs, text)]
    return text
